#!/usr/bin/env python3
"""Plants faults of one line, one at a time, and prints which tests detect them. Run this before a release.

tests/mutate.json has the faults. The script copies the sources, uncommitted changes included, and builds the copy
in the folder of --build; it changes no source in this tree. First, all selected tests must pass without a fault. Then
the script plants each fault, builds the tests of the fault, and runs them over a tenth of the random cases. If all
pass, it runs them over all cases. A test that fails, crashes or hangs has detected the fault. The exit status is 1 if
fewer than 97 % are detected, if an undetected fault has no reason in the file, or if a fault does not build."""
import argparse
import collections
import hashlib
import html
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FAULTS = Path(__file__).resolve().with_suffix(".json")
ENOUGH = 97.0   # required share of detected faults [%]
KEYS = {"name", "file", "before", "after", "means", "runs", "preset", "lives"}
FEW, USUAL = "10%", "100%"   # shares of the random cases
# Programs that tests outside Catch2 need.
PARTS = {"safety.kill_table": ["palpate_victim"],
         "scenes.igtl": ["palpate"],
         "scenes.explain_press": ["palpate", "palpate_make_volumes"]}

# Build folders of Catch2 programs that are not directly in tests/.
FOLDERS = {"haply": "tests/devices/haply"}


def fail(words):
    sys.exit(f"mutate: {words}")


def read_faults():
    """Returns the faults. Each `before` must occur exactly once in its file."""
    faults = json.loads(FAULTS.read_text())
    bad = []
    names = collections.Counter(fault["name"] for fault in faults)
    for fault in faults:
        here = fault["name"]
        missing = {"name", "file", "before", "after", "means", "runs"} - set(fault)
        if missing or set(fault) - KEYS:
            bad.append(f"{here}: its keys are not {', '.join(sorted(KEYS))}")
            continue
        if names[here] > 1:
            bad.append(f"{here}: several faults have this name")
        file = ROOT / fault["file"]
        count = file.read_text().count(fault["before"]) if file.is_file() else 0
        if count != 1:
            bad.append(f"{here}: {fault['file']} contains this text {count} times, not once: {fault['before']}")
        if fault["before"] == fault["after"] or "\n" in fault["before"]:
            bad.append(f"{here}: \"before\" equals \"after\" or has several lines")
    if bad:
        fail("\n  ".join([f"{FAULTS.relative_to(ROOT)} does not fit the sources: correct it", *bad]))
    return faults


def digest(*parts):
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def shown(command, **more):
    """Runs a command. Returns true if it succeeded, and its output."""
    run = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                         check=False, **more)
    return run.returncode == 0, run.stdout


