#!/usr/bin/env python3
"""Finds prose that a reader may not understand, in comments and pages.

prose.py          prints each folder whose rate is above LIMIT, with status 1; prints the common rate if there is none
prose.py PATH...  prints each hit of these files or folders

A hit is a hint, because a sentence with a hit may be correct. So each folder has a rate, and there is no list of
exceptions."""
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("engine", "samplers", "devices", "scenes", "tests", "bench", "docs")
LIMIT = 2.0     # hits per 100 lines of prose
LONGEST = 30    # words of a sentence; we aim at 25
RULES = {
    "nobody": re.compile(r"\b(some|any|no|every)(body|one)\b|\bwhoever\b", re.I),
    "what-clause": re.compile(r"(?:^|[.;:] )What(?! (is|are|does|do|did|was)\b[^.]*\?)\b"),
    "archaic": re.compile(r"\b(anew|hither|thither|whence|thence|thereof|therein|whereof|albeit|betwixt)\b", re.I),
    "of-that": re.compile(r"\b(that|those) of (which|whose|what|that)\b"),
    "riddle": re.compile(r"\b(says? nothing|is none|are none|is nothing|comes to nothing|goes for nothing)\b"),
}
COMMENT = {".h": re.compile(r"(?<![:\"'/])//[/!]?<? ?(.*)$"), ".py": re.compile(r"(?:^|\s)# (.*)$")}
COMMENT[".cpp"] = COMMENT[".h"]


def prose_of(file):
    """Yields (line number, text) of each line of prose in a file."""
    text = (ROOT / file).read_text(encoding="utf-8", errors="replace")
    fenced = False
    for number, line in enumerate(text.splitlines(), 1):
        if file.endswith(".md"):
            fenced ^= line.startswith("```")
            if not fenced and line[:1] not in ("|", "#", "`", "<", "") and not line.startswith("    "):
                yield number, re.sub(r"`[^`]*`|\]\([^)]*\)", "`", line)
        elif (match := COMMENT[Path(file).suffix].search(line)) and match[1].strip():
            yield number, re.sub(r"`[^`]*`", "`", match[1])


def hits_of(file):
    """Returns the number of lines of prose, and the hits: (line number, rule, text)."""
    lines, hits, sentence = 0, [], []
    before = 0
    for number, text in prose_of(file):
        lines += 1
        hits += [(number, rule, text) for rule, pattern in RULES.items() if pattern.search(text)]
        if number != before + 1:
            sentence = []
        before = number
        for word in text.split():
            sentence.append(word)
            if len(sentence) == LONGEST + 1:
                hits.append((number, "long", text))
            if word[-1] in ".:;!?|" or word.endswith((".)", ".*")):
                sentence = []
    return lines, hits


def files_in(paths):
    names = subprocess.run(["git", "ls-files", *paths], cwd=ROOT, text=True, capture_output=True,
                           check=True).stdout.splitlines()
    return [name for name in names if Path(name).suffix in (*COMMENT, ".md")]


def main(paths):
    if paths:
        for file in files_in(paths):
            for number, rule, text in hits_of(file)[1]:
                print(f"{file}:{number}: {rule}: {text.strip()[:100]}")
        return 0
    lines, hits = Counter(), Counter()
    for file in files_in([*FOLDERS, "README.md", "CONTRIBUTING.md"]):
        folder = file.split("/")[0] if "/" in file else "docs"
        count, found = hits_of(file)
        lines[folder] += count
        hits[folder] += len(found)
    over = [folder for folder in lines if hits[folder] > LIMIT / 100 * lines[folder] + 1]
    for folder in over:
        print(f"prose: {folder}: {100 * hits[folder] / lines[folder]:.1f} hits per 100 lines, more than {LIMIT}: "
              f"tests/prose.py {folder}")
    if not over:
        rate = 100 * sum(hits.values()) / sum(lines.values())
        print(f"prose: {rate:.2f} hits per 100 of {sum(lines.values())} lines")
    return 1 if over else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
