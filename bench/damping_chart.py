#!/usr/bin/python3
"""Draws what palpate_bench_damping measured.

    damping_chart.py RESULT.json FOLDER

Writes damping.png and damping.svg into FOLDER, and the table to standard output.
"""
import sys

sys.dont_write_bytecode = True
from charting import clear, number, plt, run, save, table, where  # noqa: E402

COLOURS = {1000: "#0072B2", 4000: "#009E73", 10000: "#D55E00"}  # Okabe and Ito's


def back(result, time):
    """Returns the time over which the damper computes its velocity [ms], at least one tick."""
    return max(1e3 * time, 1e3 / result["rate"])


def draw(data, folder):
    figure, (noise, room) = plt.subplots(1, 2, figsize=(10.4, 4.0))
    for ax in (noise, room):
        clear(ax)
        ax.set_xscale("log")
        ax.set_xticks([0.1, 0.25, 0.5, 1, 2, 4], labels=["0.1", "0.25", "0.5", "1", "2", "4"])
        ax.minorticks_off()
        ax.set_xlabel("looks back [ms]")
    for r in data["results"]:
        colour = COLOURS[int(r["rate"])]
        line = "-" if r["damping"] < 1 else "--"
        name = f"{r['rate'] / 1000:g} kHz, {r['damping']:g} N s/m"
        x = [back(r, t["time"]) for t in r["times"]]
        noise.plot(x, [1e3 * t["buzz"] for t in r["times"]], line, marker="o", ms=3, lw=1,
                   color=colour, label=name)
        first = r["times"][0]["released"]
        room.plot(x, [100 * t["released"] / first for t in r["times"]], line, marker="o", ms=3,
                  lw=1, color=colour)
    undamped = max(r["undamped"] for r in data["results"])
    noise.axhline(1e3 * undamped, color="#8c8c8c", lw=0.8)
    noise.annotate("no damping", (0.1, 1e3 * undamped), textcoords="offset points", xytext=(0, -10),
                   fontsize=8, color="#8c8c8c")
    noise.set_yscale("log")
    noise.set_ylim(2.5, 80)
    noise.set_yticks([3, 10, 30], labels=["3", "10", "30"])
    noise.set_ylabel("force above 100 Hz, rms [mN]")
    noise.legend(fontsize=7, frameon=False)
    room.set_ylabel("stable stiffness, % of one tick's")
    room.set_ylim(90, 100.5)
    save(figure, folder, "damping")


def tables(data):
    times = [t["time"] for t in data["results"][0]["times"]]
    head = ["rate [kHz]", "damping [N s/m]", "none"]
    head += ["a tick" if t == 0 else f"{1e3 * t:g} ms" for t in times]
    body = []
    for r in data["results"]:
        cells = [f"{number(1e3 * t['buzz'])} ({t['released']:.0f})" for t in r["times"]]
        body.append([number(r["rate"] / 1000), number(r["damping"]),
                     number(1e3 * r["undamped"]), *cells])
    return table(head, body) + f"\n\n{where(data['machine'])}."


if __name__ == "__main__":
    run(__doc__, draw, tables)
