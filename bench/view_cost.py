#!/usr/bin/env python3
"""Measures how much the view's window costs the loop: view_cost.py BIN SCENE [SECONDS [PAIRS]], under Xvfb.

Runs `palpate feel --realtime` and `palpate view` in turn, with the same scene and simulated hand. Prints medians over
the pairs: the loop's tick times, wake-ups and late ticks, and the times of the window's frames."""

import json
import os
import statistics
import subprocess
import sys
import tempfile

PROGRAM = os.path.join(sys.argv[1], "palpate")
SCENE = sys.argv[2]
SECONDS = sys.argv[3] if len(sys.argv) > 3 else "10"
PAIRS = int(sys.argv[4]) if len(sys.argv) > 4 else 10


def run(words, folder, env):
    summary = os.path.join(folder, "summary.json")
    done = subprocess.run([PROGRAM, *words, SCENE, "--device", "simulated", "--seconds", SECONDS,
                           "--summary", summary], capture_output=True, text=True, env=env, check=False)
    if done.returncode == 2:
        sys.exit(done.stderr)  # other exit statuses report a fault of the run, which is counted
    with open(summary, encoding="utf-8") as file:
        return json.load(file)


def main():
    server = subprocess.Popen(["Xvfb", "-displayfd", "1", "-screen", "0", "800x700x24", "-nolisten", "tcp"],
                              stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        display = f":{server.stdout.readline().strip()}"
        with tempfile.TemporaryDirectory() as folder:
            told = os.path.join(folder, "told.json")
            env = {**os.environ, "DISPLAY": display, "PALPATE_VIEW_TOLD": told,
                   "PALPATE_VIEW_TOLD_EVERY": "1", "PALPATE_VIEW_WIDTH": "640", "PALPATE_VIEW_HEIGHT": "480"}
            pairs, frames = [], []
            for _ in range(PAIRS):
                alone = run(["feel", "--realtime"], folder, env)
                seen = run(["view"], folder, env)
                pairs.append((alone, seen))
                with open(told, encoding="utf-8") as file:
                    frames.append(json.load(file))
    finally:
        server.terminate()
        server.wait()

    def line(name, of):
        alone = statistics.median(of(a) for a, _ in pairs)
        seen = statistics.median(of(s) for _, s in pairs)
        print(f"{name:24} {alone:10.0f} {seen:10.0f}")

    print(f"{PAIRS} pairs of {SECONDS} s: medians{'alone':>9} {'window':>10}")
    for share in ("p50", "p99", "p99.9", "max"):
        line(f"tick {share} [ns]", lambda s, share=share: s["tick_ns"][share])
    for share in ("p50", "p99", "p99.9", "max"):
        line(f"wake-up {share} [ns]", lambda s, share=share: s["wake_ns"][share])
    late = [sum(s["late_ticks"] for s in each) for each in zip(*pairs)]
    print(f"{'late ticks, in all':24} {late[0]:10} {late[1]:10}")
    cut = [sum(bool(s["faults"]) for s in each) for each in zip(*pairs)]
    print(f"{'runs with a fault':24} {cut[0]:10} {cut[1]:10}")
    for share in ("p50", "p90", "p99"):
        cost = statistics.median(f["frame_cpu_ms"][share] for f in frames)
        print(f"frame {share} {cost:.1f} ms of CPU")
    for name in ("coarse_ms", "refined_ms"):
        cost = {key: statistics.median(f[name][key] for f in frames) for key in ("cpu", "wall")}
        print(f"backdrop {name[:-3]} {cost['cpu']:.0f} ms of CPU, {cost['wall']:.0f} ms")


if __name__ == "__main__":
    main()
