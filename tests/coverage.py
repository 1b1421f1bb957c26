#!/usr/bin/env python3
"""Lists the functions that the sanitizers' tests do not reach, but other tests reach.

    cmake --preset coverage && cmake --build build/coverage
    tests/coverage.py run build/coverage OUT [SUITE...]    runs the Catch2 tests and the Python suites (default: all)
    tests/coverage.py report build/coverage OUT            prints, for each file, the functions that only the Python
                                                           suites and the Catch2 cases with [release] reach, and
                                                           which tests would reach these

The script reads gcov's counters from .gcda files, a folder for each test. A function has run if one of its
arcs has run. Names come from the .gcno files of the build. A process that ends by a signal or by _exit() writes no
counters."""
import collections
import os
import re
import struct
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FUNCTION, COUNTERS = 0x01000000, 0x01A10000
SUITES = {"scenes/cli_test.py": ("volumes",), "scenes/record_test.py": ("volumes",),
          "scenes/explain_press_test.py": ("volumes",), "scenes/bricks_test.py": ("volumes",),
          "scenes/sequence_test.py": (), "scenes/http_test.py": ("relay",), "scenes/rados_test.py": (),
          "scenes/plot_test.py": ("volumes",), "scenes/picture_test.py": ("volumes",), "scenes/igtl_test.py": ("--host",),
          "import/dicom_test.py": (), "import/images_test.py": (), "import/models_test.py": (),
          "import/slices_test.py": (), "import/zarr_test.py": (), "import/play_test.py": (), "import/slabs_test.py": (),
          "import/import_test.py": ("series",), "scenes/sites_test.py": ("relay", "Edits")}


def records_of(file):
    """Yields the records of a .gcda or .gcno file: tag, bytes, length."""
    data = file.read_bytes()
    order = "<" if data[:4] in (b"adcg", b"oncg") else ">"
    at = 12 if data[:4] == b"adcg" else None
    if at is None:   # .gcno: magic, version, stamp, checksum, working directory, unexecuted blocks
        at = 16
        length = struct.unpack_from(order + "I", data, at)[0]
        at += 4 + length + 4
    else:
        at = 16      # magic, version, stamp, checksum
    while at + 8 <= len(data):
        tag, length = struct.unpack_from(order + "Ii", data, at)
        at += 8
        if tag == 0:
            break
        yield tag, data[at:at + max(0, length)], length
        at += max(0, length)


def functions_run(file):
    """Yields the ids of the functions in a .gcda file that have run."""
    ident = None
    for tag, data, length in records_of(file):
        if tag == FUNCTION:
            ident = struct.unpack_from("<I", data)[0] if len(data) >= 4 else None
        elif tag == COUNTERS and ident is not None and length > 0 and any(data):
            yield ident


def names_in(file):
    """Returns the functions of a .gcno file: {id: (source, name)}."""
    names = {}
    for tag, data, _ in records_of(file):
        if tag != FUNCTION:
            continue
        ident = struct.unpack_from("<I", data)[0]
        at = 12

        def text(at):
            length = struct.unpack_from("<I", data, at)[0]
            return data[at + 4:at + 4 + length].rstrip(b"\0").decode(errors="replace"), at + 4 + length

        name, at = text(at)
        at += 4        # artificial
        source, at = text(at)
        # Headers are included as palpate/ROOM/NAME.h, but are in the folder ROOM.
        names[ident] = (source.rpartition("/include/palpate/")[2].removeprefix("./"), name)
    return names


def reached(folder, known):
    """Returns the functions that one test's programs ran: {(source, name)}."""
    found = set()
    for file in folder.rglob("*.gcda"):
        key = file.name.removesuffix(".gcda")
        path = str(file).split("/build/coverage/", 1)[-1].removesuffix(".gcda")
        names = known.get(path) or known.get(key)
        if names:
            found.update(names[ident] for ident in functions_run(file) if ident in names)
    return found


