#!/usr/bin/env python3
"""Tests `mpirun palpate-import --bricks` through its command line: mpi_import_test.py PROGRAM.

All ranks run on this machine and use its memory and loopback.
"""
import array
import fcntl
import gzip
import json
import math
import os
import random
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import unittest
import zlib
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import pictures  # noqa: E402
import suite  # noqa: E402

IMPORT = str(Path(sys.argv[1]).resolve())
MPIRUN = shutil.which("mpirun")
PATIENCE = 60  # [s]
HERE = ["--oversubscribe", "--mca", "btl", "self,vader",
        "--mca", "btl_vader_single_copy_mechanism", "none",
        "--mca", "odls_base_sigkill_timeout", "0", "--mca", "btl_tcp_if_include", "lo"]
# Open MPI 5 refuses the loopback interface in this option.
if MPIRUN and "(Open MPI) 4" in subprocess.run([MPIRUN, "--version"], capture_output=True, text=True, check=False).stdout:
    HERE += ["--mca", "oob_tcp_if_include", "lo"]
os.environ.update(OMPI_ALLOW_RUN_AS_ROOT="1", OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1",
                  OMPI_MCA_rmaps_base_oversubscribe="1")


def command(ranks, *words):
    """Returns the command line. 0 ranks: a process without mpirun."""
    begin = [MPIRUN, *HERE, "-n", str(ranks)] if ranks else []
    return [*begin, IMPORT, *map(str, words)]


def run(ranks, *words, status=0):
    done = subprocess.run(command(ranks, *words), capture_output=True, text=True, timeout=PATIENCE)
    if status is not None and done.returncode != status:
        raise AssertionError(f"{ranks} {words}: {done.returncode}, not {status}: {done.stderr}")
    return done


def lines_of(done):
    """Returns palpate's lines: mpirun adds lines about failed ranks."""
    return [line for line in done.stderr.splitlines() if line.startswith("palpate: ")]


def files_in(folder):
    return {str(one.relative_to(folder)): one.read_bytes() for one in sorted(folder.rglob("*"))
            if one.is_file()}


SIZE = (30, 26, 250)  # 4 layers of bricks, the last one incomplete


def blob(scale=1.0):
    """Returns a wavy rod along k in an empty image. It ends within the last layer, and its values vary everywhere."""
    values = array.array("f")
    for k in range(SIZE[2]):
        x0, y0 = 14 + 6 * math.sin(k / 17), 12 + 5 * math.cos(k / 23)
        for j in range(SIZE[1]):
            row = [0.0] * SIZE[0]
            if k < 210:
                for i in range(SIZE[0]):
                    near = 60 - (i - x0) ** 2 - (j - y0) ** 2
                    if near > 0:
                        row[i] = scale * (near + 0.1 * ((7 * i + 11 * j + 13 * k) % 31))
            values.extend(row)
    return values


def turned(values):
    values = array.array(values.typecode, values)
    values.byteswap()
    return values.tobytes()


