#!/usr/bin/python3
"""Draws traces of `palpate feel`, a column each: JSON on standard input, a picture on standard output.

The argument is the format, png, pdf or svg. The JSON names the traces: {"made_by": TEXT, "runs": [{"name": TEXT,
"descriptor": N}, ...]}, with an open descriptor for each. With --told FILE, the script writes the drawn content to FILE
as JSON. If a trace is invalid, the script draws nothing, writes {"refused": {"run": INDEX, "line": N, "reason": TEXT,
"remedy": TEXT}} to FILE and ends with status 1; line 0 is the whole file. With --check, the script only checks whether
matplotlib is installed.
"""
import sys

sys.dont_write_bytecode = True  # importing picture_style must not write a file into this folder

from picture_style import (AXES, BLUE, DPI, GREEN, ORANGE, PLANES, PURPLE, RED, SKY,  # noqa: E402
                           save, use)

import json  # noqa: E402
import math  # noqa: E402
from array import array  # noqa: E402

import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.collections import LineCollection  # noqa: E402
from matplotlib.colors import ListedColormap  # noqa: E402
from matplotlib.lines import Line2D  # noqa: E402
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator  # noqa: E402

LONGEST = 65534  # bytes of a row
LINE = 1000      # sections of a line over time; a section shows its smallest and largest value
PATH = 60000     # largest number of sections of a path, to be divided by the number of runs
BINS = 60        # bins of the histogram
NUMBERS = ["t", *(f"{what}_{a}" for what in ("probe", "proxy", "force") for a in AXES),
           "error_bound", "tick_ns", "limited"]
# Names of the statuses in the engine. A status in ALWAYS has a lane even if it does not occur.
STATUSES = ["converged", "hairpin", "substep-limit", "iteration-limit", "dropped", "fault"]
ALWAYS = ("converged", "substep-limit", "fault")
CODES = {word: code for code, word in enumerate(STATUSES)}
WRITE = "write a trace with palpate feel SCENE --trace T.csv"
CORRECT = "correct or remove the row"
SHARES = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999}
COLOURS = dict(zip(STATUSES, (BLUE, PURPLE, ORANGE, SKY, GREEN, RED)), limited="black")
# Colours of the force, from pale (zero) to dark (the largest). The palest colours of the map are left out.
FORCES = ListedColormap(plt.get_cmap("magma_r")(np.linspace(0.15, 0.95, 256)))


class Refused(Exception):
    """A trace is invalid. The arguments are the number of the line, the reason and the remedy."""


class Run:
    """A trace, and the quantities that are drawn."""

    def __init__(self, name, descriptor):
        self.name = name
        with open(descriptor, "rb") as file:
            table, self.status = read(file)
        self.t = table[:, 0]
        self.probe, self.proxy = 1e3 * table[:, 1:4], 1e3 * table[:, 4:7]  # [mm]
        forces = table[:, 7:10]
        self.force = np.linalg.norm(forces, axis=1)
        self.gap = np.linalg.norm(self.probe - self.proxy, axis=1)
        self.bound = table[:, 10]
        self.tick = 1e-3 * table[:, 11]  # [us]
        self.limited = table[:, 12] != 0
        # The force of a tick acts until the next reading of the hand. Work in N mm is energy in mJ.
        work = np.einsum("ij,ij->i", forces[:-1], np.diff(self.probe, axis=0))
        self.energy = np.concatenate([[0.0], np.cumsum(np.nan_to_num(work))])
        # Maps the name of a share to the smallest time that this share of the ticks does not exceed, as in the summary
        # of `palpate feel`.
        ticks = np.sort(self.tick[np.isfinite(self.tick)])
        self.percentiles = {word: float(ticks[max(0, math.ceil(share * len(ticks)) - 1)])
                            for word, share in SHARES.items()} if len(ticks) else {}

    def lane(self, word):
        """Returns for each tick whether it has this status; for "limited", whether its force was limited."""
        return self.limited if word == "limited" else self.status == CODES[word]

    def told(self):
        """Returns the numbers of the run, for users without the picture."""
        counts = {word: int(np.count_nonzero(self.lane(word))) for word in STATUSES}
        return {"name": self.name, "ticks": len(self.t), "seconds": float(self.t[-1] - self.t[0]),
                "force_max": most(self.force), "gap_max_mm": most(self.gap),
                "error_bound_max": most(self.bound),
                "error_bound_zero": int(np.count_nonzero(self.bound == 0)),
                "energy_mJ": float(self.energy[-1]),
                "tick_us": {**self.percentiles, "max": most(self.tick)},
                "status": {word: count for word, count in counts.items() if count},
                "limited": int(np.count_nonzero(self.limited))}


