#!/usr/bin/python3
"""Draws a run of `palpate feel` or `palpate press`: JSON on standard input, a picture on standard output.

The argument is the format, png, pdf or svg. With --check, the script only checks whether matplotlib is installed.
"""
import sys

sys.dont_write_bytecode = True  # importing picture_style must not write a file into this folder

from picture_style import AXES, BLUE, GREEN, ORANGE, RED, SKY, save, use  # noqa: E402

import json  # noqa: E402
import math  # noqa: E402
import textwrap  # noqa: E402

import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.collections import LineCollection  # noqa: E402
from matplotlib.colors import ListedColormap  # noqa: E402
from matplotlib.font_manager import FontProperties  # noqa: E402
from matplotlib.legend_handler import HandlerBase  # noqa: E402
from matplotlib.lines import Line2D  # noqa: E402
from matplotlib.patheffects import Stroke, Normal  # noqa: E402
from matplotlib.textpath import text_to_path  # noqa: E402

# Positions and sizes on a page [in], from the left and from the top. They are the same for all contents.
WIDTH, LEFT, GAP, PANELS, HIGHEST = 7.4, 0.55, 0.45, 4.5, 3.0
GREY_BAR, FORCE_BAR, BAR = 6.0, 6.68, 0.1
TITLE, TITLE_LINE, LINE, ROW_TITLE, LABELS, TIME, NOTE = 0.28, 0.14, 0.14, 0.36, 0.4, 1.1, 0.15
EVENT_LINE, EVENT_SIZE, EVENT_GAP = 0.1, 6, 0.03  # [in], font size, and gap beside events' names [in]
ROBUST = (0.5, 99.5)  # percentiles of the values that are drawn black and white
FAR = 0.1             # distance from a slice at which the path is faintest, as a fraction of the longest side
FAINT = 0.2
ARROWS = SKY
LEVELS = ((SKY, "-"), (GREEN, "--"), (ORANGE, ":"), (RED, "-."))
# Letters for a patient's directions: along -x and +x, -y and +y, -z and +z.
LETTERS = (("L", "R"), ("P", "A"), ("I", "S"))
ALONG = (0.5, 0.2, 0.8)  # places of a letter along its edge: the first that is far enough from the largest force
APART = 0.2              # wanted distance of a letter from the mark of the largest force [in]
# Colours of the force. The smallest is visible on black; a dark rim makes the largest one visible on white.
FORCES = ListedColormap(plt.get_cmap("plasma")(np.linspace(0.4, 0.97, 256)))
RIM, RIM_ALPHA, LINE_WIDTH = 1.8, 0.6, 1.0
MOST = {"marker": "o", "linestyle": "none", "markersize": 5, "markerfacecolor": "none",
        "markeredgecolor": "white", "markeredgewidth": 0.9,
        "path_effects": [Stroke(linewidth=1.8, foreground="black"), Normal()]}


def words(text, unit):
    return f"{text} [{unit}]" if unit else text


def amount(value, unit):
    digits = ".0f" if 1e3 <= abs(value) < 1e6 else ".3g"
    return f"{value:{digits}} {unit}".rstrip()


def grey_range(slices):
    """Returns the range of the values of all slices without outliers and unknown values; its width is never zero."""
    values = np.concatenate([s[np.isfinite(s)] for s in slices])
    if not len(values):
        return 0.0, 1.0
    low, high = np.percentile(values, ROBUST)
    if high <= low:  # nearly all values are equal
        low, high = values.min(), values.max()
    return (float(low), float(high)) if high > low else (float(low) - 0.5, float(low) + 0.5)


def width_of(text, size):
    """Returns the width of a line of text [in]."""
    return text_to_path.get_text_width_height_descent(text, FontProperties(size=size), False)[0] / 72


def wrapped(text, size, width):
    """Returns the text in lines that are at most `width` wide [in]."""
    for letters in range(len(text), 0, -1):
        lines = textwrap.wrap(text, letters) or [""]
        if max(width_of(line, size) for line in lines) <= width:
            return lines
    return [text]


def longest_of(field):
    """Returns the 98th percentile of the lengths of the vectors in the slices; 0 if there are none."""
    lengths = [math.hypot(*v) for piece in field["slices"] for line in piece.get("vectors", [])
               for v in line if v is not None]
    return float(np.percentile(lengths, 98)) if lengths else 0.0


