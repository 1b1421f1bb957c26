#!/usr/bin/env python3
"""Reports what the gate (test.sh) ran, and remembers which sources it passed. A room is a top folder with its tests
(ROOMS).

gate.py changed             prints the rooms that differ from the last gate that passed on this machine
gate.py passed              remembers the rooms as they were when `changed` ran
gate.py report MINUTES BUDGETS FOLDER...
    MINUTES: the lines of .ci/minutes. BUDGETS: lines of a test and its seconds. FOLDER: build/PRESET/runs/NAME with
    CTest's LastTest.log, console.log and status of one run. Prints the minutes of each step, the slowest tests, the
    tests that exceeded their budgets and those that passed at their second try. Ends with "N passed, N failed[, N
    skipped]". Status 1: a test failed or is missing, or the gate took too long."""
import hashlib
import json
import os
import re
import sys
from pathlib import Path

from cpp_text import code_of

ROOT = Path(__file__).resolve().parent.parent
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "palpate" / "passed"
# The folders whose files decide whether a room has changed.
ROOMS = {"engine": ("engine", "bench/methods", "tests/engine", "tests/loop", "tests/motion"),
         "samplers": ("samplers", "tests/samplers"),
         "devices": ("devices", "tests/devices"),
         "scenes": ("scenes", "tests/scenes", "tests/import")}
# Limit of the processor time without compilers and clang-tidy [min]: 45 minutes on two cores.
BUDGET = 90
HOST_BUDGET = 240   # [s]; limit for all tests that depend on the scheduler
DEAREST = 10

SECTION = re.compile(r"^\d+/\d+ Test(?:ing)?: (.+)$")
CASE = re.compile(r"^(passed|failed|skipped) +([\d.]+) s  (.+)$")
PYTEST = re.compile(r"^\S+\.py::(\S+) (PASSED|FAILED|ERROR|SKIPPED)")
# CTest prints a second try without N/M, and after unexpected output the seconds on another line.
CONSOLE = re.compile(r"^ *(?:\d+/\d+ +)?Test +#\d+: (.+?) \.+ *(?:\*+)?([A-Z]\w+)(?:.* ([\d.]+) sec)?")
OWN_SECONDS = 10    # [s]; for a host test without a budget


def hash_of(room):
    """Returns the hash of a room's code. C++ comments, except NOLINT, have no effect."""
    total = hashlib.sha256()
    for folder in ROOMS[room]:
        for file in sorted((ROOT / folder).rglob("*")):
            if file.is_file() and "__pycache__" not in file.parts:
                code = file.read_bytes()
                if file.suffix in (".cpp", ".h"):
                    code = code_of(code)
                total.update(f"{file.relative_to(ROOT)} {hashlib.sha256(code).hexdigest()}\n".encode())
    return total.hexdigest()


def changed():
    """Returns the rooms that differ from the last gate that passed on this machine. Skips rooms that no gate has
    passed."""
    pending().parent.mkdir(parents=True, exist_ok=True)
    hashes = {room: hash_of(room) for room in ROOMS}
    pending().write_text(json.dumps(hashes))
    return [room for room in ROOMS if (CACHE / room).exists() and (CACHE / room).read_text() != hashes[room]]


def pending():
    return ROOT / "build" / "rooms.json"


def remember():
    CACHE.mkdir(parents=True, exist_ok=True)
    for room, text in json.loads(pending().read_text()).items():
        (CACHE / room).write_text(text)


def outcome(tried):
    """Returns the last result of several tries, but "failed" if a try failed and the last one did not pass."""
    return "failed" if "failed" in tried and tried[-1] != "passed" else tried[-1]


def results_of(folder):
    """Returns {(test, case): [(result, seconds) of each try]}, and {test: seconds}."""
    results, seconds, ended = {}, {}, {}
    test = None
    for line in (folder / "LastTest.log").read_text(errors="replace").splitlines():
        if match := SECTION.match(line):
            test = match[1]
        elif match := CASE.match(line):
            results.setdefault((test, match[3]), []).append((match[1], float(match[2])))
        elif match := PYTEST.match(line):
            word = {"PASSED": "passed", "SKIPPED": "skipped"}.get(match[2], "failed")
            results.setdefault((test, match[1]), []).append((word, 0.0))
    for line in (folder / "console.log").read_text(errors="replace").splitlines():
        if match := CONSOLE.match(line):
            test = match[1]
            seconds[test] = seconds.get(test, 0.0) + float(match[3] or 0)
            ended.setdefault(test, []).append({"Passed": "passed", "Skipped": "skipped"}.get(match[2], "failed"))
    listed = {test for test, _ in results}
    for test, words in ended.items():
        # A program without case lines counts as one case. So does a process that crashed between cases.
        own = [outcome([word for word, _ in tries]) for (of, _), tries in results.items() if of == test]
        if test not in listed or (words[-1] == "failed" and "failed" not in own):
            results[(test, "")] = [(word, seconds[test]) for word in words]
    return results, seconds