def rows(file):
    """Yields the number and the fields of each line that is not blank. Reads at most LONGEST bytes of a line."""
    number = 0
    try:
        while line := file.readline(LONGEST + 1):
            number += 1
            if len(line) > LONGEST:
                raise Refused(number, f"it is longer than {LONGEST} bytes", WRITE)
            text = line.decode("utf-8", "replace").strip()
            if text:
                yield number, text.split(",")
    except OSError as error:
        raise Refused(0, f"reading failed after line {number}", "check the disk") from error


def checked(line, name, field):
    """Returns the number in a field. An empty field becomes NaN: the tick has no value in this column."""
    if not field and name != "t":
        return math.nan
    try:
        value = float(field)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise Refused(line, f'{name}: "{field}" is not a finite number', CORRECT)
    return value


def read(file):
    """Returns the numbers and the statuses of a trace's ticks. Raises Refused if a row is invalid."""
    lines = rows(file)
    header = [name.strip() for name in next(lines, (0, [""]))[1]]
    header[0] = header[0].removeprefix("\ufeff").strip()
    for name in (*NUMBERS, "status"):
        if name not in header:
            raise Refused(0, f'it is not a trace: the column "{name}" is missing', WRITE)
    columns = [header.index(name) for name in NUMBERS]
    status = header.index("status")
    numbers, statuses = array("d"), bytearray()
    before = -math.inf
    for line, fields in lines:
        if len(fields) != len(header):
            raise Refused(line, f"it has {len(fields)} fields instead of {len(header)}", CORRECT)
        try:
            values = [float(fields[column]) for column in columns]
        except ValueError:
            values = [math.nan]
        if not math.isfinite(sum(values)):
            values = [checked(line, name, fields[column].strip()) for name, column in zip(NUMBERS, columns)]
        word = fields[status].strip()
        if word not in CODES:
            raise Refused(line, f'"{word}" is not a status', CORRECT)
        if values[0] < before:
            raise Refused(line, "its time is earlier than in the row above", "give a trace of one run")
        before = values[0]
        numbers.extend(values)
        statuses.append(CODES[word])
    if not statuses:
        raise Refused(0, "it has no rows", WRITE)
    return np.frombuffer(numbers).reshape(-1, len(NUMBERS)), np.frombuffer(statuses, "u1")


def most(values):
    values = values[np.isfinite(values)]
    return float(values.max()) if len(values) else None


def least(values):
    largest = most(-values)
    return None if largest is None else -largest


def kept(columns, stretches):
    """Returns the rows to draw: in each section, those in which a column has its smallest or largest value."""
    count = len(columns[0])
    if count <= 2 * stretches:
        return np.arange(count)
    ends = np.linspace(0, count, stretches + 1).astype(int)
    rows = {0, count - 1}
    for column in columns:
        for fill, place in ((np.inf, np.argmin), (-np.inf, np.argmax)):
            filled = np.where(np.isfinite(column), column, fill)
            rows.update(int(a + place(filled[a:b])) for a, b in zip(ends[:-1], ends[1:]))
    return np.array(sorted(rows))


def along(path, force, step, stretches):
    """Returns the rows of a path to draw: both ends of each tick that ends a section of length `step`, the ends of
    the path, and the row of the largest force. If there were more than `stretches` sections, they are longer than
    `step`."""
    steps = np.nan_to_num(np.linalg.norm(np.diff(path, axis=0), axis=1))
    way = np.concatenate([[0.0], np.cumsum(steps)])
    leaves = np.flatnonzero(np.diff(np.floor(way / max(step, way[-1] / stretches))))
    strongest = int(np.argmax(np.nan_to_num(force)))
    more = [0, strongest, min(strongest + 1, len(path) - 1), len(path) - 1]
    return np.unique(np.concatenate([leaves, leaves + 1, more]))


def spans(marks, t, stretches):
    """Returns the intervals of time in which ticks are marked, to the resolution of `stretches` sections."""
    ends = np.linspace(0, len(t), min(len(t), stretches) + 1).astype(int)
    some = np.maximum.reduceat(marks.astype("u1"), ends[:-1])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], some, [0]])))
    tick = (t[-1] - t[0]) / max(1, len(t) - 1)
    starts = np.append(t, t[-1] + tick)
    return [(starts[ends[a]], starts[ends[b]] - starts[ends[a]])
            for a, b in zip(edges[::2], edges[1::2])]


