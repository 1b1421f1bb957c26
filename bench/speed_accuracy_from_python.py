#!/usr/bin/python3
"""Draws the time of a tick against the error of its proxy. Uses only the Python module.

    PYTHONPATH=build/release/bin speed_accuracy_from_python.py [--ticks N] [--rounds N] [--out FILE.png]

A hand circles inside a ball, which is an array of signed distances. The exact proxy is the nearest point of the ball's
surface. The table goes to standard output, the chart into FILE.png and FILE.svg."""
import argparse
import sys
from pathlib import Path

sys.dont_write_bytecode = True
import numpy as np  # noqa: E402
import palpate  # noqa: E402
from charting import clear, number, plt, prepare, save, table  # noqa: E402

VOXEL = 1e-3                            # [m]
RADIUS, DEPTH, SPEED = 8.0, 2.0, 1.0    # [voxels]: radius of the ball, depth of the hand, path in a tick
CENTRE = np.array([0.3, 0.2, 0.1])      # [voxels]: not on a grid point
TOLERANCES = [1, 0.1, 0.01, 1e-3, 1e-4]  # at most 64 sub-steps
SUBSTEPS = [1, 2, 4]                    # at tolerance 1e-4
FINEST = (1e-8, 64)
# Okabe and Ito's colours, which colour-blind people can distinguish; each order also has its own marker.
STYLES = {"trilinear": ("#0072B2", "o"), "quadratic": ("#E69F00", "s"), "cubic": ("#009E73", "^")}
FLOOR = 1e-8                            # smaller errors are drawn here [voxels]


def ball():
    """Returns the signed distances to a ball, negative inside."""
    x = np.arange(-20.0, 21.0)  # wide enough, because a cubic surface depends on the array's edge within 8 voxels of it
    places = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1)
    distance = np.linalg.norm(places - CENTRE, axis=-1) - RADIUS
    return palpate.volume(distance, origin=(-20, -20, -20), name="ball", level_set=True)


def course(ticks):
    """Returns the positions [m] of a hand that approaches from outside, then circles in a turning plane."""
    come = 100
    way = SPEED / (RADIUS - DEPTH) * np.maximum(np.arange(-come, ticks), 0)
    turn = way / 7
    unit = np.stack([np.cos(way), np.sin(way) * np.cos(turn), np.sin(way) * np.sin(turn)], axis=-1)
    radius = RADIUS + np.interp(np.arange(-come, ticks), [-come, -1], [3, -DEPTH])
    return come, VOXEL * (CENTRE + radius[:, None] * unit)


def scene(volume, interpolation, tolerance, substeps):
    return palpate.Scene.parse({
        "palpate": 1,
        "accuracy": {"tolerance_voxels": tolerance, "max_substeps": substeps},
        "volumes": {"ball": {"interpolation": interpolation, "place": {"scale": VOXEL}}},
        "modes": [{"mode": "isosurface", "of": "ball", "value": 0, "solid": "below", "strength": 5}],
    }, {"ball": volume})


def measure(ticks, rounds):
    """Returns a row for each setting: its time, and the proxy's largest distance from its exact place."""
    volume = ball()
    come, path = course(ticks)
    hand = path[come:] / VOXEL - CENTRE
    exact = hand * (RADIUS / np.linalg.norm(hand, axis=-1, keepdims=True))
    settings = [(t, 64) for t in TOLERANCES] + [(TOLERANCES[-1], s) for s in SUBSTEPS] + [FINEST]
    rows = [{"interpolation": i, "tolerance": t, "substeps": s, "scene": scene(volume, i, t, s), "ns": []}
            for i in STYLES for t, s in settings]
    for _ in range(rounds):  # in turns, so that other work of the machine affects all settings equally
        for row in rows:
            felt = row["scene"].run(path)[come:]
            row["ns"].append(np.median(felt["tick_ns"]))
            row["proxy"] = np.stack([felt[f"proxy_{axis}"] for axis in "xyz"], axis=-1) / VOXEL - CENTRE
            row["steps"] = felt["substeps"].mean()
    finest = {r["interpolation"]: r["proxy"] for r in rows if (r["tolerance"], r["substeps"]) == FINEST}
    for row in rows:
        row["ns"] = np.median(row["ns"])
        row["off"] = np.linalg.norm(row["proxy"] - exact, axis=-1).max()
        row["moved"] = np.linalg.norm(row["proxy"] - finest[row["interpolation"]], axis=-1).max()
    return rows


def draw(rows):
    figure, axes = plt.subplots(1, 2, figsize=(10.5, 4.8), sharex=True, sharey=True)
    for ax, quantity, title in ((axes[0], "off", "from the nearest place of the true ball"),
                                (axes[1], "moved", "from the finest setting, interpolated alike")):
        for name, (colour, marker) in STYLES.items():
            mine = [r for r in rows if r["interpolation"] == name and (r["tolerance"], r["substeps"]) != FINEST]
            for few, words in ((False, f"{name}, tolerance 1 to 1e-4"), (True, f"{name}, at most 1, 2, 4 sub-steps")):
                some = [r for r in mine if (r["substeps"] < 64) == few]
                ax.plot([r["ns"] for r in some], [max(r[quantity], FLOOR) for r in some], color=colour, marker=marker,
                        linestyle=":" if few else "-", markerfacecolor="white" if few else colour, label=words)
        ax.set_yscale("log")
        ax.set_xlabel("time of a tick, median [ns]")
        ax.set_title(title, fontsize=10)
        clear(ax)
    axes[0].set_ylabel("largest error of the proxy [voxels]")
    figure.tight_layout(rect=(0, 0.11, 1, 0.96))
    figure.legend(*axes[0].get_legend_handles_labels(), loc="lower center", ncols=3, fontsize=8.5, frameon=False)
    figure.suptitle(f"Speed against accuracy, from Python: a ball of {RADIUS:g} voxels, a hand of {SPEED:g} voxel "
                    "a tick", fontsize=11)
    return figure


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ticks", type=int, default=4000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    rows = measure(arguments.ticks, arguments.rounds)
    print(f"palpate {palpate.__version__} ({palpate.__commit__}), {arguments.ticks} ticks, "
          f"{arguments.rounds} rounds\n")
    print(table(["interpolation", "tolerance, voxels", "most sub-steps", "sub-steps a tick", "ns a tick, median",
                 "off the true ball, voxels", "off the finest, voxels"],
                [[r["interpolation"], f"{r['tolerance']:g}", r["substeps"], number(r["steps"]), f"{r['ns']:.0f}",
                  number(r["off"]), number(r["moved"])] for r in rows]))
    if arguments.out:
        prepare(arguments.out.parent)
        save(draw(rows), arguments.out.parent, arguments.out.stem)


if __name__ == "__main__":
    main()
