"""Tests scripts that use the Python module, with pytest and PYTHONPATH on the module: they run and print correct
results."""

import importlib.util
import os
import pathlib
import re
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).parents[2]


def script(path, folder, *words):
    """Runs a script without a display, so that it waits for no window. Returns its output."""
    env = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    done = subprocess.run([sys.executable, str(ROOT / path), *map(str, words)], cwd=folder, text=True,
                          env={**env, "MPLBACKEND": "Agg"}, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert done.returncode == 0, done.stdout
    return done.stdout


def test_the_python_session_prints_the_output_that_its_page_shows(tmp_path):
    said = script("scenes/bindings/python/session.py", tmp_path)
    shown = re.findall(r"^```text\n(.*?)^```$", (ROOT / "docs/notebook.md").read_text(), flags=re.S | re.M)
    assert len(shown) == 3
    for block in shown:
        assert block in said
    assert 2.5 < float(re.search(r"at most ([0-9.]+) N", said)[1]) < 3
    assert 20_000 < (tmp_path / "session.png").stat().st_size < 150_000
    assert ("750 has " in said) == (importlib.util.find_spec("vtk") is not None)


def test_the_python_benchmark_measures_speed_and_accuracy(tmp_path):
    """Tests errors, not times."""
    said = script("bench/speed_accuracy_from_python.py", tmp_path, "--ticks", 300, "--rounds", 1, "--out",
                  tmp_path / "chart.png")
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in said.splitlines() if line[:1] == "|"]
    of = {(r[0], float(r[1]), int(r[2])): (float(r[4]), float(r[5]), float(r[6])) for r in rows[2:]}
    assert len(of) == 27
    assert all(ns > 0 for ns, _, _ in of.values())
    off = [of[how, 1e-4, 64][1] for how in ("trilinear", "quadratic", "cubic")]
    # With trilinear interpolation the surface is off by at most (k1 + k2) / 8 voxels, where k1 and k2 are its principal
    # curvatures per voxel: 1 / 32 for a ball with a radius of 8 voxels.
    assert off[0] == pytest.approx(1 / 32, rel=0.1)
    assert off[1] < off[0] / 4 and off[2] < off[1] / 10
    for how in ("trilinear", "quadratic", "cubic"):
        loose, tight, single, finest = (of[how, *setting][2] for setting in
                                        ((1, 64), (1e-4, 64), (1e-4, 1), (1e-8, 64)))
        assert finest == 0 and tight < 1e-4 and tight <= loose < single < 0.1
    for name in ("chart.png", "chart.svg"):
        assert (tmp_path / name).stat().st_size > 10_000