def limits(low, high, margin=0.05):
    """Returns the limits of an axis: `low` and `high` with a margin, and never with zero width."""
    room = margin * (high - low) or 0.05 * abs(high) or 1.0
    return low - room, high + room


def together(runs, of):
    """Returns the smallest and the largest finite value of all runs; 0 and 0 if there are none."""
    values = [v[np.isfinite(v)] for v in map(of, runs)]
    values = [v for v in values if v.size]
    return (float(min(v.min() for v in values)), float(max(v.max() for v in values))) if values else (0.0, 0.0)


class Picture:
    """A column of panels for each run. Panels in one row show the same quantity with the same range."""

    def __init__(self, runs):
        self.runs = runs
        self.panels = []
        self.lines = {}  # the line in each panel that shows a quantity over time
        self.lanes = [w for w in STATUSES if w in ALWAYS or any(r.lane(w).any() for r in runs)]
        self.lanes.append("limited")
        one = len(runs) == 1
        strips = [(self.draw_force, 1.1), (self.draw_gap, 0.75), (self.draw_bound, 0.75),
                  (self.draw_energy, 0.75), (self.draw_status, 0.13 * len(self.lanes) + 0.1),
                  (self.draw_times, 1.0)]
        side = 1.4 if one else 1.65
        heights = [side] * (1 if one else 3) + [height for _, height in strips]
        width = 7.0 if one else 2.2 * len(runs) + 1.1
        self.figure = plt.figure(figsize=(width, sum(heights) + 0.17 * len(heights) + 0.5),
                                 layout="constrained")
        self.figure.get_layout_engine().set(w_pad=0.03, h_pad=0.03, hspace=0.01, wspace=0.01)
        grid = self.figure.add_gridspec(len(heights), 3 if one else len(runs), height_ratios=heights)
        paths = []
        for column, run in enumerate(runs):
            places = [grid[0, i] if one else grid[i, column] for i in range(3)]
            for place, plane in zip(places, PLANES):
                paths.append(self.figure.add_subplot(place))
                colours = self.draw_path(paths[-1], run, plane)
                self.note(paths[-1], run, "-".join(AXES[a] for a in plane), one or column == 0)
            if one:
                self.figure.suptitle(run.name, fontsize=8, parse_math=False)
            else:  # the panel is as wide as its column
                paths[-3].set_title(run.name, parse_math=False, pad=13,
                                    fontsize=8 * min(1, 25 / len(run.name)))
            first = None
            for row, (draw, _) in enumerate(strips, start=len(heights) - len(strips)):
                over_time = draw != self.draw_times
                ax = self.figure.add_subplot(grid[row, :] if one else grid[row, column],
                                             sharex=first if over_time else None)
                first = first or ax
                draw(ax, run)
                if over_time:
                    ax.set_xlim(*limits(run.t[0], run.t[-1], 0.01))
                    ax.set_xlabel("time [s]")
                    if draw != self.draw_status:
                        ax.set_xlabel("")
                        ax.tick_params(labelbottom=False)
                self.note(ax, run, draw.__name__[5:], column == 0)
        handles = [Line2D([], [], color="0.55", linewidth=0.6, label="probe"),
                   Line2D([], [], color=FORCES(0.75), linewidth=1.2, label="proxy")]
        paths[0].legend(handles=handles, loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncol=2,
                        columnspacing=1.0, borderaxespad=0.1)
        self.figure.colorbar(colours, ax=paths, label="force [N]", aspect=20 if one else 30, pad=0.01,
                             fraction=0.05, shrink=0.9 if one else 0.6)

    def note(self, ax, run, panel, labelled):
        """Stores the content of a panel for told(). Only the first column shows the scale."""
        self.panels.append((ax, run, panel, ax.get_ylabel()))
        if not labelled:
            ax.set_ylabel("")
            ax.tick_params(labelleft=False)

    def draw_path(self, ax, run, plane):
        a, b = plane
        # All panels have equal ranges, so that paths of different runs can be compared.
        ranges = [together(self.runs, lambda r, i=i: np.concatenate([r.probe[:, i], r.proxy[:, i]]))
                  for i in range(3)]
        half = 0.54 * max(high - low for low, high in ranges) or 1.0
        middle = [(low + high) / 2 for low, high in ranges]
        largest = together(self.runs, lambda r: r.force)[1]
        for path, width in ((run.probe, 0.5), (run.proxy, 1.0)):
            rows = along(path, run.force, 2e-3 * half, PATH // len(self.runs))
            points = path[rows][:, [a, b]]
            segments = np.stack([points[:-1], points[1:]], axis=1)
            lines = LineCollection(segments, linewidths=width, capstyle="round", rasterized=True)
            if path is run.probe:
                lines.set_color("0.55")
            else:
                lines.set(array=run.force[rows][:-1], cmap=FORCES, clim=(0.0, largest or 1.0))
            ax.add_collection(lines)
        ax.set_xlim(middle[a] - half, middle[a] + half)
        ax.set_ylim(middle[b] - half, middle[b] + half)
        ax.set_aspect("equal")
        ax.set_xlabel(f"{AXES[a]} [mm]", labelpad=1)
        ax.set_ylabel(f"{AXES[b]} [mm]", labelpad=1)
        ax.locator_params(nbins=5)
        ax.grid(linewidth=0.3, alpha=0.5)
        return lines

    def draw_line(self, ax, run, of, colour):
        values = of(run)
        rows = kept([values], LINE)
        self.lines[ax] = values[rows]
        ax.plot(run.t[rows], values[rows], color=colour)
        ax.grid(linewidth=0.3, alpha=0.5)

    def draw_force(self, ax, run):
        self.draw_line(ax, run, lambda r: r.force, BLUE)
        # In each section, marks only the limited tick with the largest force.
        marked = np.flatnonzero(run.limited & np.isfinite(run.force))
        if len(marked) > LINE:
            marked = np.array([part[np.argmax(run.force[part])] for part in np.array_split(marked, LINE)])
        ax.plot(run.t[marked], run.force[marked], ".", color=RED, markersize=2.5, markeredgewidth=0)
        handles = [Line2D([], [], color=BLUE, label="sent"),
                   Line2D([], [], color=RED, marker=".", linestyle="none", markersize=4,
                          label=f"limited ({ticks(np.count_nonzero(run.limited))})")]
        ax.legend(handles=handles, loc="upper right", ncol=2, columnspacing=1.0)
        largest = together(self.runs, lambda r: r.force)[1] or 1.0
        ax.set_ylim(-0.03 * largest, 1.3 * largest)
        ax.set_ylabel("force [N]")

    def draw_gap(self, ax, run):
        self.draw_line(ax, run, lambda r: r.gap, BLUE)
        largest = together(self.runs, lambda r: r.gap)[1] or 1.0
        ax.set_ylim(-0.03 * largest, 1.08 * largest)
        ax.set_ylabel("|probe - proxy|\n[mm]")

    def draw_bound(self, ax, run):
        positive = together(self.runs, lambda r: r.bound[r.bound > 0])
        low, high = positive if positive[1] > 0 else (1e-12, 1e-6)
        low, high = 10.0 ** math.floor(math.log10(low) - 1e-9), 10.0 ** math.ceil(math.log10(high) + 1e-9)
        exact = any(np.any(r.bound == 0) for r in self.runs)
        if exact:
            low /= 10.0  # an error of zero is drawn here, because the axis is logarithmic
        self.draw_line(ax, run, lambda r: np.where(r.bound == 0, low, r.bound), BLUE)
        ax.set_yscale("log")
        ax.set_ylim(low / 1.5, high)
        ax.yaxis.set_major_locator(LogLocator(numticks=5))
        ax.yaxis.set_minor_locator(NullLocator())
        if exact:
            places = [p for p in LogLocator(numticks=5).tick_values(10 * low, high) if 20 * low < p <= high]
            ax.set_yticks([low, *places])
            ax.yaxis.set_major_formatter(FuncFormatter(
                lambda v, _: "0" if v <= 1.01 * low else f"$10^{{{round(math.log10(v))}}}$"))
        ax.set_ylabel("error bound\n[m]")

    def draw_energy(self, ax, run):
        ax.axhline(0.0, color="black", linewidth=0.5)
        self.draw_line(ax, run, lambda r: r.energy, GREEN)
        ax.set_ylim(*limits(*together(self.runs, lambda r: np.append(r.energy, 0.0))))
        ax.set_ylabel("work on the\nhand [mJ]")

    def draw_status(self, ax, run):
        for at, word in enumerate(self.lanes):
            marks = run.lane(word)
            if marks.any():
                ax.broken_barh(spans(marks, run.t, LINE), (at - 0.38, 0.76), color=COLOURS[word],
                               linewidth=0.5)
            ax.text(1.015, at, str(np.count_nonzero(marks)), transform=ax.get_yaxis_transform(),
                    ha="left", va="center", fontsize=6)
        ax.set_ylim(len(self.lanes) - 0.4, -0.6)
        ax.set_yticks(range(len(self.lanes)), self.lanes)
        ax.set_ylabel("status\n(ticks)")

    def draw_times(self, ax, run):
        least, largest = (max(v, 1e-3) for v in together(self.runs, lambda r: r.tick))
        edges = np.geomspace(least / 1.05, largest * 1.05, BINS + 1)
        times = np.maximum(run.tick[np.isfinite(run.tick)], 1e-3)
        share = 100.0 * np.histogram(times, edges)[0] / max(1, len(times))
        ax.stairs(share, edges, fill=True, color=SKY)
        styles = zip(run.percentiles.items(), ("-", "--", ":"))
        for (word, value), style in styles:
            ax.axvline(value, color="black", linestyle=style, linewidth=0.8,
                       label=f"{word}  {value:.3g} µs")
        ax.legend(loc="upper right", handlelength=2.2, framealpha=1)
        ax.set_xscale("log")
        ax.set_xlim(edges[0], edges[-1])
        plain = FuncFormatter(lambda v, _: f"{v:g}")
        ax.xaxis.set_major_formatter(plain)
        if edges[-1] / edges[0] < 30.0:
            ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.xaxis.set_minor_formatter(plt.NullFormatter())
        ax.set_yscale("log")
        least = 0.5 * min(100.0 / len(r.t) for r in self.runs)
        ax.set_ylim(least, 100.0 * (100.0 / least) ** 0.3)  # space for the legend
        ax.yaxis.set_major_formatter(plain)
        ax.yaxis.set_minor_locator(NullLocator())
        ax.set_yticks([p for p in LogLocator(numticks=5).tick_values(least, 100.0) if least < p <= 100.0])
        ax.grid(linewidth=0.3, alpha=0.5)
        ax.set_xlabel("time of a tick [µs]")
        ax.set_ylabel("ticks [%]")

    def told(self, kind):
        """Returns the content of all panels as JSON."""
        panels = []
        for ax, run, panel, ylabel in self.panels:
            over_time = panel in ("force", "gap", "bound", "energy")
            legend = ax.get_legend()
            line = self.lines.get(ax, np.empty(0))
            panels.append({"run": run.name, "panel": panel,
                           "x": {"label": "time [s]" if over_time else ax.get_xlabel(),
                                 "scale": ax.get_xscale(), "limits": list(ax.get_xlim())},
                           "y": {"label": " ".join(ylabel.split()), "scale": ax.get_yscale(),
                                 "limits": list(ax.get_ylim())},
                           "line": [least(line), most(line), len(line)] if len(line) else None,
                           "marks": sum(len(c.get_paths()) for c in ax.collections),
                           "texts": [t.get_text() for t in ax.texts],
                           "legend": [t.get_text() for t in legend.get_texts()] if legend else []})
        return {"format": kind, "dpi": DPI, "inches": list(self.figure.get_size_inches()),
                "colours": "force [N]", "runs": [run.told() for run in self.runs], "panels": panels,
                "lanes": self.lanes}


def ticks(count):
    return f"{count} tick" if count == 1 else f"{count} ticks"


def tell(content):
    if "--told" in sys.argv:
        with open(sys.argv[sys.argv.index("--told") + 1], "w", encoding="utf-8") as file:
            json.dump(content, file)


def main():
    if "--check" in sys.argv:
        return
    kind = sys.argv[1]
    data = json.load(sys.stdin)
    use()
    runs = []
    for run in data["runs"]:
        try:
            runs.append(Run(run["name"], run["descriptor"]))
        except Refused as why:
            tell({"refused": dict(zip(("run", "line", "reason", "remedy"), (len(runs), *why.args)))})
            sys.exit(1)
    picture = Picture(runs)
    save(picture.figure, kind, data["made_by"])
    tell(picture.told(kind))


if __name__ == "__main__":
    main()
