#!/usr/bin/python3
"""Draws what palpate_bench_speed_accuracy measured.

    speed_accuracy_chart.py RESULT.json FOLDER [--doc FILE.md]

Writes speed_accuracy, speed_accuracy_motion, figure7 and nonorthogonal into FOLDER, each as .png and .svg. The tables
go to standard output, or into FILE.md between its markers.
"""
import argparse
import json
import sys
from pathlib import Path

sys.dont_write_bytecode = True
from charting import Page, number, plt, prepare, save, table, where  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.lines import Line2D  # noqa: E402

OURS = "palpate"
WARM = "palpate, warm"
PAPER = "Euler, adaptive step"

# Okabe and Ito's colours, which colour-blind people can distinguish; each method also has its own marker.
STYLES = {
    "force function": ("#8c8c8c", "X"),
    "constraint approach": ("#000000", "P"),
    "Euler, fixed step": ("#E69F00", "v"),
    PAPER: ("#D55E00", "^"),
    "Nelder-Mead": ("#009E73", "D"),
    "smallest residual": ("#CC79A7", "s"),
    OURS: ("#0072B2", "o"),
    WARM: ("#56B4E9", "*"),
}
FAMILIES = {
    "random": "random kinds, anchors and directions",
    "one point": "all at one point",
    "near-parallel": "near-parallel, within 1e-2 rad",
    "slot": "slot: planes face to face",
    "orthogonal": "orthogonal",
    "walk, fixed": "a walking hand, primitives fixed",
    "walk, carried": "a walking hand, primitives carried",
    "surface and drag": "exploration: surface and drag",
    "surface and stream": "exploration: surface and stream",
}
FLOOR = 1e-13  # [m]: smaller errors are drawn here


def style(method):
    return STYLES.get(method, ("#000000", "."))


VARIANTS = {"": "-", "halving": "--", "slow": "-."}  # line styles for the variants of a method


def rows_of(results):
    """Returns the results grouped by family and number of primitives, in the file's order."""
    rows = {}
    for r in results:
        rows.setdefault((r["family"], r["primitives"]), []).append(r)
    return rows


def draw_row(ax, row):
    """Draws the cost against the error for one family and number of primitives: a line per variant of a method, a mark
    per setting."""
    reach = row[0]["reach_m"]
    for share, text in ((1e-3, "1e-3 S/k"), (1e-6, "1e-6 S/k")):
        ax.axhline(share * reach, color="#bbbbbb", linewidth=0.8, linestyle=":", zorder=0)
        ax.text(0.995, share * reach, text, transform=ax.get_yaxis_transform(), fontsize=6.5,
                color="#777777", ha="right", va="bottom")
    def line_of(r):  # the settings of each variant of a method form one line
        return r["method"], r["setting"].partition(", ")[2]

    for method, variant in dict.fromkeys(map(line_of, row)):
        colour, marker = style(method)
        points = [r for r in row if line_of(r) == (method, variant)]
        cost = np.array([1e-3 * r["cost_ns"]["median"] for r in points])
        error = np.maximum([r["error_m"]["median"] for r in points], FLOOR)
        late = np.maximum([r["error_m"]["p99"] for r in points], FLOOR)
        slow = np.array([1e-3 * r["cost_ns"]["p99"] for r in points])
        gap = np.full(len(cost), np.nan)
        ax.plot(np.ravel([cost, cost, gap, cost, slow, gap], "F"),
                np.ravel([error, late, gap, error, error, gap], "F"), color=colour, linewidth=0.7,
                alpha=0.4, zorder=1)
        ax.plot(cost, error, color=colour, linewidth=1.0, linestyle=VARIANTS[variant],
                zorder=2)
        if "cold_ns" in points[0]:
            cold = np.array([1e-3 * r["cold_ns"] for r in points])
            ax.plot(np.ravel([cost, cold, gap], "F"), np.ravel([error, error, gap], "F"),
                    color=colour, linewidth=0.7, linestyle=":", zorder=1)
            ax.plot(cold, error, marker="|", markersize=7, color=colour, linestyle="none", zorder=3)
        every = np.array([r["reached"]["1e-3"] >= 1.0 for r in points])
        for which, face in ((~every, "white"), (every, colour)):
            ax.plot(cost[which], error[which], marker=marker, markersize=8 if marker == "*" else 5.5,
                    color=colour, markerfacecolor=face, linestyle="none", zorder=3)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.grid(color="#e8e8e8", linewidth=0.5)
    ax.minorticks_off()
    ax.tick_params(labelsize=7.5)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def add_legend(ax, methods, cold):
    ax.axis("off")
    handles = []
    for method in methods:
        colour, marker = style(method)
        handles.append(Line2D([], [], color=colour, marker=marker, markersize=6.5, linewidth=1.0,
                              label=method))
    grey = "#555555"
    handles += [
        *(Line2D([], [], color=style(PAPER)[0], linewidth=1.0, linestyle=VARIANTS[variant],
                 label=f"{PAPER}, {variant}") for variant in ("halving", "slow")),
        Line2D([], [], color=grey, marker="o", markersize=6, linestyle="none",
               label="filled: every case within 1e-3 S/k"),
        Line2D([], [], color=grey, marker="o", markersize=6, markerfacecolor="white",
               linestyle="none", label="hollow: some case is not"),
        Line2D([], [], color=grey, linewidth=0.8, label="thin lines: from median to p99"),
    ]
    if cold:
        handles.append(Line2D([], [], color=grey, linewidth=0.7, linestyle=":", marker="|", markersize=7,
                              label="to a bar: after 1 ms asleep, its core busy"))
    ax.legend(handles=handles, loc="center", fontsize=8.5, frameon=False)


