#!/usr/bin/python3
"""Prints how far the proxy is from an exact god-object proxy on the bone of a CT, and what a cut through it changes.

    scenes/examples/prepare ct
    bench/bone.py build/release/bin/palpate out/examples/packages/invesalius-examples/usr/share/doc/\
invesalius-examples/examples/Cranium.inv3

Every second voxel along x and y is used, without smoothing, so the bone is rough. A hand is 1.5 and 4 voxels deep in
the bone. Then the bone is cut into two volumes that overlap by 2 or 4 voxels, and the hand moves over the cut and back,
2.5 voxels deep. If the uncut bone's force steps by more than 2 N, the hand falls off an edge there. Takes a minute."""
import argparse
import json
import math
import subprocess
import tarfile
import tempfile
from pathlib import Path

import numpy as np

SPACING = np.array([1.914062, 1.914062, 1.5]) * 1e-3  # [m]
VOXEL = SPACING.min()
BONE = 300.0        # [HU]
AIR = -1024.0       # [HU]
STIFFNESS = 500.0   # [N/m]
TICK = 1e-3         # [s]
PAD = 4             # voxels of air around the scan
COMES = 60          # ticks in which the hand approaches the bone from outside
EVERY = 4           # the exact proxy follows every fourth position of the hand
STEP = 0.02         # longest step of the exact proxy [voxels]


def scan_in(project):
    with tarfile.open(project) as archive:
        member = next(m for m in archive.getmembers() if m.name.endswith("matrix.dat"))
        scan = np.frombuffer(archive.extractfile(member).read(), "<i2").reshape(108, 256, 256)
    return np.pad(scan.transpose(2, 1, 0)[::2, ::2].astype(float), PAD, constant_values=AIR)


class Trilinear:
    """The interpolated values V. Positions are in voxels, slopes in HU per metre."""

    def __init__(self, values):
        self.shape, self.flat = values.shape, values.ravel().tolist()
        self.values = values

    def at(self, p):
        """Returns V and its slope in the cell of p."""
        i, j, k = (int(math.floor(c)) for c in p)
        u, v, w = p[0] - i, p[1] - j, p[2] - k
        x, y = self.shape[1] * self.shape[2], self.shape[2]
        n, f = i * x + j * y + k, self.flat
        a, b, c, d = (f[m] * (1 - w) + f[m + 1] * w for m in (n, n + y, n + x, n + x + y))
        by_w = [f[m + 1] - f[m] for m in (n, n + y, n + x, n + x + y)]
        low, high = a * (1 - v) + b * v, c * (1 - v) + d * v
        by = np.array([high - low, (b - a) * (1 - u) + (d - c) * u,
                       (by_w[0] * (1 - v) + by_w[1] * v) * (1 - u) + (by_w[2] * (1 - v) + by_w[3] * v) * u])
        return low * (1 - u) + high * u, by / SPACING

    def many(self, points):
        base = np.floor(points).astype(int)
        t, sum_ = points - base, 0.0
        for corner in np.ndindex(2, 2, 2):
            weight = np.prod(np.where(np.array(corner) == 1, t, 1 - t), axis=-1)
            sum_ = sum_ + weight * self.values[tuple(np.moveaxis(base + corner, -1, 0))]
        return sum_


def on_surface(field, y):
    """Returns the place of the surface near y, by Newton's method along the slope."""
    for _ in range(6):
        value, slope = field.at(y / SPACING)
        y = y + slope * ((BONE - value) / max(slope @ slope, 1e-300))
    return y


def exact_proxy(field, x, hand):
    """Moves an exact god-object proxy from x towards the hand [m], and returns its place: a local minimum of the
    distance, on a downhill path that does not enter the bone. At kinks between cells, where a step along the tangent
    plane does not come nearer, it tries 16 directions. On these paths its median distance from another exact proxy,
    written independently, was at most 0.013 voxel."""
    longest = step = STEP * VOXEL
    while step > longest / 64:
        pull = hand - x
        left = np.linalg.norm(pull)
        if left < 1e-3 * longest:
            return hand
        value, slope = field.at(x / SPACING)
        size = np.linalg.norm(slope)
        ahead = pull * min(1.0, step / left)
        if field.at((x + ahead) / SPACING)[0] <= BONE:
            x, step = x + ahead, min(longest, 2 * step)
            continue
        normal = -slope / size
        along = pull - (pull @ normal) * normal
        length = np.linalg.norm(along)
        ways = [along * min(1.0, step / length)] if length > 0.0 else []
        if step < longest / 2:
            side = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
            side /= np.linalg.norm(side)
            turns = np.linspace(0, 2 * np.pi, 16, endpoint=False)
            ways += [step * (math.cos(t) * side + math.sin(t) * np.cross(normal, side)) for t in turns]
        for way in ways:
            y = on_surface(field, x + way)
            if np.linalg.norm(hand - y) < left - 3e-3 * step and np.linalg.norm(y - x) < 3 * step:
                x, step = y, min(longest, 2 * step)
                break
        else:
            step /= 2
    return x


