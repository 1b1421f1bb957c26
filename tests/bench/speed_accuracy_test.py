#!/usr/bin/env python3
"""Tests the chart of speed against accuracy from end to end: speed_accuracy_test.py PROGRAM CHART."""
import json
import os
import statistics
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import suite  # noqa: E402

PROGRAM = sys.argv[1]
CHART = sys.argv[2]

METHODS = {"force function", "constraint approach", "Euler, fixed step", "Euler, adaptive step",
           "Nelder-Mead", "smallest residual", "palpate"}
FAMILIES = {"random", "one point", "near-parallel", "slot", "orthogonal", "walk, fixed",
            "walk, carried", "surface and drag", "surface and stream"}
CHARTS = ("speed_accuracy", "speed_accuracy_motion", "figure7", "nonorthogonal")


class SpeedAccuracy(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.holder = tempfile.TemporaryDirectory()
        cls.dir = Path(cls.holder.name)
        cls.result = cls.dir / "result.json"
        subprocess.run([PROGRAM, "--problems", "8", "--seconds", "0", "--exploration", "3",
                        "--cold", "10", "--output", str(cls.result)], check=True, timeout=300)
        cls.data = json.loads(cls.result.read_text())

    @classmethod
    def tearDownClass(cls):
        cls.holder.cleanup()

    def test_the_results_contain_the_machine_and_the_options(self):
        self.assertEqual(list(self.data), ["machine", "options", "truth", "results", "ratios",
                                           "figure7", "nonorthogonal"])
        for key in ("processor", "compiler", "flags", "commit", "clock_step_ns"):
            self.assertIn(key, self.data["machine"])
        self.assertEqual(self.data["options"]["problems"], 8)

    def test_the_reference_s_error_bounds_are_small_and_no_certificate_is_broken(self):
        truth = self.data["truth"]
        self.assertGreater(truth["cases"], 100)
        for r in self.data["results"]:
            ours = r["method"].startswith("palpate")
            self.assertEqual(r["certificates"], r["cases"] if ours else 0)
            if r["setting"] in ("1e-2", "1e-3", "1e-4", "1e-6"):
                self.assertEqual(r["certificates_broken"], 0, r)
        self.assertLess(truth["widest_bound_over_reach"], 1e-6)

    def test_the_results_contain_every_method_on_every_family_of_problems(self):
        seen = {(r["family"], r["method"]) for r in self.data["results"]}
        for family in FAMILIES:
            for method in METHODS:
                self.assertIn((family, method), seen)
        warm = {r["family"] for r in self.data["results"] if r["method"] == "palpate, warm"}
        self.assertEqual(warm, {r["family"] for r in self.data["results"] if r["motion"]})
        counts = {(r["family"], r["primitives"]) for r in self.data["results"]}
        for count in (2, 8, 32):
            self.assertIn(("random", count), counts)
            self.assertIn(("walk, carried", count), counts)
        for r in self.data["results"]:
            self.assertGreater(r["cost_ns"]["median"], 0)
            timed_cold = r["motion"] and r["method"] in ("palpate, warm", "Euler, adaptive step")
            self.assertEqual(r.get("cold_ns", 0) > 0, timed_cold)
            self.assertLessEqual(r["error_m"]["median"], r["error_m"]["worst"])

    def test_palpate_reaches_the_requested_accuracy(self):
        for r in self.data["results"]:
            if r["method"].startswith("palpate") and r["setting"] in r["reached"]:
                self.assertEqual(r["reached"][r["setting"]], 1.0, r)

    def test_the_constraint_approach_is_exact_for_orthogonal_directions(self):
        for r in self.data["results"]:
            if r["method"] == "constraint approach" and r["family"] == "orthogonal":
                self.assertEqual(r["reached"]["1e-6"], 1.0, r)

    def test_ratios_of_times_use_only_problems_that_both_methods_solve(self):
        self.assertTrue(any(r["other"] == "Euler, adaptive step" for r in self.data["ratios"]))
        for r in self.data["ratios"]:
            self.assertGreaterEqual(r["both"] + r["missed_by_other"] + r["missed_by_ours"],
                                    r["cases"])
            self.assertLessEqual(r["both"], r["cases"] - r["missed_by_other"])

    def test_the_data_of_figure_7_contain_every_tick_for_every_solver(self):
        figure = self.data["figure7"]
        self.assertGreaterEqual(len(figure["speed_m_s"]), 3000)
        self.assertGreaterEqual(len(figure["solvers"]), 2)
        for solver in figure["solvers"]:
            self.assertEqual(len(solver["iterations"]), len(figure["speed_m_s"]))

    def test_in_figure_7_the_median_for_two_primitives_is_1_to_8_iterations_in_palpate_and_30_to_45_elsewhere(self):
        figure = self.data["figure7"]
        for solver in figure["solvers"]:
            both = [n for n, count in zip(solver["iterations"], figure["primitives"]) if count == 2]
            self.assertGreater(len(both), 100)
            low, high = (1, 8) if solver["method"].startswith("palpate") else (30, 45)
            self.assertLessEqual(low, statistics.median(both), solver["method"])
            self.assertLessEqual(statistics.median(both), high, solver["method"])

    def test_the_constraint_approach_gives_a_spurious_force_unless_constraints_are_orthogonal(self):
        for curve in self.data["nonorthogonal"]["curves"]:
            old = curve["constraint_approach_n"]["worst"]
            self.assertEqual((curve["degrees"][0], curve["degrees"][-1]), (90, 1))
            self.assertLess(old[0], 1e-9)
            self.assertGreater(min(old[1:]), 1e-3)
            self.assertLess(max(curve["palpate_n"]["worst"]), 1e-6)

    def test_the_chart_script_draws_charts_and_fills_the_tables_of_a_page(self):
        page = self.dir / "page.md"
        page.write_text("before\n<!-- numbers: begin -->\nold\n<!-- numbers: end -->\nafter\n")
        drawn = []
        for name in ("first", "second"):
            folder = self.dir / name
            subprocess.run([CHART, str(self.result), str(folder), "--doc", str(page)], check=True,
                           timeout=300)
            self.assertEqual(sorted(os.listdir(folder)),
                             sorted(f"{c}.{kind}" for c in CHARTS for kind in ("png", "svg")))
            drawn.append(folder)
        for chart in CHARTS:
            svg = (drawn[0] / f"{chart}.svg").read_bytes()
            self.assertEqual(svg, (drawn[1] / f"{chart}.svg").read_bytes())
            self.assertLess(len(svg), 300000, chart)
        text = page.read_text()
        self.assertTrue(text.startswith("before\n") and text.endswith("after\n"))
        self.assertNotIn("old\n", text)
        self.assertIn("| random | 2 |", text)

    def test_a_page_without_markers_is_refused_and_stays_unchanged(self):
        page = self.dir / "bare.md"
        page.write_text("nothing\n")
        done = subprocess.run([CHART, str(self.result), str(self.dir / "third"), "--doc",
                               str(page)], capture_output=True, text=True, timeout=300)
        self.assertEqual(done.returncode, 1)
        self.assertIn("numbers: begin", done.stderr)
        self.assertEqual(page.read_text(), "nothing\n")


if __name__ == "__main__":
    suite.main(sys.argv[3:])
