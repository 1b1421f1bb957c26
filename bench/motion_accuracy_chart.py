#!/usr/bin/python3
"""Draws what palpate_bench_motion_accuracy measured.

    motion_accuracy_chart.py RESULT.json FOLDER [--doc FILE.md]

Writes motion_accuracy.png and .svg into FOLDER. The tables go to standard output, or into FILE.md between its markers.
"""
import argparse
import json
import sys
from pathlib import Path

sys.dont_write_bytecode = True
from charting import Page, clear, number, plt, prepare, save, table, where  # noqa: E402
from matplotlib.lines import Line2D  # noqa: E402
from matplotlib.ticker import FixedLocator, LogLocator, NullLocator  # noqa: E402

# Okabe and Ito's colours; palpate's lines are solid.
STYLES = {
    "palpate": ("#D55E00", "-", "o"),
    "plane": ("#000000", "--", "s"),
    "line": ("#000000", "--", "s"),
    "midpoint": ("#0072B2", "--", "^"),
    "RK4": ("#009E73", "--", "D"),
}
SPEED = 0.5      # m/s, of the panels that show the cost
TOP = {"surfaces": 20.0, "streams": 1000.0}  # larger errors are drawn here [voxels]
BOTTOM = 1e-6
OFF, BESIDE = "off", {"surfaces": "true", "streams": "departures"}
PANELS = 4       # panels per row
# The methods that the lower panels show over the hand's speed: kind, case, and methods at one setting each.
OVER_SPEED = [("surfaces", "sphere, radius 40"), ("surfaces", "sphere, radius 8"),
              ("surfaces", "sphere in fog, radius 40"), ("streams", "ABC flow, 16 voxels")]
FOLLOWED = {"surfaces": [("palpate", "0.01"), ("palpate", "1e-4"), ("plane", "1"), ("plane", "16"),
                         ("midpoint", "3")],
            "streams": [("palpate", "0.01"), ("palpate", "1e-4"), ("line", "1"), ("line", "16"),
                        ("RK4", "4")]}
# Place of a line's label: index of the speed, whether the label is above the line, and horizontal alignment.
LABELS = {("palpate", "0.01"): (1, True, "left"), ("palpate", "1e-4"): (1, False, "left"),
          ("plane", "1"): (0, True, "left"), ("line", "1"): (0, True, "left"),
          ("plane", "16"): (1, False, "left"), ("line", "16"): (1, False, "left"),
          ("midpoint", "3"): (0, False, "left"), ("RK4", "4"): (0, True, "left")}
STREAM_LABELS = {**LABELS, ("palpate", "1e-4"): (1, True, "left")}


def label(method, setting):
    """Returns the name of a method with its setting."""
    parts = "1 step" if setting == "1" else f"{setting} sub-steps"
    if method == "palpate":
        return f"palpate, {setting} voxel"
    if method == "midpoint":
        return "explicit midpoint" if setting == "1" else f"midpoint, {setting} times"
    return f"{method}, {parts}"


def stream_label(method, setting):
    return "midpoint, length kept" if method == "midpoint" else label(method, setting)


def is_lost(row):
    return row.get("lost", 0) > 0


def cases(rows):
    return list(dict.fromkeys(r["case"] for r in rows))


def speeds(rows):
    return sorted({r["speed"] for r in rows})


def place(row, kind, quantity=OFF):
    """Returns the position of a row on the error axis."""
    return TOP[kind] if is_lost(row) else min(max(row[quantity], BOTTOM), TOP[kind])


def style_axes(ax, kind):
    ax.set_yscale("log")
    ax.set_ylim(0.5 * BOTTOM, 2.0 * TOP[kind])
    ax.yaxis.set_major_locator(LogLocator(numticks=9))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.tick_params(labelsize=8)
    clear(ax)


def draw_floor(ax, floor):
    if floor > 0:
        ax.axhline(floor, color="#aa3333", linewidth=1.0, zorder=1)
        ax.text(0.99, floor * 1.1, "the interpolant's own error", color="#aa3333", ha="right",
                transform=ax.get_yaxis_transform(), fontsize=7, va="bottom")


def draw_cost(ax, kind, rows):
    """Draws one case at one speed: the time of a tick against the error."""
    for method, (colour, line, marker) in STYLES.items():
        mine = [r for r in rows if r["method"] == method]
        if not mine:
            continue
        ours = method == "palpate"
        held = [r for r in mine if not is_lost(r)]
        ax.plot([r["ns"]["median"] for r in held], [place(r, kind) for r in held], color=colour,
                linestyle=line, marker=marker, markersize=5.5, linewidth=1.1,
                markerfacecolor=colour if ours else "white", zorder=3)
        ax.plot([r["ns"]["median"] for r in held], [place(r, kind, BESIDE[kind]) for r in held],
                color=colour, marker="_", markersize=9, linestyle="none", alpha=0.6, zorder=2)
        lost = [r for r in mine if is_lost(r)]
        ax.plot([r["ns"]["median"] for r in lost], [TOP[kind]] * len(lost), color=colour, marker="x",
                markersize=6, linestyle="none", zorder=3)
    draw_floor(ax, rows[0].get("floor", 0))
    ax.set_xscale("log")
    ax.set_xlim(80, 12000)
    ax.xaxis.set_major_locator(FixedLocator([100, 200, 500, 1000, 2000, 5000, 10000]))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter("{x:.0f}")
    style_axes(ax, kind)
    ax.set_xlabel("time of a tick [ns]", fontsize=8)


