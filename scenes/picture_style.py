"""How palpate's pictures for papers look, and how they are saved; used by the scripts beside it."""
import signal
import sys

signal.signal(signal.SIGINT, signal.SIG_DFL)  # palpate says that it was interrupted

import warnings  # noqa: E402

import matplotlib  # noqa: E402

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

DPI = 300
AXES = "xyz"
# Across and up: x is always to the right, z always up.
PLANES = ((0, 1), (0, 2), (1, 2))
# Okabe and Ito's colours, which the colour-blind tell apart.
BLUE, ORANGE, GREEN, RED, PURPLE, SKY = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7",
                                         "#56B4E9")
STYLE = {"font.size": 7, "axes.titlesize": 8, "axes.labelsize": 7, "legend.fontsize": 6,
         "xtick.labelsize": 6, "ytick.labelsize": 6, "axes.linewidth": 0.6, "lines.linewidth": 0.7,
         "xtick.major.width": 0.6, "ytick.major.width": 0.6, "xtick.major.size": 2.5,
         "ytick.major.size": 2.5, "legend.borderpad": 0.3, "legend.handlelength": 1.6,
         "legend.framealpha": 0.85, "legend.edgecolor": "none", "axes.axisbelow": True,
         "pdf.fonttype": 42, "svg.fonttype": "none", "svg.hashsalt": "palpate"}


def use():
    """Whatever the user's own style is."""
    plt.style.use("default")
    matplotlib.rcParams.update(STYLE)
    warnings.filterwarnings("ignore", message="Glyph .* missing")  # of a name in other letters


def save(figure, kind, made_by):
    """To standard output, as png, pdf or svg. No dates: the same bytes every time."""
    metadata = {"png": {"Software": made_by},
                "pdf": {"Creator": made_by, "CreationDate": None},
                "svg": {"Creator": made_by, "Date": None}}[kind]
    figure.savefig(sys.stdout.buffer, format=kind, dpi=DPI, metadata=metadata)