class Program:
    """Runs palpate on scenes with isosurfaces of bone."""

    def __init__(self, palpate, folder):
        self.palpate, self.folder = palpate, Path(folder)

    def volume(self, name, values):
        raw, out = self.folder / f"{name}.raw", self.folder / f"{name}.vdb"
        raw.write_bytes(values.astype("<f4").tobytes(order="F"))
        layout = {"size": list(values.shape), "type": "float32", "unit": "mm", "axes": np.diag(SPACING * 1e3).tolist()}
        subprocess.run([self.palpate, "import", raw, out, "--raw", json.dumps(layout)], check=True, capture_output=True)
        return {"file": str(out), "place": {"scale": 1e-3}}

    def feel(self, volumes, hands, reach=0.5):
        scene = {"palpate": 1, "coupling": {"stiffness": STIFFNESS, "damping": 0}, "accuracy": {"slope_reach": reach},
                 "volumes": {f"v{i}": v for i, v in enumerate(volumes)},
                 "modes": [{"mode": "isosurface", "of": f"v{i}", "value": BONE, "solid": "above", "strength": 20}
                           for i in range(len(volumes))]}
        files = {name: self.folder / name for name in ("scene.json", "path.csv", "trace.csv")}
        files["scene.json"].write_text(json.dumps(scene))
        rows = np.column_stack([np.arange(len(hands)) * TICK, hands])
        np.savetxt(files["path.csv"], rows, fmt="%.17g", delimiter=",", header="t,x,y,z", comments="")
        run = subprocess.run([self.palpate, "feel", files["scene.json"], "--device", f"path:{files['path.csv']}",
                              "--rate", "1000", "--trace", files["trace.csv"]], capture_output=True, text=True)
        if run.returncode not in (0, 1):
            raise SystemExit(f"bone.py: palpate feel failed: {run.stderr.strip()}")
        trace = np.genfromtxt(files["trace.csv"], delimiter=",", names=True, dtype=None, encoding="utf-8")
        return [np.column_stack([trace[f"{what}_{a}"] for a in "xyz"]) for what in ("proxy", "force")]


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def rotation(random):
    q = np.linalg.qr(random.normal(size=(3, 3)))[0]
    return q * np.sign(np.linalg.det(q))


def smoothed(values, sigma):
    x = np.arange(-4 * sigma, 4 * sigma + 1)
    weights = np.exp(-0.5 * (x / sigma)**2)
    return np.convolve(np.pad(values, 4 * sigma, mode="symmetric"), weights / weights.sum(), mode="valid")


def radii(field, centre, rays, every):
    """Returns the distance from the centre to the outer bone along each ray [voxels], NaN without bone."""
    r = np.arange(85, 2, -0.25)
    out = np.full(len(rays), np.nan)
    for i in range(0, len(rays), every):
        inside = np.clip(centre[i] + r[:, None] * rays[i], 0, np.array(field.shape) - 1.001)
        bone = np.nonzero(field.many(inside) > BONE)[0]
        if len(bone):
            out[i:i + every] = r[bone[0]]
    return out


def moved(places, speed, above, ticks):
    """Returns the hand's positions [m]: from `above` to the first of the places, then along them."""
    lengths = np.r_[0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))]
    way = np.arange(0, lengths[-1], speed * TICK)[:ticks]
    path = np.column_stack([np.interp(way, lengths, places[:, a]) for a in range(3)])
    return np.concatenate([above + (path[0] - above) * np.linspace(0, 1, COMES)[:-1, None], path])


def paths_along(field, random):
    """Yields rays from the middle of the bone, and their lengths to the bone, as measured and smoothed [voxels]."""
    bone = np.argwhere(field.values > BONE)
    centre, shape = bone.mean(0), np.array(field.shape)
    while True:
        q, turn = rotation(random), np.linspace(0, 0.8, 700)[:, None]
        rays = unit(np.cos(turn) * q[0] + np.sin(turn) * q[1] + 0.15 * np.sin(5 * turn) * q[2])
        r = radii(field, np.broadcast_to(centre, rays.shape), rays, 4)
        ends = centre + rays * r[:, None]
        if not np.isnan(r).any() and (ends > 8).all() and (ends < shape - 9).all():
            yield centre, rays, r, smoothed(r, 25)


