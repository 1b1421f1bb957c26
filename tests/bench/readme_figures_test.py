#!/usr/bin/env python3
"""Tests that README.md's figures come from the output of commands, and that the page stays unchanged otherwise:
readme_figures_test.py SOURCE_DIR. The commands' outputs are recorded (readme_figures/)."""
import json
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

ROOT = Path(sys.argv[1]).resolve()
SCRIPT = ROOT / "bench" / "readme_figures.py"
RECORDED = ROOT / "tests" / "bench" / "readme_figures"
sys.dont_write_bytecode = True
sys.path.insert(0, str(SCRIPT.parent))
import readme_figures as figures  # noqa: E402  (in the folder bench)

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import suite  # noqa: E402

CELLS = {
    1: ["3e-9 N (eq. 2: 4.7 N)"],
    2: ["none; 44 solves at most"],
    3: ["0.64 to 0.86 us"],
    4: ["0.98, 2.7, 6 us", "3.8, 12, 17 us"],
    5: ["0.0019 degrees rms"],
    6: ["0"],
    7: ["1.03 times, 1.07 at p99.9"],
    8: ["none"],
    9: ["at most 16 ms"],
    10: ["0, 0, 0"],
}
# For each figure: a text in the recorded output, and a replacement with which the output has no valid figure.
OTHERWISE = {1: ("1e-09 |", "1e-08 |"), 2: ("10000000 problems", "20000 problems"),
             3: ('"walk, carried", "primitives": 8', '"walk, carried", "primitives": 4'),
             4: ("1 kHz, asleep", "1 kHz, early"), 5: ("along 1000", "along 100"),
             6: ("of 30000", "of 3000"), 7: ('"placements": 10000', '"placements": 9999'),
             8: ("ticks 100000000", "ticks 1000000"), 9: ("hang  ", "exit  "),
             10: (" Passed", " ***Skipped")}
PROGRAM = """#!/bin/sh
case "$(basename "$0") $*" in
    cmake*) exit 0 ;;
    "palpate --version") echo "palpate 0.2.0 ($COMMIT)"; echo "GNU 12.2.0, Release; imports"; exit 0 ;;
    *paper*) n=1 ;; *balance*) n=2 ;; *speed_accuracy*) n=3 ;; *tick*) n=4 ;; *press*) n=5 ;;
    *1.5*) n=6 ;; *scale*) n=7 ;; *random*) n=8 ;; *kill_table*) n=9 ;; *realtime*) n=10 ;;
esac
[ "$n" != "$FAILS" ] || { echo "it went wrong" >&2; exit 3; }
cat "$RECORDED/$n.txt"
"""
PROGRAMS = ["cmake", "ctest", "palpate", "palpate_engine_tests", "palpate_samplers_tests",
            "palpate_motion_tests", "palpate_loop_tests", "palpate_bench_speed_accuracy",
            "palpate_bench_tick", "palpate_bench_scale"]


def recorded(number):
    return (RECORDED / f"{number}.txt").read_text(encoding="utf-8")


class Reading(unittest.TestCase):
    def test_every_figure_is_found_in_the_recorded_outputs(self):
        for number, (_, read) in figures.COMMANDS.items():
            self.assertEqual(read(recorded(number)), CELLS[number], number)

    def test_an_output_without_its_figure_is_reported_as_unmeasured(self):
        for number, (_, read) in figures.COMMANDS.items():
            before, after = OTHERWISE[number]
            self.assertIn(before, recorded(number), number)
            for text in ("", recorded(number).replace(before, after)):
                with self.assertRaises(figures.Unmeasured, msg=number):
                    read(text)

    def test_figures_are_rounded_to_two_digits(self):
        for x, words in ((1.02, "1"), (0.803, "0.8"), (12.7, "13"), (141, "140"), (0.00194, "0.0019")):
            self.assertEqual(figures.two(x), words)
        ways = recorded(9).replace("15.92", "16.05")
        self.assertEqual(figures.killed(ways), ["at most 17 ms"])


class Readme(unittest.TestCase):
    def test_the_table_of_the_readme_has_the_written_format(self):
        page = figures.Page(ROOT / "README.md")
        self.assertEqual(page.part, figures.part(page.head, page.cells))
        self.assertRegex(page.head, r"^Measured at .* on .*\. The column \*by\* gives the number of the command")


