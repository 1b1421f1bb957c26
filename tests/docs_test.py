#!/usr/bin/env python3
"""Tests that the documents agree with the sources: docs_test.py SOURCE_DIR.

Links of README.md, CHANGELOG.md, CONTRIBUTING.md and docs/ must lead to existing files. In docs/paper.md, every
`file:name` must be a name in that file, every tag must be a test's, and every key (P1, D2) must be defined and
used. A quoted name that ends in * must be the beginning of a Catch2 test's name."""
import os
import re
import sys
import unittest
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent / "support"))
import suite  # noqa: E402

ROOT = Path(sys.argv[1]).resolve()
SKIPPED = {".git", "build", "out"}
REFERENCE = re.compile(r"([\w./-]+\.(?:h|cpp|py|sh|md|json|txt)):(\S.*)")
FILE = re.compile(r"[\w./-]+\.(?:h|cpp|py|sh|md|json)")
TAG = re.compile(r"\[(?:eq|fig)\d+\]")
KEY = re.compile(r"\b[A-Z]\d+\b")


def files():
    """Returns the paths of all files, from the root."""
    found = []
    for folder, folders, names in os.walk(ROOT):
        folders[:] = [f for f in folders if f not in SKIPPED]
        found += [(Path(folder) / name).relative_to(ROOT) for name in names]
    return found


FILES = files()


def find(name):
    """Returns the file with this path, or the only file with this name, or None."""
    if "/" in name or (ROOT / name).is_file():
        return Path(name) if (ROOT / name).is_file() else None
    # The tests' host programs have headers with the same names as palpate's.
    same = [f for f in FILES if f.name == name and "host" not in f.parts]
    return same[0] if len(same) == 1 else None


def prose(text):
    """Returns a text without blocks of code."""
    return re.sub(r"^```.*?^```", "", text, flags=re.S | re.M)


def spans(text):
    """Yields the texts in backticks, including those that span lines of a paragraph."""
    for paragraph in re.split(r"\n\s*\n|\n(?=[-|])", prose(text)):
        for span in re.findall(r"`([^`]+)`", paragraph):
            yield " ".join(span.split())


def names(path, name):
    """Returns true if a file has a test, a function or a word of this name."""
    text = (ROOT / path).read_text(encoding="utf-8")
    if path.suffix == ".py":
        return re.search(rf"\bdef {re.escape(name)}\(", text) is not None
    if not re.fullmatch(r"\w+", name) or path.name.endswith("_test.cpp"):
        joined = re.sub(r'"\s*\n\s*"', "", text)  # a long name consists of several literals
        return re.search(rf'TEST_CASE\(\s*"{re.escape(name)}"', joined) is not None
    code = re.sub(r"//[^\n]*", "", text)  # words in comments do not count
    return re.search(rf"\b{re.escape(name)}\b", code) is not None


def broken_references(text):
    """Returns references to missing things: `file:name`, `:name` of the file named before, and `folder/file`."""
    broken = []
    last = None
    for span in spans(text):
        reference = REFERENCE.fullmatch(span)
        if reference or span.startswith(":"):
            path = find(reference[1]) if reference else last
            if path is None or not names(path, reference[2] if reference else span[1:]):
                broken.append(span)
        elif FILE.fullmatch(span):
            last = find(span)
            if last is None:
                broken.append(span)
    return broken


def broken_tags(text):
    tests = "".join((ROOT / f).read_text(encoding="utf-8") for f in FILES
                    if f.name.endswith("_test.cpp"))
    wanted = {tag for span in spans(text) for tag in TAG.findall(span)}
    return sorted(tag for tag in wanted if tag not in tests)


def broken_keys(text):
    """Returns keys that are used but not defined, defined but not used, or defined twice."""
    defined = re.findall(r"^- \*\*([A-Z]\d+)\*\*", text, flags=re.M)
    used = set(KEY.findall(re.sub(r"\*\*[A-Z]\d+\*\*|`[^`]*`", "", prose(text))))
    twice = {key for key in defined if defined.count(key) > 1}
    return sorted(used.symmetric_difference(defined) | twice)


