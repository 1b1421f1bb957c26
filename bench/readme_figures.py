#!/usr/bin/env python3
"""Measures the figures of README.md again: readme_figures.py BUILD_DIR [--write README.md].

Builds the programs and runs the command of each figure. Prints the table, with commit and machine, and the changed
cells. With --write, writes the table between the two marks of the page instead. The results stay in
BUILD_DIR/readme_figures/, so the figures can be measured in parts (--only 2,8, then --only 3), and --resume continues
an interrupted run. Only figures of one commit and one machine are written. Times are valid only on a machine without
other load."""
import argparse
import datetime
import json
import os
import re
import shlex
import subprocess
import sys
import textwrap
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BEGIN = "<!-- figures: begin -->"
END = "<!-- figures: end -->"
WIDTH = 120
MISSING = "not measured yet"


class Unmeasured(Exception):
    """Raised if a command failed or did not print its figure, or if the page or an option is not suitable."""


def find(pattern, text):
    """Returns the groups of the first match of a pattern in a program's output. White space of any length
    counts as one space, because Catch2 may break the lines of its output."""
    found = re.search(pattern, " ".join(text.split()))
    if found is None:
        raise Unmeasured(f"its output has no \"{pattern}\"")
    return found.groups()


def two(x):
    """Formats with two significant digits."""
    return f"{float(f'{float(x):.2g}'):g}"


def microseconds(quantiles, scale=1.0):
    return ", ".join(two(scale * float(x)) for x in quantiles) + " us"


def parsed(text):
    try:
        return json.loads(text)
    except json.JSONDecodeError as e:
        raise Unmeasured("its output is not JSON") from e


# Functions that extract the cells of a figure's rows from the output of the figure's command.

def weak_planes(text):
    eq2, ours = find(r"\b1e-09 \| (\S+) \| (\S+) \|", text)
    force = re.sub(r"e([+-])0", r"e\1", f"{float(ours):.0e}")
    return [f"{force} N (eq. 2: {float(eq2):.1f} N)"]


def proved(text):
    most, = find(r"\b10000000 problems, .* failures 0;.* worst (\d+), above 25", text)
    return [f"none; {most} solves at most"]


def balances(text):
    try:
        medians = [r["cost_ns"]["median"] for r in parsed(text)["results"]
                   if r["method"] == "palpate, warm" and r["setting"] == "1e-6"
                   and r["family"].startswith("walk") and r["primitives"] == 8]
    except (KeyError, TypeError) as e:
        raise Unmeasured(f"its result has no {e}") from e
    if len(medians) != 2:
        raise Unmeasured(f"its result has {len(medians)} walks among 8 primitives, and not 2")
    return [f"{two(1e-3 * min(medians))} to {two(1e-3 * max(medians))} us"]


def ticks(text):
    warm = find(r"\ball \d+ (\d+) (\d+) (\d+) \d+", text)
    find(r"their busy neighbour: own\b", text)
    cold = find(r"\b1 kHz, asleep \d+ (\S+) (\S+) (\S+)", text)
    return [microseconds(warm, 1e-3), microseconds(cold)]


def pressed(text):
    degrees, = find(r"pressed along 1000 directions: force direction (\S+) degrees rms", text)
    return [f"{two(degrees)} degrees rms"]


def crossed(text):
    return list(find(r"\bcrossed: (\d+) of 30000 strokes", text))


def placements(text):
    try:
        row, = (r for r in parsed(text)["number"] if r["placements"] == 10000)
        return [f"{row['p50_ratio']['median']:.2f} times, "
                f"{row['p999_ratio']['median']:.2f} at p99.9"]
    except (KeyError, TypeError, ValueError) as e:
        raise Unmeasured("its result has no 10,000 placements") from e


def whatever(text):
    find(r"\bticks 100000000, with force \d+, .*All tests passed", text)
    return ["none"]


def killed(text):
    ways = dict(re.findall(r"(\w+) +\| +([\d.]+) ms", text))
    if len(ways) != 15:
        raise Unmeasured(f"its table has {len(ways)} ways, and not 15")
    return [f"at most {-int(-max(map(float, ways.values())) // 1)} ms"]


def counted(text):
    find(r"\bpassed [\d.]+ s the tick does not allocate, lock or throw", text)
    find(r"\bscenes\.head \.+ Passed", text)
    find(r"100% tests passed", text)
    return ["0, 0, 0"]


