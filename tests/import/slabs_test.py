#!/usr/bin/env python3
"""Tests that `palpate import --bricks` imports a large image in bounded memory: slabs_test.py BIN_DIR."""
import gzip
import json
import os
import resource
import struct
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import suite  # noqa: E402

PALPATE = str(Path(sys.argv[1]).resolve() / "palpate")
SIZE = (520, 520, 320)   # 5 layers of bricks, each a slab of its own: 87 MB of bytes
LIMIT = 345 << 20        # address space [bytes]; enough for the program's libraries and slabs, not for the whole image


def limited():
    """Limits the address space, and the threads, whose stacks and arenas count too."""
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:2])
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT, LIMIT))


def nifti():
    """Returns a NIfTI of bytes. Its values move along j from slice to slice, so they cross the borders of slabs."""
    header = bytearray(352)
    struct.pack_into("<i", header, 0, 348)
    struct.pack_into("<8h", header, 40, 3, *SIZE, 1, 1, 1, 1)
    struct.pack_into("<hh", header, 70, 2, 8)
    struct.pack_into("<4f", header, 76, 1, 0.5, 0.5, 1)
    struct.pack_into("<f", header, 108, 352)
    header[344:348] = b"n+1\0"
    row = bytes(32) + bytes(1 + i % 97 for i in range(SIZE[0] - 64)) + bytes(32)
    plane = bytes(SIZE[0] * 80) + row * (SIZE[1] - 160) + bytes(SIZE[0] * 80)
    shifts = (SIZE[0] * (abs(k - 90) // 3) for k in range(SIZE[2]))
    return bytes(header) + b"".join(plane[shift:] + plane[:shift] for shift in shifts)


def files_in(folder):
    return {str(one.relative_to(folder)): one.read_bytes() for one in sorted(folder.rglob("*")) if one.is_file()}


def bricks(file, out, status=0, **more):
    done = subprocess.run([PALPATE, "import", str(file), str(out), "--bricks", "--json"], capture_output=True,
                          text=True, timeout=300, check=False, **more)
    if status is not None and done.returncode != status:
        raise AssertionError(f"{file}: status {done.returncode}, not {status}: {done.stderr}")
    return done


class Slabs(unittest.TestCase):
    def test_an_image_that_only_fits_into_the_memory_limit_as_slabs_gives_the_bricks_of_the_whole_image(self):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            # A gzipped file with the same name is read whole, so it needs more than LIMIT.
            for part in ("plain", "packed"):
                (folder / part).mkdir()
            contents = nifti()
            (folder / "plain/image.nii").write_bytes(contents)
            (folder / "packed/image.nii").write_bytes(gzip.compress(contents, 1))
            del contents
            refused = bricks(folder / "packed/image.nii", folder / "refused", status=None, preexec_fn=limited)
            self.assertNotEqual(refused.returncode, 0)
            self.assertFalse((folder / "refused/palpate.bricks").exists())

            slabs = json.loads(bricks(folder / "plain/image.nii", folder / "slabs", preexec_fn=limited).stdout)
            whole = json.loads(bricks(folder / "packed/image.nii", folder / "whole").stdout)
            self.assertEqual(slabs["grids"], whole["grids"])
            mine, theirs = files_in(folder / "slabs"), files_in(folder / "whole")
            self.assertIn("palpate.bricks", mine)
            self.assertEqual(sorted(mine), sorted(theirs))
            self.assertEqual([name for name in mine if mine[name] != theirs[name]], [])


if __name__ == "__main__":
    suite.main(sys.argv[2:])