def test_names():
    """Returns the names of all Catch2 tests."""
    found = set()
    for file in FILES:
        if file.suffix == ".cpp":
            text = (ROOT / file).read_text(encoding="utf-8")
            for parts in re.findall(r'TEST_CASE\(\s*((?:"(?:[^"\\]|\\.)*"\s*)+)', text):
                name = "".join(re.findall(r'"((?:[^"\\]|\\.)*)"', parts))
                found.add(re.sub(r"\\(.)", r"\1", name))
    return found


def broken_quotes(text, known):
    """Yields the quoted names in a text, as "slip begins*", with which no test's name begins."""
    for quoted in re.findall(r'"([^"\n]{6,}\*)"', text):
        for name in re.split(r"(?<!\\),", quoted):
            start = re.sub(r"\\(.)", r"\1", name.strip().removesuffix("*"))
            if not any(test.startswith(start) for test in known):
                yield name


def anchors(page):
    """Returns the anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", prose(page.read_text(encoding="utf-8")), flags=re.M)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading) for heading in headings]
    return {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in plain}


def broken_links(text, folder):
    """Returns missing targets of [text](target) and [text]: target, and labels without a target. A target is a file, or
    a heading of a page (page.md#heading)."""
    text = re.sub(r"`[^`\n]*`", "", prose(text))
    labels = dict(re.findall(r"^\[([^\]]+)\]: (\S+)$", text, flags=re.M))
    wanted = re.findall(r"\[[^\]]+\]\[([^\]]+)\]", text) + re.findall(r"\[([^\]]+)\]\[\]", text)
    targets = re.findall(r"\]\(([^)\s]+)\)", text) + list(labels.values())
    broken = [label for label in wanted if label not in labels]
    for target in targets:
        if re.match(r"[a-z]+:|#", target):
            continue
        file, _, heading = target.partition("#")
        if not (folder / file).exists() or (heading and file.endswith(".md") and heading not in anchors(folder / file)):
            broken.append(target)
    return broken


class Documents(unittest.TestCase):
    def test_links_in_the_documents_lead_to_existing_files(self):
        pages = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md",
                 *sorted((ROOT / "docs").rglob("*.md"))]
        self.assertGreater(len(pages), 8)
        for page in pages:
            text = page.read_text(encoding="utf-8")
            self.assertEqual(broken_links(text, page.parent), [], page)


class Programs(unittest.TestCase):
    def test_quoted_test_names_are_those_of_tests(self):
        known = test_names()
        self.assertGreater(len(known), 900)
        for file in FILES:
            if file.suffix == ".md":
                with self.subTest(file=str(file)):
                    self.assertEqual(list(broken_quotes((ROOT / file).read_text(encoding="utf-8"), known)), [])

    def test_code_on_pages_equals_its_source(self):
        """Each block of C or C++ on a page must be consecutive lines of a source."""
        sources = [path.read_text(encoding="utf-8")
                   for folder in ("scenes", "tests/scenes/embed")
                   for path in (ROOT / folder).rglob("*.c*")]
        shown = 0
        for page in [ROOT / "README.md", ROOT / "docs" / "embed.md"]:
            for block in re.findall(r"^```c(?:pp)?\n(.*?)^```$", page.read_text(encoding="utf-8"),
                                    flags=re.S | re.M):
                shown += 1
                self.assertTrue(any(block in source for source in sources),
                                f"{page.name} has a block of code that is in no source:\n{block}")
        self.assertGreater(shown, 8)

    def test_the_session_page_equals_its_script(self):
        """Compares all cells of the script, except its title."""
        script = (ROOT / "scenes" / "bindings" / "python" / "session.py").read_text(encoding="utf-8")
        page = (ROOT / "docs" / "notebook.md").read_text(encoding="utf-8")
        cells = re.findall(r"^# %% (.*)\n((?:(?!# %%).*\n)*)", script, flags=re.M)
        self.assertGreater(len(cells), 4)
        self.assertEqual(re.findall(r"^## (.*)$", page, flags=re.M), [title for title, _ in cells])
        self.assertEqual(re.findall(r"^```python\n(.*?)^```$", page, flags=re.S | re.M),
                         [cell.strip("\n") + "\n" for _, cell in cells])