def cases_of(program, tags):
    """Returns the names of a Catch2 program's cases with these tags, escaped for its command line."""
    done = subprocess.run([program, "--list-test-names-only", tags], capture_output=True, text=True, check=False)
    return [re.sub(r"[\\,\[\]]", r"\\\g<0>", line) for line in done.stdout.splitlines() if line]


def run(build, out, suites):
    build, out = build.resolve(), out.resolve()
    environment = dict(os.environ, PALPATE_CASES="1%", PALPATE_COVERAGE=str(out), PALPATE_ROOM="scenes")
    if not suites or "catch2" in suites:
        inside = dict(environment, GCOV_PREFIX=str(out / "sanitized" / "all"))
        subprocess.run(["ctest", "--test-dir", build, "-j2", "-R", "_tests|hostile|samplers.data|headsq", "-LE", "host"],
                       env=inside, check=False)
        for program in sorted((build / "tests").rglob("palpate_*_tests")):
            for case in cases_of(program, "[release]"):
                subprocess.run([program, case], check=False,
                               env=dict(environment, GCOV_PREFIX=str(out / "release" / case.replace("/", " "))))
    words = {"volumes": build / "tests/palpate_make_volumes", "relay": build / "tests/palpate_relay",
             "series": build / "tests/palpate_import_make_series"}
    for suite, arguments in SUITES.items():
        if suites and suite not in suites:
            continue
        subprocess.run(["/usr/bin/python3", ROOT / "tests" / suite, build / "bin", *(words.get(a, a) for a in arguments)],
                       env=environment, check=False)


def is_smoke():
    """Returns the tests that are marked for sanitizers in their sources: {file: {Class.test}}."""
    marked = collections.defaultdict(set)
    for suite in SUITES:
        name, mark = None, False
        for line in (ROOT / "tests" / suite).read_text().splitlines():
            if line.startswith("class "):
                name = line[6:].split("(")[0].split(":")[0]
            elif line.strip() == "@suite.smoke":
                mark = True
            elif mark and line.strip().startswith("def "):
                marked[Path(suite).stem].add(f"{name}.{line.strip()[4:].split('(')[0]}")
                mark = False
    return marked


def report(build, out):
    known = {}
    for file in build.rglob("*.gcno"):
        known[str(file).split("/build/coverage/", 1)[-1].removesuffix(".gcno")] = names_in(file)
    smoke = is_smoke()
    sanitized, others = set(), {}
    for suite in sorted(out.iterdir()):
        for test in sorted(suite.iterdir()):
            functions = reached(test, known)
            if suite.name == "sanitized" or test.name in smoke[suite.name] or (
                    test.name == "fixtures" and smoke[suite.name]):
                sanitized |= functions
            else:
                others[f"{suite.name} {test.name}"] = functions
    rooms = ("engine/", "samplers/", "devices/", "scenes/")

    def ours(functions):
        return {(s, n) for s, n in functions if s.startswith(rooms)}

    lost = ours(set().union(*others.values()) if others else set()) - sanitized
    print(f"{len(ours(sanitized))} functions run with sanitizers, {len(lost)} only without")
    by_file = collections.defaultdict(list)
    for source, name in lost:
        by_file[source].append(name)
    for source in sorted(by_file):
        print(f"{source}: {len(by_file[source])}")
        done = subprocess.run(["c++filt"], input="\n".join(sorted(by_file[source])), capture_output=True, text=True, check=True)
        for name in done.stdout.splitlines():
            print(f"    {name[:150]}")
    print("tests that would reach them:")
    left = set(lost)
    while left:
        best = max(others, key=lambda test: len(others[test] & left))
        more = others[best] & left
        if not more:
            break
        print(f"{len(more):5}  {best}")
        left -= more


if __name__ == "__main__":
    verb, build_folder, out_folder, *rest = sys.argv[1:]
    if verb == "run":
        run(Path(build_folder), Path(out_folder), rest)
    else:
        report(Path(build_folder).resolve(), Path(out_folder).resolve())
