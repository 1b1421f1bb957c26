#!/usr/bin/python3
"""Draws the error of proxy and force at seams, grooves and bends, and the time of a tick, from Python alone.

    seams_from_python.py MODULE_FOLDER [--before MODULE_FOLDER] [--rounds N] [--out FILE.png]

A hand slides 3 voxels deep over seams of two volumes and along a groove, and beside a bent stream. The exact proxy of
each case is known, or is the proxy of the body without a seam. A module folder holds the Python module of a build.
With --before, the module of an earlier build is measured in the same run for comparison. The table goes to standard
output, the chart into FILE.png and FILE.svg."""
import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

sys.dont_write_bytecode = True
import numpy as np  # noqa: E402

VOXEL = 1e-3       # [m]
STIFFNESS = 500.0  # [N/m]
HALF = 24          # voxels from an array's middle to its faces
DEPTH = 3.0        # of the hand below the surface [voxels]
SWEEP = 10.0       # to each side of a seam [voxels]
TICKS = 3000
COMES = 200        # ticks in which the hand approaches the surface from outside
METRICS = {
    "off": "distance from the exact proxy, 99 % [voxels]",
    "turned": "direction of the force, 99 % [degrees]",
    "step": "step of the force beyond the exact one's, largest [mN]",
    "buzz": "force above 100 Hz, rms [mN]",
}
# Okabe and Ito's colours, which colour-blind people can distinguish; each case also has its own marker.
STYLES = {
    "flat seam, overlap 1": ("#0072B2", "o"),
    "turned seam, overlap 2": ("#E69F00", "s"),
    "rough ball cut in two": ("#009E73", "^"),
    "groove of 60 degrees": ("#CC79A7", "D"),
    "3 inside a bend": ("#D55E00", "v"),
    "2 outside a bend": ("#56B4E9", "P"),
}
FLOOR = 1e-4  # smaller values are drawn here


def places():
    x = np.arange(-HALF, HALF + 1.0)
    return np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1)


def rotation(seed):
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]


def norm(v):
    return np.linalg.norm(v, axis=-1)


def scene(palpate, arrays, settings, **mode):
    """Returns a scene with one mode on each array. Arrays of scalars are level sets, negative inside."""
    volumes, modes = {}, []
    for i, values in enumerate(arrays):
        level_set = values.ndim == 3
        if level_set:
            values = np.clip(values, -3, 3)
        volumes[f"v{i}"] = palpate.volume(values, origin=(-HALF,) * 3, name=f"v{i}", level_set=level_set)
        modes.append({"of": f"v{i}", "strength": 5, **mode})
    text = {"palpate": 1, "coupling": {"stiffness": STIFFNESS, "damping": 0}, "modes": modes,
            "volumes": {name: {"place": {"scale": VOXEL}} for name in volumes}}
    if settings:
        text["accuracy"] = settings
    return palpate.Scene.parse(text, volumes)


SURFACE = {"mode": "isosurface", "value": 0, "solid": "below"}


def slide(turn=None):
    """Returns the positions of a hand that goes through the plane z = 0 and slides below it, and their projections on
    the plane, which are the exact proxies below it."""
    turn = np.eye(3) if turn is None else turn
    x = np.concatenate([np.full(COMES, -SWEEP), -SWEEP * np.cos(np.arange(TICKS) / 300)])
    z = np.concatenate([np.linspace(3, -DEPTH, COMES), np.full(TICKS, -DEPTH)])
    hand = np.stack([x, np.full_like(x, 0.2), z], axis=-1)
    exact = hand * [1, 1, 0]
    return hand @ turn.T, exact @ turn.T


def halves(body, across, overlap):
    return [np.maximum(body, side * across - overlap / 2) for side in (1, -1)]


def rough_ball(at):
    """Returns the distance to a ball of radius 14 voxels with waves of 0.5 voxel height and 9 voxels length, exact to
    first order."""
    r = norm(at)
    relief = np.prod(np.sin(2 * np.pi / 9 * at + [0.3, 1.1, 2.0]), axis=-1)
    return r - 14 + 0.5 * relief