def steps_of(force):
    return np.linalg.norm(np.diff(force, axis=0), axis=1)


def measure_distance(program, field, plain):
    kinds = {"reach 1/2": ({}, 0.5), "reach 1": ({}, 1.0), "cubic": ({"interpolation": "cubic"}, 0.5)}
    paths = paths_along(field, np.random.default_rng(5))
    print("| path, depth [voxels] | gradient | distance from the exact proxy, median, 90 % [voxels] "
          "| force steps > 20 mN |")
    print("|---|---|---|---|")
    for number in (1, 2):
        centre, rays, r, even = next(paths)
        above = SPACING * (centre + rays[0] * (r[0] + 8))
        for depth in (1.5, 4.0):
            places = SPACING * (centre + rays * (even - depth)[:, None])
            hands = moved(places, 0.05, above, 1500)
            exact = [hands[0]]
            for hand in hands[EVERY::EVERY]:
                exact.append(exact_proxy(field, exact[-1], hand))
            exact, some = np.array(exact), hands[::EVERY]
            held = (np.arange(len(some)) * EVERY >= COMES) & (np.linalg.norm(exact - some, axis=1) > 0.1 * VOXEL)
            slow = moved(places, 0.015, above, 6000)
            for kind, (more, reach) in kinds.items():
                proxy = program.feel([{**plain, **more}], hands, reach)[0][::EVERY]
                off = np.linalg.norm(proxy - exact, axis=1)[held] / VOXEL
                steps = steps_of(program.feel([{**plain, **more}], slow, reach)[1][150:])
                print(f"| {number}, {depth:g} | {kind} | {np.median(off):.2f}, {np.quantile(off, 0.9):.2f} "
                      f"| {(steps > 0.02).sum()} |", flush=True)


def measure_cuts(program, field, plain):
    print("\n| cut across, overlap [voxels] | gradient | distance from the proxy on uncut bone, 99 % [voxels] "
          "| largest force step, cut and uncut [N] |")
    print("|---|---|---|---|")
    middle = np.argwhere(field.values > BONE).mean(0)
    for axis, overlap in ((0, 2), (1, 4), (2, 2)):
        cut, index = int(round(middle[axis])), np.arange(field.shape[axis])
        halves = []
        for name, gone in (("low", index > cut + overlap // 2), ("high", index < cut - overlap // 2)):
            half = field.values.copy()
            half[tuple(gone if a == axis else slice(None) for a in range(3))] = AIR
            halves.append(program.volume(name, half))
        for seed in (0, 1):
            random, e = np.random.default_rng(10 * axis + seed), np.eye(3)[axis]
            offsets, r = np.linspace(-8, 8, 321), np.array([np.nan])
            while np.isnan(r).any() or np.abs(np.diff(r)).max() >= 3:
                q = rotation(random)[0]
                ray = unit(q - (q @ e) * e)
                starts = middle + offsets[::8, None] * e
                r = radii(field, starts, np.broadcast_to(ray, starts.shape), 1)
            even = np.interp(offsets, offsets[::8], smoothed(r, 3))
            places = SPACING * (middle + ray * (even - 2.5)[:, None] + offsets[:, None] * e)
            above = SPACING * (middle + ray * (r[0] + 8) + offsets[0] * e)
            hands = moved(np.concatenate([places, places[::-1]]), 0.02, above, 10000)
            for kind, reach in (("reach 1/2", 0.5), ("reach 1", 1.0)):
                (p, f), (whole, g) = (program.feel(v, hands, reach) for v in (halves, [plain]))
                off = np.linalg.norm(p - whole, axis=1)[100:] / VOXEL
                print(f"| {'xyz'[axis]}, {overlap} | {kind} | {np.quantile(off, 0.99):.2f} "
                      f"| {steps_of(f[100:]).max():.2f}, {steps_of(g[100:]).max():.2f} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("palpate", help="the program, as build/release/bin/palpate")
    parser.add_argument("project", help="Cranium.inv3 of Debian's invesalius-examples")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        program = Program(options.palpate, folder)
        field = Trilinear(scan_in(options.project))
        plain = program.volume("bone", field.values)
        measure_distance(program, field, plain)
        measure_cuts(program, field, plain)


if __name__ == "__main__":
    main()
