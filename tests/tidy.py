#!/usr/bin/env python3
"""clang-tidy over sources that have not passed it as they are: tidy.py [--all] BUILD SOURCE...

BUILD has a compile_commands.json. A source has passed as it is when a stamp says so: a file named
by a hash of clang-tidy's version, its configuration, this file, the compile command, and the bytes
of every file that the source includes, the system's among them. Stamps lie in the user's cache
folder, as ccache's objects do, so that a fresh clone knows what another has passed. --all ignores
the stamps, and runs the slow checks too.

Most of the time goes into headers, which clang-tidy 14 reads and matches anew for every source. So
sources with the same flags are asked several in one unit; those of a unit with complaints, also
where they do not compile side by side, are asked again, each alone, and only that counts."""
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

ROOT = Path(__file__).resolve().parent.parent
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "palpate" / "tidy"
KEPT = 90 * 86400   # seconds that a stamp nobody asks for is kept
# These take most of the time, so that only --all checks them. One looks for copied arguments, the analyzer follows
# paths, the others look at every expression of every header.
SLOW = ("performance-unnecessary-value-param", "clang-analyzer-*", "bugprone-assert-side-effect",
        "bugprone-implicit-widening-of-multiplication-result", "bugprone-infinite-loop",
        "bugprone-multiple-statement-macro", "bugprone-sizeof-expression", "bugprone-suspicious-semicolon", "bugprone-suspicious-string-compare",
        "bugprone-unused-raii", "bugprone-unused-return-value", "modernize-use-nullptr", "modernize-use-using",
        "readability-container-size-empty", "readability-redundant-control-flow", "readability-redundant-declaration")
# With --all the analyzer does not follow calls deep into OpenVDB's templates.
TIDY = ["clang-tidy", "-quiet", "--extra-arg=-Wno-unknown-warning-option",
        "--extra-arg=-Wno-unused-command-line-argument",
        "--extra-arg=-Wno-ignored-optimization-argument",
        *(f"--extra-arg={a}" for a in ("-Xclang", "-analyzer-config", "-Xclang", "mode=shallow"))]
TOGETHER = 8        # sources of a unit at most: more take more memory, and end less evenly


def output_of(command):
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


VERSION = output_of(["clang-tidy", "--version"])
# Debian gives it no name without its number.
SCANNER = "clang-scan-deps-" + re.search(r"version (\d+)", VERSION)[1]


def included(build):
    """For each source, every file that it is made of: by clang's own scanner, in seconds."""
    rules = output_of([SCANNER, "-j", str(os.cpu_count()),
                       f"--compilation-database={build / 'compile_commands.json'}"])
    files = {}
    for rule in rules.replace("\\\n", " ").splitlines():
        source, *rest = (str(Path(f).resolve()) for f in rule.partition(": ")[2].split())
        # A source that several targets compile is made of what any of them reads.
        files.setdefault(source, set()).update([source, *rest])
    return files


class Stamps:
    def __init__(self, build):
        self.files = included(build)
        self.hashes = {}
        # The same in every clone.
        self.here = lambda text: text.replace(str(build), "build").replace(str(ROOT), ".")
        self.entries = {}
        for entry in json.loads((build / "compile_commands.json").read_text()):
            file = str(Path(entry["file"]).resolve())
            self.entries.setdefault(file, []).append(entry["command"])
        self.commands = {file: [self.here(c) for c in commands]
                         for file, commands in self.entries.items()}
        self.common = "\n".join([VERSION, Path(__file__).read_text(),
                                 (ROOT / ".clang-tidy").read_text()])

    def hash_of(self, file):
        if file not in self.hashes:
            self.hashes[file] = hashlib.sha256(Path(file).read_bytes()).hexdigest()
        return self.hashes[file]

    def stamp(self, source):
        """None where no target compiles it here, so that nobody knows what it is made of."""
        if source not in self.files or source not in self.commands:
            return None
        parts = [self.common, *sorted(self.commands[source])]
        # By the names that are the same in every clone: one may lie before /usr, another behind it.
        parts += sorted(f"{self.here(file)} {self.hash_of(file)}" for file in self.files[source])
        return CACHE / hashlib.sha256("\n".join(parts).encode()).hexdigest()


def tidy(build, source, every):
    """Whether it has passed, and what clang-tidy has to say."""
    checks = [] if every else ["-checks=" + ",".join("-" + check for check in SLOW)]
    run = subprocess.run([*TIDY, *checks, f"--config-file={ROOT / '.clang-tidy'}", "-p", str(build), source], stdout=subprocess.PIPE,
                         stderr=subprocess.PIPE, text=True, check=False)
    words = run.stdout + run.stderr
    return run.returncode == 0, words or f"{source}: clang-tidy ended with {run.returncode}"


def own_names(text):
    """What a source defines for itself, roughly: what two of them may both define."""
    names = {"main"} if re.search(r"^int main\(", text, re.M) else set()
    for inside in re.findall(r"^namespace \{\n(.*?)^\}  // namespace$", text, re.M | re.S):
        # What is not indented is at the namespace's own level.
        for line in re.findall(r"^[A-Za-z].*", inside, re.M):
            names.update(re.findall(r"\b(?:struct|class|enum class) (\w+)", line))
            if not re.match(r"using (namespace |\w+::)", line):
                names.update(re.findall(r"\b(\w+)(?=\(| =|\{|\[|;)", line)[:1])
    return names


def using(source):
    """Its using-declarations: whether one of them is used is heard only where no other source of
    the unit has it."""
    return set(re.findall(r"^ *using [\w:]+::\w+;", Path(source).read_text(), re.M))


def unit_of(sources):
    """One text of them all: what they include first, so that a name which several of them define
    can be told apart where it is their own. Pasted, not included: the analyzer, and some checks,
    look at the main file's own text only; and renamed there, not by the preprocessor, behind which
    names are not looked at."""
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
    """Shares sources out into units."""
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
    """Sources that are compiled alike, several to a unit: [(file, sources)]."""
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
    """For each source of a unit, whether it has passed, and what clang-tidy has to say."""
    file, sources = unit
    if len(sources) > 1:
        if tidy(build / "units", file, every)[0]:
            return [(source, True, "") for source in sources]
    return [(source, *tidy(build, source, every)) for source in sources]


def main():
    arguments = sys.argv[1:]
    every = "--all" in arguments
    build, *sources = [Path(a).resolve() for a in arguments if a != "--all"]
    stamps = Stamps(build)
    CACHE.mkdir(parents=True, exist_ok=True)
    for old in CACHE.iterdir():
        # Another clone may remove them as well.
        with contextlib.suppress(FileNotFoundError):
            if time.time() - old.stat().st_mtime > KEPT:
                old.unlink()
    left = {}
    for source in map(str, sources):
        stamp = stamps.stamp(source)
        if stamp is not None and stamp.exists() and not every:
            stamp.touch()
        else:
            left[source] = stamp
    bad = 0
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        asked = pool.map(lambda unit: ask(build, unit, every), units(stamps, build, left))
        for source, passed, words in (answer for answers in asked for answer in answers):
            if not passed:
                bad += 1
                print(words, file=sys.stderr)
            elif left[source] is not None:
                left[source].touch()
    print(f"tidy: {len(sources)} sources, {len(sources) - len(left)} of them passed before as they "
          f"are, {bad} with complaints")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