def draw_grid(rows, families, title, foot, columns=3):
    """Draws a row of panels for each family; families of one panel share rows. A free panel has the methods' names."""
    lines = [[key for key in rows if key[0] == family] for family in families]
    packed = []
    for line in lines:  # single panels share a row
        if packed and len(line) == 1 and len(packed[-1]) == 1:
            packed[-1] += line
        elif line:
            packed.append(line)
    if packed and all(len(line) == columns for line in packed):
        packed.append([])
    figure, axes = plt.subplots(len(packed), columns, figsize=(10.5, 2.6 * len(packed) + 0.9),
                                sharex=True, sharey=True, squeeze=False, layout="constrained")
    methods = [m for m in STYLES if any(r["method"] == m for row in rows.values() for r in row)]
    legend_at = None
    for i, line in enumerate(packed):
        for j in range(columns):
            ax = axes[i][j]
            if j >= len(line):
                ax.axis("off")
                legend_at = ax
                continue
            draw_row(ax, rows[line[j]])
            family, count = line[j]
            ax.set_title(f"{FAMILIES.get(family, family)}, N = {count}", fontsize=9)
            if j == 0:
                ax.set_ylabel("error of the proxy [m]", fontsize=8.5)
            below = packed[i + 1] if i + 1 < len(packed) else []
            if j >= len(below):
                ax.set_xlabel("time per balance [µs]", fontsize=8.5)
                ax.tick_params(labelbottom=True)
    add_legend(legend_at, methods, any("cold_ns" in r for row in rows.values() for r in row))
    figure.suptitle(title, fontsize=11)
    figure.text(0.005, -0.004, foot, fontsize=7, color="#666666", va="top")
    return figure