COMMANDS = {
    1: ('palpate_engine_tests "[paper]"', weak_planes),
    2: ('PALPATE_CASES=10000000 palpate_engine_tests "[balance]"', proved),
    3: ("palpate_bench_speed_accuracy", balances),
    4: ("palpate_bench_tick out/head.json --cold 60", ticks),
    5: ('palpate_samplers_tests "[press]"', pressed),
    6: ('palpate_motion_tests "a solid of 1.5 voxels*"', crossed),
    7: ("palpate_bench_scale --only number", placements),
    8: ('PALPATE_CASES=100000000 palpate_loop_tests "under random events*"', whatever),
    9: ("ctest --preset release --no-tests=error -R safety.kill_table -V", killed),
    10: ("ctest --preset release --no-tests=error -V -L realtime", counted),
}
ROWS = [
    ("three weak planes within 10 to 60 degrees of one axis, 1e-9 N each: force", 1),
    ("ten million random sets of 1 to 32 primitives: not proved to 1e-6 S/k, or rounding", 2),
    ("one balance along a hand's motion at 1e-6 S/k, 8 primitives: medians", 3),
    ("one whole tick of the head scene, back to back: median, p99, p99.9", 4),
    ("the same at 1 kHz, asleep in between, on a core that others keep busy", 4),
    ("level-set sphere of 60 voxels pressed along 1,000 directions: force direction", 5),
    ("walls of 1.5 voxels at 2 m/s, 1,000 directions, at 0, 45 and 72 degrees: crossed", 6),
    ("ten thousand volumes, two at the hand: a tick beside that of the two alone", 7),
    ("10^8 ticks of random scenes, swaps, faults: force above peak or slew, or after a fault", 8),
    ("a program that is killed, stopped or hangs, 15 ways: zero force at the device after", 9),
    ("allocations, locks, exceptions in a tick", 10),
]


def part(head, cells):
    """Returns the text between the marks: the table, its commands, and where the figures were measured."""
    lines = [*textwrap.wrap(head, WIDTH, break_on_hyphens=False), "",
             "| what | figure | by |", "|---|---|---|"]
    left = {number: list(of) for number, of in cells.items()}
    lines += [f"| {what} | {left[number].pop(0)} | {number} |" for what, number in ROWS]
    lines += ["", "```sh"]
    lines += [f"{command:<73} # {number}" for number, (command, _) in COMMANDS.items()]
    return "\n".join([*lines, "```"])


class Page:
    """A page with a table between its marks."""

    def __init__(self, path):
        self.path = path
        try:
            text = path.read_text(encoding="utf-8")
            self.above, rest = text.split(f"{BEGIN}\n\n")
            self.part, self.below = rest.split(f"\n\n{END}")
        except OSError as e:
            raise Unmeasured(f"{path}: {e.strerror}") from e
        except ValueError as e:
            raise Unmeasured(f"{path}: no {BEGIN} ... {END}") from e
        self.head = " ".join(self.part.split("\n\n|")[0].split())
        self.cells = {number: [] for number in COMMANDS}
        shown = dict(re.findall(r"^\| (.*) \| (.*) \| \d+ \|$", self.part, flags=re.M))
        for what, number in ROWS:
            self.cells[number].append(shown.get(what, MISSING))

    def write(self, head, cells):
        """Writes the whole page, or leaves it unchanged."""
        new = self.path.with_name(self.path.name + ".new")
        new.write_text(f"{self.above}{BEGIN}\n\n{part(head, cells)}\n\n{END}{self.below}",
                       encoding="utf-8")
        os.replace(new, self.path)


