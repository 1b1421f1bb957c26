#!/usr/bin/python3
"""Draws what palpate_bench_sampler_accuracy measured.

    sampler_accuracy_chart.py RESULT.json FOLDER [--doc FILE.md] [--load LOAD.md]

Writes sampler_accuracy.png and .svg into FOLDER. The tables go to standard output, or into FILE.md between its markers.
"""
import argparse
import json
import sys
from pathlib import Path

sys.dont_write_bytecode = True
from charting import Page, clear, number, plt, prepare, save, table, where  # noqa: E402
from matplotlib.lines import Line2D  # noqa: E402
from matplotlib.ticker import FixedLocator, NullLocator  # noqa: E402

# Okabe and Ito's colours, and grey. Only palpate's lines are solid.
STYLES = {
    "palpate nearest": ("#8c8c8c", "-"),
    "palpate trilinear": ("#0072B2", "-"),
    "palpate quadratic": ("#009E73", "-"),
    "palpate cubic": ("#D55E00", "-"),
    "PointSampler": ("#8c8c8c", "--"),
    "BoxSampler": ("#56B4E9", "--"),
    "GridSampler": ("#56B4E9", ":"),
    "7x BoxSampler": ("#0072B2", "--"),
    "BoxStencil": ("#000000", "--"),
    "QuadraticSampler": ("#E69F00", "--"),
    "7x QuadraticSampler": ("#009E73", "--"),
    "NanoVDB trilinear": ("#CC79A7", ":"),
}
MARKERS = {4: "o", 8: "s", 16: "^", 32: "*"}  # voxels per wavelength or radius
FIELDS = {"waves": ("waves: sin x sin y sin z", "of the amplitude", "wavelength"),
          "distance": ("distance to a ball", "of the radius", "radius")}
QUANTITIES = {"value": "value", "gradient": "gradient", "direction_deg": "gradient's direction"}

# Average threshold at which people distinguish two force directions while they see the same direction: Barbagli,
# Salisbury, Ho, Spence and Tan, "Haptic discrimination of force direction and the influence of visual information", ACM
# Transactions on Applied Perception 3(2), 2006. Without vision the threshold was 25.6 degrees, with misleading vision
# 31.9. The threshold does not apply to jumps and textures, for which perception is far finer.
FORCE_DIRECTION = 18.4


NOTHING = "nothing"  # the time of the loop and of the clock alone


def label(method, reads):
    if method == NOTHING:
        return "nothing: the clock and the loop"
    source = "" if method.startswith(("palpate", "NanoVDB")) else "OpenVDB "
    return f"{source}{method}, {reads}"


def draw_panel(ax, data, field, quantity):
    costs = {m["method"]: m for m in data["scalar"]}
    for method, (colour, line) in STYLES.items():
        points = [r for r in data["errors"]
                  if r["method"] == method and r["field"] == field and quantity in r]
        if not points:
            continue
        walk = costs[method]["walk_ns"]["median"]
        errors = [r[quantity]["rms"] for r in points]
        hollow = not method.startswith("palpate")
        ax.plot([walk] * len(points), errors, color=colour, linestyle=line, linewidth=1.1, zorder=2)
        if quantity == "direction_deg":  # the largest error over all points
            ax.plot([walk] * len(points), [r[quantity]["max"] for r in points], color=colour,
                    marker="_", markersize=9, linestyle="none", alpha=0.7, zorder=2)
        for r, error in zip(points, errors):
            marker = MARKERS[int(r["voxels"])]
            ax.plot(walk, error, marker=marker, markersize=8.5 if marker == "*" else 5.5,
                    color=colour, markerfacecolor="white" if hollow else colour, zorder=3)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlim(2.5, 1500)
    ax.xaxis.set_major_locator(FixedLocator([3, 5, 10, 20, 50, 100, 200, 500, 1000]))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter("{x:.0f}")
    ax.tick_params(labelsize=8)
    clear(ax)
    if quantity == "direction_deg":
        ax.set_ylim(top=400)
        ax.axhline(FORCE_DIRECTION, color="#aa3333", linewidth=1.0, zorder=1)
        ax.text(0.01, FORCE_DIRECTION * 1.15, f"felt: {FORCE_DIRECTION}°", color="#aa3333",
                transform=ax.get_yaxis_transform(), fontsize=7.5, va="bottom")


