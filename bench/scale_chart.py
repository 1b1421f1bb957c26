#!/usr/bin/python3
"""Draws what palpate_bench_scale measured.

    scale_chart.py RESULT.json FOLDER [--doc FILE.md]

Writes scale_number, scale_overlap and scale_size as .png and .svg into FOLDER. The tables go to standard output, or
into FILE.md between its markers.
"""
import sys

sys.dont_write_bytecode = True
from charting import clear, number, plt, run, save, table, where  # noqa: E402

# Okabe and Ito's colours.
MEDIAN, TAIL, OTHER = "#0072B2", "#D55E00", "#8c8c8c"


def panels(count):
    figure, axes = plt.subplots(1, count, figsize=(4.2 * count, 3.6), squeeze=False)
    for ax in axes[0]:
        clear(ax)
    figure.subplots_adjust(wspace=0.32)
    return figure, axes[0]


def ticks_of(ax, x, rows, key, style="-", suffix="", colours=(MEDIAN, TAIL)):
    for colour, what, label in ((colours[0], "p50_ns", "median"), (colours[1], "p999_ns", "p99.9")):
        ax.plot(x, [1e-3 * r[key][what] for r in rows], style, marker="o", markersize=3,
                color=colour, label=label + suffix)


def draw_number(rows, folder):
    x = [r["placements"] for r in rows]
    figure, (tick, memory, build) = panels(3)
    ticks_of(tick, x, rows, "tick")
    paired = [r for r in rows if "two_alone" in r]
    ticks_of(tick, [r["placements"] for r in paired], paired, "two_alone", ":", ", the two alone",
             (OTHER, OTHER))
    tick.set_ylabel("a tick on two of them that overlap [us]")
    tick.set_ylim(bottom=0)
    tick.legend(fontsize=7, frameon=False)
    memory.plot(x, [r["memory_mb"] for r in rows], marker="o", markersize=3, color=MEDIAN)
    memory.set_ylabel("memory for the placements [MB]")
    build.plot(x, [1e3 * r["build_s"] for r in rows], marker="o", markersize=3, color=MEDIAN)
    build.set_ylabel("building the scene [ms]")
    for ax in (tick, memory, build):
        ax.set_xscale("log")
        ax.set_xlabel("volumes (up to 10,000: in 1 m³)")
    build.set_yscale("log")
    save(figure, folder, "scale_number")


def draw_overlap(rows, folder):
    x = [r["overlap"] for r in rows]
    figure, (tick, each, error) = panels(3)
    ticks_of(tick, x, rows, "tick")
    tick.set_ylabel("a tick [us]")
    tick.legend(fontsize=7, frameon=False)
    each.plot(x, [1e-3 * r["tick"]["p50_ns"] / r["overlap"] for r in rows], marker="o",
              markersize=3, color=MEDIAN)
    each.set_ylabel("of the median, for each volume [us]")
    each.set_ylim(bottom=0)
    error.plot(x, [r["bound_n"] for r in rows], marker="o", markersize=3, color=OTHER,
               label="bound that was given")
    error.plot(x, [r["error_n"] for r in rows], marker="o", markersize=3, color=MEDIAN,
               label="against the reference")
    error.set_yscale("log")
    error.set_ylabel("error of the force, largest [N]")
    error.legend(fontsize=7, frameon=False)
    for ax in (tick, each, error):
        ax.set_xlabel("volumes that overlap where the hand is")
    save(figure, folder, "scale_overlap")


def draw_size(rows, folder):
    x = [r["volume_mb"] for r in rows]
    figure, (tick, memory, build) = panels(3)
    ticks_of(tick, x, rows, "tick")
    tick.set_ylabel("a tick over its skin [us]")
    tick.set_ylim(bottom=0)
    tick.legend(fontsize=7, frameon=False)
    memory.plot(x, [r["thousand_mb"] for r in rows], marker="o", markersize=3, color=MEDIAN,
                label="placed a thousand times")
    memory.plot(x, [r["one_mb"] for r in rows], ":", marker="o", markersize=3, color=OTHER,
                label="placed once")
    memory.set_yscale("log")
    memory.set_ylabel("memory [MB]")
    memory.legend(fontsize=7, frameon=False)
    build.plot(x, [1e3 * r["build_one_s"] for r in rows], ":", marker="o", markersize=3,
               color=OTHER, label="the first time")
    build.plot(x, [1e3 * r["build_thousand_s"] for r in rows], marker="o", markersize=3,
               color=MEDIAN, label="a thousand places more")
    build.set_yscale("log")
    build.set_ylabel("building the scene [ms]")
    build.legend(fontsize=7, frameon=False)
    for ax in (tick, memory, build):
        ax.set_xscale("log")
        ax.set_xlabel("memory of the volume [MB]")
    save(figure, folder, "scale_size")


