#!/usr/bin/env python3
"""Runs clang-tidy on sources that have not passed unchanged before: tidy.py [--all] [--most N] BUILD SOURCE...

BUILD has a compile_commands.json. A source or header has passed unchanged if it has a stamp: a file named by a hash of
clang-tidy's version and options, the compile command, and the file's own code without comments, except NOLINT.
clang-tidy reports a complaint about a header with any source that includes the header. So a changed header is checked
with one source that includes it, not with all. Only --all finds a complaint that a changed header causes in an
unchanged source. Stamps are in the user's cache folder, as ccache's objects are, so that all clones share them. --all
ignores the stamps and runs the slow checks too. With --most N at most N sources are checked, and the next run
continues. So a run stays short on a machine without stamps, and after a change of flags.

clang-tidy 14 spends most of its time on headers, which it reads and matches again for every source. So several sources
with the same flags are checked in one unit. If a unit has complaints, or does not compile, each of its sources is
checked again alone, and only those results count."""
import argparse
import collections
import concurrent.futures
import contextlib
import hashlib
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

from cpp_text import code_of

ROOT = Path(__file__).resolve().parent.parent
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "palpate" / "tidy"
KEPT = 90 * 86400   # [s]; an unused stamp is removed after this time
# These checks take most of the time, so only --all runs them.
SLOW = ("performance-unnecessary-value-param", "clang-analyzer-*", "bugprone-assert-side-effect",
        "bugprone-implicit-widening-of-multiplication-result", "bugprone-infinite-loop",
        "bugprone-multiple-statement-macro", "bugprone-sizeof-expression", "bugprone-suspicious-semicolon", "bugprone-suspicious-string-compare",
        "bugprone-unused-raii", "bugprone-unused-return-value", "modernize-use-nullptr", "modernize-use-using",
        "readability-container-size-empty", "readability-redundant-control-flow", "readability-redundant-declaration")
# With --all, the analyzer does not follow calls deep into OpenVDB's templates.
TIDY = ["clang-tidy", "-quiet", "--extra-arg=-Wno-unknown-warning-option",
        "--extra-arg=-Wno-unused-command-line-argument",
        "--extra-arg=-Wno-ignored-optimization-argument",
        *(f"--extra-arg={a}" for a in ("-Xclang", "-analyzer-config", "-Xclang", "mode=shallow"))]
TOGETHER = 8        # largest number of sources in a unit; larger units need more memory and make the load uneven


def output_of(command):
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


VERSION = output_of(["clang-tidy", "--version"])
# Debian's name of the program has the version number.
SCANNER = "clang-scan-deps-" + re.search(r"version (\d+)", VERSION)[1]


def included(build):
    """Returns, for each source, the project's headers that it includes, from clang's scanner. Takes seconds."""
    rules = output_of([SCANNER, "-j", str(os.cpu_count()),
                       f"--compilation-database={build / 'compile_commands.json'}"])
    headers = {}
    for rule in rules.replace("\\\n", " ").splitlines():
        source, *rest = (str(Path(f).resolve()) for f in rule.partition(": ")[2].split())
        # A source of several targets depends on the headers that any of these targets includes.
        headers.setdefault(source, set()).update(
            file for file in rest if file.startswith(f"{ROOT}/") and not file.startswith(f"{build}/") and file != source)
    return headers


class Stamps:
    def __init__(self, build):
        self.headers = included(build)
        # Replaces the folders in paths, so that paths are equal in all clones.
        self.here = lambda text: text.replace(str(build), "build").replace(str(ROOT), ".")
        self.entries = {}
        for entry in json.loads((build / "compile_commands.json").read_text()):
            file = str(Path(entry["file"]).resolve())
            self.entries.setdefault(file, []).append(entry["command"])
        self.common = "\n".join([VERSION, *TIDY, *SLOW, (ROOT / ".clang-tidy").read_text()])

    def stamp(self, file):
        """Returns the stamp of a source or header."""
        commands = sorted(map(self.here, self.entries.get(file, [])))
        parts = [self.common, self.here(file), *commands, hashlib.sha256(code_of(Path(file).read_bytes())).hexdigest()]
        return CACHE / hashlib.sha256("\n".join(parts).encode()).hexdigest()

    def passed(self, file):
        stamp = self.stamp(file)
        if stamp.exists():
            stamp.touch()
            return True
        return False

    def to_check(self, sources, every):
        """Returns the sources without a stamp, and sources that include all headers without a stamp. Picks those by
        the number of remaining headers."""
        chosen = [source for source in sources if every or not self.passed(source)]
        within = {source: self.headers.get(source, set()) for source in sources}
        left = {header for header in set().union(*within.values()) if not self.passed(header)}
        left -= set().union(*(within[source] for source in chosen))
        while left:
            best = max(sources, key=lambda source: len(within[source] & left))
            chosen.append(best)
            left -= within[best]
        return chosen