def draw_figure7(data):
    """Draws the iterations over time in bins: the median as a line, the range from smallest to largest as a band."""
    size = max(1, len(data["speed_m_s"]) // 400)
    count = len(data["speed_m_s"]) // size
    rate = data["rate_hz"]
    time = (np.arange(count) + 0.5) * size / rate

    def bins(values):
        return np.array(values[:count * size], dtype=float).reshape(count, size)

    figure, (top, bottom) = plt.subplots(2, 1, figsize=(10.5, 5.6), sharex=True,
                                         height_ratios=[3, 1.2], layout="constrained")
    touching = bins(data["primitives"]).mean(axis=1) > 1.5
    for ax in (top, bottom):
        ax.fill_between(time, 0, 1, where=touching, step="mid", color="#f2efe6", linewidth=0,
                        transform=ax.get_xaxis_transform(), zorder=0)
        ax.grid(color="#e8e8e8", linewidth=0.5)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
    for solver in data["solvers"]:
        colour, _ = style(solver["method"])
        values = bins(solver["iterations"])
        two = solver["two_primitives"]
        setting = f" {solver['setting']}" if solver["setting"] else ""
        top.fill_between(time, values.min(axis=1), values.max(axis=1), color=colour, alpha=0.25,
                         linewidth=0)
        top.plot(time, np.median(values, axis=1), color=colour, linewidth=1.1,
                 label=f"{solver['method']}{setting}: median {two['median']:.0f}, "
                       f"p99 {two['p99']:.0f}, most {two['worst']:.0f} on the surface")
    top.set_yscale("symlog", linthresh=1)
    top.set_ylim(bottom=0)
    top.yaxis.set_major_formatter("{x:.0f}")
    top.set_ylabel("iterations per balance")
    top.legend(fontsize=8.5, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    bottom.plot(time, bins(data["speed_m_s"]).mean(axis=1), color="#444444", linewidth=0.9)
    bottom.set_ylim(0, 1.1 * max(1e-3, bins(data["speed_m_s"]).mean(axis=1).max()))
    bottom.set_ylabel("probe speed [m/s]")
    bottom.set_xlabel("time [s]")
    bottom.set_xlim(0, count * size / rate)
    figure.suptitle("Figure 7 of the paper, repeated: a hand explores a ball with a surface and a drag "
                    "(shaded: both are balanced, else one)", fontsize=10.5)
    return figure


def draw_nonorthogonal(data):
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.2), layout="constrained")
    smallest = 1e-18
    old = STYLES[PAPER][0]
    curves = data["curves"]
    every = ", ".join(f"{c['strength_n']:g}" for c in curves)
    for n, curve in enumerate(curves):
        angle = curve["degrees"]
        for key, colour, name in (("constraint_approach_n", old, "eq. (2)"),
                                  ("palpate_n", STYLES[OURS][0], "palpate")):
            worst = np.array(curve[key]["worst"])
            left.plot(angle, worst, color=colour, linewidth=1.8,
                      label=f"{name}, constraints of {every} N" if n == 0 else None)
            right.plot(angle, np.maximum(worst, smallest), color=colour, linewidth=1.3,
                       linestyle=("-", "--", ":")[n % 3],
                       label=f"{name}, {curve['strength_n']:g} N")
    for ax in (left, right):
        ax.set_xlim(90, 0)
        ax.set_xticks(range(90, -1, -15))
        ax.set_xlabel("angle between two of the three constraints [degrees]")
        ax.grid(color="#e8e8e8", linewidth=0.5)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
    left.set_ylabel("force out of nothing, largest [N]")
    left.set_title("linear: the strengths cannot be told apart", fontsize=9.5)
    left.legend(fontsize=8, loc="upper left")
    right.set_yscale("log")
    right.set_ylim(smallest / 3, 30)
    right.legend(fontsize=8, loc="center right")
    right.set_title("logarithmic (zero is drawn at 1e-18 N)", fontsize=9.5)
    pull = data["stiffness_n_m"] * data["hand_away_m"]
    figure.suptitle("Section 3.1 as an experiment: the force that weak constraints make up, hand "
                    f"{1e3 * data['hand_away_m']:.0f} mm from the old proxy, k = "
                    f"{data['stiffness_n_m']:.0f} N/m (a spring of {pull:.1f} N)", fontsize=10.5)
    return figure


def percent(part, whole):
    return "0" if part == 0 else f"{part} ({100 * part / whole:.2g} %)"


