#!/usr/bin/env python3
"""Tests gate.py's reading of CTest's output, the list of CTest's processes (list_shards.cmake), the include order
(structure.py) and the prose check (prose.py)."""
import contextlib
import io
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent / "support"))
sys.dont_write_bytecode = True
import gate  # noqa: E402
import prose  # noqa: E402
import structure  # noqa: E402
import suite  # noqa: E402

# Output of CTest 3.25.
CONSOLE = {
    "passed": "  1/4 Test  #1: {} .................   Passed    0.12 sec\n",
    "failed": "  1/4 Test  #1: {} .................***Failed    0.12 sec\n",
    "again": "      Test  #1: {} .................   Passed    0.30 sec\n",
    "crashed": "  1/4 Test  #1: {} .................***Exception: SegFault  0.12 sec\n",
    "unlike": "  1/4 Test  #1: {} .................***Failed  Required regular expression not found. Regex=[x\n]  0.12 sec\n",
    "skipped": "  1/4 Test  #1: {} .................***Skipped   0.12 sec\n"}


class Rooms(unittest.TestCase):
    def test_the_hash_of_a_room_changes_with_its_code_and_nolint_but_not_with_other_comments(self):
        with tempfile.TemporaryDirectory() as folder:
            for name, value in (("ROOT", Path(folder)), ("ROOMS", {"room": ("room",)})):
                self.addCleanup(setattr, gate, name, getattr(gate, name))
                setattr(gate, name, value)
            source = Path(folder) / "room" / "a.cpp"
            source.parent.mkdir()

            def hash_with(text):
                source.write_text(text)
                return gate.hash_of("room")

            before = hash_with("/// One.\nint a = 1;\n")
            self.assertEqual(hash_with("/// Another one.\n  // And more.\nint a = 1;\n"), before)
            self.assertNotEqual(hash_with("/// One.\nint a = 2;\n"), before)
            self.assertEqual(hash_with("int a = 1;  // a\n"), before)
            self.assertNotEqual(hash_with("int a = 1;  // NOLINT(cert-err58-cpp)\n"), before)
            for a, b in (('R"(\n// 1\n)"', 'R"(\n// 2\n)"'), ('"/*1*/"', '"/*2*/"'), ("10'000 + '\"'; // x\n\"", "10'000 + '\"'; // y\n\"")):
                self.assertEqual(hash_with(f"int a = {a}\n") == hash_with(f"int a = {b}\n"), "10'000" in a)


class Shards(unittest.TestCase):
    def test_a_test_name_with_a_semicolon_counts_as_one_case(self):
        with tempfile.TemporaryDirectory() as folder:
            program, out = Path(folder) / "tests", Path(folder) / "tests.cmake"
            program.write_text("#!/bin/sh\nprintf 'one\\n\\nits value; its slope\\nthree\\n'\n")
            program.chmod(0o755)
            subprocess.run(["cmake", "-D", f"PROGRAM={program}", "-D", f"OUT={out}", "-D", "ROOM=room",
                            "-DSETS=all|spec|room|-|1;own|spec|room|host|1", "-P",
                            gate.ROOT / "tests" / "support" / "list_shards.cmake"], check=True)
            self.assertEqual(Path(f"{out}.counts").read_text(), "3 all\n")
            self.assertIn("[==[own.its value; its slope]==]", out.read_text())


