#!/usr/bin/env python3
"""Tests the loading benchmark with small files: load_test.py PROGRAM MAKE_VOLUMES. Does not test times."""
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import suite  # noqa: E402

PROGRAM = sys.argv[1]
MAKE_VOLUMES = sys.argv[2]


def run(*arguments):
    return subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True,
                          timeout=120)


class Load(unittest.TestCase):
    def setUp(self):
        self.holder = tempfile.TemporaryDirectory()
        self.addCleanup(self.holder.cleanup)
        self.dir = Path(self.holder.name)
        subprocess.run([MAKE_VOLUMES, str(self.dir)], check=True, timeout=120)

    def test_the_benchmark_prints_one_line_for_each_loaded_file(self):
        done = run(self.dir / "ball.vdb", self.dir / "linear.vdb", "--runs", 2)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        rows = [line.split(" | ") for line in done.stdout.splitlines() if ".vdb" in line]
        self.assertEqual([row[0] for row in rows],
                         ["| ball.vdb, ball", "| linear.vdb, density"])
        for row in rows:
            self.assertEqual(len(row), 9)
            self.assertEqual(row[1], "blosc")
            self.assertGreater(float(row[6]), 0)

    def test_the_benchmark_loads_only_the_grid_that_option_grid_names(self):
        done = run(self.dir / "linear.vdb", "--grid", "velocity", "--runs", 1)
        self.assertIn("linear.vdb, velocity", done.stdout)

    def test_the_benchmark_ends_with_status_2_if_a_file_cannot_be_loaded(self):
        done = run(self.dir / "nan.vdb", "--runs", 1)
        self.assertEqual(done.returncode, 2)
        self.assertIn("density", done.stderr)


if __name__ == "__main__":
    suite.main(sys.argv[3:])