def certificates(data):
    """Returns a text that states, for each setting, how many of the engine's error bounds hold."""
    counts = {}
    for r in data["results"]:
        if r["certificates"]:
            count = counts.setdefault(f"{r['method']} {r['setting']}", [0, 0])
            count[0] += r["certificates"] - r["certificates_broken"]
            count[1] += r["certificates"]
    return ", ".join(f"{name}: " + ("all" if held == of else f"{held}") + f" of {of}"
                     for name, (held, of) in counts.items())


def write_tables(data):
    machine, truth = data["machine"], data["truth"]
    rows = rows_of(data["results"])
    methods = [m for m in STYLES if any(r["method"] == m for r in data["results"])]
    text = [
        f"{where(machine)}; {data['options']['problems']} problems a family and N, "
        f"seed {data['options']['seed']}.",
        f"True answers are the reference solver's, known to {truth['widest_bound_over_reach']:.0e} "
        f"S/k or better in all of {truth['cases']}. Certificates of the engine's solver that hold: {certificates(data)}."]

    # Short form: the range of the families' medians.
    def spread(values):
        low, high = min(values), max(values)
        return number(low) if low == high else f"{number(low)} to {number(high)}"

    body = []
    for motion in (False, True):
        for count in sorted({count for _, count in rows}):
            every = [r for r in data["ratios"]
                     if r["motion"] == motion and r["primitives"] == count and r["other"] == PAPER
                     and r["target"] == "1e-3"]
            for ours in (OURS, WARM):
                some = [r for r in every if r["ours"] == ours]
                if not some:
                    continue
                both = [r for r in some if r["both"]]
                missed = [100 * r["missed_by_other"] / r["cases"] for r in some]
                body.append(["a hand's motion" if motion else "out of the blue", count, ours,
                             spread([1e-3 * r["ours_median_ns"] for r in both]),
                             spread([1e-3 * r["other_median_ns"] for r in both]),
                             spread([r["ratio"]["median"] for r in both]),
                             spread([r["ratio"]["missed_or_not_median"] for r in some]),
                             f"{min(missed):.0f} to {max(missed):.0f} %",
                             sum(r["missed_by_ours"] for r in some)])
    text += ["### In short: 1e-3 S/k, against the paper's Euler with adaptive step",
             "From the least to the largest of the families' medians; the families one by one below.",
             table(["problems", "N", "ours", "ours µs", "Euler µs", "times faster",
                    "missed or not", "Euler misses", "ours misses"], body)]

    # Time at equal accuracy, relative to the paper's solver.
    def ratio_table(motion, targets):
        body = []
        for r in data["ratios"]:
            if r["other"] != PAPER or r["target"] not in targets or r["motion"] != motion:
                continue
            ratio = r["ratio"]
            cells = [number(1e-3 * r["ours_median_ns"]), number(1e-3 * r["other_median_ns"]),
                     f"**{number(ratio['median'])}** "
                     f"({number(ratio['p10'])} to {number(ratio['p90'])})",
                     number(ratio["of_sums"]), number(ratio["luckiest_setting_median"])]
            anyway = number(ratio["missed_or_not_median"])
            if not r["both"]:
                cells = ["-"] * len(cells)
            body.append([r["family"], r["primitives"], r["target"], r["ours"], r["setting"], *cells, anyway,
                         percent(r["missed_by_other"], r["cases"]),
                         percent(r["missed_by_all_its_settings"], r["cases"]),
                         percent(r["missed_by_ours"], r["cases"])])
        return table(["family", "N", "S/k", "ours", "Euler's setting", "ours µs", "Euler µs",
                      "times faster, median (p10 to p90)", "summed", "luckiest setting", "missed or not",
                      "Euler misses", "at every setting", "ours misses"], body)

    text += ["### At equal accuracy, against the paper's Euler with adaptive step",
             "Over the cases that both reach; those that one misses are counted in the last columns. "
             "Ours is asked for the accuracy. Euler runs at the cheapest setting that reaches it as "
             "often as its most reliable one does; \"luckiest setting\" is the median if for each "
             "case the cheapest setting that happens to get there is taken, which no program could. What Euler "
             "misses is seldom what is easy: \"missed or not\" is the median over all cases, with what it "
             "cost Euler to get there or to give up.",
             ratio_table(False, ("1e-3",)), "Along motions:", ratio_table(True, ("1e-2", "1e-3"))]

    # Share of cases in which a method does not reach the accuracy.
    body = []
    for (family, count), row in rows.items():
        line = [family, count]
        for method in methods:
            shares = [r["reached"]["1e-3"] for r in row if r["method"] == method]
            if not shares:
                line.append("")
                continue
            missed = 100 * (1 - max(shares))
            line.append("0" if missed < 1e-9 else f"{missed:.0f}" if missed >= 10 else f"{missed:.1f}")
        body.append(line)
    text += ["### Cases not solved to 1e-3 S/k, in per cent, each method at its most reliable setting",
             table(["family", "N", *methods], body)]

    # The engine with its default settings.
    body = []
    for (family, count), row in rows.items():
        for r in row:
            if r["method"] in (OURS, WARM) and r["setting"] == "1e-6":
                body.append([family, count, r["method"], number(1e-3 * r["cost_ns"]["median"]),
                             number(1e-3 * r["cost_ns"]["p99"]), f"{r['iterations']['median']:.0f}",
                             f"{r['iterations']['worst']:.0f}", f"{r['error_m']['worst']:.1e}",
                             "0" if r["reached"]["1e-6"] >= 1 else
                             f"{100 * (1 - r['reached']['1e-6']):.2g} %"])
    text += ["### The engine's solver at its default, 1e-6 S/k",
             table(["family", "N", "", "median µs", "p99 µs", "solves, median", "most",
                    "largest error m", "above 1e-6 S/k"], body)]

    # Figure 7 and section 3.1.
    body = [[s["method"], s["setting"], s["two_primitives"]["ticks"],
             f"{s['two_primitives']['median']:.0f}", f"{s['two_primitives']['p99']:.0f}",
             f"{s['two_primitives']['worst']:.0f}"] for s in data["figure7"]["solvers"]]
    text += ["### Iterations over the exploration, ticks of two primitives",
             table(["solver", "setting", "ticks", "median", "p99", "most"], body)]
    body = []
    for curve in data["nonorthogonal"]["curves"]:
        for degrees in (90, 60, 30, 10, 1):
            i = curve["degrees"].index(degrees)
            body.append([f"{curve['strength_n']:g}", degrees,
                         number(curve["largest_true_force_n"][i]),
                         number(curve["constraint_approach_n"]["worst"][i]),
                         number(curve["palpate_n"]["worst"][i])])
    text += ["### Force out of nothing, largest over directions",
             table(["strength N", "angle °", "true force, largest N", "eq. (2): too much by N",
                    "palpate: too much by N"], body)]
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

    rows = rows_of(data["results"])
    machine = data["machine"]
    foot = (f"{machine['processor']}, {machine['compiler']}, commit {machine['commit']}. Marks: medians "
            f"over the problems, one per setting. Errors below the true answer's own bound are drawn at it.")
    still = {key: row for key, row in rows.items() if not row[0]["motion"]}
    moving = {key: row for key, row in rows.items() if row[0]["motion"]}
    for part, name, title in (
            (still, "speed_accuracy", "Speed against accuracy: problems out of the blue"),
            (moving, "speed_accuracy_motion", "Speed against accuracy: along a hand's motion")):
        families = list(dict.fromkeys(family for family, _ in part))
        save(draw_grid(part, families, title, foot), arguments.folder, name)
    save(draw_figure7(data["figure7"]), arguments.folder, "figure7")
    save(draw_nonorthogonal(data["nonorthogonal"]), arguments.folder, "nonorthogonal")

    page.fill(write_tables(data))


if __name__ == "__main__":
    main()