class Tree:
    """The copy of the sources, with its builds."""

    def __init__(self, folder, jobs):
        self.path = folder / "tree"
        self.jobs = jobs
        self.log = folder / "test.log"
        self.configured = set()
        names = subprocess.run(["git", "-C", ROOT, "ls-files", "-co", "--exclude-standard", "-z"],
                               check=True, stdout=subprocess.PIPE, text=True).stdout
        hashes = []
        for name in sorted(filter(None, names.split("\0"))):
            source, to = ROOT / name, self.path / name
            if not source.is_file():
                continue
            content = source.read_bytes()
            if source != FAULTS:
                hashes.append(name + hashlib.sha256(content).hexdigest())
            # An unchanged file keeps its time stamp, so that it is not built again.
            if not to.is_file() or to.read_bytes() != content:
                to.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(source, to)
            shutil.copymode(source, to)
        self.hash = digest(*hashes)

    def build(self, preset, runs):
        """Returns the error of a build that fails; "" if it succeeds."""
        if preset not in self.configured:
            good, words = shown(["cmake", "--preset", preset, "-DPALPATE_TESTS=ON"], cwd=self.path)
            if not good:
                fail(words)
            self.configured.add(preset)
        targets = []
        for run in runs:
            program = run.split()[0]
            targets += PARTS.get(program, [f"palpate_{program}_tests"])
        good, words = shown(["ninja", "-C", f"build/{preset}", f"-j{self.jobs}",
                             *dict.fromkeys(targets)], cwd=self.path)
        return "" if good else words

    def test(self, preset, run, cases, limit):
        """Returns the name of the failing test, or a sanitizer's summary; after "hangs: " if the tests took longer than
        `limit` [s]. Returns None if all tests pass."""
        program, _, spec = run.partition(" ")
        build = self.path / "build" / preset
        if program in PARTS:
            command = ["ctest", "--no-tests=error", "-R", f"^{re.escape(program)}$"]
        else:
            # Tests that depend on the scheduler run only on request, and tests of external data do not run. The XML
            # report has the name of the failing test even if the program crashes.
            command = [f"{FOLDERS.get(program, 'tests')}/palpate_{program}_tests",
                       spec if "[host]" in spec else f"{spec}~[host]~[.]", "--abort",
                       "--reporter", "xml"]
        with open(self.log, "wb") as log:
            child = subprocess.Popen(command, cwd=build, stdout=log, stderr=subprocess.STDOUT,
                                     start_new_session=True,
                                     env={**os.environ, "PALPATE_CASES": cases})
            try:
                status = child.wait(limit)
            except subprocess.TimeoutExpired:
                status = None
            finally:
                if child.poll() is None:
                    os.killpg(child.pid, signal.SIGKILL)
                    child.wait()
        words = self.log.read_text(errors="replace")
        tests = re.findall(r'<TestCase name="([^"]*)"', words)
        if "No tests were found" in words or (status in (0, 2) and program not in PARTS and not tests):
            fail(f"\"{run}\" matches no test")
        if status == 0:
            return None
        sanitizer = re.search(r"SUMMARY: (\w+Sanitizer: [\w -]+?)(?: [/(]|$)", words, re.MULTILINE)
        name = html.unescape(tests[-1]) if tests else program
        # With a sanitizer the program can continue after the failing test, so the last test is not always the failing
        # one.
        name = sanitizer[1] if sanitizer else name
        return f"hangs: {name}" if status is None else name


class Results:
    """The results so far. They are saved after every fault, so that a run can resume."""

    def __init__(self, file, resume):
        self.file = file
        self.known = {"base": {}, "faults": {}}
        if resume and file.is_file():
            self.known = json.loads(file.read_text())

    def save(self):
        new = self.file.with_suffix(".new")
        new.write_text(json.dumps(self.known, indent=1) + "\n")
        new.replace(self.file)

    def base(self, tree_hash, preset, run):
        """Returns the time of the tests without a fault [s], or None."""
        known = self.known["base"].get(f"{preset} {run}", {})
        return known.get("seconds") if known.get("tree") == tree_hash else None

    def add_base(self, tree_hash, preset, run, seconds):
        self.known["base"][f"{preset} {run}"] = {"tree": tree_hash, "seconds": seconds}
        self.save()

    def verdict(self, tree_hash, key, name):
        """Returns the known verdict. "Detected" holds while the fault's key is the same. An undetected fault is tried
        again after each change of the sources, because there may be a new test."""
        known = self.known["faults"].get(name, {})
        same = known.get("key") == key
        return known if same and (known["verdict"] == "died" or known["tree"] == tree_hash) else None

    def add(self, name, verdict):
        self.known["faults"][name] = verdict
        self.save()


def try_fault(tree, fault, preset, seconds):
    file = tree.path / fault["file"]
    sound = (ROOT / fault["file"]).read_text()
    file.write_text(sound.replace(fault["before"], fault["after"]))
    try:
        words = tree.build(preset, fault["runs"])
        if words:
            return "unbuilt", words.strip().splitlines()[-1]
        for cases in (FEW, USUAL):
            for run in fault["runs"]:
                # The limit allows for other programs on the cores.
                seen = tree.test(preset, run, cases, 60.0 + 5.0 * seconds[preset, run])
                if seen:
                    return "died", f"{run.split()[0]}: {seen}"
        return "lived", ""
    finally:
        file.write_text(sound)


