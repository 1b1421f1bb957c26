#!/usr/bin/env python3
"""Tests that tidy.py reports the same complaints for sources in a unit as for each source alone, and tests its
stamps."""
import json
import tempfile
import unittest
from pathlib import Path

import tidy

GOOD = """#include <vector>
namespace {
struct Options {
  int rounds = 1;
};
int run(const Options& options) { return options.rounds; }
}  // namespace
int first() { return run(Options()); }
"""
# A source with the same names as GOOD, and other contents.
OTHER = """#include <string>
namespace {
struct Options {
  std::string name;
};
std::size_t run(const Options& options) { return options.name.size(); }
}  // namespace
std::size_t second() { return run(Options()); }
"""
FAULTS = {
    "readability-identifier-naming": "int Bad_Name() { return 0; }\n",
    "clang-analyzer-core.NullDereference":
        "static int at(const int* p, bool b) { return p == nullptr && b ? *p : 0; }\n"
        "int useNull(bool b) { return at(nullptr, b); }\n",
    "bugprone-use-after-move":
        "#include <utility>\n#include <string>\nvoid take(std::string);\n"
        "int left(std::string s) { take(std::move(s)); return static_cast<int>(s.size()); }\n",
    "bugprone-infinite-loop": "void wait() { int i = 0; while (i < 1) { } }\n",
}
# A pattern of a source, for names that another source uses for something else.
NAMES = "namespace {\nstruct %s {};\nint %s() { return 0; }\n}  // namespace\nint %s() { return %s(); }\n"


class Unit(unittest.TestCase):
    def told(self, *texts, every=False):
        with tempfile.TemporaryDirectory() as folder:
            build = Path(folder)
            sources = []
            for i, text in enumerate(texts):
                sources.append(build / f"source{i}.cpp")
                sources[-1].write_text(text)
            unit = build / "unit.cpp"
            unit.write_text(tidy.unit_of(map(str, sources)))
            (build / "compile_commands.json").write_text(json.dumps([
                {"directory": folder, "file": str(unit), "command": f"c++ -std=c++20 -c {unit}"}]))
            return tidy.tidy(build, str(unit), every)

    def test_correct_sources_with_the_same_names_pass_when_checked_together(self):
        passed, words = self.told(GOOD, OTHER)
        self.assertTrue(passed, words)

    def test_a_fault_in_any_source_of_a_unit_is_reported(self):
        for check, fault in FAULTS.items():
            for texts in ((GOOD + fault, OTHER), (GOOD, OTHER + fault)):
                with self.subTest(check=check, last=texts[0] == GOOD):
                    slow = check in tidy.SLOW or check.startswith("clang-analyzer")
                    passed, words = self.told(*texts, every=slow)
                    self.assertFalse(passed)
                    self.assertIn(check, words)

    def test_an_invalid_name_is_reported_even_if_it_is_valid_in_another_source(self):
        self.assertTrue(self.told(NAMES % ("Told", "shape", "one", "shape"), GOOD)[0])
        passed, words = self.told(NAMES % ("Told", "shape", "one", "shape"),
                                  NAMES % ("shape", "Told", "two", "Told"))
        self.assertFalse(passed)
        self.assertIn("invalid case style for struct 'shapeB'", words)

    def test_sources_with_the_same_using_declaration_are_checked_separately(self):
        with tempfile.TemporaryDirectory() as folder:
            sources = []
            for i, line in enumerate(("using std::max;", "int a;", "using std::max;")):
                sources.append(str(Path(folder) / f"source{i}.cpp"))
                Path(sources[-1]).write_text(line + "\n")
            self.assertEqual(tidy.together(sources), [sources[:2], sources[2:]])


class Stamp(unittest.TestCase):
    def setUp(self):
        holder = tempfile.TemporaryDirectory()
        self.addCleanup(holder.cleanup)
        self.root = Path(holder.name)
        self.addCleanup(setattr, tidy, "CACHE", tidy.CACHE)
        tidy.CACHE = self.root / "cache"
        tidy.CACHE.mkdir()

    def stamps(self, clone, headers):
        """Returns the stamps of a clone with these sources and headers, {source: headers}."""
        folder = self.root / clone
        folder.mkdir(exist_ok=True)
        stamps = tidy.Stamps.__new__(tidy.Stamps)
        stamps.here = lambda text: text.replace(str(folder), ".")
        stamps.headers = {str(folder / s): {str(folder / h) for h in hs} for s, hs in headers.items()}
        stamps.entries = {source: [f"c++ -c {source}"] for source in stamps.headers}
        stamps.common = ""
        for name in {*headers}.union(*headers.values()):
            (folder / name).write_text(f"int {name[0]};\n")
        return folder, stamps

    def test_the_hash_of_a_source_depends_neither_on_the_clone_s_folder_nor_on_comments_except_nolint(self):
        (first, a), (second, b) = self.stamps("first", {"x.cpp": []}), self.stamps("second", {"x.cpp": []})
        before = a.stamp(str(first / "x.cpp"))
        self.assertEqual(b.stamp(str(second / "x.cpp")), before)
        for text, same in (("// x\nint x;  // x\n", True), ("int y;\n", False), ("int x;  // NOLINT\n", False)):
            (first / "x.cpp").write_text(text)
            self.assertEqual(a.stamp(str(first / "x.cpp")) == before, same)

    def test_a_changed_header_is_checked_with_one_source_that_includes_it(self):
        folder, stamps = self.stamps("one", {"a.cpp": ["x.h"], "b.cpp": ["x.h", "y.h"], "c.cpp": ["y.h"]})
        sources = sorted(stamps.headers)
        self.assertEqual(stamps.to_check(sources, False), sources)
        for file in (*sources, folder / "x.h", folder / "y.h"):
            stamps.stamp(str(file)).touch()
        self.assertEqual(stamps.to_check(sources, False), [])
        self.assertEqual(stamps.to_check(sources, True), sources)
        (folder / "x.h").write_text("int other;\n")
        self.assertEqual(stamps.to_check(sources, False), sources[:1])
        (folder / "y.h").write_text("int other;\n")
        self.assertEqual(stamps.to_check(sources, False), sources[1:2])
        (folder / "c.cpp").write_text("int other;\n")
        self.assertEqual(stamps.to_check(sources, False), [sources[2], sources[0]])


if __name__ == "__main__":
    unittest.main(verbosity=0)