def tidy(build, source, every):
    """Runs clang-tidy. Returns True if the source passed, and the output."""
    checks = [] if every else ["-checks=" + ",".join("-" + check for check in SLOW)]
    run = subprocess.run([*TIDY, *checks, f"--config-file={ROOT / '.clang-tidy'}", "-p", str(build), source], stdout=subprocess.PIPE,
                         stderr=subprocess.PIPE, text=True, check=False)
    words = run.stdout + run.stderr
    return run.returncode == 0, words or f"{source}: clang-tidy ended with {run.returncode}"


def own_names(text):
    """Returns names, approximately, that a source defines only for itself, which other sources could also define."""
    names = {"main"} if re.search(r"^int main\(", text, re.M) else set()
    for inside in re.findall(r"^namespace \{\n(.*?)^\}  // namespace$", text, re.M | re.S):
        # Lines without indentation are at namespace level.
        for line in re.findall(r"^[A-Za-z].*", inside, re.M):
            names.update(re.findall(r"\b(?:struct|class|enum class) (\w+)", line))
            if not re.match(r"using (namespace |\w+::)", line):
                names.update(re.findall(r"\b(\w+)(?=\(| =|\{|\[|;)", line)[:1])
    return names


def using(source):
    """Returns a source's using-declarations. In a unit, clang-tidy reports an unused one only if no other source has
    the same."""
    return set(re.findall(r"^ *using [\w:]+::\w+;", Path(source).read_text(), re.M))


def unit_of(sources):
    """Returns one text of all sources: their includes, then their contents, with names that several sources define
    made distinct. The contents are pasted, because the analyzer and some checks read only the main file. Names are
    replaced in the text, because checks skip names from macros."""
    texts = {source: Path(source).read_text() for source in sources}
    headers = dict.fromkeys(h for t in texts.values() for h in re.findall(r"^#include .*", t, re.M))
    lines = [*headers]
    seen = collections.Counter()
    for text in texts.values():
        own = own_names(text)
        for name in sorted(own):
            if seen[name]:
                text = re.sub(rf"\b{name}\b", name + chr(ord("A") + seen[name]), text)
        lines.append(text)
        seen.update(own)
    return "\n".join(lines) + "\n"


def together(sources):
    """Distributes sources over units. Sources with an equal using-declaration get different units."""
    parts = [[] for _ in range(-(-len(sources) // TOGETHER))]
    for source in sources:
        mine = using(source)
        fits = [part for part in parts if len(part) < TOGETHER and
                not any(mine & using(other) for other in part)]
        if fits:
            min(fits, key=len).append(source)
        else:
            parts.append([source])
    return parts


def units(stamps, build, sources):
    """Groups sources of equal flags into units: [(file, sources)]."""
    alike = collections.defaultdict(list)
    for source in sources:
        commands = stamps.entries.get(source, [])
        one = len(commands) == 1
        flags = re.sub(r" -o \S+ -c \S+$", "", commands[0]) if one else None
        alike[flags if one else source].append(source)
    folder = build / "units"
    folder.mkdir(exist_ok=True)
    found, commands = [], []
    for flags, group in alike.items():
        for part in together(group):
            file = folder / f"unit{len(found)}.cpp"
            if len(part) > 1:
                file.write_text(unit_of(part))
                commands.append({"directory": str(build), "file": str(file),
                                 "command": f"{flags} -c {file}"})
            found.append((str(file), part))
    (folder / "compile_commands.json").write_text(json.dumps(commands))
    return found


def ask(build, unit, every):
    """Returns, for each source of a unit, whether it passed, and clang-tidy's output."""
    file, sources = unit
    if len(sources) > 1:
        if tidy(build / "units", file, every)[0]:
            return [(source, True, "") for source in sources]
    return [(source, *tidy(build, source, every)) for source in sources]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--all", action="store_true")
    parser.add_argument("--most", type=int)
    parser.add_argument("build", type=Path)
    parser.add_argument("sources", type=Path, nargs="+")
    options = parser.parse_args()
    every, build = options.all, options.build.resolve()
    sources = [source.resolve() for source in options.sources]
    stamps = Stamps(build)
    CACHE.mkdir(parents=True, exist_ok=True)
    for old in CACHE.iterdir():
        # Another clone may remove stamps at the same time.
        with contextlib.suppress(FileNotFoundError):
            if time.time() - old.stat().st_mtime > KEPT:
                old.unlink()
    sources = [str(source) for source in sources]
    chosen = stamps.to_check(sources, every)
    now = chosen[:options.most]
    bad = 0
    passed_now = set()
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        asked = pool.map(lambda unit: ask(build, unit, every), units(stamps, build, now))
        for source, passed, words in (answer for answers in asked for answer in answers):
            if passed:
                passed_now.add(source)
            else:
                bad += 1
                print(words, file=sys.stderr)
    # A source that no target of this build compiles was not checked with its own flags, so it gets no stamp.
    known = {source for source in passed_now if source in stamps.entries}
    complained = set().union(*(stamps.headers.get(source, set()) for source in set(now) - passed_now))
    for file in known.union(*(stamps.headers.get(source, set()) for source in known)) - complained:
        stamps.stamp(file).touch()
    print(f"tidy: {len(sources)} sources, {len(now)} of them checked, {bad} with complaints, "
          f"{len(chosen) - len(now)} left for the next run")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
