#!/usr/bin/python3
"""Draws a run of `palpate feel`: JSON on standard input, a PNG on standard output.

With --check it only sees whether matplotlib is there.
"""
import json
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.collections import LineCollection  # noqa: E402

AXES = "xyz"


def draw_slice(ax, piece, field, ticks, largest):
    a, b = piece["axes"]
    values = np.array(piece["values"], dtype=float)
    extent = [1e3 * e for e in piece["extent"]]
    ax.imshow(values, origin="lower", extent=extent, cmap="gray", interpolation="bilinear")
    for level in field["levels"]:
        if values.min() < level < values.max():
            ax.contour(values, levels=[level], origin="lower", extent=extent,
                       colors="tab:blue", linewidths=0.8)
    points = 1e3 * ticks[:, [4 + a, 4 + b]]
    segments = np.stack([points[:-1], points[1:]], axis=1)
    force = np.linalg.norm(ticks[:-1, 7:10], axis=1)
    lines = LineCollection(segments, array=force, cmap="autumn_r", linewidths=1.2)
    lines.set_clim(0, max(largest, 1e-6))
    ax.add_collection(lines)
    ax.set_xlim(extent[0], extent[1])
    ax.set_ylim(extent[2], extent[3])
    ax.set_aspect("equal")
    ax.set_xlabel(f"{AXES[a]} [mm]")
    ax.set_ylabel(f"{AXES[b]} [mm]")
    ax.set_title(f"{field['name']}, {AXES[3 - a - b]} = {1e3 * piece['at']:.1f} mm", fontsize=9)
    return lines


def main():
    if "--check" in sys.argv:
        return
    data = json.load(sys.stdin)
    ticks = np.array(data["ticks"], dtype=float).reshape(-1, 10)
    fields = data["fields"]
    force = np.linalg.norm(ticks[:, 7:10], axis=1)
    largest = float(force.max()) if len(force) else 0.0

    rows = len(fields)
    figure = plt.figure(figsize=(11, 3.6 * rows + 2.8), layout="constrained")
    grid = figure.add_gridspec(rows + 1, 3, height_ratios=[3.6] * rows + [2.4])
    lines = None
    for row, field in enumerate(fields):
        for column, piece in enumerate(field["slices"]):
            ax = figure.add_subplot(grid[row, column])
            lines = draw_slice(ax, piece, field, ticks, largest)
    if lines is not None:
        figure.colorbar(lines, ax=figure.axes, label="force [N]", shrink=0.6)
    ax = figure.add_subplot(grid[rows, :])
    for i, axis in enumerate(AXES):
        ax.plot(ticks[:, 0], ticks[:, 7 + i], linewidth=0.7, label=axis)
    ax.plot(ticks[:, 0], force, color="black", linewidth=1.0, label="|force|")
    ax.set_xlabel("time [s]")
    ax.set_ylabel("force on the hand [N]")
    ax.legend(ncol=4, fontsize=8)
    ax.grid(alpha=0.3)
    figure.suptitle(f"{data['scene']}: the proxy's path, projected on the slices", fontsize=10)
    figure.savefig(sys.stdout.buffer, format="png", dpi=110, metadata={"Software": data["made_by"]})


if __name__ == "__main__":
    main()