def add_legend(ax, data):
    ax.axis("off")
    reads = {m["method"]: m["reads"] for m in data["scalar"]}
    methods = [Line2D([], [], color=colour, linestyle=line, marker="o", markersize=5.5,
                      markerfacecolor=colour if name.startswith("palpate") else "white",
                      linewidth=1.1, label=label(name, reads[name]))
               for name, (colour, line) in STYLES.items() if name in reads]
    methods.append(Line2D([], [], color="#555555", marker="_", markersize=9, linestyle="none",
                          label="dashes: the largest error (direction only)"))
    sizes = [Line2D([], [], color="#555555", marker=marker, linestyle="none",
                    markersize=8.5 if marker == "*" else 5.5,
                    label=f"{count} voxels to a wavelength or radius")
             for count, marker in MARKERS.items()]
    ax.legend(handles=methods + sizes, loc="center", ncols=4, fontsize=8.5, frameon=False)


def draw(data):
    figure = plt.figure(figsize=(11.5, 9.0), layout="constrained")
    grid = figure.add_gridspec(3, 3, height_ratios=[1, 1, 0.3])
    for i, (field, (title, share, _)) in enumerate(FIELDS.items()):
        for j, (quantity, words) in enumerate(QUANTITIES.items()):
            ax = figure.add_subplot(grid[i, j])
            draw_panel(ax, data, field, quantity)
            ax.set_title(f"{title}: {words}", fontsize=9.5)
            unit = {"value": share, "gradient": "of the steepest", "direction_deg": "degrees"}
            ax.set_ylabel(f"error, rms [{unit[quantity]}]", fontsize=8.5)
            ax.set_xlabel("time per call on a walk [ns]", fontsize=8.5)
    add_legend(figure.add_subplot(grid[2, :]), data)
    figure.suptitle("What a reading costs, and how wrong it is (V: value, V+G: value and gradient)",
                    fontsize=11.5)
    foot = (f"{where(data['machine']).replace('`', '')}. Times: median of {data['options']['rounds']} "
            "rounds, steps under 0.1 voxel through a ball's narrow band. Red line: average threshold with "
            "congruent vision, Barbagli\net al. 2006 (25.6° without vision); jumps and textures are felt far "
            "finer. A method has one mark for each resolution, all in one column, because its time does not "
            "depend on the data.")
    figure.text(0.005, -0.004, foot, fontsize=7, color="#666666", va="top")
    return figure


def spread(times):
    return f"{number(times['median'])} ({number(times['p10'])} to {number(times['p90'])})"


def calls(times):
    return " / ".join(f"{1e-3 * times[p]:.1f}" for p in ("p50", "p90", "p99"))


def time_table(methods, base):
    """Returns a table of times, relative to the base's time for the walk."""
    reference = next(m for m in methods if m["method"] == base)["walk_ns"]["median"]
    body = [[label(m["method"], m["reads"]), spread(m["walk_ns"]),
             number(reference / m["walk_ns"]["median"]), spread(m["cold_ns"]),
             calls(m["first_near_ns"]), calls(m["first_far_ns"])] for m in methods]
    return table(["method", "walk ns", f"times as fast as {base}", "random points ns",
                  "first call, hand where it was, µs", "first call, elsewhere, µs"], body)


def error_table(data, field):
    """Returns a table sorted by quantity, so that the methods of one quantity are consecutive rows."""
    reads = {m["method"]: m["reads"] for m in data["scalar"]}
    rows = {(r["method"], r["voxels"]): r for r in data["errors"] if r["field"] == field}
    unit, size = FIELDS[field][1:]
    words = {"value": f"value, {unit}", "gradient": "gradient, of the steepest",
             "direction_deg": "direction °", "jump": "largest jump"}

    def cell(error):
        if isinstance(error, dict):
            return f"{number(error['rms'])} ({number(error['max'])})"
        return "0" if error < 1e-5 else number(error)

    body = []
    for quantity, word in words.items():
        for method in STYLES:
            found = [rows.get((method, voxels), {}).get(quantity) for voxels in MARKERS]
            if None not in found:
                body.append([word, label(method, reads[method]), *map(cell, found)])
    return table(["error", "method", *(f"{voxels} voxels to a {size}" for voxels in MARKERS)], body)