def thinned(path, force, step):
    """Returns the rows of a path to draw: the ends of sections of length `step`, both ends of the path, and the
    row of the largest force."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    leaves = np.flatnonzero(np.diff(np.floor(way / step)))
    more = [0, int(np.argmax(force)), len(path) - 1]
    return np.unique(np.concatenate([leaves, leaves + 1, more]))


def events(press, width):
    """Returns labels for a press's events, and the number of text lines that the labels need above the axes. The axes
    are `width` wide [in]. A label is its depth [m], its lines, and the number of lines below it. Labels do not overlap.
    """
    scale = width / max(row[0] for row in press["in"] + press["out"])  # [in/m]
    places = []  # depths with the names of the events there
    for mark in sorted(press["marks"], key=lambda mark: mark["depth"]):
        if places and scale * (mark["depth"] - places[-1][0]) < EVENT_GAP:
            places[-1][1].append(mark["name"])
        else:
            places.append((mark["depth"], [mark["name"]]))
    # A name begins at its depth. From the right, each name lies above all names that begin in its width.
    drawn = []
    for depth, names in reversed(places):
        lines = wrapped(", ".join(names), EVENT_SIZE, WIDTH - LEFT - scale * depth - 2 * EVENT_GAP)
        end = depth + (max(width_of(line, EVENT_SIZE) for line in lines) + 2 * EVENT_GAP) / scale
        level = max((low + len(said) for other, said, low in drawn if other < end), default=0)
        drawn.append((depth, lines, level))
    return drawn, max((low + len(said) for _, said, low in drawn), default=0)


class PathMark(HandlerBase):
    """Draws the legend's mark of the path: a line with the colours of the force, and a rim."""

    def __init__(self, largest):
        super().__init__()
        self.colours = FORCES(np.linspace(0.0, largest, 32))

    def create_artists(self, legend, handle, xdescent, ydescent, width, height, fontsize, trans):
        x = np.linspace(0.0, width, len(self.colours) + 1) - xdescent
        points = np.stack([x, np.full_like(x, 0.5 * height - ydescent)], axis=1)
        alpha = handle.get_alpha()
        rim = Line2D(points[:, 0], points[:, 1], color="black", alpha=RIM_ALPHA * alpha, linewidth=RIM)
        rim.set_transform(trans)
        colours = LineCollection(np.stack([points[:-1], points[1:]], axis=1), colors=self.colours, alpha=alpha,
                                 linewidths=LINE_WIDTH, transform=trans)
        return [rim, colours]