def draw_speeds(ax, kind, rows):
    """Draws one case over the hand's speed."""
    for method, setting in FOLLOWED[kind]:
        colour, _, marker = STYLES[method]
        mine = [r for r in rows if (r["method"], r["setting"]) == (method, setting)]
        fine = setting in ("1e-4", "16", "3", "4")
        ax.plot([r["speed"] for r in mine], [place(r, kind) for r in mine],
                color=colour, linestyle="-" if method == "palpate" else "--", linewidth=1.1,
                marker=marker, markersize=4 if fine else 6,
                markerfacecolor=colour if method == "palpate" else "white", zorder=3)
        words, labels = (stream_label, STREAM_LABELS) if kind == "streams" else (label, LABELS)
        which, above, side = labels[method, setting]
        at = min(which, len(mine) - 1)  # a short run has only one speed
        ax.annotate(words(method, setting), (mine[at]["speed"], place(mine[at], kind)),
                    xytext=(0, 5 if above else -10), textcoords="offset points", fontsize=6.5,
                    color=colour, ha=side)
        lost = [r for r in mine if is_lost(r)]
        ax.plot([r["speed"] for r in lost], [TOP[kind]] * len(lost), color=colour, marker="x",
                markersize=7, linestyle="none", zorder=4)
    ax.set_xscale("log")
    ax.set_xlim(0.04, 2.5)
    ax.xaxis.set_major_locator(FixedLocator(speeds(rows)))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter("{x:g}")
    style_axes(ax, kind)
    ax.set_xlabel("speed of the hand [m/s]", fontsize=8)


def add_legend(ax, columns):
    ax.axis("off")
    words = {"palpate": "palpate, tolerance 0.1, 0.01, 1e-3, 1e-4 voxel (left to right)",
             "plane": "plane or line at the proxy; 1, 4, 16, 64 sub-steps",
             "midpoint": "midpoint rule; surfaces: normal read 1, 2, 3, 5 times half-way",
             "RK4": "streams: RK4; 1, 4, 16 sub-steps"}
    handles = [Line2D([], [], color=STYLES[m][0], linestyle=STYLES[m][1], marker=STYLES[m][2],
                      markersize=5.5, linewidth=1.1, label=text,
                      markerfacecolor=STYLES[m][0] if m == "palpate" else "white")
               for m, text in words.items()]
    handles.append(Line2D([], [], color="#555555", marker="_", markersize=9, linestyle="none",
                          label="dashes: distance from the true surface; of streams,\n"
                                "one-tick departures summed over 1,280 voxels"))
    handles.append(Line2D([], [], color="#555555", marker="x", markersize=6, linestyle="none",
                          label="at the top: lost; the hand was in the solid\n"
                                "and nothing held the proxy"))
    ax.legend(handles=handles, loc="center", ncols=columns, fontsize=8.5, frameon=False)