class Writing(unittest.TestCase):
    def setUp(self):
        self.holder = tempfile.TemporaryDirectory()
        self.addCleanup(self.holder.cleanup)
        self.dir = Path(self.holder.name)
        (self.dir / "bin").mkdir()
        for name in PROGRAMS:
            (self.dir / "bin" / name).write_text(PROGRAM)
            (self.dir / "bin" / name).chmod(0o755)
        (self.dir / "head.json").write_text("{}\n")
        self.page = self.dir / "page.md"
        self.before = f"# above\n\n{figures.BEGIN}\n\nold\n\n{figures.END}\n\nbelow\n"
        self.page.write_text(self.before)

    def run_it(self, *words, commit="0123456789ab", fails="", status=0):
        env = {**os.environ, "COMMIT": commit, "FAILS": fails, "RECORDED": str(RECORDED)}
        done = subprocess.run([sys.executable, "-B", str(SCRIPT), str(self.dir), "--data", str(self.dir),
                               *map(str, words)],
                              capture_output=True, text=True, timeout=60, env=env, check=False)
        self.assertEqual(done.returncode, status, done)
        if status:
            self.assertEqual(len(done.stderr.splitlines()), 1, done.stderr)
        return done.stdout + done.stderr

    def untouched(self):
        self.assertEqual(self.page.read_text(), self.before)
        self.assertEqual([p.name for p in self.dir.glob("page*")], ["page.md"])

    def test_the_script_writes_all_figures_to_the_page(self):
        self.run_it("--write", self.page)
        page = figures.Page(self.page)
        self.assertEqual(page.cells, CELLS)
        self.assertRegex(page.head, r"^Measured at commit 0123456789ab on \d+ cores of .*"
                                    r", GNU 12\.2\.0, Release, \d{4}-\d\d-\d\d\. ")
        self.assertEqual(page.part, figures.part(page.head, page.cells))
        self.assertEqual((page.above, page.below), ("# above\n\n", "\n\nbelow\n"))

    def test_after_a_failed_command_option_resume_measures_only_the_missing_figures(self):
        self.assertIn("figure 8: PALPATE_CASES=100000000 palpate_loop_tests",
                      self.run_it("--write", self.page, fails="8", status=1))
        self.untouched()
        # Figures 1 to 7 were measured before the failure and are kept.
        told = self.run_it("--write", self.page, "--resume")
        self.assertEqual([n for n in CELLS if f"\n{n}: " in told], [8, 9, 10])
        self.assertEqual(figures.Page(self.page).cells, CELLS)

    def test_figures_can_be_measured_in_several_runs_but_only_of_one_commit(self):
        self.assertIn("figures 1, 4, 5, 6, 7, 8, 9, 10 are not measured",
                      self.run_it("--write", self.page, "--only", "2,3", status=1))
        self.assertIn("figures 2, 3 are not", self.run_it(
            "--write", self.page, "--only", "1,4,5,6,7,8,9,10", commit="ba9876543210", status=1))
        self.assertIn("is not a commit", self.run_it("--write", self.page, commit="ba9876543210+",
                                                  status=1))
        self.untouched()
        self.run_it("--write", self.page, "--only", "2,3", commit="ba9876543210")
        self.assertEqual(figures.Page(self.page).cells, CELLS)

    def test_missing_data_and_page_markers_are_reported(self):
        (self.dir / "head.json").unlink()
        self.assertIn("./demo.sh", self.run_it("--write", self.page, status=1))
        self.untouched()
        self.page.write_text("bare\n")
        self.assertIn("no <!-- figures: begin -->", self.run_it("--write", self.page, status=1))
        self.assertEqual(self.page.read_text(), "bare\n")

    def test_without_a_page_the_script_prints_the_changes(self):
        told = self.run_it("--only", "7")
        self.assertIn("| 1.03 times, 1.07 at p99.9 | 7 |", told)
        self.assertIn(f"| {figures.MISSING} | 8 |", told)
        result = json.loads((self.dir / "readme_figures" / "results.json").read_text())
        self.assertEqual(result["7"]["cells"], CELLS[7])


if __name__ == "__main__":
    suite.main(sys.argv[2:])
