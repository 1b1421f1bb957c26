#!/usr/bin/env python3
"""Tests of what gate.py makes of CTest's output."""
import contextlib
import io
import os
import sys
import tempfile
import unittest
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent / "support"))
sys.dont_write_bytecode = True
import gate  # noqa: E402
import suite  # noqa: E402

# As CTest 3.25 prints them.
CONSOLE = {
    "passed": "  1/4 Test  #1: {} .................   Passed    0.12 sec\n",
    "failed": "  1/4 Test  #1: {} .................***Failed    0.12 sec\n",
    "again": "      Test  #1: {} .................   Passed    0.30 sec\n",
    "crashed": "  1/4 Test  #1: {} .................***Exception: SegFault  0.12 sec\n",
    "unlike": "  1/4 Test  #1: {} .................***Failed  Required regular expression not found. Regex=[x\n]  0.12 sec\n",
    "skipped": "  1/4 Test  #1: {} .................***Skipped   0.12 sec\n"}


class Report(unittest.TestCase):
    def setUp(self):
        holder = tempfile.TemporaryDirectory()
        self.addCleanup(holder.cleanup)
        self.folder = Path(holder.name) / "release" / "runs" / "host"
        self.folder.mkdir(parents=True)

    def report(self, console, cases="", status=0, minutes="60\t60\trelease: tests\t\n", counts=""):
        """The exit status and the lines for one run."""
        (self.folder / "console.log").write_text("".join(CONSOLE[word].format(name) for name, word in console))
        (self.folder / "LastTest.log").write_text(cases)
        (self.folder / "status").write_text(f"{status}\n")
        (self.folder.parents[1] / "palpate_some_tests.cmake.counts").write_text(counts)
        for name, text in (("minutes", minutes), ("budgets", "slow 1\n")):
            (self.folder / name).write_text(text)
        said = io.StringIO()
        with contextlib.redirect_stdout(said):
            result = gate.report(self.folder / "minutes", self.folder / "budgets", [self.folder])
        return result, said.getvalue().splitlines()

    def test_a_program_without_case_lines_counts_as_one(self):
        self.assertEqual(self.report([("a", "passed")])[1][-1], "1 passed, 0 failed")
        self.assertEqual(self.report([("a", "passed")])[0], 0)

    def test_a_failure_ends_red_however_it_is_printed(self):
        for word in ("failed", "crashed", "unlike"):
            with self.subTest(word):
                result, lines = self.report([("a", word), ("b", "passed")], status=8)
                self.assertEqual((result, lines[-1]), (1, "1 passed, 1 failed"))

    def test_a_second_try_counts_and_is_printed(self):
        result, lines = self.report([("a", "failed"), ("a", "again")])
        self.assertEqual((result, lines[-1]), (0, "1 passed, 0 failed"))
        self.assertIn("passed at its second try: release/host: a: failed, then passed", lines)

    def test_cases_are_counted_one_by_one(self):
        cases = "1/1 Testing: a\npassed     0.100 s  one\nfailed     0.100 s  two\nfailed     0.100 s  three\n" \
                "once more\npassed     0.100 s  two\nskipped    0.000 s  three\n"
        result, lines = self.report([("a", "failed")], cases, status=8)
        self.assertEqual((result, lines[-1]), (1, "2 passed, 1 failed"))
        self.assertIn("failed: release/host: a three", lines)

    def test_a_process_that_loses_its_last_cases_ends_red(self):
        cases = "1/1 Testing: a\npassed     0.100 s  one\n"
        self.assertEqual(self.report([("a", "passed")], cases, counts="1 a\n")[0], 0)
        result, lines = self.report([("a", "passed")], cases, counts="2 a\n")
        self.assertEqual((result, lines[-1]), (1, "1 passed, 1 failed"))

    def test_ctest_that_fails_without_a_failed_test_ends_red(self):
        self.assertEqual(self.report([("a", "passed")], status=8)[0], 1)

    def test_a_skip_fails_where_data_was_given(self):
        data = os.environ.pop("PALPATE_DATA", None)
        try:
            self.assertEqual(self.report([("a", "skipped")])[1][-1], "0 passed, 0 failed, 1 skipped")
            os.environ["PALPATE_DATA"] = "."
            self.assertEqual(self.report([("a", "skipped")])[0], 1)
        finally:
            os.environ.pop("PALPATE_DATA")
            if data is not None:
                os.environ["PALPATE_DATA"] = data

    def test_too_many_minutes_end_red_unless_they_compile(self):
        many = str(60 * (gate.BUDGET + 1))
        self.assertEqual(self.report([("a", "passed")], minutes=f"1\t{many}\tdev: tests\t\n")[0], 1)
        for step in ("dev: build", "lint"):
            self.assertEqual(self.report([("a", "passed")], minutes=f"1\t{many}\t{step}\t\n")[0], 0)

    def test_host_steps_together_have_a_budget(self):
        minutes = "200\t1\trelease: host\t\n100\t1\trelease: host_suites\t\n100\t1\trelease: tests\t\n"
        words = "tests that depend on how the machine schedules: 300 s of 240: over their budget"
        self.assertIn(words, self.report([("a", "passed")], minutes=minutes)[1])


if __name__ == "__main__":
    suite.main(sys.argv[1:])