def missing_cases(folder, results):
    """Yields a line for each Catch2 process that reported another number of cases than it has."""
    for file in folder.parents[1].rglob("*_tests.cmake.counts"):
        for line in file.read_text().splitlines():
            count, test = line.split(" ", 1)
            cases = [case for of, case in results if of == test and case]
            if cases and len(cases) != int(count):
                yield f"{test} reports {len(cases)} of its {count} cases"


def report(minutes, budgets, folders):
    bad = []
    print("== minutes, and minutes of processor time")
    total = processors = compiling = alone = 0.0
    for line in minutes.read_text().splitlines():
        took, cpu, step, note = line.split("\t")
        total += float(took)
        processors += float(cpu)
        if step.endswith(": build") or step == "lint":
            compiling += float(cpu)
        if ": host" in step:
            alone += float(took)
        print(f"{float(took) / 60:7.1f} {float(cpu) / 60:7.1f}  {step:24} {note}".rstrip())
    print(f"{total / 60:7.1f} {processors / 60:7.1f}  in all; {(processors - compiling) / 60:.1f} minutes of processor time without compilers and lint")
    if (processors - compiling) / 60 > BUDGET and not os.environ.get("PALPATE_LONG"):
        bad.append(f"the gate took more than {BUDGET} minutes of processor time: see above which step or test grew")

    count = {"passed": 0, "failed": 0, "skipped": 0}
    dearest, failed, again = [], [], []
    allowed = dict(line.rsplit(" ", 1) for line in budgets.read_text().splitlines())
    for folder in folders:
        results, seconds = results_of(folder)
        name = f"{folder.parts[-3]}/{folder.name}"
        bad += [f"{name}: {words}" for words in missing_cases(folder, results)]
        status = (folder / "status").read_text().strip()
        if status != "0" and not any(outcome([word for word, _ in tries]) == "failed" for tries in results.values()):
            bad.append(f"{name}: ctest ended with status {status}: see {folder}/console.log")
        dearest += [(took, name, test) for test, took in seconds.items()]
        for (test, case), tries in results.items():
            words = f"{name}: {test} {case}".rstrip()
            tried = [word for word, _ in tries]
            last = outcome(tried)
            count[last] += 1
            if last == "failed":
                failed.append(words)
            elif "failed" in tried:
                again.append(f"{words}: {', then '.join(tried)}")
            if last == "skipped" and os.environ.get("PALPATE_DATA") and not case:
                bad.append(f"{words} was skipped, although --data was given")
        if "host" in folder.name:
            for test, took in seconds.items():
                if took > float(allowed.get(test, OWN_SECONDS)):
                    print(f"over its budget: {test} took {took:.0f} s of {allowed.get(test, OWN_SECONDS)}")
    print(f"== the {DEAREST} slowest tests, seconds")
    for took, name, test in sorted(dearest, reverse=True)[:DEAREST]:
        print(f"{took:7.1f}  {name:14} {test}")
    print(f"tests that depend on how the machine schedules: {alone:.0f} s of {HOST_BUDGET}" + (": over their budget" if alone > HOST_BUDGET else ""))
    for words in again:
        print(f"passed at its second try: {words}")
    for words in failed:
        print(f"failed: {words}")
    for words in bad:
        print(f"gate: {words}")
    bad_count = count["failed"] + len(bad)
    print(f"{count['passed']} passed, {bad_count} failed" + (f", {count['skipped']} skipped" if count["skipped"] else ""))
    return 1 if bad_count else 0


def main():
    verb, *rest = sys.argv[1:]
    if verb == "changed":
        print(*changed())
        return 0
    if verb == "passed":
        remember()
        return 0
    minutes, budgets, *folders = map(Path, rest)
    return report(minutes, budgets, folders)


if __name__ == "__main__":
    sys.exit(main())