class Build:
    """The programs of one commit, and their measured figures."""

    def __init__(self, folder, data):
        self.folder = folder.resolve()
        self.kept = self.folder / "readme_figures"
        self.data = data
        self.env = {k: v for k, v in os.environ.items() if k != "PALPATE_CASES"}
        self.env["PATH"] = f"{self.folder}/bin:{self.folder}/tests:{self.env['PATH']}"
        print("building", flush=True)
        self.run(f"cmake -DPALPATE_BENCH_ALL=ON {shlex.quote(str(self.folder))}")
        self.run(f"cmake --build {shlex.quote(str(self.folder))}")
        version = self.run("palpate --version")
        self.commit, compiler = find(r"^palpate \S+ \((\w+\+?)\) ([^;]+);", version)
        self.machine = f"{machine()}, {compiler}"
        self.results = {}
        if (self.kept / "results.json").exists():
            self.results = json.loads((self.kept / "results.json").read_text(encoding="utf-8"))

    def run(self, command, output=None):
        """Runs a command and returns its standard output. The file `output` gets standard output and standard error."""
        done = subprocess.run(command, shell=True, cwd=ROOT, env=self.env, stdout=subprocess.PIPE,
                              stderr=subprocess.PIPE, text=True, errors="replace", check=False)
        if output is not None:
            output.write_text(done.stdout + done.stderr, encoding="utf-8")
        if done.returncode != 0:
            said = (done.stderr.strip() or done.stdout.strip() or "nothing").splitlines()[-1]
            raise Unmeasured(f"{command} ended with {done.returncode}: {said}" +
                             (f" ({output})" if output else ""))
        return done.stdout

    def measured(self, number):
        """Returns the cells measured with this build on this machine, or None."""
        result = self.results.get(str(number))
        if result is None or (result["commit"], result["machine"]) != (self.commit, self.machine):
            return None
        return result["cells"]

    def measure(self, number):
        command, cells = COMMANDS[number]
        print(f"{number}: {command}", flush=True)
        command = command.replace("--preset release", f"--test-dir {shlex.quote(str(self.folder))}")
        command = command.replace("out/head.json", shlex.quote(str(self.data / "head.json")))
        since = time.monotonic()
        self.kept.mkdir(exist_ok=True)
        output = self.kept / f"{number}.txt"
        try:
            got = cells(self.run(command, output))
        except Unmeasured as e:
            raise Unmeasured(f"figure {number}: {e}" +
                             ("" if str(output) in str(e) else f" ({output})")) from e
        seconds = time.monotonic() - since
        print(f"   {'; '.join(got)}, in {seconds:.0f} s", flush=True)
        self.results[str(number)] = {"cells": got, "commit": self.commit, "machine": self.machine,
                                     "date": datetime.date.today().isoformat(),
                                     "seconds": round(seconds, 1)}
        (self.kept / "results.json").write_text(json.dumps(self.results, indent=1) + "\n",
                                                encoding="utf-8")

    def head(self):
        dates = sorted({result["date"] for result in self.results.values()})
        when = dates[0] if len(dates) == 1 else f"{dates[0]} to {dates[-1]}"
        return (f"Measured at commit {self.commit} on {self.machine}, {when}. The column "
                "*by* gives the number of the command under the table.")


def machine():
    text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    name = re.search(r"^model name\s*: (.*)$", text, flags=re.M)
    virtual = ", a virtual machine" if re.search(r"^flags.*\bhypervisor\b", text, flags=re.M) else ""
    return f"{os.cpu_count()} cores of {name[1].strip() if name else 'a processor'}{virtual}"


def numbers(text):
    wanted = [int(n) for n in text.split(",")]
    if not set(wanted) <= set(COMMANDS):
        raise argparse.ArgumentTypeError(f"figures are 1 to {len(COMMANDS)}")
    return wanted


def measure(arguments):
    page = Page(arguments.write or ROOT / "README.md")
    if 4 in arguments.only and not (arguments.data / "head.json").exists():
        raise Unmeasured(f"{arguments.data}/head.json: no file; run ./demo.sh, or give --data")
    build = Build(arguments.build, arguments.data)
    if arguments.write and build.commit.endswith("+"):
        raise Unmeasured(f"{build.commit} is not a commit: commit the changes, or remove --write")
    for number in arguments.only:
        if not arguments.resume or build.measured(number) is None:
            build.measure(number)
    cells = {number: build.measured(number) for number in COMMANDS}
    missing = [str(number) for number in COMMANDS if cells[number] is None]
    if arguments.write:
        if missing:
            raise Unmeasured(f"figures {', '.join(missing)} are not measured at commit {build.commit}"
                             ": give --resume without --only")
        page.write(build.head(), cells)
        print(f"{arguments.write}: written")
        return
    shown = {number: of or [MISSING] * len(page.cells[number]) for number, of in cells.items()}
    print("\n" + part(build.head(), shown) + "\n")
    for number, of in cells.items():
        for before, after in zip(page.cells[number], of or []):
            if before != after:
                print(f"{number}: {before} -> {after}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0],
                                     epilog=__doc__.split("\n\n", maxsplit=1)[1])
    parser.add_argument("build", type=Path, help="as build/release")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="README.md")
    parser.add_argument("--only", type=numbers, metavar="N,N", default=list(COMMANDS),
                        help="measures these alone")
    parser.add_argument("--resume", action="store_true",
                        help="measures what this build has not yet")
    parser.add_argument("--data", type=Path, metavar="DIR", default=ROOT / "out",
                        help="has head.json and its volumes, as ./demo.sh leaves them in out/")
    arguments = parser.parse_args()
    arguments.data = arguments.data.resolve()
    try:
        measure(arguments)
    except Unmeasured as e:
        sys.exit(f"readme_figures: {e}")


if __name__ == "__main__":
    main()