def around(radius, start=2.0, turns=1.0):
    """Returns the positions of a hand that starts `start` voxels outside of radius + DEPTH, moves in, then
    circles the z axis at `radius` [voxels]."""
    angle = np.concatenate([np.zeros(COMES), 2 * np.pi * turns * np.arange(TICKS) / TICKS])
    r = np.concatenate([np.linspace(radius + DEPTH + start, radius, COMES), np.full(TICKS, radius)])
    return np.stack([r * np.cos(angle), r * np.sin(angle), np.full_like(r, 0.3)], axis=-1)


def cases(palpate, settings):
    """Yields name, scene, hand and exact proxies, in voxels."""
    at = places()
    hand, exact = slide()
    yield ("flat seam, overlap 1", scene(palpate, halves(at[..., 2], at[..., 0], 1), settings, **SURFACE), hand, exact)
    turn = rotation(3)
    hand, exact = slide(turn)
    inside = at @ turn
    yield ("turned seam, overlap 2", scene(palpate, halves(inside[..., 2], inside[..., 0], 2), settings, **SURFACE),
           hand, exact)
    body = rough_ball(at)
    hand = around(14 - DEPTH)
    uncut = felt_by(scene(palpate, [body], settings, **SURFACE), hand)[1]
    yield ("rough ball cut in two", scene(palpate, halves(body, at @ turn[0], 2), settings, **SURFACE), hand, uncut)
    # The walls meet in the line x = z = 0 of `inside`; the solid is below them.
    lean = np.radians(30)
    groove = np.minimum(inside[..., 0] * np.cos(lean) + inside[..., 2] * np.sin(lean),
                        -inside[..., 0] * np.cos(lean) + inside[..., 2] * np.sin(lean))
    y = np.concatenate([np.full(COMES, -SWEEP), -SWEEP * np.cos(np.arange(TICKS) / 300)])
    z = np.concatenate([np.linspace(3, -DEPTH, COMES), np.full(TICKS, -DEPTH)])
    hand = np.stack([0 * y, y, z], axis=-1)
    yield ("groove of 60 degrees", scene(palpate, [groove], settings, **SURFACE), hand @ turn.T,
           hand * [0, 1, 0] @ turn.T)
    radius = 10.0
    flow = np.stack([-at[..., 1], at[..., 0], 0 * at[..., 0]], axis=-1)
    for name, aside in (("3 inside a bend", -3.0), ("2 outside a bend", 2.0)):
        hand = around(radius + aside, start=0)
        hand[:COMES] = [radius, 0, 0.3]  # starts on the stream that the hand follows
        hand[COMES:COMES + 300, :2] *= (np.linspace(radius, radius + aside, 300) / (radius + aside))[:, None]
        exact = hand * (radius / norm(hand * [1, 1, 0]))[:, None] * [1, 1, 0] + hand * [0, 0, 1]
        yield name, scene(palpate, [flow], settings, mode="follow"), hand, exact


def felt_by(felt_scene, hand):
    """Returns the time of a tick [ns], the proxies [voxels] and the forces [N] of a run."""
    path = np.column_stack([np.arange(len(hand)) / 1000.0, VOXEL * hand])
    felt = felt_scene.run(path)
    column = {name: np.stack([felt[f"{name}_{axis}"] for axis in "xyz"], axis=-1) for name in ("proxy", "force")}
    rows = slice(0, len(hand))
    return felt["tick_ns"][rows], column["proxy"][rows] / VOXEL, column["force"][rows]


