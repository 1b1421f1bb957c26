#!/usr/bin/python3
"""Draws what palpate_bench_window measured: memory, share of coarse ticks and tick times along the path.

    window_chart.py RESULT.json FOLDER [--doc FILE.md]

Writes window_way.png and .svg into FOLDER. The table goes to standard output, or into FILE.md between its markers."""
import sys

sys.dont_write_bytecode = True
from charting import clear, number, plt, run, save, table, where  # noqa: E402

# Okabe and Ito's colours.
MEDIAN, TAIL, OTHER = "#0072B2", "#D55E00", "#8c8c8c"


def draw(data, folder):
    figure, axes = plt.subplots(3, 2, figsize=(8.4, 6.2), sharex="col", sharey="row")
    brick = data["budget_mb"] / data["slow"][0]["slots"]
    for column, (key, title) in enumerate((("slow", "0.3 m/s"), ("fast", "2 m/s"))):
        memory, coarse, tick = axes[:, column]
        rows = data[key]
        x = [row["s"] for row in rows]
        memory.set_title(f"hand at {title}", fontsize=9)
        memory.plot(x, [row["resident"] * brick for row in rows], color=MEDIAN, label="bricks in memory")
        memory.axhline(data["budget_mb"], color=OTHER, linewidth=0.8, linestyle=":", label="budget")
        fetched = memory.twinx()
        fetched.plot(x, [row["fetched"] * brick for row in rows], color=TAIL, linewidth=0.8)
        fetched.set_ylim(bottom=0)
        for side in ("top", "left"):
            fetched.spines[side].set_visible(False)
        fetched.tick_params(colors=TAIL, labelsize=7)
        fetched.set_ylabel("fetched so far [MB]", color=TAIL, fontsize=8)
        coarse.plot(x, [100 * row["coarse_share"] for row in rows], color=MEDIAN)
        tick.plot(x, [row["p50_us"] for row in rows], color=MEDIAN, label="median")
        tick.plot(x, [row["max_us"] for row in rows], color=TAIL, label="worst of 50 ms")
        tick.set_yscale("log")
        tick.set_xlabel("on the way [s]")
        for ax in axes[:, column]:
            clear(ax)
    axes[0, 0].set_ylim(bottom=0)
    axes[0, 0].set_ylabel("memory [MB]")
    axes[1, 0].set_ylim(-2, 102)
    axes[1, 0].set_ylabel("coarse ticks [%]")
    axes[2, 0].set_ylabel("a tick [us]")
    axes[0, 0].legend(fontsize=7, frameon=False, loc="lower right")
    axes[2, 0].legend(fontsize=7, frameon=False)
    figure.subplots_adjust(wspace=0.28, hspace=0.16)
    save(figure, folder, "window_way")


def tables(data):
    head = ["hand", "", "p50 us", "p99", "p99.9", "worst", "late ticks", "coarse ticks %", "largest growth of force N"]
    body = []
    pairs = [("0.3 m/s", data["all"])] if "all" in data else []
    for speed, both in [*pairs, ("2 m/s", data["haste"])]:
        for key, name in (("whole", "in memory"), ("window", "through the window")):
            row = both[key]
            body.append([speed, name, *(number(row[k]) for k in ("p50_us", "p99_us", "p999_us", "max_us")),
                         int(row["late"]), number(100 * row["coarse_share"]), number(row["step_n"])])
    lines = [f"{where(data['machine'])}.", "",
             f"The volume has {number(data['whole_mb'])} MB, the window a budget of {number(data['budget_mb'])} MB; by the "
             f"system it takes {number(data['memory_mb'])} MB. In {len(data['pairs'])} pairs of runs the p99.9 through the "
             f"window is {number(data.get('p999_ratio', 0))} of that in memory, in the median.", "",
             table(head, body)]
    if "ticks" in data:
        # All runs have the same path, so a delay by the machine affects the same tick only in few runs.
        lines += ["", "At 0.3 m/s, of each tick its median over the pairs:", "",
                  table(["", "in memory us", "through the window us", "ratio"],
                        [[name, number(a), number(b), f"{b / a:.2f}"] for name, (a, b) in data["ticks"].items()])]
    return "\n".join(lines)


if __name__ == "__main__":
    run(__doc__, draw, tables)