def print_table(faults, verdicts):
    rooms = {}
    for fault in faults:
        count = rooms.setdefault(fault["file"].split("/")[0], collections.Counter())
        count[verdicts[fault["name"]]["verdict"]] += 1
    print(f"\n{'room':10} {'planted':>8} {'died':>6} {'lived':>6}")
    for room, count in rooms.items():
        print(f"{room:10} {count['died'] + count['lived']:8} {count['died']:6} {count['lived']:6}")
    total = sum(rooms.values(), collections.Counter())
    planted = total["died"] + total["lived"]
    share = 100.0 * total["died"] / max(planted, 1)
    print(f"{'all':10} {planted:8} {total['died']:6} {total['lived']:6}   {share:.1f} % died")
    bad = share < ENOUGH or planted == 0
    for fault in faults:
        verdict = verdicts[fault["name"]]["verdict"]
        if verdict == "lived":
            print(f"lived: {fault['name']}: {fault.get('lives', 'no test sees it: write one')}")
            bad = bad or "lives" not in fault
        elif verdict == "unbuilt":
            print(f"unbuilt: {fault['name']}: the sources do not build with this fault: correct it")
            bad = True
        elif "lives" in fault:
            print(f"{fault['name']} died: remove its \"lives\"")
    return 1 if bad else 0


def main():
    asked = argparse.ArgumentParser(description=__doc__,
                                    formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--list", action="store_true", help="print the faults, and what each means")
    asked.add_argument("--check", action="store_true",
                       help="only check that every \"before\" is exactly once in its file")
    asked.add_argument("--only", metavar="REGEX", default="", help="only faults whose name or file matches REGEX")
    asked.add_argument("--preset", default="release", help="preset of faults that name none (default: release)")
    asked.add_argument("--jobs", type=int, default=os.cpu_count(), help="number of parallel jobs of the build")
    asked.add_argument("--build", type=Path, default=ROOT / "build" / "mutate",
                       help="folder for the copy, 2 GB, and the results (build/mutate)")
    asked.add_argument("--resume", action="store_true",
                       help="continue with the results of an earlier run there")
    args = asked.parse_args()
    faults = read_faults()
    if args.check:
        print(f"mutate: {len(faults)} faults, each in its place")
        return 0
    only = re.compile(args.only)
    faults = [f for f in faults if only.search(f["name"]) or only.search(f["file"])]
    if not faults:
        fail(f"no fault has a name or file like {args.only}")
    if args.list:
        for f in faults:
            print(f"{f['name']}: {f['means']}\n  {f['file']}: {f['before']}\n  -> {f['after']}\n"
                  f"  {', '.join(f['runs'])}")
        return 0

    args.build.mkdir(parents=True, exist_ok=True)
    tree = Tree(args.build.resolve(), args.jobs)
    results = Results(args.build / "results.json", args.resume)
    verdicts = {}
    for fault in faults:
        key = digest(fault["file"], fault["before"], fault["after"],
                     (ROOT / fault["file"]).read_text())
        fault["key"] = key
        known = results.verdict(tree.hash, key, fault["name"])
        if known:
            verdicts[fault["name"]] = known
    left = [f for f in faults if f["name"] not in verdicts]

    wanted = {}   # runs, by preset
    for fault in left:
        wanted.setdefault(fault.get("preset", args.preset), {}).update(dict.fromkeys(fault["runs"]))
    seconds = {}
    for preset, runs in wanted.items():
        words = tree.build(preset, runs)
        if words:
            fail(f"without a fault {preset} does not build:\n{words}")
        for run in runs:
            took = results.base(tree.hash, preset, run)
            if took is None:
                for cases in (FEW, USUAL):
                    since = time.monotonic()
                    seen = tree.test(preset, run, cases, 1800.0)
                    if seen:
                        fail(f"without a fault {run} fails: {seen}: see {tree.log}")
                    took = time.monotonic() - since
                results.add_base(tree.hash, preset, run, took)
            seconds[preset, run] = took
            print(f"passes  {took:6.0f} s  {run}", flush=True)
    for fault in faults:
        name = fault["name"]
        if name not in verdicts:
            since = time.monotonic()
            verdict, by = try_fault(tree, fault, fault.get("preset", args.preset), seconds)
            verdicts[name] = {"verdict": verdict, "by": by, "key": fault["key"], "tree": tree.hash,
                              "seconds": round(time.monotonic() - since, 1)}
            results.add(name, verdicts[name])
        told = verdicts[name]
        print(f"{told['verdict']:7} {told['seconds']:6.0f} s  {name:32} {told['by']}", flush=True)
    return print_table(faults, verdicts)


if __name__ == "__main__":
    sys.exit(main())