def row_of(name, setting, ns, proxy, force, hand, exact):
    used = slice(COMES + 400, None)
    n = min(len(proxy), len(hand))
    proxy, force, hand, exact = (v[:n][used] for v in (proxy, force, hand, exact))
    right = STIFFNESS * VOXEL * (exact - hand)
    cosine = np.sum(force * right, axis=-1) / np.maximum(norm(force) * norm(right), 1e-12)
    steps = norm(np.diff(force, axis=0)) - norm(np.diff(right, axis=0))
    wave = force - right
    window = np.hanning(len(wave))
    power = np.sum(np.abs(np.fft.rfft((wave - wave.mean(axis=0)) * window[:, None], axis=0))**2, axis=-1)
    above = np.fft.rfftfreq(len(wave), 1e-3) > 100
    return {"case": name, "setting": setting, "ns": float(np.median(ns[used])),
            "off": float(np.quantile(norm(proxy - exact), 0.99)),
            "turned": float(np.quantile(np.degrees(np.arccos(np.clip(cosine, -1, 1))), 0.99)),
            "step": 1e3 * float(max(steps.max(), 0)),
            "buzz": 1e3 * float(np.sqrt(2 * power[above].sum() / (window**2).sum() / len(wave)))}


def measure(settings):
    """Measures the module that this process imports, and prints the rows as JSON."""
    import palpate
    rows = []
    for word, setting in settings.items():
        for name, felt_scene, hand, exact in cases(palpate, setting):
            rows.append(row_of(name, f"{word}, {palpate.__commit__[:8]}", *felt_by(felt_scene, hand), hand, exact))
    print(json.dumps(rows))


def rows_of(folder, settings, rounds):
    """Returns the rows of a module. Each row has its smallest time over the rounds, because other programs can only
    increase a time."""
    all_rounds = []
    for _ in range(rounds):
        done = subprocess.run([sys.executable, __file__, "--measure", json.dumps(settings), str(folder)], check=True,
                              stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": str(folder)})
        all_rounds.append(json.loads(done.stdout))
    for row, *others in zip(*all_rounds):
        row["ns"] = min(r["ns"] for r in (row, *others))
    return all_rounds[0]


def draw(rows, out):
    from charting import clear, plt, prepare, save
    prepare(out.parent)
    figure, axes = plt.subplots(2, 2, figsize=(10.5, 7.6), sharex=True)
    settings = list(dict.fromkeys(r["setting"] for r in rows))
    for ax, (metric, title) in zip(axes.flat, METRICS.items()):
        for name, (colour, marker) in STYLES.items():
            mine = [r for r in rows if r["case"] == name]
            ax.plot([r["ns"] for r in mine], [max(r[metric], FLOOR) for r in mine], color=colour, linewidth=0.8, zorder=1)
            for row in mine:
                last = row["setting"] == settings[-1]
                middle = len(settings) > 2 and row["setting"] == settings[1]
                ax.plot(row["ns"], max(row[metric], FLOOR), color=colour, marker=marker, zorder=2, linestyle="none",
                        markerfacecolor=colour if last else "white", markersize=4 if middle else 7,
                        label=name if last else None)
        ax.set_yscale("log")
        ax.set_title(title, fontsize=10)
        clear(ax)
    for ax in axes[1]:
        ax.set_xlabel("time of a tick, median [ns]")
    figure.tight_layout(rect=(0, 0.07, 1, 0.97))
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="lower center", ncols=3, fontsize=8.5, frameon=False)
    marks = ["hollow"] + ["small"] * (len(settings) - 2) + ["full"]
    figure.suptitle("; ".join(f"{mark}: {setting}" for mark, setting in zip(marks, settings)), fontsize=10)
    save(figure, out.parent, out.stem)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--measure", type=json.loads, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure is not None:
        measure(arguments.measure)
        return
    rows = rows_of(arguments.before, {"before": {}}, arguments.rounds) if arguments.before else []
    rows += rows_of(arguments.folder, {"slope reach 1": {"slope_reach": 1}, "slope reach 0.5": {"slope_reach": 0.5}},
                    arguments.rounds)
    from charting import number, table
    print(table(["case", "engine", "ns a tick", *METRICS.values()],
                [[r["case"], r["setting"], f"{r['ns']:.0f}", *(number(r[m]) for m in METRICS)] for r in rows]))
    if arguments.out:
        draw(rows, arguments.out)


if __name__ == "__main__":
    main()
