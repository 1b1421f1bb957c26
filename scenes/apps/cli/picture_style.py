"""The style of palpate's pictures for papers, and how they are saved: for feel_picture.py and trace_picture.py."""
import signal
import sys

signal.signal(signal.SIGINT, signal.SIG_DFL)  # no traceback after Ctrl-C: palpate reports the interrupt

import warnings  # noqa: E402

import matplotlib  # noqa: E402

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

DPI = 300
AXES = "xyz"
# The horizontal and the vertical axis: x points to the right, z points up.
PLANES = ((0, 1), (0, 2), (1, 2))
# Colours of Okabe and Ito, which colour-blind people can distinguish.
BLUE, ORANGE, GREEN, RED, PURPLE, SKY = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7",
                                         "#56B4E9")
STYLE = {"font.size": 7, "axes.titlesize": 8, "axes.labelsize": 7, "legend.fontsize": 6,
         "xtick.labelsize": 6, "ytick.labelsize": 6, "axes.linewidth": 0.6, "lines.linewidth": 0.7,
         "xtick.major.width": 0.6, "ytick.major.width": 0.6, "xtick.major.size": 2.5,
         "ytick.major.size": 2.5, "legend.borderpad": 0.3, "legend.handlelength": 1.6,
         "legend.framealpha": 0.85, "legend.edgecolor": "none", "axes.axisbelow": True,
         "pdf.fonttype": 42, "svg.fonttype": "none", "svg.hashsalt": "palpate"}


def use():
    """Applies this style instead of the user's matplotlib configuration."""
    plt.style.use("default")
    matplotlib.rcParams.update(STYLE)
    warnings.filterwarnings("ignore", message="Glyph .* missing")  # the font lacks letters of some names


def save(figure, kind, made_by):
    """Writes the figure to standard output as png, pdf or svg, without dates: equal figures give equal bytes."""
    metadata = {"png": {"Software": made_by},
                "pdf": {"Creator": made_by, "CreationDate": None},
                "svg": {"Creator": made_by, "Date": None}}[kind]
    figure.savefig(sys.stdout.buffer, format=kind, dpi=DPI, metadata=metadata)
