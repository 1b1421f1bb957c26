#!/usr/bin/env python3
"""Measures how much faster an import is with several ranks of one core each than with one rank.

mpi_import.py PROGRAM [EDGE [RANKS]]

Imports a smooth image with noise, of EDGE^3 16-bit values (default 512), as bricks: with one rank and with RANKS
(default 2), in turn, three times each, with `mpirun --bind-to core`. Repeats all with `--smooth 2`. Prints the times,
and the peak memory that the last run reports. The times are invalid if other programs use the cores, so check the load
first."""
import array
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def image(file, edge):
    """Writes a ball of shells with noise. 41 % of the voxels differ from the background."""
    noise = random.Random(1)
    squares = [(4.0 * n / edge - 2.0) ** 2 for n in range(edge)]
    with file.open("wb") as out:
        for k in range(edge):
            speckle = array.array("h", noise.randbytes(2 * edge))
            plane = array.array("h")
            for j in range(edge):
                rest = squares[j] + squares[k]
                shift = noise.randrange(edge)
                row = [0 if rest + s > 3.4 else
                       1000 + int(400 * (rest + s)) + (speckle[(i + shift) % edge] & 31)
                       for i, s in enumerate(squares)]
                plane.extend(row)
            plane.tofile(out)


def main():
    program = str(Path(sys.argv[1]).resolve())
    edge = int(sys.argv[2]) if len(sys.argv) > 2 else 512
    ranks = int(sys.argv[3]) if len(sys.argv) > 3 else 2
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        image(folder / "image.raw", edge)
        layout = json.dumps({"size": [edge] * 3, "type": "int16"})
        print(f"{edge}^3 values of 16 bits; load {os.getloadavg()[0]:.1f} before")
        for more in ([], ["--smooth", "2"]):
            times = {1: [], ranks: []}
            memory = {}
            for _ in range(3):
                for count, each in times.items():
                    out = folder / "out"
                    begin = time.monotonic()
                    done = subprocess.run(
                        ["mpirun", "--allow-run-as-root", "--bind-to", "core", "-n", str(count),
                         program, str(folder / "image.raw"), str(out), "--bricks", "--raw", layout,
                         "--json", *more], check=True, capture_output=True, text=True)
                    each.append(time.monotonic() - begin)
                    memory[count] = json.loads(done.stdout)["memory"]["peak"] / 1e6
                    shutil.rmtree(out)
            print(" ".join(more) or "as it is")
            for count, each in times.items():
                print(f"  {count} rank{'s' if count > 1 else ''}: "
                      f"{', '.join(f'{t:.1f}' for t in each)} s; {memory[count]:.0f} MB a rank")
            print(f"  {min(times[1]) / min(times[ranks]):.2f} times, by the best of each")


if __name__ == "__main__":
    main()
