#!/usr/bin/env python3
"""Tests the stability chart from end to end: stability_accuracy_test.py PROGRAM CHART. Does not test times."""
import json
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import suite  # noqa: E402

PROGRAM = sys.argv[1]
CHART = sys.argv[2]


class StabilityAccuracy(unittest.TestCase):
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

    def of(self, contact, method):
        return next(r for r in self.data["results"]
                    if r["contact"].startswith(contact) and r["method"] == method)

    def test_the_engine_s_force_error_is_below_1e_5_and_its_stable_stiffness_follows_the_wall_formula(self):
        for contact in ("a wall", "two planes"):
            ours = self.of(contact, "palpate")
            self.assertLess(ours["force_error"], 1e-5)
            for at in ours["stable"]:
                self.assertGreater(at["stiffness"], 0.85 * at["formula"], (contact, at))
                self.assertLess(at["stiffness"], 1.3 * at["formula"], (contact, at))

    def test_a_force_function_is_unstable_and_the_constraint_approach_is_wrong_at_two_planes(self):
        for contact in ("a wall", "two planes"):
            none = self.of(contact, "force function")
            self.assertGreater(none["force_error"], 1.0)
            self.assertEqual([at["stiffness"] for at in none["stable"]], [0, 0])
        # The planes are not orthogonal, so the constraint approach adds each plane's load to the other's.
        self.assertGreater(self.of("two planes", "constraint approach")["force_error"], 0.1)
        self.assertLess(self.of("a wall", "constraint approach")["force_error"], 1e-9)

    def test_euler_s_adaptive_step_is_stable_near_the_wall_formula_with_a_small_force_error(self):
        """The benchmark must not make this method of the paper worse than necessary by its settings."""
        wall = self.of("a wall", "Euler, adaptive step")
        self.assertLess(wall["force_error"], 0.01)
        for at in wall["stable"]:
            self.assertGreater(at["stiffness"], 0.85 * at["formula"], at)
        self.assertLess(self.of("two planes", "Euler, adaptive step")["force_error"], 0.04)

    def test_the_chart_script_draws_the_chart(self):
        words = subprocess.run([CHART, str(self.result), str(self.dir)], check=True, text=True,
                               capture_output=True, timeout=120).stdout
        self.assertIn("| palpate |", words)
        self.assertTrue((self.dir / "stability_accuracy.png").read_bytes().startswith(b"\x89PNG"))
        self.assertIn("<svg", (self.dir / "stability_accuracy.svg").read_text())


if __name__ == "__main__":
    suite.main(sys.argv[3:])