def draw(data):
    panels = [(draw_cost, kind, case, case) for kind in BESIDE for case in cases(data[kind])]
    panels += [(draw_speeds, kind, case, f"over speed: {case}") for kind, case in OVER_SPEED]
    left = -len(panels) % PANELS  # free panels in the last row: the legend goes there if the space is wide enough
    rows = -(-len(panels) // PANELS)
    extra = left < 2
    figure = plt.figure(figsize=(13.0, 2.9 * rows + 0.9 * extra), layout="constrained")
    grid = figure.add_gridspec(rows + extra, PANELS, height_ratios=[1] * rows + [0.3] * extra)
    for i, (paint, kind, case, title) in enumerate(panels):
        ax = figure.add_subplot(grid[i // PANELS, i % PANELS])
        rows_of_case = [r for r in data[kind] if r["case"] == case]
        if paint is draw_cost:
            rows_of_case = [r for r in rows_of_case if r["speed"] == SPEED]
        paint(ax, kind, rows_of_case)
        ax.set_title(title, fontsize=9.5)
        if i % PANELS == 0:
            ax.set_ylabel("largest error [voxels]", fontsize=8.5)
    if extra:
        add_legend(figure.add_subplot(grid[rows, :]), 2)
    else:
        add_legend(figure.add_subplot(grid[rows - 1, PANELS - left:]), 1)
    figure.suptitle(f"What a tick costs, and how far the proxy is from its exact course; hand at {SPEED} "
                    "m/s but where it says otherwise", fontsize=11.5)
    options = data["options"]
    foot = (f"{where(data['machine']).replace('`', '')}. Times: median of {options['rounds']} rounds; "
            f"{options['way']:,.0f} voxels along each surface, {options['paths']} or more paths of a flow.")
    figure.text(0.005, -0.004, foot, fontsize=7, color="#666666", va="top")
    return figure


def spread(times):
    return f"{times['median']:.0f} ({times['p10']:.0f} to {times['p90']:.0f})"


def reads(row):
    return f"{number(row['reads'])} ({row['most_reads']:.0f})"


def capped(row):
    return f"{number(100 * row['capped'])} %" if row["capped"] else ""


def surface_table(rows):
    body = []
    for r in rows:
        lost = is_lost(r)
        body.append([label(r["method"], r["setting"]), "lost" if lost else number(r["off"]),
                     "" if lost else number(r["true"]), reads(r), spread(r["ns"]), capped(r)])
    return table(["method", "off the interpolant's surface", "off the true surface",
                  "reads a tick (most)", "ns a tick", "not done"], body)


def stream_table(rows):
    body = [[stream_label(r["method"], r["setting"]),
             f"{number(r['off_median'])} ({number(r['off'])})",
             f"{number(r['departures_median'])} ({number(r['departures'])})",
             reads(r), spread(r["ns"]), capped(r)] for r in rows]
    return table(["method", "off the course, median path (worst)",
                  "departures over 1,280 voxels, median path (worst)", "reads a tick (most)",
                  "ns a tick", "not done"], body)


def speed_table(rows, words):
    """Returns a table of the largest errors of every method at every speed."""
    found = {(r["method"], r["setting"], r["speed"]): r for r in rows}
    methods = list(dict.fromkeys((r["method"], r["setting"]) for r in rows))

    def cell(row):
        return "lost" if is_lost(row) else f"{number(row['off'])}; {number(row['reads'])}"

    body = [[words(*m), *(cell(found[(*m, speed)]) for speed in speeds(rows))] for m in methods]
    return table(["method", *(f"{speed:g} m/s" for speed in speeds(rows))], body)


def default_table(data):
    """Returns a table of the engine at its default tolerance."""
    def ours(kind, case):
        return next(r for r in data[kind] if (r["case"], r["speed"], r["method"], r["setting"]) ==
                    (case, SPEED, "palpate", "0.01"))

    body = []
    for case in cases(data["surfaces"]):
        r = ours("surfaces", case)
        floor = number(r["floor"]) if r["floor"] else ""
        body.append([case, number(r["off"]), number(r["true"]), floor, reads(r), spread(r["ns"])])
    for case in cases(data["streams"]):
        r = ours("streams", case)
        body.append([case, number(r["off"]), f"departures {number(r['departures'])}", "", reads(r),
                     spread(r["ns"])])
    return table(["case", "off the interpolant's surface or stream",
                  "off the true surface", "the interpolant's own error", "reads a tick (most)",
                  "ns a tick"], body)


def rubbing_table(rows):
    def pair(r, key):
        return f"{1e3 * r[key]:.3g} / {1e3 * r[key + '_held']:.3g}"

    body = [[f"{1e3 * r['speed']:g} mm/s", f"{r['ticks']:,}", f"{r['force']:.3f} N", pair(r, "buzz"),
             pair(r, "given"), f"{1e3 * r['injected']:.3g}", number(r["reads"]), capped(r)]
            for r in rows]
    return table(["hand", "ticks", "mean force", "force above 100 Hz, mN rms: as it is / held back",
                  "given by re-anchoring, mJ a metre: as it is / held back",
                  "counted as injected, mJ a metre", "reads a tick", "not done"], body)


def write_tables(data):
    options = data["options"]
    text = [
        f"{where(data['machine'])}. {options['rounds']} rounds; {options['way']:,.0f} voxels along each "
        f"surface; {options['paths']} paths of up to {options['length']:.0f} voxels of a made flow, up to "
        f"{4 * options['paths']} of one from a file. The loop and the call take "
        f"{options['nothing_ns']:.1f} ns of every tick. Lengths are in voxels; times are medians of rounds "
        "(10th to 90th percentile).",
        f"### palpate at its default tolerance, 0.01 voxel, {SPEED} m/s", default_table(data)]
    for kind, tabled, words in (("surfaces", surface_table, label),
                                ("streams", stream_table, stream_label)):
        for case in cases(data[kind]):
            rows = [r for r in data[kind] if r["case"] == case]
            size = ""
            if kind == "streams":
                size = f", {rows[0]['paths']} paths, the longest {rows[0]['longest']:.0f} voxels"
            text += [f"### {case[0].upper()}{case[1:]}{size}", f"At {SPEED} m/s:",
                     tabled([r for r in rows if r["speed"] == SPEED])]
            if len(speeds(rows)) > 1:
                text += ["Largest error, and reads a tick, by the hand's speed:",
                         speed_table(rows, words)]
    if data["rubbing"]:
        text += [f"### Rubbing on a scan, {data['rubbing'][0]['slides']} slides of 5 cm",
                 rubbing_table(data["rubbing"])]
    return "\n\n".join(text) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("result", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--doc", type=Path, help="a page whose marked part the tables replace")
    arguments = parser.parse_args()
    data = json.loads(arguments.result.read_text())
    page = Page(arguments.doc)
    prepare(arguments.folder)
    save(draw(data), arguments.folder, "motion_accuracy")
    page.fill(write_tables(data))


if __name__ == "__main__":
    main()
