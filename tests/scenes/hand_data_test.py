#!/usr/bin/env python3
"""Tests that the simulated hand feels more than 0.2 N in at least 30 % of the ticks, in every volume of PALPATE_DATA.
Also tests that the `palpate explain` command of each run gives the spring force of the run's strongest tick:
hand_data_test.py BIN_DIR

Feels .vdb files directly. Imports other files, with the scene that `palpate import` guesses. Prints a table."""
import json
import math
import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

BIN = Path(sys.argv[1])
DATA = Path(os.environ["PALPATE_DATA"])
STORM = {"size": [8, 14, 25], "type": "float32", "endian": "big",
         "skip": {"after": "\nend\n"},
         "axes": [[0, 2214.286, 0], [0, 0, 4153.846], [4166.667, 0, 0]]}
MRI = {"size": [128, 128, 84], "type": "uint8", "skip": 62}
IMPORTED = {
    "ct_headsq/quarter.nhdr": None, "mri_brainsmall/brainsmall.den": MRI,
    "cfd_kitchen/kitchen.vtk": None, "cfd_disk_out_ref/disk_out_ref.ex2": None,
    "flow_carotid/carotid.vtk": None, "storm_dx/wind.dx": {**STORM, "components": 3},
    "storm_dx/temperature.dx": STORM, "storm_dx/cloudwater.dx": STORM,
    "storm_dx/rainwater.dx": STORM,
}


def run(*words):
    done = subprocess.run([str(BIN / "palpate"), *map(str, words)], capture_output=True, text=True,
                          timeout=300)
    if done.returncode != 0:
        sys.exit(f"{words}: status {done.returncode}: {done.stdout}{done.stderr}")
    return done.stdout


def main():
    failed = []
    print("| file | above 0.2 N, % of ticks | strongest [N] | found in [ms] |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        scenes = {f.name: f for f in sorted((DATA / "vdb").glob("*.vdb"))}
        for name, raw in IMPORTED.items() if (BIN / "palpate-import").exists() else ():
            scene = Path(folder) / f"{Path(name).stem}.json"
            run("import", DATA / name, scene.with_suffix(".vdb"), "--scene", scene,
                *(["--raw", json.dumps(raw)] if raw else []))
            scenes[Path(name).name] = scene
        for name, scene in scenes.items():
            felt = json.loads(run("feel", scene, "--seconds", 10, "--json"))
            share = felt["felt_share"]
            print(f"| {name} | {100 * share:.1f} | {felt['force_max']:.2f} "
                  f"| {felt['search']['ms']:.0f} |")
            most = felt["most"]
            told = json.loads(run(*shlex.split(most["explain"])[1:], "--json"))
            explained = math.hypot(*told["balance"]["spring"])
            if share < 0.3 or abs(explained - most["spring"]) > 0.02 * most["spring"]:
                failed.append(f"{name} ({share}; {most['spring']} N, explained {explained} N)")
    if failed or len(scenes) < 4:
        sys.exit(f"{len(scenes)} volumes; at least 4 are required. Too little force, or another explained force, in: "
                 f"{failed}")


main()
