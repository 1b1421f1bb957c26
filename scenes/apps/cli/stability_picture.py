#!/usr/bin/python3
"""Draws the results of `palpate stability`: JSON on standard input, a picture on standard output.

The argument is the format, png or svg. With --check, the script only checks whether matplotlib is installed.
"""
import json
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.colors import ListedColormap  # noqa: E402
from matplotlib.patches import Patch  # noqa: E402

# Colours of outcomes: r rests, c oscillates, l diverges. Capital letters: the coupling generated energy.
COLOURS = {"r": "#e8f2e4", "R": "#b7d7a8", "c": "#fde2b3", "C": "#f5b041", "l": "#f1b0a8",
           "L": "#c0392b"}
WORDS = {"r": "rests", "R": "rests, energy gained", "c": "oscillates", "C": "oscillates, energy gained",
         "l": "diverges", "L": "diverges, energy gained"}
ORDER = "rRcClL"


def draw_map(ax, method, boundaries):
    stiffness = np.array(method["stiffness"])
    damping = np.array(method["damping"])
    cells = np.array([[ORDER.index(letter) for letter in row] for row in method["rows"]])
    rows = np.arange(len(damping))
    ax.pcolormesh(stiffness, rows, cells, cmap=ListedColormap([COLOURS[k] for k in ORDER]),
                  vmin=-0.5, vmax=5.5, shading="nearest", rasterized=True)
    ax.set_xscale("log")
    # Damping grows by a constant factor from row to row. Row 0, without damping, is drawn at half of row 1's damping.
    place = np.interp(np.log([max(b["damping"], damping[1] / 2) for b in boundaries]),
                      np.log(np.maximum(damping, damping[1] / 2)), rows)
    for key, style in (("stable", "-"), ("passive", ":")):
        values = np.array([b[key] if b[key] is not None else np.nan for b in boundaries])
        ax.plot(np.where(values > 0, values, np.nan), place, style, color="black", linewidth=1.2)
    ticks = np.linspace(0, len(damping) - 1, 5).astype(int)
    ax.set_yticks(ticks, [f"{damping[i]:.2g}" for i in ticks])
    ax.set_xlim(stiffness[0], stiffness[-1])
    ax.set_ylim(-0.5, rows[-1] + 0.5)
    ax.set_title(method["name"], fontsize=9)


def main():
    if "--check" in sys.argv:
        return
    data = json.load(sys.stdin)
    methods = data["methods"]
    columns = len(methods) + 1  # the last panel is the legend
    figure, axes = plt.subplots(1, columns, figsize=(3 * columns, 3.7), layout="constrained")
    for ax, method in zip(axes, methods):
        draw_map(ax, method, data["boundaries"])
        ax.set_xlabel("stiffness [N/m]")
    axes[0].set_ylabel("damping [N s/m]")
    axes[-1].set_axis_off()
    handles = [Patch(color=COLOURS[k], label=WORDS[k]) for k in ORDER]
    handles += [plt.Line2D([], [], color="black", linestyle=s, label=w) for s, w in
                (("-", "one wall: stable with this hand"), (":", "one wall: passive with any hand"))]
    axes[-1].legend(handles=handles, loc="center", fontsize=8, frameon=False)
    arm = data["arm"]
    figure.suptitle(f"{data['of']} at {data['rate']:g} Hz\n{arm['mass']:g} kg, "
                    f"{arm['viscous']:g} N s/m, {arm['coulomb']:g} N, "
                    f"encoder {1e6 * arm['encoder']:g} um, delay {1e3 * arm['delay']:g} ms",
                    fontsize=10)
    kind = "svg" if "svg" in sys.argv else "png"
    matplotlib.rcParams["svg.hashsalt"] = "palpate"  # equal results give equal bytes
    figure.savefig(sys.stdout.buffer, format=kind, dpi=110,
                   metadata={"Date": None} if kind == "svg" else None)


if __name__ == "__main__":
    main()
