#!/usr/bin/env python3
"""Imports, compares, describes and feels real data: data_test.py BIN_DIR AGREEMENT_PROGRAM. Needs PALPATE_DATA. Prints
a table of the agreement with VTK's probe of the originals."""
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

PALPATE, AGREEMENT = str(Path(sys.argv[1]) / "palpate"), sys.argv[2]
DATA = Path(os.environ["PALPATE_DATA"])
WIND = {"size": [8, 14, 25], "type": "float32", "endian": "big", "components": 3,
        "skip": {"after": "\nend\n"}, "name": "wind",
        "axes": [[0, 2214.286, 0], [0, 0, 4153.846], [4166.667, 0, 0]]}
MRI = {"size": [128, 128, 84], "type": "uint8", "skip": 62}

# Name, kind for the agreement program, original, file to import (if not the original), options.
FILES = [
    ("headsq", "headsq", "ct_headsq", "ct_headsq/quarter.nhdr", []),
    ("brainsmall", "brainsmall", "mri_brainsmall/brainsmall.den", None, ["--raw", json.dumps(MRI)]),
    ("kitchen", "vtk", "cfd_kitchen/kitchen.vtk", None, []),
    ("disk_out_ref", "exodus", "cfd_disk_out_ref/disk_out_ref.ex2", None, []),
    ("carotid", "vtk", "flow_carotid/carotid.vtk", None, []),
    ("wind", "wind", "storm_dx/wind.dx", None, ["--raw", json.dumps(WIND)]),
]


def run(*words):
    done = subprocess.run([*map(str, words)], capture_output=True, text=True, timeout=300)
    if done.returncode != 0:
        sys.exit(f"{words}: status {done.returncode}: {done.stdout}{done.stderr}")
    return done.stdout


def main():
    table, felt = [], []
    with tempfile.TemporaryDirectory() as folder:
        for name, kind, original, given, options in FILES:
            out, scene = Path(folder) / f"{name}.vdb", Path(folder) / f"{name}.json"
            report = json.loads(run(PALPATE, "import", DATA / (given or original), out,
                                    "--scene", scene, "--json", *options))
            grids = {grid["name"]: grid for grid in report["grids"]}
            if name == "disk_out_ref":
                # The grids of one file have equal voxels.
                voxels = {json.dumps([grids[g]["voxel"], grids[g]["active_voxels"]])
                          for g in ("V", "Pres", "Temp")}
                assert len(voxels) == 1, voxels
            table.append(run(AGREEMENT, kind, DATA / original, out))
            run(PALPATE, "info", out)
            run(PALPATE, "check", scene)
            summary = json.loads(run(PALPATE, "feel", scene, "--seconds", "10", "--json"))
            assert summary["force_max"] > 0.05, (name, summary["force_max"])
            modes = ", ".join(f"{f['mode']} {f['seconds']:.1f} s" for f in summary["felt"])
            felt.append(f"| {name} | {modes} | {summary['force_max']:.2f} |")
    print("| file | array | voxel centres | largest difference | random places | rms | largest "
          "| stated rms |\n|---|---|---|---|---|---|---|---|")
    print("".join(table))
    print("| file | felt in 10 s | largest force [N] |\n|---|---|---|")
    print("\n".join(felt))


main()
