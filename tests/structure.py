#!/usr/bin/env python3
"""Checks that no source includes a header of a higher folder and that no file or function is too long.

structure.py          checks; status 1 if an include is wrong, a file or function has more lines than LONGEST_FILE or
                      LONGEST_FUNCTION, or install.cmake or Doxyfile lacks a folder of public headers
structure.py sizes    prints files and lines of each folder, and the files and functions above these limits
"""
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Lowest folder first. A source may include headers of its own folder and of earlier ones, so there are no cycles.
ORDER = """
engine
engine/balance engine/field engine/modes engine/safety engine/scene engine/tick engine/loop
samplers
samplers/grid samplers/time samplers/bricks
devices/json devices/arm devices/recording devices/simulated devices/hid devices/plugins
devices
scenes/guess scenes/library scenes/apps/common scenes/network/sites scenes/network/slicer
scenes/bindings/c scenes/bindings/python scenes/apps/import scenes/apps/view scenes/apps/cli scenes/apps
scenes
""".split()
# Folders that must not include headers of each other.
APART = {"scenes/bindings/c", "scenes/bindings/python", "scenes/apps/import", "scenes/apps/view", "scenes/apps/cli"}
# Folders without a public header.
PRIVATE = APART - {"scenes/bindings/c"} | {"scenes/apps/common", "scenes/network/sites", "scenes/network/slicer"}
LONGEST_FILE = 600
LONGEST_FUNCTION = 80


def sources():
    names = subprocess.run(["git", "ls-files", "engine", "samplers", "devices", "scenes"], cwd=ROOT, text=True,
                           capture_output=True, check=True).stdout.split()
    return [name for name in names if name.endswith((".h", ".cpp"))]


def fault_of(source, header):
    """Returns the reason why a source must not include a header, or None. Both paths are relative to the root."""
    own, other = str(Path(source).parent), str(Path(header).parent)
    for folder in (own, other):
        if folder not in ORDER:
            return f"{folder} is not in ORDER of tests/structure.py: add it"
    if own == other:
        return None
    if ORDER.index(other) > ORDER.index(own):
        return f"{other} is above {own}"
    if own in APART and other in APART:
        return f"{own} and {other} must not include each other's headers"
    return None


def functions(text):
    """Yields (first line, number of lines) of each function body. Relies on clang-format's layout."""
    lines = text.splitlines()
    for opens, line in enumerate(lines):
        if not re.match(r"^ *\S.*[)a-z] \{$", line):
            continue
        # A signature can span lines, up to the one that closes its parentheses.
        first, signature = opens, line
        while signature.count(")") > signature.count("(") and first > 0 and not re.search(r"[;{}]", lines[first - 1]):
            first -= 1
            signature = lines[first] + signature
        if signature.count("(") != signature.count(")") or not re.match(r" {0,2}\S", signature) or \
                re.match(r" *(namespace|struct|class|enum|union|if|for|while|switch|else|do|try)\b", signature):
            continue
        indent = re.match(r" *", lines[first])[0]
        for last in range(opens + 1, len(lines)):
            if lines[last].startswith(indent + "}"):
                yield first + 1, last - first + 1
                break


def check():
    faults = []
    installed = (ROOT / "scenes" / "package" / "install.cmake").read_text(encoding="utf-8").split()
    documented = (ROOT / "docs" / "Doxyfile").read_text(encoding="utf-8").split()
    for source in sources():
        folder = str(Path(source).parent)
        if folder not in ORDER:
            faults.append(f"{source}: {folder} is not in ORDER of tests/structure.py: add it")
        if source.endswith(".h") and folder not in PRIVATE:
            for place, words in (("scenes/package/install.cmake", installed), ("docs/Doxyfile", documented)):
                if folder not in words and folder + ")" not in words:
                    faults.append(f"{source}: {place} does not name the folder {folder}")
        text = (ROOT / source).read_text(encoding="utf-8")
        for header in re.findall(r'^#include "palpate/([^"]+)"', text, re.M):
            if fault := fault_of(source, header):
                faults.append(f"{source} includes {header}: {fault}")
        faults += [f"{source}:{at}: the function has {n} lines: at most {LONGEST_FUNCTION} are allowed"
                   for at, n in functions(text) if n > LONGEST_FUNCTION]
        if (count := text.count("\n")) > LONGEST_FILE:
            faults.append(f"{source}: the file has {count} lines: at most {LONGEST_FILE} are allowed")
    print("\n".join(faults) or "structure: no include is of a higher folder, no file or function is too long")
    return 1 if faults else 0


def sizes():
    files, lines, long_files, long_functions = Counter(), Counter(), [], []
    for source in sources():
        text = (ROOT / source).read_text(encoding="utf-8")
        folder, count = str(Path(source).parent), text.count("\n")
        files[folder] += 1
        lines[folder] += count
        long_files.append((count, source))
        long_functions += [(n, f"{source}:{at}") for at, n in functions(text)]
    for folder in sorted(files, key=ORDER.index):
        print(f"{folder:26} {files[folder]:4} files {lines[folder]:7} lines")
    print(f"in all {sum(files.values())} files, {sum(lines.values())} lines")
    for what, limit, found in (("files", LONGEST_FILE, long_files), ("functions", LONGEST_FUNCTION, long_functions)):
        over = sorted((one for one in found if one[0] > limit), reverse=True)
        print(f"{len(over)} {what} over {limit} lines:")
        for count, name in over:
            print(f"  {count:5} {name}")
    return 0


if __name__ == "__main__":
    sys.exit(sizes() if sys.argv[1:] == ["sizes"] else check())
