"""Runs `palpate`. sys.argv[1] is the folder of the programs."""
import sys
from pathlib import Path

import process

PALPATE = str(Path(sys.argv[1]).resolve() / "palpate")


def run(*words, status=0, **more):
    done = process.run([PALPATE, *map(str, words)], capture_output=True, text=True, timeout=300, **more)
    if status is not None and done.returncode != status:
        raise AssertionError(f"{words}: status {done.returncode}, not {status}: {done.stderr}")
    return done