class Case(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        holder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(holder.cleanup)
        cls.dir = Path(holder.name)
        cls.values = blob()
        cls.raw = cls.dir / "blob.raw"
        cls.raw.write_bytes(cls.values.tobytes())
        cls.layout = ["--raw", json.dumps({"size": SIZE, "type": "float32",
                                           "spacing": [1, 1, 0.75]})]

    def assert_same(self, alone, other):
        self.assertEqual(sorted(alone), sorted(other))
        self.assertEqual([name for name in alone if alone[name] != other[name]], [])

    def require_vtk(self, file, *words):
        """Imports a file that only a build with VTK can read. Skips the test in another build."""
        done = run(0, file, self.dir / "whole.vdb", *words, status=None)
        if "built without VTK" in done.stderr:
            self.skipTest("built without VTK")
        self.assertEqual(done.returncode, 0, done.stderr)

    def check(self, ranks, file, *words):
        """Checks that these numbers of ranks give the bytes and the report of a single process. In the report, the file's
        name and the memory may differ."""
        name = f"{file.name}{len(list(self.dir.iterdir()))}"
        alone = self.dir / f"{name}_alone"
        report = json.loads(run(0, file, alone, "--bricks", "--json", *words).stdout)
        bytes_alone = files_in(alone)
        self.assertIn("palpate.bricks", bytes_alone)
        for count in ranks:
            out = self.dir / f"{name}_{count}"
            theirs = json.loads(run(count, file, out, "--bricks", "--json", *words).stdout)
            with self.subTest(file=file.name, words=words, ranks=count):
                self.assert_same(bytes_alone, files_in(out))
                for one in (report, theirs):
                    one.pop("file")
                    one.pop("memory")
                self.assertEqual(report, theirs)
            report["file"] = report["memory"] = None
            shutil.rmtree(out)


class Bytes(Case):
    def test_smoothing_on_several_ranks_equals_that_of_a_single_process(self):
        self.check([1, 2, 3, 5], self.raw, *self.layout, "--smooth", "2.5")

    def test_an_import_with_a_tolerance_equals_that_of_a_single_process(self):
        self.check([2], self.raw, *self.layout, "--tolerance", "3")

    def test_an_import_with_data_on_one_rank_only_equals_that_of_a_single_process(self):
        # Only the third layer is active, so its rank has no active neighbours.
        values = array.array("f", self.values)
        slab = SIZE[0] * SIZE[1] * 64
        for n in list(range(2 * slab)) + list(range(3 * slab, len(values))):
            values[n] = 0.0
        file = self.dir / "one.raw"
        file.write_bytes(values.tobytes())
        self.check([3], file, *self.layout)

    def test_an_import_with_two_invalid_values_equals_that_of_a_single_process(self):
        values = array.array("f", self.values)
        values[len(values) * 3 // 4] = math.nan
        values[len(values) // 2] = 1e39  # too large for a float
        file = self.dir / "holes.raw"
        file.write_bytes(values.tobytes())
        self.check([2], file, *self.layout)

    def test_an_import_with_a_whole_number_that_a_float_cannot_hold_equals_that_of_a_single_process(self):
        values = array.array("i", map(int, self.values))
        values[len(values) - 5] = 2 ** 25 + 1
        file = self.dir / "large.raw"
        file.write_bytes(values.tobytes())
        layout = json.dumps({"size": SIZE, "type": "int32"})
        self.check([2], file, "--raw", layout)

    def test_an_import_of_a_big_endian_nrrd_equals_that_of_a_single_process(self):
        file = self.dir / "blob.nrrd"
        header = ("NRRD0004\ntype: short\ndimension: 3\nsizes: %d %d %d\nendian: big\n"
                  "encoding: raw\nspace: right-anterior-superior\n"
                  "space directions: (0.5,0,0) (0,0.5,0) (0,0,0.5)\nspace origin: (1,2,3)\n\n" % SIZE)
        file.write_bytes(header.encode() + turned(array.array("h", map(int, self.values))))
        self.check([3], file, "--smooth", "1")

    def test_an_import_of_a_metaimage_of_many_files_equals_that_of_a_single_process(self):
        folder = self.dir / "meta"
        folder.mkdir()
        slices = [self.values[n:n + 10 * SIZE[0] * SIZE[1]]
                  for n in range(0, len(self.values), 10 * SIZE[0] * SIZE[1])]
        for n, one in enumerate(slices):
            (folder / f"part{n}.raw").write_bytes(one.tobytes())
        names = "\n".join(f"part{n}.raw" for n in range(len(slices)))
        file = folder / "blob.mhd"
        file.write_text("ObjectType = Image\nNDims = 3\nDimSize = %d %d %d\n"
                        "ElementSpacing = 1 1 2\nElementType = MET_FLOAT\n"
                        "ElementToIntensityFunctionSlope = 0.3\n" % SIZE +
                        f"ElementDataFile = LIST\n{names}\n")
        self.check([3], file, "--smooth", "2")

    def test_imports_of_compressed_nifti_and_vectors_equal_those_of_a_single_process(self):
        points = len(self.values)
        header = bytearray(352)
        struct.pack_into("<i", header, 0, 348)
        struct.pack_into("<8h", header, 40, 5, *SIZE, 1, 3, 1, 1)
        struct.pack_into("<hhh", header, 68, 1007, 16, 32)
        struct.pack_into("<8f", header, 76, 1, 1, 1, 1, 1, 1, 1, 1)
        struct.pack_into("<f", header, 108, 352)
        header[344:348] = b"n+1\0"
        planes = [self.values, self.values[points // 2:] + self.values[:points // 2],
                  array.array("f", reversed(self.values))]
        data = bytes(header) + b"".join(plane.tobytes() for plane in planes)
        file = self.dir / "vectors.nii"
        file.write_bytes(data)
        self.check([2], file, "--smooth", "1")
        packed = self.dir / "vectors.nii.gz"
        packed.write_bytes(gzip.compress(data, 1))
        self.check([3], packed)

    def test_an_import_of_a_zarr_array_equals_that_of_a_single_process(self):
        folder = self.dir / "blob.zarr"
        folder.mkdir()
        depth = 30  # slices of a chunk
        (folder / ".zarray").write_text(json.dumps({
            "zarr_format": 2, "shape": SIZE[::-1], "chunks": (depth, SIZE[1], SIZE[0]), "dtype": "<f4", "order": "C",
            "filters": None, "compressor": {"id": "zlib"}, "fill_value": 0}))
        size = depth * SIZE[0] * SIZE[1]
        for n in range(-(-SIZE[2] // depth) - 1):  # the last chunk is missing, so its values are the fill value
            data = self.values[n * size:(n + 1) * size].tobytes()
            (folder / f"{n}.0.0").write_bytes(zlib.compress(data))
        self.check([3], folder, "--smooth", "1")

    def test_a_smoothed_import_of_a_vtk_file_equals_that_of_a_single_process(self):
        file = self.dir / "blob.vtk"
        file.write_bytes(b"# vtk DataFile Version 3.0\nblob\nBINARY\nDATASET STRUCTURED_POINTS\n" +
                         b"DIMENSIONS %d %d %d\nORIGIN 0 0 0\nSPACING 1 1 1\nPOINT_DATA %d\n"
                         % (*SIZE, len(self.values)) +
                         b"SCALARS density float 1\nLOOKUP_TABLE default\n" + turned(self.values))
        self.require_vtk(file)
        self.check([3], file, "--smooth", "1")

    def test_imports_of_a_tiff_stack_and_of_its_slices_equal_those_of_a_single_process(self):
        rows = [self.values[n:n + SIZE[0]].tobytes() for n in range(0, len(self.values), SIZE[0])]
        pages = [rows[n:n + SIZE[1]] for n in range(0, len(rows), SIZE[1])]
        how = {"bits": 32, "kind": pictures.FLOAT, "packing": pictures.DEFLATE}
        tiff = pictures.Tiff(**how)
        folder = self.dir / "slices"
        folder.mkdir()
        for k, page in enumerate(pages):
            tiff.page(page, SIZE[0])
            (folder / f"{k}.tif").write_bytes(pictures.Tiff(**how).page(page, SIZE[0]).bytes())
        file = self.dir / "blob.tif"
        file.write_bytes(tiff.bytes())
        words = ["--spacing", "1,1,2mm", "--smooth", "2vx"]
        self.require_vtk(file, *words)
        self.check([2, 3], file, *words)
        self.check([3], folder, *words)

    def test_imports_with_iso_values_and_voxel_sizes_equal_those_of_a_single_process(self):
        self.check([2], self.raw, *self.layout, "--iso", "30")
        self.check([3], self.raw, *self.layout, "--voxel", "1.3")


class Trouble(Case):
    def refused(self, done, *words):
        self.assertNotEqual(done.returncode, 0)
        lines = lines_of(done)
        self.assertEqual(len(lines), 1, done.stderr)
        for word in words:
            self.assertIn(word, lines[0])
        self.assertEqual(done.stdout, "")

    def test_an_invalid_import_on_several_ranks_is_refused_with_one_line(self):
        out = self.dir / "refused"
        self.refused(run(3, self.raw, self.dir / "x.vdb", *self.layout, status=None), "mpirun",
                     "--bricks")
        self.refused(run(3, self.raw, out, "--bricks", "--nonsense", status=None), "usage")
        self.refused(run(3, self.raw, out, "--bricks", "--raw",
                         '{"size":[90,90,900],"type":"float32"}', status=None), "the layout needs")
        self.refused(run(2, self.raw, out, "--bricks", *self.layout, "--scene", "a.json",
                         status=None), "--scene")
        self.assertFalse(out.exists())

    def test_an_import_on_one_rank_works_and_ranks_of_another_mpi_library_are_refused(self):
        for name in ("PMIX_RANK", "PMI_RANK"):
            done = subprocess.run([IMPORT, str(self.raw), str(self.dir / f"{name}.vdb"), *map(str, self.layout)],
                                  env={**os.environ, name: "0"}, capture_output=True, text=True, timeout=PATIENCE)
            self.assertEqual(done.returncode, 0, done.stderr)
        # If mpirun is from another MPI, every process believes that it is the first rank.
        done = subprocess.run([IMPORT, str(self.raw), str(self.dir / "many"), "--bricks", *map(str, self.layout)],
                              env={**os.environ, "PMI_RANK": "1", "PMI_SIZE": "2"}, capture_output=True, text=True,
                              timeout=PATIENCE)
        self.assertEqual(done.returncode, 2)
        self.assertIn("different MPI libraries", done.stderr)
        self.assertFalse((self.dir / "many").exists())

    def test_an_invalid_value_of_the_last_rank_is_reported(self):
        values = array.array("f", self.values)
        values[len(values) - 10] = math.nan
        file = self.dir / "nan.raw"
        file.write_bytes(values.tobytes())
        out = self.dir / "nan"
        self.refused(run(2, file, out, "--bricks", *self.layout, "--smooth", "1", status=2),
                     "nan.raw", "without data")
        self.assertFalse(out.exists())

    def test_an_output_that_one_rank_cannot_write_is_refused(self):
        out = self.dir / "held"
        out.mkdir()
        held = os.open(out, os.O_RDONLY)
        fcntl.flock(held, fcntl.LOCK_EX)
        self.refused(run(3, self.raw, out, "--bricks", *self.layout, status=2), "held")
        os.close(held)
        # Only the last rank cannot write a brick.
        words = [self.raw, out, "--bricks", *self.layout]
        run(2, *words)
        (out / "palpate.bricks").unlink()
        brick = max(out.glob("0/0.0.*.0"))
        brick.unlink()
        brick.mkdir()
        self.refused(run(3, *words, status=2), brick.name)
        self.assertFalse((out / "palpate.bricks").exists())
        brick.rmdir()
        run(2, *words)
        alone = self.dir / "not_held"
        run(0, self.raw, alone, "--bricks", *self.layout)
        self.assert_same(files_in(alone), files_in(out))

    def processes(self, out, rank):
        """Returns the two processes of a rank: the one that mpirun started, and its child, which works."""
        found = {}
        for one in Path("/proc").iterdir():
            try:
                words = (one / "cmdline").read_bytes().split(b"\0")
                if words[0] != IMPORT.encode() or str(out).encode() not in words:
                    continue
                if f"OMPI_COMM_WORLD_RANK={rank}".encode() in \
                        (one / "environ").read_bytes().split(b"\0"):
                    found[int(one.name)] = int((one / "stat").read_text().split()[3])
            except (OSError, IndexError):
                continue
        workers = [pid for pid, parent in found.items() if parent in found]
        return [pid for pid in found if pid not in workers], workers

    def test_a_killed_import_on_several_ranks_resumes(self):
        # The values are noise, which takes long to compress.
        size = (250, 250, 320)
        file = self.dir / "noise.raw"
        file.write_bytes(random.Random(3).randbytes(size[0] * size[1] * size[2]))
        words = ["--bricks", "--raw", json.dumps({"size": size, "type": "uint8"})]
        alone = self.dir / "noise_alone"
        run(0, file, alone, *words)
        whole = files_in(alone)
        out = self.dir / "noise"
        kept = {}
        for rank, which in ((1, 1), (0, 0)):
            begun = subprocess.Popen(command(2, file, out, *words), stdout=subprocess.PIPE,
                                     stderr=subprocess.PIPE, text=True)
            end = time.monotonic() + PATIENCE
            fresh = victims = []
            while len(fresh) < 3 and begun.poll() is None and time.monotonic() < end:
                victims = victims or self.processes(out, rank)[which]
                fresh = [one for one in out.glob("0/*.0") if one.name not in kept]
                time.sleep(0.002)
            self.assertTrue(victims)
            self.assertIsNone(begun.poll(), "the import ended before it was killed")
            for pid in victims:
                os.kill(pid, signal.SIGKILL)
            begun.communicate(timeout=PATIENCE)
            self.assertNotEqual(begun.returncode, 0)
            self.assertFalse((out / "palpate.bricks").exists())
            # A child learns of its parent's end by a signal, which takes time on a busy machine.
            left = lambda: self.processes(out, 0)[1] + self.processes(out, 1)[1]
            end = time.monotonic() + PATIENCE
            while left() and time.monotonic() < end:
                time.sleep(0.01)
            self.assertEqual(left(), [])
            now = {one.name: one.stat().st_mtime_ns for one in out.glob("0/*.0")}
            for name, when in kept.items():
                self.assertEqual(now[name], when, "a brick that existed was written again")
            kept = now
            self.assertGreater(len(kept), 2)
        run(3, file, out, *words)
        self.assert_same(whole, files_in(out))
        for name, when in kept.items():
            self.assertEqual((out / "0" / name).stat().st_mtime_ns, when)
        self.assertLess(len(kept), len(list(out.glob("0/*.0"))), "no brick was left for the last run")


if __name__ == "__main__":
    if MPIRUN is None:
        print("no mpirun: skipped")
        sys.exit(77)
    if "built without MPI" in run(1, "a", "b", "--bricks", status=None).stderr:
        print("built without MPI: skipped")
        sys.exit(77)
    suite.main(sys.argv[2:])
