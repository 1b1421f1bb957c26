#!/usr/bin/env python3
"""What a run of all tests took: minutes.py MINUTES LOG...

MINUTES: lines of seconds, step and note (.ci/minutes). LOG: what ctest printed, in a folder of the
preset's name."""
import re
import sys
from pathlib import Path

TEST = re.compile(r"Test +#\d+: (.+?) \.+ *(?:\*+)?(\w+).* +([\d.]+) sec")


def main():
    print("== minutes")
    total = 0.0
    for line in Path(sys.argv[1]).read_text().splitlines():
        seconds, step, note = line.split("\t")
        total += float(seconds)
        print(f"{float(seconds) / 60:7.1f}  {step:24} {note}".rstrip())
    print(f"{total / 60:7.1f}  in all")
    tests = []
    for log in map(Path, sys.argv[2:]):
        preset = log.parent.name
        tests += [(float(seconds), preset, name)
                  for name, _, seconds in TEST.findall(log.read_text())]
    print("== the ten slowest tests, seconds")
    for seconds, preset, name in sorted(tests, reverse=True)[:10]:
        print(f"{seconds:7.1f}  {preset:8} {name}")


if __name__ == "__main__":
    main()