def microseconds(times):
    return f"{number(1e-3 * times['p50_ns'])} / {number(1e-3 * times['p999_ns'])}"


def spread(ratio):
    return f"{number(ratio['median'])} ({number(ratio['least'])} to {number(ratio['most'])})"


def tables(data):
    parts = []
    body = [[r["placements"], microseconds(r["tick"]),
             microseconds(r["two_alone"]) if "two_alone" in r else "",
             spread(r["p50_ratio"]) if "two_alone" in r else "",
             spread(r["p999_ratio"]) if "two_alone" in r else "",
             f"{number(r['look_up']['p50_ns'])} / {number(r['look_up']['p999_ns'])}",
             number(r["look_up"]["asking_p50_ns"]), microseconds(r["free_tick"]),
             number(1e3 * r["build_s"]), number(r["memory_mb"]), number(r["hands_mb"])]
            for r in data["number"]]
    parts.append("**Volumes placed.** Two of them overlap where the hand is.\n\n" + table(
        ["placed", "tick [us], p50 / p99.9", "the two alone", "ratio of p50", "ratio of p99.9",
         "look-up in free space [ns], p50 / p99.9", "where it asks the tree, p50",
         "tick in free space [us]", "build [ms]", "memory [MB]", "four hands [MB]"], body))
    body = [[r["overlap"], microseconds(r["tick"]), microseconds(r["one_graph"]),
             spread(r["ratio"]), number(1e-3 * r["tick"]["p50_ns"] / r["overlap"]), number(r["iterations"]),
             number(r["force_n"]), number(r["error_n"]), number(r["bound_n"])]
            for r in data["overlap"]]
    parts.append("**Volumes that overlap.**\n\n" + table(
        ["overlap", "tick [us], p50 / p99.9", "without instances", "ratio of p50", "p50 for each [us]",
         "iterations",
         "largest force [N]", "largest error [N]", "bound given [N]"], body))
    body = [[r["placed"], microseconds(r["tick"]), number(r["missing_n"])] for r in data["crowd"]]
    parts.append("**More than there is room for**: clouds as before; 64 are felt.\n\n" + table(
        ["overlap", "tick [us], p50 / p99.9", "the force is off by at most [N]"], body))
    body = [[number(r["volume_mb"]), microseconds(r["tick"]), number(r["one_mb"]),
             number(r["thousand_mb"]), number(r["thousand_mb"] / r["one_mb"]),
             number(1e3 * r["build_one_s"]), number(1e3 * r["build_thousand_s"])]
            for r in data["size"]]
    parts.append("**Size of a volume.**\n\n" + table(
        ["volume [MB]", "tick [us], p50 / p99.9", "placed once [MB]", "a thousand times [MB]",
         "ratio", "build, the first time [ms]", "a thousand places more [ms]"], body))
    body = [[r["parts"], r["volumes"], microseconds(r["tick"]), number(r["felt_mean"]),
             r["felt_most"], r["ticks_with_parts_left_out"], number(1e3 * r["build_s"]),
             number(r["memory_mb"])] for r in data["scenes"]]
    if body:
        parts.append("**Scenes of files**, each explored for 60 s.\n\n" + table(
            ["placed", "volumes", "tick [us], p50 / p99.9", "met in the mean", "at most",
             "ticks without room", "load and build [ms]", "memory [MB]"], body))
    parts.append(f"{where(data['machine'])}; times include the clock's {data['clock_ns']:.0f} ns.")
    return "\n\n".join(parts) + "\n"


def draw(data, folder):
    draw_number(data["number"], folder)
    draw_overlap(data["overlap"], folder)
    draw_size(data["size"], folder)


if __name__ == "__main__":
    run(__doc__, draw, tables)
