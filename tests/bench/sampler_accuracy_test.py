#!/usr/bin/env python3
"""Tests the sampler chart from end to end: sampler_accuracy_test.py PROGRAM CHART. Does not test times."""
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

VALUES = {"palpate nearest", "PointSampler", "BoxSampler", "GridSampler", "QuadraticSampler"}
GRADIENTS = {"palpate trilinear", "palpate quadratic", "palpate cubic", "7x BoxSampler",
             "BoxStencil", "7x QuadraticSampler"}
VOXELS = (4, 8, 16, 32)
FIELDS = ("waves", "distance")


class SamplerAccuracy(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.holder = tempfile.TemporaryDirectory()
        cls.dir = Path(cls.holder.name)
        cls.result = cls.dir / "result.json"
        subprocess.run([PROGRAM, "--quick", "--output", str(cls.result)], check=True, timeout=300)
        cls.data = json.loads(cls.result.read_text())
        cls.nano = {"NanoVDB trilinear"} if cls.data["options"]["nanovdb"] else set()

    @classmethod
    def tearDownClass(cls):
        cls.holder.cleanup()

    def errors(self, field, method, quantity="value", which="rms"):
        """Returns the errors, in the order of voxels per wavelength from coarse to fine."""
        found = {r["voxels"]: r[quantity][which] for r in self.data["errors"]
                 if r["field"] == field and r["method"] == method}
        return [found[voxels] for voxels in VOXELS]

    def falls(self, method, quantity, factor, field="waves"):
        # At four voxels per wavelength, the error does not yet fall with the order of the method.
        _, *fine = self.errors(field, method, quantity)
        for coarse, half in zip(fine, fine[1:]):
            self.assertGreaterEqual(coarse / half, factor, (method, field, quantity, fine))

    def test_the_results_contain_the_machine_and_the_options(self):
        self.assertEqual(list(self.data),
                         ["machine", "options", "grids", "errors", "scalar", "vector"])
        for key in ("processor", "compiler", "flags", "commit", "clock_step_ns"):
            self.assertIn(key, self.data["machine"])
        self.assertTrue(self.data["options"]["quick"])
        self.assertGreater(self.data["grids"]["scalar"]["active_voxels"], 100000)

    def test_every_method_has_errors_and_times_for_every_field(self):
        everyone = VALUES | GRADIENTS | self.nano
        judged = [(r["field"], r["voxels"], r["method"]) for r in self.data["errors"]]
        self.assertEqual(len(judged), len(FIELDS) * len(VOXELS) * len(everyone))
        self.assertEqual(set(judged), {(f, v, m) for f in FIELDS for v in VOXELS for m in everyone})
        for r in self.data["errors"]:
            self.assertEqual("gradient" in r, r["method"] not in VALUES, r)
            self.assertLessEqual(r["value"]["rms"], r["value"]["max"])
        self.assertEqual({m["method"] for m in self.data["scalar"]}, everyone | {"nothing"})
        self.assertEqual({(m["method"], m["reads"]) for m in self.data["vector"]},
                         {("palpate trilinear", "V+J"), ("BoxSampler", "V")})
        options = self.data["options"]
        for m in self.data["scalar"] + self.data["vector"]:
            self.assertGreater(m["walk_ns"]["median"], 0)
            self.assertGreater(m["cold_ns"]["median"], 0)
            for where in ("first_near_ns", "first_far_ns"):
                self.assertEqual(m[where]["count"], options["first_calls"])
                self.assertLessEqual(m[where]["p50"], m[where]["p99"])

    def test_values_converge_with_the_order_of_the_interpolation(self):
        for field in FIELDS:
            self.falls("palpate nearest", "value", 1.9, field)
            self.falls("palpate trilinear", "value", 3.5, field)
            self.falls("palpate quadratic", "value", 7.0, field)
            self.falls("palpate cubic", "value", 12.0, field)

    def test_gradients_converge_with_the_order_of_the_method(self):
        for field in FIELDS:
            self.falls("palpate trilinear", "gradient", 3.5, field)
            self.falls("palpate quadratic", "gradient", 3.5, field)
            self.falls("palpate cubic", "gradient", 7.0, field)
            self.falls("BoxStencil", "gradient", 1.9, field)

    def test_all_trilinear_readers_have_equal_errors_to_within_0_1_per_cent(self):
        same = {"palpate trilinear", "BoxSampler", "BoxStencil"} | self.nano
        for field in FIELDS:
            for which in ("rms", "max"):
                rows = [self.errors(field, method, "value", which) for method in same]
                for errors in zip(*rows):
                    self.assertLess(max(errors) / min(errors), 1.001)

    def test_palpate_s_gradients_are_continuous_and_the_cell_gradient_is_not(self):
        for r in self.data["errors"]:
            if r["method"].startswith("palpate") and "jump" in r:
                self.assertLess(r["jump"], 1e-5, r)
            if r["method"] in {"BoxStencil"} | self.nano:
                self.assertGreater(r["jump"], 0.03, r)

    def test_directions_are_off_by_less_than_18_4_degrees_at_eight_voxels_or_more(self):
        for field in FIELDS:
            for method in ("palpate trilinear", "palpate quadratic", "palpate cubic"):
                self.assertLess(max(self.errors(field, method, "direction_deg", "max")[1:]), 18.4)

    def test_the_chart_script_draws_a_chart_and_fills_the_table_of_a_page(self):
        page = self.dir / "page.md"
        page.write_text("before\n<!-- numbers: begin -->\nold\n<!-- numbers: end -->\nafter\n")
        folder = self.dir / "charts"
        subprocess.run([CHART, str(self.result), str(folder), "--doc", str(page)], check=True,
                       timeout=300)
        self.assertEqual(sorted(os.listdir(folder)),
                         ["sampler_accuracy.png", "sampler_accuracy.svg"])
        self.assertLess((folder / "sampler_accuracy.svg").stat().st_size, 300000)
        text = page.read_text()
        self.assertTrue(text.startswith("before\n") and text.endswith("after\n"))
        self.assertNotIn("old\n", text)
        self.assertIn("| palpate cubic, V+G |", text)
        self.assertIn("| OpenVDB BoxSampler, V |", text)


if __name__ == "__main__":
    suite.main(sys.argv[3:])