class Picture:
    """A row of three slices for each field, and the force over time or over the depth of a press."""

    def __init__(self, data):
        self.data = data
        self.low, self.high = np.array(data["extent"], dtype=float)
        self.size = self.high - self.low
        self.through = np.array(data["through"], dtype=float)
        self.strongest = np.array(data["strongest"] or data["through"], dtype=float)
        self.unit = data["space"]["unit"]
        ticks = np.array(data["ticks"], dtype=float).reshape(-1, 7)
        self.time, self.path, self.forces = ticks[:, 0], ticks[:, 1:4], ticks[:, 4:7]
        self.force = np.linalg.norm(self.forces, axis=1)
        self.most = float(self.force.max()) if len(self.force) else 0.0
        self.far = FAR * self.size.max()
        fields = data["fields"]
        self.arrows = {field["name"]: longest for field in fields
                       if (longest := longest_of(field)) > 0.0}
        self.levels = {}  # colour and line style for each pair of field and mode
        styles = [style for style in LEVELS if not self.arrows or style[0] != ARROWS]
        for field in fields:
            for level in field["levels"]:
                self.levels[field["name"], level["mode"]] = styles[len(self.levels) % len(styles)]

        marks = self.legend()
        # All slices are drawn at the same scale.
        self.scale = min(PANELS / (2 * self.size[0] + self.size[1]),
                         HIGHEST / max(self.size[1], self.size[2]))
        row = ROW_TITLE + max(1.0, self.scale * max(self.size[1], self.size[2])) + LABELS
        longest = max(map(len, marks))
        columns = 3 if longest < 45 else 2 if longest < 70 else 1
        legend = LINE * math.ceil(len(marks) / columns) + 0.1
        title = wrapped(data["title"], 8, WIDTH - 2 * LEFT)
        self.under_title = TITLE + TITLE_LINE * (len(title) - 1)
        first = self.under_title + legend
        self.events, lines = events(data["press"], PANELS + 2 * GAP) if data["press"] else ([], 0)
        above = 0.1 + EVENT_LINE * lines
        self.height = first + row * len(fields) + above + TIME + LABELS + NOTE
        self.figure = plt.figure(figsize=(WIDTH, self.height))
        for number, field in enumerate(fields):
            self.draw_field(number + 1, field, first + number * row + ROW_TITLE)
        if fields:
            height = len(fields) * row - ROW_TITLE - LABELS
            bar = self.axes(FORCE_BAR, first + ROW_TITLE, BAR, height)
            self.figure.colorbar(self.forces_map(), cax=bar, label="force on the hand [N]")
        top = first + len(fields) * row + above
        draw = self.draw_depth if data["press"] else self.draw_time
        draw(self.axes(LEFT, top, PANELS + 2 * GAP, TIME))
        self.draw_legend(marks, columns)
        self.figure.text(LEFT / WIDTH, 1 - 0.06 / self.height, "\n".join(title), fontsize=8, va="top",
                         parse_math=False)
        self.figure.text(LEFT / WIDTH, 0.05 / self.height, self.note(), fontsize=6,
                         parse_math=False)

    def axes(self, left, top, width, height):
        """Adds axes at a position on the page [in]."""
        return self.figure.add_axes((left / WIDTH, 1 - (top + height) / self.height, width / WIDTH,
                                     height / self.height))

    def note(self):
        """Returns the note at the bottom of the page: the axes' space, the scale and the time of moving volumes."""
        space = self.data["space"]
        time = self.data["stands_at"]
        when = "" if time is None else f"; moving volumes are drawn at {time:.2f} s"
        when += "; sequences: the first frame" if self.data["first_frame"] else ""
        when += f"; {space['heights']}" if space["heights"] else ""
        if space["name"] == "hand":
            return "axes: the hand's space, z up" + when
        ratio = f"1 {self.unit or 'unit'} of the {space['name']} is {space['hand_mm']:.3g} mm of the hand"
        of_patient = "the patient's, x to the right, y to the front, z up"
        axes = of_patient if space["name"] == "patient" else "the file's"
        return f"axes: {axes}; {ratio}{when}"

    def forces_map(self):
        return plt.cm.ScalarMappable(plt.Normalize(0.0, self.most or 1.0), FORCES)

    def draw_field(self, number, field, top):
        slices = [np.array(piece["values"], dtype=float) for piece in field["slices"]]
        low, high = grey_range(slices)
        longest = self.arrows.get(field["name"], 0.0)
        title = field["name"] + (f", on {field['label']}" if field["kind"] == "axial" else "")
        self.figure.text(LEFT / WIDTH, 1 - (top - ROW_TITLE + 0.02) / self.height, title,
                         fontsize=8, fontweight="bold", va="top", parse_math=False)
        left = LEFT
        for piece, values in zip(field["slices"], slices):
            a, b = piece["axes"]
            width, height = self.scale * self.size[[a, b]]
            ax = self.axes(left, top, width, height)
            left += width + GAP
            extent = (self.low[a], self.high[a], self.low[b], self.high[b])
            ax.set_facecolor("#CFE3F2")  # colour of places without data
            image = ax.imshow(values, origin="lower", extent=extent, cmap="gray", vmin=low,
                              vmax=high)
            image.set_gid(f"slice-{number}-{AXES[a]}{AXES[b]}")
            self.draw_levels(ax, field, values, extent)
            if longest > 0.0:
                self.draw_vectors(ax, field, piece, longest)
            self.draw_path(ax, a, b)
            self.draw_axes(ax, a, b)
        bar = self.axes(GREY_BAR, top, BAR, max(1.0, self.scale * self.size[[1, 2]].max()))
        every = np.concatenate([s[np.isfinite(s)] for s in slices] or [np.zeros(0)])
        below, above = bool((every < low).any()), bool((every > high).any())
        extend = {(True, True): "both", (True, False): "min", (False, True): "max"}
        scale = self.figure.colorbar(image, cax=bar, extend=extend.get((below, above), "neither"))
        scale.formatter.set_powerlimits((-3, 5))   # longer numbers would reach the next bar
        scale.update_ticks()
        bar.set_ylabel(words(field["label"], field["unit"]), parse_math=False)
        for level in field["levels"]:
            if low < level["value"] < high:
                colour, style = self.levels[field["name"], level["mode"]]
                bar.axhline(level["value"], color=colour, linestyle=style, linewidth=1.2)

    def draw_levels(self, ax, field, values, extent):
        for level in field["levels"]:
            if not np.nanmin(values) < level["value"] < np.nanmax(values):
                continue
            colour, style = self.levels[field["name"], level["mode"]]
            ax.contour(np.ma.masked_invalid(values), levels=[level["value"]], origin="lower",
                       extent=extent, colors=colour, linestyles=style, linewidths=0.8)

    def draw_vectors(self, ax, field, piece, longest):
        """Draws arrows, or lines without heads if the vectors have no sign. The longest ones fill a cell."""
        a, b = piece["axes"]
        rows = piece["vectors"]
        nothing = [np.nan, np.nan]
        vectors = np.array([[v or nothing for v in line] for line in rows], dtype=float)
        count = vectors.shape[:2]
        x = self.low[a] + (np.arange(count[1]) + 0.5) / count[1] * self.size[a]
        y = self.low[b] + (np.arange(count[0]) + 0.5) / count[0] * self.size[b]
        cell = min(self.size[a] / count[1], self.size[b] / count[0])
        known = np.isfinite(vectors[..., 0])
        lengths = np.hypot(vectors[..., 0], vectors[..., 1])
        known &= lengths > 0.1 * longest  # a vector this short has no visible direction
        # Vectors longer than the 98th percentile are drawn with that length.
        shown = vectors / np.maximum(1.0, lengths / longest)[..., None]
        grid = np.meshgrid(x, y)
        axial = field["kind"] == "axial"
        heads = {"headwidth": 0, "headlength": 0, "headaxislength": 0} if axial else {
            "headwidth": 4, "headlength": 4.5, "headaxislength": 4, "minlength": 0.3}
        arrows = ax.quiver(grid[0][known], grid[1][known], shown[known][:, 0], shown[known][:, 1],
                           angles="xy", scale_units="xy", scale=longest / (0.85 * cell),
                           pivot="mid", units="inches", width=0.01, color=ARROWS, **heads)
        arrows.set_path_effects([Stroke(linewidth=0.6, foreground="black"), Normal()])
        arrows.set_gid("fibres" if axial else "arrows")

    def alpha(self, off):
        """Returns the alpha of the path at a distance from a slice."""
        return 1.0 - (1.0 - FAINT) * np.minimum(1.0, off / self.far)

    def draw_path(self, ax, a, b):
        """Draws the path. Sections that are farther from the slice are fainter, and lie below nearer ones."""
        if len(self.path) < 2:
            return
        normal = 3 - a - b
        rows = thinned(self.path, self.force, 2e-3 * self.size.max())
        if len(rows) < 2:
            return
        points = self.path[rows][:, [a, b]]
        segments = np.stack([points[:-1], points[1:]], axis=1)
        off = np.abs(self.path[rows][:-1, normal] - self.through[normal])
        order = np.argsort(-off, kind="stable")
        colours = self.forces_map().to_rgba(self.force[rows][:-1])
        colours[:, 3] = self.alpha(off)
        rims = np.zeros_like(colours)
        rims[:, 3] = RIM_ALPHA * colours[:, 3]
        for of, width in ((rims, RIM), (colours, LINE_WIDTH)):
            lines = LineCollection(segments[order], colors=of[order], linewidths=width,
                                   capstyle="butt", rasterized=True)
            ax.add_collection(lines)
        if self.data["strongest"]:
            alpha = self.alpha(abs(self.strongest - self.through)[normal])
            ax.plot(*self.strongest[[a, b]], alpha=alpha, zorder=6, **MOST)  # above the letters

    def draw_axes(self, ax, a, b):
        ax.set_xlim(self.low[a], self.high[a])
        ax.set_ylim(self.low[b], self.high[b])
        ax.set_aspect("equal")
        ax.set_xlabel(words(AXES[a], self.unit), labelpad=1, parse_math=False)
        ax.set_ylabel(words(AXES[b], self.unit), labelpad=0, parse_math=False)
        for axis, of in (("x", a), ("y", b)):
            ax.locator_params(axis=axis, nbins=int(np.clip(4 * self.scale * self.size[of], 1, 5)))
        normal = 3 - a - b
        unit = f" {self.unit}" if self.unit else ""
        digits = max(1, 2 - math.floor(math.log10(self.size.max())))
        at = f"{round(self.through[normal], digits) + 0.0:.{digits}f}"  # turns -0.0 into 0.0
        ax.set_title(f"{AXES[normal]} = {at}{unit}", fontsize=7, pad=3, parse_math=False)
        if self.data["space"]["name"] != "patient":
            return
        size = self.scale * self.size[[a, b]]
        mark = (self.strongest - self.low)[[a, b]] / self.size[[a, b]]
        edges = ([(0.02, t) for t in ALONG], [(0.98, t) for t in ALONG],
                 [(t, 0.02) for t in ALONG], [(t, 0.98) for t in ALONG])
        ends = zip(LETTERS[a] + LETTERS[b], edges, ("left", "right", "center", "center"),
                   ("center", "center", "bottom", "top"))
        for letter, places, across, up in ends:
            off = [np.hypot(*(size * (mark - place))) for place in places]
            place = places[int(np.argmax(np.minimum(off, APART)))]
            ax.text(*place, letter, transform=ax.transAxes, ha=across, va=up, fontsize=7,
                    fontweight="bold", color="white",
                    bbox={"facecolor": "black", "edgecolor": "none", "alpha": 0.6, "pad": 1.0})

    def draw_time(self, ax):
        ax.plot(self.time, self.force, color="0.6", linewidth=1.6, label="magnitude")
        for i, (colour, style) in enumerate(zip((BLUE, RED, GREEN), ("-", "--", "-."))):
            ax.plot(self.time, self.forces[:, i], color=colour, linestyle=style, linewidth=0.7,
                    label=AXES[i])
        if len(self.time) > 1:
            ax.set_xlim(self.time[0], self.time[-1])
        ax.set_xlabel("time [s]", labelpad=1)
        ax.set_ylabel("force on the hand [N]")
        ax.legend(loc="upper left", bbox_to_anchor=(1.005, 1.0), borderaxespad=0.0)
        ax.grid(linewidth=0.3, alpha=0.5)

    def draw_depth(self, ax):
        """Draws the force along the path of a press over the hand's depth, and labels the events at their depths."""
        press = self.data["press"]
        for key, colour, style, label in (("in", BLUE, "-", "moving in"), ("out", RED, "--", "moving out")):
            rows = np.array(press[key], dtype=float).reshape(-1, 2)
            ax.plot(1e3 * rows[:, 0], rows[:, 1], color=colour, linestyle=style, linewidth=0.9, label=label)
        deepest = max(row[0] for row in press["in"] + press["out"])
        ax.set_xlim(0.0, 1e3 * deepest)
        if not any(row[1] for row in press["in"] + press["out"]):
            ax.set_ylim(0.0, 1.0)
        for depth, lines, level in self.events:
            # The names stand above the axes, so that no name covers a number or the curve.
            x, top = 1e3 * depth, 1.0 + EVENT_LINE * (level + len(lines)) / TIME
            ax.plot([x, x], [0.0, top], transform=ax.get_xaxis_transform(), clip_on=False, color="0.4", linestyle=":",
                    linewidth=0.8)
            ax.annotate("\n".join(lines), (x, top), xycoords=ax.get_xaxis_transform(), textcoords="offset points",
                        xytext=(72 * EVENT_GAP, 0), va="top", fontsize=EVENT_SIZE, linespacing=1.0,
                        annotation_clip=False, parse_math=False)
        ax.set_xlabel("depth of the hand [mm]", labelpad=1)
        ax.set_ylabel("force along the path [N]")
        ax.legend(loc="upper left", bbox_to_anchor=(1.005, 1.0), borderaxespad=0.0)
        ax.grid(linewidth=0.3, alpha=0.5)

    def legend(self):
        """Returns the legend: a mark for each label."""
        marks = {"proxy's path in the slice (colour: force)": LineCollection([], alpha=1.0),
                 f"{amount(self.far, self.unit or 'units')} or more from the slice": LineCollection([], alpha=FAINT)}
        if self.data["strongest"]:
            marks["largest force"] = Line2D([], [], **MOST)
        for field in self.data["fields"]:
            for level in field["levels"]:
                colour, style = self.levels[field["name"], level["mode"]]
                value = f"{level['value']:.6g} {field['unit']}".rstrip()
                marks[f"{level['mode']}: {field['name']} = {value}"] = Line2D(
                    [], [], color=colour, linestyle=style, linewidth=1.0)
            longest = self.arrows.get(field["name"])
            if longest is None:
                continue
            label = f"{field['name']}, component in the slice"
            if field["kind"] == "axial":
                marks[label] = Line2D([], [], color=ARROWS, linewidth=1.2)
                continue
            label += f"; longest arrow: {amount(longest, field['vector_unit'])} or more"
            marks[label] = Line2D([], [], color=ARROWS, linestyle="none", marker=r"$\rightarrow$",
                                  markersize=8, markeredgewidth=0.2)
        return marks

    def draw_legend(self, marks, columns):
        legend = self.figure.legend(
            marks.values(), marks.keys(), loc="upper left", ncol=columns, columnspacing=1.2,
            borderaxespad=0.0, bbox_to_anchor=(LEFT / WIDTH, 1 - (self.under_title - 0.02) / self.height),
            facecolor="0.8", framealpha=1, handler_map={LineCollection: PathMark(1.0 if self.most else 0.0)})
        for text in legend.get_texts():
            text.set_parse_math(False)


def main():
    if "--check" in sys.argv:
        return
    data = json.load(sys.stdin)
    use()
    save(Picture(data).figure, sys.argv[1], data["made_by"])


if __name__ == "__main__":
    main()