class Paper(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.text = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")

    def rows(self, heading):
        """Returns the first cells of the tables of a section."""
        section = re.search(rf"^## {heading}$(.*?)(?=^## |\Z)", self.text, flags=re.S | re.M)[1]
        return re.findall(r"^\| \(?(\d+)\)? \|", section, flags=re.M)

    def test_tests_and_names_on_the_page_about_the_paper_exist(self):
        self.assertGreater(sum(1 for span in spans(self.text) if REFERENCE.fullmatch(span)), 80)
        self.assertEqual(broken_references(self.text), [])
        self.assertEqual(broken_tags(self.text), [])
        self.assertEqual(broken_keys(self.text), [])

    def test_the_page_about_the_paper_lists_every_equation_and_figure(self):
        self.assertEqual(self.rows("Equations"), [str(i) for i in range(1, 16)])
        self.assertEqual(self.rows("Figures"), [str(i) for i in range(1, 8)])

    def test_all_rows_of_a_table_have_the_same_number_of_cells(self):
        """GitHub drops cells beyond the header's number."""
        for table in re.findall(r"(?:^\|.*\n)+", prose(self.text), flags=re.M):
            cells = [len(row.split("|")) for row in table.splitlines()]
            self.assertEqual(set(cells), {cells[0]}, table)


class Checker(unittest.TestCase):
    """Tests that the checks find errors."""

    def test_the_checker_finds_references_to_missing_names(self):
        right = "`solver.h:solveProxy` `engine/balance/solver.h:solveProxy` `engine/balance/solver.cpp`"
        self.assertEqual(broken_references(right), [])
        for wrong in ("`solver.h:solveProx`", "`solve.h:solveProxy`", "`devices/solver.h:Vec3`",
                      "`engine/solve.cpp`", "`CMakeLists.txt:palpate_tests`", "`:solveProxy`",
                      "`paper_test.cpp:fig. 5`", "`docs_test.py:spans_of`"):
            self.assertEqual(len(broken_references(wrong)), 1, wrong)
        below = "`tests/engine/paper_test.cpp`\n- `:fig. 5: a plane balances the spring by a force "
        self.assertEqual(broken_references(below + "within\n  its strength`"), [])
        self.assertEqual(broken_references(below + "beyond it`"),
                         [":fig. 5: a plane balances the spring by a force beyond it"])

    def test_the_checker_finds_unknown_tags_and_keys(self):
        self.assertEqual(broken_tags("`[eq9]` `[eq99]`"), ["[eq99]"])
        self.assertEqual(broken_keys("A1 A2 `B1`\n- **A1** this\n- **A3** that\n"), ["A2", "A3"])

    def test_the_checker_finds_quotes_of_missing_tests(self):
        known = {"a ball, rolling, stops", "slip begins at mu"}
        self.assertEqual(list(broken_quotes('the test "slip begins*" and "slip ends*"', known)), ["slip ends*"])
        self.assertEqual(list(broken_quotes('`"a ball\\, rolling*,slip*,a cube*"`', known)), ["a cube*"])

    def test_the_checker_finds_broken_links(self):
        text = ("[a](paper.md#symbols) [a](paper.md#nothing) [b](nowhere.md) [c](https://example.org) [d][e] [f][]\n"
                "```\n[g](no.md)\n```\n[f]: ../README.md\n")
        self.assertEqual(broken_links(text, ROOT / "docs"), ["e", "paper.md#nothing", "nowhere.md"])


if __name__ == "__main__":
    suite.main(sys.argv[2:])
