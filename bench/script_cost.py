#!/usr/bin/env python3
"""Measures the cost that the Python module adds to C++: script_cost.py BIN, the folder of programs and module.

Takes a million random samples of a grid, and ticks along a press, with the module and with C++
(palpate_bench_script) in turn, in five pairs. Prints the medians, and the ratio or the difference."""

import os
import statistics
import subprocess
import sys
import tempfile
import time

import numpy as np

sys.path.insert(0, sys.argv[1])
import palpate  # noqa: E402  (in the folder BIN)


def best(call, items):
    """Returns the smallest time per item [ns] of five rounds."""
    least = float("inf")
    for _ in range(5):
        begin = time.perf_counter()
        call()
        least = min(least, time.perf_counter() - begin)
    return 1e9 * least / items


def main():
    program = os.path.join(sys.argv[1], "palpate")
    with tempfile.TemporaryDirectory() as folder:
        file = os.path.join(folder, "bodies.vdb")
        subprocess.run([program, "make", "two-bodies", file], check=True, capture_output=True)
        field = palpate.Volume.load(file, "cloud").field()
        points = np.random.default_rng(1).uniform(*field.bounds, (1_000_000, 3))
        scene = palpate.Scene.load(file)
        probes = np.zeros((100_000, 3))
        probes[:, 2] = np.interp(np.arange(100_000), [0, 50_000, 100_000], [0.06, -0.03, 0.06])
        points.tofile(os.path.join(folder, "points"))
        probes.tofile(os.path.join(folder, "probes"))
        steps = probes.tolist()

        def tick():
            hand = scene.hand()
            step = hand.step
            for x, y, z in steps:
                step(x, y, z)

        pairs = []
        for _ in range(5):
            here = best(lambda: field.sample(points), len(points)), best(tick, len(probes))
            told = subprocess.run([os.path.join(sys.argv[1], "palpate_bench_script"), file, "cloud",
                                   os.path.join(folder, "points"), os.path.join(folder, "probes")],
                                  check=True, capture_output=True, text=True).stdout
            pairs.append(here + tuple(map(float, told.split())))
    sample, step, sample_cpp, step_cpp = (statistics.median(each) for each in zip(*pairs))
    print(f"a sample of 1,000,000: Python {sample:.0f} ns, C++ {sample_cpp:.0f} ns: "
          f"{statistics.median(p[0] / p[2] for p in pairs):.2f} times")
    print(f"a tick of 100,000: Python {step:.0f} ns, C++ {step_cpp:.0f} ns: "
          f"{statistics.median(p[1] - p[3] for p in pairs):.0f} ns more")


if __name__ == "__main__":
    main()