class Report(unittest.TestCase):
    def setUp(self):
        holder = tempfile.TemporaryDirectory()
        self.addCleanup(holder.cleanup)
        self.folder = Path(holder.name) / "release" / "runs" / "host"
        self.folder.mkdir(parents=True)

    def report(self, console, cases="", status=0, minutes="60\t60\trelease: tests\t\n", counts=""):
        """Returns the exit status and the output lines of a report on one run."""
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

    def test_a_program_that_prints_no_case_names_counts_as_one_test(self):
        self.assertEqual(self.report([("a", "passed")])[1][-1], "1 passed, 0 failed")
        self.assertEqual(self.report([("a", "passed")])[0], 0)

    def test_the_gate_fails_if_a_test_fails_crashes_or_prints_unexpected_output(self):
        for word in ("failed", "crashed", "unlike"):
            with self.subTest(word):
                result, lines = self.report([("a", word), ("b", "passed")], status=8)
                self.assertEqual((result, lines[-1]), (1, "1 passed, 1 failed"))

    def test_a_test_that_passes_at_the_second_try_counts_as_passed_and_is_printed(self):
        result, lines = self.report([("a", "failed"), ("a", "again")])
        self.assertEqual((result, lines[-1]), (0, "1 passed, 0 failed"))
        self.assertIn("passed at its second try: release/host: a: failed, then passed", lines)

    def test_each_case_of_a_program_is_counted(self):
        cases = "1/1 Testing: a\npassed     0.100 s  one\nfailed     0.100 s  two\nfailed     0.100 s  three\n" \
                "once more\npassed     0.100 s  two\nskipped    0.000 s  three\n"
        result, lines = self.report([("a", "failed")], cases, status=8)
        self.assertEqual((result, lines[-1]), (1, "2 passed, 1 failed"))
        self.assertIn("failed: release/host: a three", lines)

    def test_the_gate_fails_if_a_process_prints_too_few_cases(self):
        cases = "1/1 Testing: a\npassed     0.100 s  one\n"
        self.assertEqual(self.report([("a", "passed")], cases, counts="1 a\n")[0], 0)
        result, lines = self.report([("a", "passed")], cases, counts="2 a\n")
        self.assertEqual((result, lines[-1]), (1, "1 passed, 1 failed"))

    def test_the_gate_fails_if_ctest_fails_without_a_failed_test(self):
        self.assertEqual(self.report([("a", "passed")], status=8)[0], 1)

    def test_the_gate_fails_if_a_test_is_skipped_although_its_data_were_given(self):
        data = os.environ.pop("PALPATE_DATA", None)
        try:
            self.assertEqual(self.report([("a", "skipped")])[1][-1], "0 passed, 0 failed, 1 skipped")
            os.environ["PALPATE_DATA"] = "."
            self.assertEqual(self.report([("a", "skipped")])[0], 1)
        finally:
            os.environ.pop("PALPATE_DATA")
            if data is not None:
                os.environ["PALPATE_DATA"] = data

    def test_the_gate_fails_if_it_takes_too_many_processor_minutes_besides_builds_and_lint(self):
        many = str(60 * (gate.BUDGET + 1))
        self.assertEqual(self.report([("a", "passed")], minutes=f"1\t{many}\tdev: tests\t\n")[0], 1)
        for step in ("dev: build", "lint"):
            self.assertEqual(self.report([("a", "passed")], minutes=f"1\t{many}\t{step}\t\n")[0], 0)

    def test_the_gate_reports_if_tests_that_depend_on_the_machine_s_timing_exceed_their_common_budget(self):
        minutes = "200\t1\trelease: host\t\n100\t1\trelease: host_suites\t\n100\t1\trelease: tests\t\n"
        words = "tests that depend on how the machine schedules: 300 s of 240: over their budget"
        self.assertIn(words, self.report([("a", "passed")], minutes=minutes)[1])


class Structure(unittest.TestCase):
    def test_an_include_of_a_header_in_a_higher_or_unrelated_folder_is_reported(self):
        fault = structure.fault_of
        self.assertIsNone(fault("engine/tick/step.cpp", "engine/balance/solver.h"))
        self.assertIsNone(fault("scenes/apps/view/window.cpp", "scenes/apps/common/touch.h"))
        self.assertIn("is above", fault("engine/balance/solver.cpp", "engine/tick/step.h"))
        self.assertIn("is above", fault("engine/tick/step.cpp", "samplers/grid/volume.h"))
        self.assertIn("must not include each other", fault("scenes/apps/cli/feel.cpp", "scenes/apps/import/reader.h"))
        self.assertIn("is not in ORDER", fault("engine/new/one.cpp", "engine/types.h"))

    def test_the_length_of_a_function_counts_from_its_signature_to_its_end(self):
        text = "void one() {\n  if (a) {\n  }\n}\n\nint two(int first,\n        int second) {\n  three([&] {\n  });\n}\n"
        self.assertEqual(list(structure.functions(text)), [(1, 4), (6, 5)])


class Prose(unittest.TestCase):
    def hits(self, name, text):
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / name).write_text(text, encoding="utf-8")
            root, prose.ROOT = prose.ROOT, Path(folder)
            self.addCleanup(setattr, prose, "ROOT", root)
            return [rule for _, rule, _ in prose.hits_of(name)[1]]

    def test_the_prose_checker_reports_unclear_prose(self):
        self.assertEqual(self.hits("a.h", "/// What is told to nobody.\nint a;  // begun anew\n"),
                         ["nobody", "what-clause", "archaic"])
        self.assertEqual(self.hits("a.cpp", "// " + "word " * 16 + "\n// " + "word " * 16 + "end.\n"), ["long"])
        self.assertEqual(self.hits("a.md", "The force says nothing.\n```\nWhat is this\n```\n"), ["riddle"])

    def test_the_prose_checker_accepts_plain_words_and_code(self):
        self.assertEqual(self.hits("a.cpp", "/// Returns the force [N].\nauto a = \"What is told\";\n"), [])
        self.assertEqual(self.hits("a.py", "# The hand rests.\nnobody = 1\n"), [])
        self.assertEqual(self.hits("a.md", "`What is told` is a name.\n\n" + "A short sentence. " * 20 + "\n"), [])


if __name__ == "__main__":
    suite.main(sys.argv[1:])
