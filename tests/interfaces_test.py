#!/usr/bin/env python3
"""Tests that docs/interfaces.md equals the output of the programs and the schemas: interfaces_test.py BIN_DIR."""
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path
from unittest import mock

BIN = Path(sys.argv[1]).resolve()
ROOT = Path(__file__).resolve().parents[1]
SCRIPT = ROOT / "docs" / "interfaces.py"
sys.path[:0] = [str(SCRIPT.parent)]
import interfaces  # noqa: E402  (in the folder docs)
import schema_keys  # noqa: E402

sys.path.append(str(Path(__file__).resolve().parent / "support"))
import suite  # noqa: E402

HELP = """Feels a scene
Usage: palpate feel [OPTIONS] SCENE

Positionals:
  SCENE TEXT REQUIRED         A scene | a folder

Options:
  -h,--help                   Print this help message and exit
  --reengage FLOAT:FLOAT in [0 - 60]
                              The force returns (docs/loop.md)
  --out TEXT REQUIRED         The picture

Exit status: 4

Example:
  palpate feel head.json"""
SECTION = """## feel SCENE

Feels a scene. More.

| argument | meaning |
|---|---|
| `SCENE` | Required. A scene \\| a folder |
| `--reengage FLOAT:FLOAT in [0 - 60]` | The force returns ([loop.md](loop.md)) |
| `--out TEXT` | Required. The picture |

```
Exit status: 4

Example:
  palpate feel head.json
```
"""


def shape(word, **keys):
    return {"type": "object", "required": ["shape"], "properties": {"shape": {"const": word}, **keys}}


class Page(unittest.TestCase):
    def refused(self, page, verbs=interfaces.VERBS):
        """Returns the error of a check of this page."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "interfaces.md"
            path.write_text(page, encoding="utf-8")
            with mock.patch.object(interfaces, "PAGE", path), mock.patch.object(interfaces, "VERBS", verbs), \
                    mock.patch.object(sys, "argv", ["interfaces.py", str(BIN), "--check"]), \
                    self.assertRaises(SystemExit) as stopped:
                interfaces.main()
            self.assertEqual(path.read_text(encoding="utf-8"), page)
        return str(stopped.exception)

    def test_the_page_of_interfaces_equals_the_programs_help_and_the_schemas(self):
        done = subprocess.run([sys.executable, SCRIPT, BIN, "--check"], capture_output=True, text=True, check=False)
        self.assertEqual((done.returncode, done.stderr), (0, ""))

    def test_the_first_difference_is_reported_with_the_command_that_updates_the_page(self):
        lines = interfaces.programs(BIN)
        self.enterContext(mock.patch.object(interfaces, "programs", lambda _: lines))
        page = "\n".join([interfaces.INTRODUCTION, *lines, *interfaces.keys()]).rstrip() + "\n"
        row = "| [info](#info-file) |"
        self.assertEqual(page.count(row), 1)
        line = page[:page.index(row)].count("\n") + 1
        for wrong in (page.replace(row, "| [inform](#info-file) |"), page.replace(row, "").replace("`--json`", "")):
            told = self.refused(wrong)
            self.assertEqual(len(told.splitlines()), 1)
            self.assertRegex(told, rf'^interfaces: docs/interfaces.md:{line}: .*"\| \[info\].*run docs/interfaces.py ')
        self.assertIn(f'md:{page.count(chr(10)) + 1}: the page has "more"', self.refused(page + "more"))

    def test_a_command_without_a_handwritten_section_is_reported(self):
        with tempfile.TemporaryDirectory() as folder:
            verbs = Path(folder) / "verbs.md"
            text = interfaces.VERBS.read_text(encoding="utf-8")
            for before, after, told in (("## info FILE", "### info FILE", "verb info: the page has no section"),
                                        ("## info FILE", "## inform FILE\n\n## info FILE", "palpate has no such verb")):
                verbs.write_text(text.replace(before, after), encoding="utf-8")
                self.assertIn(told, self.refused("", verbs))


class Sections(unittest.TestCase):
    def test_a_help_text_is_converted_to_a_section_of_the_page(self):
        blocks = [block.split("\n") for block in HELP.split("\n\n")]
        self.assertEqual(interfaces.options(blocks, "More."), ("feel SCENE", SECTION.split("\n")))

    def test_headings_get_the_same_anchors_as_on_github(self):
        for heading, anchor in (("scene FILE.vdb", "scene-filevdb"), ("plot TRACE...", "plot-trace"),
                                ("solve [FILE]", "solve-file")):
            self.assertEqual(interfaces.slug(heading), anchor)


class Keys(unittest.TestCase):
    def test_the_table_of_keys_describes_types_and_ranges_in_words(self):
        number = {"type": "number"}
        for node, words in (
                ({**number, "exclusiveMinimum": 0, "maximum": 2.0}, ("number", "> 0, ≤ 2")),
                ({"type": "integer", "minimum": 0, "maximum": 5000}, ("integer", "0 to 5,000")),
                ({**number, "minimum": -1, "not": {"const": 0}}, ("number", "≥ -1, not 0")),
                ({"enum": ["a", "b"]}, ("string", "`a`, `b`")),
                ({"type": "array", "items": number, "minItems": 3, "maxItems": 3}, ("list of numbers", "3 elements")),
                ({"oneOf": [number, {"$ref": "#/definitions/curve"}]}, ("number or [curve](#scene-curve)", "")),
                ({"type": "object", "additionalProperties": number}, ("number for each `NAME`", ""))):
            self.assertEqual(schema_keys.kind(node, "scene"), words)
        with self.assertRaisesRegex(schema_keys.Refused, "multipleOf: the keyword is not known"):
            schema_keys.kind({**number, "multipleOf": 2}, "scene")

    def test_the_table_of_keys_has_a_separate_cell_for_each_default(self):
        node = {"properties": {"rate": {"type": "number", "description": "Rate [1/s]. The default is 0.5. Or more."}}}
        self.assertEqual(schema_keys.rows(node, "scene"), [("rate", "number", "", "0.5", "Rate [1/s]. Or more.")])

    def test_the_table_of_keys_states_with_which_shapes_a_key_is_valid(self):
        along = {"type": "object", "properties": {"x": {"type": "number"}}, "required": ["x"]}
        node = {"oneOf": [shape("point"), shape("line", along=along), shape("plane", along=along)]}
        self.assertEqual(schema_keys.rows(node, "scene"), [
            ("shape", "string", "`point`, `line`, `plane`", "required", ""),
            ("along", "object", "", "", "With line, plane."), ("along.x", "number", "", "required", "")])
        either = {"oneOf": [{"properties": {name: {"type": "number"}}, "required": [name]} for name in ("fit", "unit")]}
        self.assertEqual([row[3] for row in schema_keys.rows(either, "scene")], ["one of these"] * 2)


if __name__ == "__main__":
    suite.main(sys.argv[2:])
