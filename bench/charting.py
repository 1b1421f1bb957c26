"""Common code of the benchmarks' charts: their style, their files, and tables in Markdown."""
import argparse
import io
import json
import math
import re
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

BEGIN = "<!-- numbers: begin -->"
END = "<!-- numbers: end -->"


class Page:
    """A Markdown page whose marked part the tables replace. Without a page, the tables go to standard output."""

    def __init__(self, path):
        self.path = path
        text = path.read_text() if path else ""
        if path and (BEGIN not in text or END not in text):
            sys.exit(f"{path}: no {BEGIN} ... {END}")
        if path:
            self.head, rest = text.split(BEGIN, 1)
            self.tail = rest.split(END, 1)[1]

    def fill(self, tables):
        if self.path is None:
            print(tables)
        else:
            self.path.write_text(f"{self.head}{BEGIN}\n\n{tables}\n{END}{self.tail}")


def prepare(folder):
    folder.mkdir(parents=True, exist_ok=True)
    plt.rcParams["svg.hashsalt"] = "palpate"
    plt.rcParams["svg.fonttype"] = "none"


def clear(ax):
    """Draws a faint grid, and removes the frame's upper and right lines."""
    ax.grid(color="#e8e8e8", linewidth=0.5)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def save(figure, folder, name):
    figure.savefig(folder / f"{name}.png", bbox_inches="tight", dpi=110,
                   metadata={"Software": None})
    drawing = io.StringIO()
    figure.savefig(drawing, format="svg", bbox_inches="tight",
                   metadata={"Date": None, "Creator": None})
    plt.close(figure)
    # Cuts coordinates after two decimals: a hundredth of a point is not visible, and the file is smaller.
    short = re.sub(r"(\d\.\d\d)\d+", r"\1", drawing.getvalue())
    (folder / f"{name}.svg").write_text(short)


def table(head, body):
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(map(str, line)) + " |" for line in body]
    return "\n".join(lines)


def number(x):
    """Formats with two digits below 1 and at least three digits from 1 on. Numbers below 1e-3 and from 1e5 on have two
    digits and an exponent."""
    if x == 0:
        return "0"
    if 1e-3 <= abs(x) < 1e5:
        digits = 2 if abs(x) >= 1 else 1
        return f"{x:.{max(0, digits - math.floor(math.log10(abs(x))))}f}"
    return f"{x:.1e}"


def run(description, draw, tables):
    """The main function of a chart's program: draws RESULT.json into FOLDER, and writes the tables to the page or to
    standard output."""
    parser = argparse.ArgumentParser(description=description.split("\n", maxsplit=1)[0])
    parser.add_argument("result", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--doc", type=Path, help="a page whose marked part the tables replace")
    arguments = parser.parse_args()
    page = Page(arguments.doc)
    prepare(arguments.folder)
    data = json.loads(arguments.result.read_text())
    draw(data, arguments.folder)
    page.fill(tables(data))


def where(machine):
    """Returns the machine, the build and the clock's resolution, in one line."""
    return (f"{machine['processor']}, {machine['compiler']}, `{machine['flags']}`, commit "
            f"{machine['commit']}, {'pinned' if machine['pinned'] else 'not pinned'}, clock step "
            f"{machine['clock_step_ns']:.0f} ns")
