#!/usr/bin/env python3
"""Tests the motion chart from end to end: motion_accuracy_test.py PROGRAM CHART. Does not test times."""
import json
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import suite  # noqa: E402

PROGRAM = sys.argv[1]
CHART = sys.argv[2]

SPHERES = {"sphere, radius 40", "sphere, radius 8", "sphere, radius 3.5", "sphere in fog, radius 40",
           "inside of a sphere, radius 40"}
SURFACES = SPHERES | {"torus, radii 30 and 12", "cube, over its edges",
                      "hollow cube, into its corners"}
STREAMS = {"ABC flow, 16 voxels", "Taylor-Green, 16 voxels"}
OURS = {("palpate", tolerance) for tolerance in ("0.1", "0.01", "1e-3", "1e-4")}
ON_SURFACES = OURS | {("plane", n) for n in ("1", "4", "16", "64")} | {
    ("midpoint", n) for n in ("1", "2", "3", "5")}
ON_STREAMS = OURS | {("line", n) for n in ("1", "4", "16", "64")} | {("midpoint", "1")} | {
    ("RK4", n) for n in ("1", "4", "16")}


class MotionAccuracy(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.holder = tempfile.TemporaryDirectory()
        cls.dir = Path(cls.holder.name)
        cls.result = cls.dir / "result.json"
        subprocess.run([PROGRAM, "--quick", "--output", str(cls.result)], check=True, timeout=300)
        cls.data = json.loads(cls.result.read_text())

    @classmethod
    def tearDownClass(cls):
        cls.holder.cleanup()

    def row(self, kind, case, method, setting):
        found = [r for r in self.data[kind]
                 if (r["case"], r["method"], r["setting"]) == (case, method, setting)]
        self.assertEqual(len(found), 1, (case, method, setting))
        return found[0]

    def test_the_results_contain_the_machine_and_the_options(self):
        self.assertEqual(list(self.data), ["machine", "options", "surfaces", "streams", "rubbing"])
        for key in ("processor", "compiler", "flags", "commit", "clock_step_ns"):
            self.assertIn(key, self.data["machine"])
        self.assertTrue(self.data["options"]["quick"])

    def test_every_method_has_errors_and_times_in_every_case(self):
        for kind, names, methods in (("surfaces", SURFACES, ON_SURFACES),
                                     ("streams", STREAMS, ON_STREAMS)):
            judged = [(r["case"], r["method"], r["setting"]) for r in self.data[kind]]
            self.assertEqual(len(judged), len(names) * len(methods))
            self.assertEqual(set(judged), {(n, *m) for n in names for m in methods})
            for r in self.data[kind]:
                self.assertEqual(r["speed"], 0.5)
                self.assertGreater(r["ns"]["median"], 0, r)
                self.assertGreater(r["reads"], 0, r)
                self.assertLessEqual(r["reads"], r["most_reads"])

    def test_the_proxy_s_error_on_spheres_is_at_most_a_tolerance_of_0_01_voxel(self):
        for case in SPHERES:
            r = self.row("surfaces", case, "palpate", "0.01")
            self.assertLessEqual(r["off"], 0.01, r)
            self.assertEqual((r["lost"], r["capped"]), (0, 0), r)
            if r["floor"]:
                self.assertLessEqual(r["true"], 1.05 * r["floor"] + r["off"], r)

    def test_on_spheres_a_smaller_tolerance_increases_the_error_by_at_most_5_per_cent(self):
        coarse_first = sorted(OURS, key=lambda m: -float(m[1]))
        for case in SPHERES:
            errors = [self.row("surfaces", case, *m)["off"] for m in coarse_first]
            # If one reading suffices for several tolerances, their errors are equal except for rounding.
            for wide, narrow in zip(errors, errors[1:]):
                self.assertLessEqual(narrow, 1.05 * wide, case)

    def test_one_step_to_a_plane_has_more_than_100_times_palpate_s_error_on_a_sphere(self):
        ours = self.row("surfaces", "sphere, radius 40", "palpate", "0.01")
        one = self.row("surfaces", "sphere, radius 40", "plane", "1")
        self.assertEqual(one["lost"], 0)
        self.assertGreater(one["off"], 100 * ours["off"])
        # The engine reads the field at most 10 % more often.
        self.assertLessEqual(ours["reads"], 1.1 * one["reads"])

    def test_in_fog_methods_without_memory_lose_the_surface_or_drift(self):
        case = "sphere in fog, radius 40"
        ours = self.row("surfaces", case, "palpate", "0.01")
        for method in ON_SURFACES - OURS:
            r = self.row("surfaces", case, *method)
            self.assertTrue(r["lost"] > 0 or r["off"] > 100 * ours["off"], r)

    def test_the_proxy_s_error_on_streams_is_at_most_a_tolerance_of_0_01_voxel(self):
        for case in STREAMS:
            r = self.row("streams", case, "palpate", "0.01")
            self.assertLessEqual(r["off"], 0.01, r)
            self.assertLessEqual(r["departures"], 0.02, r)
            self.assertLessEqual(r["reads"], 20, r)
            self.assertEqual(r["capped"], 0, r)
            self.assertGreater(self.row("streams", case, "line", "1")["off"], 100 * r["off"])

    def test_the_chart_script_draws_a_chart_and_fills_the_table_of_a_page(self):
        page = self.dir / "page.md"
        page.write_text("before\n<!-- numbers: begin -->\nold\n<!-- numbers: end -->\nafter\n")
        folder = self.dir / "charts"
        subprocess.run([CHART, str(self.result), str(folder), "--doc", str(page)], check=True,
                       timeout=300)
        self.assertEqual(sorted(os.listdir(folder)), ["motion_accuracy.png", "motion_accuracy.svg"])
        self.assertLess((folder / "motion_accuracy.svg").stat().st_size, 600000)
        text = page.read_text()
        self.assertTrue(text.startswith("before\n") and text.endswith("after\n"))
        self.assertNotIn("old\n", text)
        self.assertIn("| palpate, 0.01 voxel |", text)
        self.assertIn("| plane, 1 step |", text)
        self.assertIn("| RK4, 4 sub-steps |", text)


if __name__ == "__main__":
    suite.main(sys.argv[3:])