def asked_table(data):
    """Returns a table of the project's targets, relative to the times of OpenVDB's BoxSampler (in one row GridSampler),
    which read only the value."""
    scalar = {m["method"]: m for m in data["scalar"]}
    vector = {m["method"]: m for m in data["vector"]}

    def row(what, asked, ours, base, key, which):
        mine, theirs = ours[key][which], base[key][which]
        ratio = theirs / mine
        return [what, asked, number(mine), number(theirs),
                f"{number(ratio)} times as fast" if ratio >= 1 else f"{number(1 / ratio)} times as long"]

    box = scalar["BoxSampler"]
    body = [row("trilinear, value and gradient, walk", "2 times as fast",
                scalar["palpate trilinear"], box, "walk_ns", "median"),
            row("the same, both from the hand's world: GridSampler", "2 times as fast",
                scalar["palpate trilinear"], scalar["GridSampler"], "walk_ns", "median"),
            row("quadratic, value and gradient, walk", "no slower",
                scalar["palpate quadratic"], box, "walk_ns", "median"),
            row("trilinear, random points", "", scalar["palpate trilinear"], box, "cold_ns", "median"),
            row("velocity and Jacobian, walk", "", vector["palpate trilinear"],
                vector["BoxSampler"], "walk_ns", "median")]
    for key, hand in (("first_near_ns", "where it was"), ("first_far_ns", "elsewhere")):
        for which in ("p50", "p99"):
            body.append(row(f"trilinear, first call, hand {hand}, {which}", "no slower",
                            scalar["palpate trilinear"], box, key, which))
    return table(["measure, against BoxSampler's value", "asked", "ours ns", "BoxSampler ns",
                  "reached"], body)


def write_tables(data, load):
    options, grids = data["options"], data["grids"]
    millions = grids["scalar"]["active_voxels"] / 1e6
    notes = [f"{label(m['method'], m['reads'])}: {m['note']}" for m in data["scalar"] if m["note"]]
    text = [
        f"{where(data['machine'])}. {options['rounds']} rounds of {options['walk_steps']:,} steps and "
        f"{options['cold_points']:,} random points; {options['first_calls']} first calls, each after reading "
        f"{options['evicted_bytes'] / 2**20:.0f} MB of something else." +
        ("" if options["nanovdb"] else " NanoVDB was not found."),
        "; ".join(notes) + ".",
        "### Requested and reached accuracy", asked_table(data),
        f"### Times, a scalar in a ball's band of {millions:.1f} million voxels "
        f"({grids['scalar']['memory'] / 2**20:.0f} MB)",
        "Per call, median of the rounds (10th to 90th percentile); first calls p50 / p90 / p99.",
        time_table(data["scalar"], "BoxSampler"),
        f"### Times, a velocity in the same voxels ({grids['vector']['memory'] / 2**20:.0f} MB)",
        time_table(data["vector"], "BoxSampler")]
    for field, (title, _, _) in FIELDS.items():
        text += [f"### Errors, {title}", "Rms (largest). A jump is the largest step of the gradient "
                 "across a face, of the steepest gradient.", error_table(data, field)]
    if load:
        text += ["### Loading", load.read_text().strip()]
    return "\n\n".join(text) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("result", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--doc", type=Path, help="a page whose marked part the tables replace")
    parser.add_argument("--load", type=Path, help="what palpate_bench_load printed, for the page")
    arguments = parser.parse_args()
    data = json.loads(arguments.result.read_text())
    page = Page(arguments.doc)
    prepare(arguments.folder)
    save(draw(data), arguments.folder, "sampler_accuracy")
    page.fill(write_tables(data, arguments.load))


if __name__ == "__main__":
    main()
