#!/usr/bin/env python3
"""Tests imports of images in formats of other programs, written by this test: images_test.py BIN_DIR."""
import bz2
import csv
import gzip
import io
import json
import math
import os
import random
import re
import struct
import sys
import tempfile
import unittest
import zlib
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import process  # noqa: E402
import suite  # noqa: E402
from cases import cases  # noqa: E402
from refusals import refusal  # noqa: E402

BIN = Path(sys.argv[1])

SIZE = (4, 5, 6)
INDICES = [(i, j, k) for k in range(6) for j in range(5) for i in range(4)]
INNER = [(1, 1, 1), (2, 1, 4), (1, 3, 2), (2, 3, 4)]


def scalar(i, j, k):
    return 1 + i + 10 * j + 100 * k


def vector(i, j, k):
    return (1.0 + i, 20.0 + j, 300.0 + k)


SCALARS = [scalar(*p) for p in INDICES]
SHORTS = struct.pack("<120h", *SCALARS)
BIG_SHORTS = struct.pack(">120h", *SCALARS)
VECTORS = struct.pack("<360f", *(c for p in INDICES for c in vector(*p)))
PLANES = struct.pack("<360f", *(vector(*p)[c] for c in range(3) for p in INDICES))

IDENTITY = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def within(p):
    """Returns true inside the image. The faces get another value, so that every grid has at least two values."""
    return all(0 < p[a] < SIZE[a] - 1 for a in range(3))


def times(matrix, v):
    return tuple(sum(row[c] * v[c] for c in range(3)) for row in matrix)


def place(columns, origin, index):
    """Returns the position of an index. `columns` are the steps along i, j and k."""
    return tuple(origin[d] + sum(columns[a][d] * index[a] for a in range(3)) for d in range(3))


class Case(unittest.TestCase):
    def setUp(self):
        self.holder = tempfile.TemporaryDirectory()
        self.addCleanup(self.holder.cleanup)
        self.dir = Path(self.holder.name)

    def write(self, name, *contents):
        path = self.dir / name
        path.write_bytes(b"".join(c.encode() if isinstance(c, str) else c for c in contents))
        return path

    def convert(self, path, *words):
        out = self.dir / "out.vdb"
        out.unlink(missing_ok=True)
        done = process.run([str(BIN / "palpate-import"), str(path), str(out), *words],
                              capture_output=True, text=True, timeout=120)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        return out

    def refused(self, path, says, *words, out=None):
        """Checks that the import is refused: one line on stderr, status 2, no file left."""
        done, line = refusal(self, self.dir, lambda: process.run(
            [str(BIN / "palpate-import"), str(path), str(out or self.dir / "out.vdb"), *words],
            capture_output=True, text=True, timeout=120))
        self.assertIn(says, line)
        # The status is 1 if a sanitizer's allocator ended the program because it requested too much memory.
        self.assertIn(done.returncode, (1, 2) if "without a message" in line else (2,))

    def bits_are_guarded(self, name, before, packed, count=40):
        """Flips bits of the packed data after `before`. The result must be one line on stderr or the same volume (gzip
        has bits without effect, such as its time)."""
        count = min(8 * len(packed), max(2, cases(count, "flipped bits of " + name)))
        uuid = 57  # bytes to skip: OpenVDB writes a random id before this offset
        whole = self.convert(self.write(name, before, packed)).read_bytes()[uuid:]
        (self.dir / "out.vdb").unlink()
        refused = 0
        for n in range(count):
            bit = n * (8 * len(packed) - 1) // (count - 1)
            bad = bytearray(packed)
            bad[bit // 8] ^= 1 << bit % 8
            path = self.write(name, before, bytes(bad))
            out = self.dir / "out.vdb"
            done = process.run([str(BIN / "palpate-import"), str(path), str(out)],
                                  capture_output=True, text=True, timeout=120)
            if done.returncode == 0:
                self.assertEqual(out.read_bytes()[uuid:], whole, f"bit {bit} changes voxels")
                out.unlink()
            else:
                self.assertEqual(done.returncode, 2, done.stderr)
                self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
                refused += 1
        self.assertGreater(refused, 0.7 * count)

    def report(self, path, *words):
        done = process.run([str(BIN / "palpate-import"), str(path), str(self.dir / "out.vdb"),
                               "--json", *words], capture_output=True, text=True, timeout=120)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        return json.loads(done.stdout)

    def notes(self, path, *words):
        return "\n".join(self.report(path, *words)["notes"])

    def sample(self, volume, grid, points):
        text = "x,y,z\n" + "".join("{!r},{!r},{!r}\n".format(*map(float, p)) for p in points)
        done = process.run([str(BIN / "palpate"), "sample", str(volume), "--grid", grid,
                               "--points", "-"], input=text, capture_output=True, text=True,
                              timeout=120)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        return list(csv.DictReader(io.StringIO(done.stdout)))

    def says_patient(self, volume, says):
        """Checks whether the file has the metadata "space" = "RAS", in OpenVDB's encoding of strings."""
        entry = b"".join(struct.pack("<i", len(w)) + w for w in (b"space", b"string", b"RAS"))
        self.assertEqual(entry in volume.read_bytes(), says)

    def holds(self, volume, grid, columns, origin, expected, indices=INNER, places=4):
        """Checks that the grid has the value expected(i, j, k), a number or a vector, at the position of (i, j, k)."""
        rows = self.sample(volume, grid, [place(columns, origin, p) for p in indices])
        for index, row in zip(indices, rows):
            value = expected(*index)
            if isinstance(value, tuple):
                found = [float(row[k]) for k in ("vx", "vy", "vz")]
            else:
                value, found = (value,), [float(row["value"])]
            for a, b in zip(value, found):
                self.assertAlmostEqual(a, b, places, (grid, index, row))


def nrrd(*fields, kind="short", sizes="4 5 6", encoding="raw", endian="little"):
    dimension = len(sizes.split())
    return ("NRRD0005\n# by images_test.py\n" + f"type: {kind}\ndimension: {dimension}\n"
            + f"sizes: {sizes}\nencoding: {encoding}\nendian: {endian}\n"
            + "".join(f + "\n" for f in fields))


DIRECTIONS = "space directions: (2,0.5,0) (0,3,0) (0,0.25,4)"
COLUMNS = ((2, 0.5, 0), (0, 3, 0), (0, 0.25, 4))
ORIGIN = "space origin: (10,-20,30)"
AT = (10, -20, 30)


def turned(turn, columns=COLUMNS, origin=AT):
    return tuple(times(turn, c) for c in columns), times(turn, origin)


RAS_FROM_LPS = ((-1, 0, 0), (0, -1, 0), (0, 0, 1))
RIGHT_FROM_LEFT = ((1, 0, 0), (0, -1, 0), (0, 0, 1))
RAS_FROM_LAS = ((-1, 0, 0), (0, 1, 0), (0, 0, 1))


class Nrrd(Case):
    @classmethod
    def setUpClass(cls):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "a.nrrd"
            path.write_bytes(b"NRRD0004\n\n")
            done = process.run([str(BIN / "palpate-import"), str(path), folder + "/out.vdb"],
                                  capture_output=True, text=True, timeout=120)
        if "without teem" in done.stderr:
            raise unittest.SkipTest("built without teem")

    @suite.smoke
    def test_every_patient_space_of_an_nrrd_file_is_converted_to_ras(self):
        for space, turn in (("left-posterior-superior", RAS_FROM_LPS), ("LPS", RAS_FROM_LPS),
                            ("left-anterior-superior", RAS_FROM_LAS),
                            ("right-anterior-superior", IDENTITY),
                            ("3D-right-handed", IDENTITY), ("3D-left-handed", RIGHT_FROM_LEFT)):
            path = self.write("a.nrrd", nrrd(f"space: {space}", DIRECTIONS, ORIGIN), "\n", SHORTS)
            out = self.convert(path)
            self.holds(out, "density", *turned(turn), scalar)
            self.says_patient(out, says=not space.startswith("3D"))
        path = self.write("a.nrrd", nrrd("space dimension: 3", DIRECTIONS, ORIGIN), "\n", SHORTS)
        out = self.convert(path)
        self.holds(out, "density", COLUMNS, AT, scalar)
        self.says_patient(out, says=False)
        # A space without directions is not that of a patient.
        path = self.write("a.nrrd", nrrd("space: LPS", "spacings: 1 2 3"), "\n", SHORTS)
        self.says_patient(self.convert(path), says=False)

    @suite.smoke
    def test_reads_an_nrrd_file_in_every_encoding_and_byte_order(self):
        text = " ".join(map(str, SCALARS))
        for encoding, data in (("raw", SHORTS), ("gzip", gzip.compress(SHORTS)),
                               ("bzip2", bz2.compress(SHORTS)), ("ascii", text.encode()),
                               ("hex", SHORTS.hex().encode())):
            path = self.write("a.nrrd", nrrd("spacings: 1 2 3", encoding=encoding), "\n", data)
            self.holds(self.convert(path), "density", ((1, 0, 0), (0, 2, 0), (0, 0, 3)), (0, 0, 0),
                       scalar)
        for data in (BIG_SHORTS, gzip.compress(BIG_SHORTS)):
            encoding = "raw" if data is BIG_SHORTS else "gzip"
            path = self.write("a.nrrd", nrrd("spacings: 1 2 3", encoding=encoding, endian="big"),
                              "\n", data)
            self.holds(self.convert(path), "density", ((1, 0, 0), (0, 2, 0), (0, 0, 3)), (0, 0, 0),
                       scalar)

    @suite.smoke
    def test_reads_an_nrrd_file_of_every_number_type(self):
        for kind, letter in (("signed char", "b"), ("uchar", "B"), ("ushort", "H"), ("int", "i"),
                             ("uint", "I"), ("longlong", "q"), ("ulonglong", "Q"), ("float", "f"),
                             ("double", "d")):
            values = [v % 100 for v in SCALARS]
            path = self.write("a.nrrd", nrrd(kind=kind), "\n",
                              struct.pack("<120" + letter, *values))
            self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0),
                       lambda i, j, k: scalar(i, j, k) % 100)

    def test_axis_bounds_of_an_nrrd_file_are_faces_of_voxels_unless_its_centers_are_node(self):
        mins = ("axis mins: 10 20 30", "axis maxs: 18 25 42")
        path = self.write("a.nrrd", nrrd(*mins), "\n", SHORTS)
        self.holds(self.convert(path), "density", ((2, 0, 0), (0, 1, 0), (0, 0, 2)), (11, 20.5, 31),
                   scalar)
        path = self.write("a.nrrd", nrrd("axis mins: 10 20 30", "axis maxs: 16 28 40",
                                         "centers: node node node"), "\n", SHORTS)
        self.holds(self.convert(path), "density", ((2, 0, 0), (0, 2, 0), (0, 0, 2)), (10, 20, 30),
                   scalar)

    @suite.smoke
    def test_reads_an_nrrd_header_with_values_in_other_files(self):
        one = SHORTS
        self.write("whole.raw", b"junk" + one)
        self.write("a b.raw", one)
        for k in range(6):
            self.write(f"part{k + 1:03d}.raw", one[k * 40:k * 40 + 40])
            self.write(f"line{k}.txt", "one\ntwo\n", one[k * 40:k * 40 + 40])
            self.write(f"skip{k}.raw", b"x" * k, one[k * 40:k * 40 + 40])
        lists = "".join(f"part{k + 1:03d}.raw\n" for k in range(6))
        lines = "".join(f"line{k}.txt\n" for k in range(6))
        for fields in (("data file: whole.raw", "byte skip: 4"),
                       ("byte skip: -1", "data file: whole.raw"),
                       ("data file: a b.raw",),
                       (f"datafile: {self.dir}/a b.raw",),
                       ("data file: part%03d.raw 1 6 1",),
                       ("data file: ./part%03d.raw 1 6 1 2",),
                       ("data file: LIST\n" + lists,),
                       ("line skip: 2", "data file: LIST 2\n" + lines)):
            path = self.write("a.nhdr", nrrd(*fields))
            self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)
        path = self.write("a.nhdr", nrrd("data file: part%03d.raw 6 1 -1"))
        self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0),
                   lambda i, j, k: scalar(i, j, 5 - k))
        path = self.write("a.nhdr", nrrd("data file: part%03d.raw 1 6 1").replace("\n", "\r\n"))
        self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)

    def test_refuses_an_nrrd_header_whose_data_file_is_in_another_folder(self):
        (self.dir / "within").mkdir()
        (self.dir / "headers" / "x").mkdir(parents=True)
        (self.dir / "headers" / "link.raw").symlink_to("../a.raw")
        self.write("a.raw", SHORTS)
        self.write("within/b.raw", SHORTS)
        for name in ("within/b.raw", "./within/../a.raw", f"{self.dir}/a.raw"):
            self.convert(self.write("a.nhdr", nrrd(f"data file: {name}")))
        for name in ("../a.raw", f"{self.dir}/a.raw", "x/../../a.raw", "link.raw", "LIST\n../a.raw"):
            for header in (self.write("headers/a.nhdr", nrrd(f"data file: {name}")),
                           self.write("headers/a.mhd", meta(data=name))):
                with self.subTest(name=name, header=header.name):
                    self.refused(header, "the header names a data file in another folder")
                    self.convert(header, "--follow")

    @suite.smoke
    def test_vectors_of_an_nrrd_file_are_converted_from_its_space_to_ras(self):
        fields = ("space: left-posterior-superior", ORIGIN)
        columns, origin = turned(RAS_FROM_LPS)
        for word in ("vector", "3-vector", "covariant-vector", "3-gradient", "normal", "3-normal"):
            path = self.write("a.nrrd", nrrd(
                *fields, "space directions: none (2,0.5,0) (0,3,0) (0,0.25,4)",
                f"kinds: {word} space space space", kind="float", sizes="3 4 5 6"), "\n", VECTORS)
            self.holds(self.convert(path), "vector", columns, origin,
                       lambda i, j, k: times(RAS_FROM_LPS, vector(i, j, k)))
        # The components are on the last axis.
        path = self.write("a.nrrd", nrrd(
            *fields, "space directions: (2,0.5,0) (0,3,0) (0,0.25,4) none",
            "kinds: space space space vector", kind="float", sizes="4 5 6 3"), "\n", PLANES)
        self.holds(self.convert(path), "vector", columns, origin,
                   lambda i, j, k: times(RAS_FROM_LPS, vector(i, j, k)))

    def test_integer_vectors_of_an_nrrd_file_are_converted_from_its_space_to_ras(self):
        data = struct.pack("<360B", *(int(c) % 200 for p in INDICES for c in vector(*p)))
        path = self.write("a.nrrd", nrrd(
            "space: LPS", "space directions: none (1,0,0) (0,1,0) (0,0,1)",
            "kinds: vector space space space", kind="uchar", sizes="3 4 5 6"), "\n", data)
        self.holds(self.convert(path), "vector", *turned(RAS_FROM_LPS, IDENTITY, (0, 0, 0)),
                   lambda i, j, k: times(RAS_FROM_LPS, tuple(c % 200 for c in vector(i, j, k))))

    @suite.smoke
    def test_the_measurement_frame_of_an_nrrd_file_is_applied_to_its_vectors(self):
        # Columns of the frame: its x is the space's y, its y is the space's -x.
        path = self.write("a.nrrd", nrrd(
            "space: LAS", "space directions: none (1,0,0) (0,1,0) (0,0,1)",
            "kinds: vector space space space", "measurement frame: (0,1,0) (-1,0,0) (0,0,1)",
            kind="float", sizes="3 4 5 6"), "\n", VECTORS)
        self.holds(self.convert(path), "vector", *turned(RAS_FROM_LAS, IDENTITY, (0, 0, 0)),
                   lambda i, j, k: times(RAS_FROM_LAS, (-20.0 - j, 1.0 + i, 300.0 + k)))

    def test_reads_vectors_of_an_nrrd_file_without_the_field_kinds(self):
        path = self.write("a.nrrd", nrrd(kind="float", sizes="3 4 5 6"), "\n", VECTORS)
        self.holds(self.convert(path), "vector", IDENTITY, (0, 0, 0), vector)

    @suite.smoke
    def test_tensors_become_direction_anisotropy_and_diffusivity(self):
        # D = 3 n n^T + 1 with n = (0.6, 0.8, 0) has eigenvalues 4, 1, 1.
        n = (0.6, 0.8, 0.0)
        full = [3 * n[a] * n[b] + (a == b) for a in range(3) for b in range(3)]
        six = [full[i] for i in (0, 1, 2, 4, 5, 8)]
        for word, values in (("3D-symmetric-matrix", six), ("3D-matrix", full),
                             ("3D-masked-symmetric-matrix", [1.0] + six),
                             ("3D-masked-matrix", [1.0] + full)):
            width = len(values)
            data = struct.pack(f"<{120 * width}f", *(c if within(p) else float(a == 0)
                                                     for p in INDICES
                                                     for a, c in enumerate(values)))
            path = self.write("a.nrrd", nrrd(
                "space: left-anterior-superior",
                "space directions: none (1,0,0) (0,1,0) (0,0,1)",
                f"kinds: {word} space space space", kind="float", sizes=f"{width} 4 5 6"),
                "\n", data)
            out = self.convert(path)
            at = turned(RAS_FROM_LAS, IDENTITY, (0, 0, 0))
            self.holds(out, "tensor_direction", *at, lambda *_: (0.6, -0.8, 0.0))
            # eigenvalues 4, 1, 1: FA = 3 / sqrt(18)
            self.holds(out, "tensor_anisotropy", *at, lambda *_: 3 / 18 ** 0.5)
            self.holds(out, "tensor_diffusivity", *at, lambda *_: 2.0)

    def test_the_measurement_frame_of_an_nrrd_file_is_applied_to_its_tensors(self):
        # The tensor is diag(3, 1, 1) in a frame whose x is the space's z.
        data = struct.pack("<720f", *([3, 0, 0, 1, 0, 1] * 120))
        path = self.write("a.nrrd", nrrd(
            "space: RAS", "space directions: none (1,0,0) (0,1,0) (0,0,1)",
            "kinds: 3D-symmetric-matrix space space space",
            "measurement frame: (0,0,1) (0,1,0) (-1,0,0)", kind="float", sizes="6 4 5 6"),
            "\n", data)
        self.holds(self.convert(path), "tensor_direction", IDENTITY, (0, 0, 0),
                   lambda *_: (0.0, 0.0, 1.0))

    @suite.smoke
    def test_tensors_outside_their_mask_have_no_data(self):
        values = []
        for i, j, k in INDICES:
            values += [0.0 if (i, j, k) == (1, 1, 1) else 1.0, 3, 0, 0, 1, 0, 1]
        path = self.write("a.nrrd", nrrd(
            "kinds: 3D-masked-symmetric-matrix space space space", kind="float",
            sizes="7 4 5 6"), "\n", struct.pack("<840f", *values))
        out = self.convert(path)
        others = [p for p in INNER if p != (1, 1, 1)]
        self.assertLess(len(others), len(INNER))
        self.holds(out, "tensor_direction", IDENTITY, (0, 0, 0), lambda *p: (1.0, 0.0, 0.0), others)
        rows = self.sample(out, "tensor_direction", [(1, 1, 1), *others])
        self.assertEqual([row["inside"] for row in rows], ["0"] + ["1"] * len(others))

    @suite.smoke
    def test_the_first_time_step_of_an_nrrd_series_is_imported_by_default(self):
        more = struct.pack("<240h", *SCALARS, *(-v for v in SCALARS))
        path = self.write("a.nrrd", nrrd(
            "space: RAS", "space directions: (1,0,0) (0,1,0) (0,0,1) none",
            "kinds: space space space list", sizes="4 5 6 2"), "\n", more)
        self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)
        # As in diffusion-weighted files, the index of the image varies fastest.
        mixed = struct.pack("<240h", *(w for v in SCALARS for w in (v, -v)))
        path = self.write("a.nrrd", nrrd(
            "space: RAS", "space directions: none (1,0,0) (0,1,0) (0,0,1)",
            "kinds: list space space space", sizes="2 4 5 6"), "\n", mixed)
        self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)
        # The space has four dimensions, the last of which is time.
        path = self.write("a.nrrd", nrrd(
            "space: right-anterior-superior-time",
            "space directions: (1,0,0,0) (0,1,0,0) (0,0,1,0) (0,0,0,2.5)",
            "kinds: space space space time", sizes="4 5 6 2"), "\n", more)
        self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)

    def labels(self, volume):
        """Returns the labels of each grid, as `palpate info` prints them."""
        done = process.run([str(BIN / "palpate"), "info", str(volume), "--json"], capture_output=True, text=True,
                           timeout=120)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        return {grid["name"]: grid.get("labels", []) for grid in json.loads(done.stdout)["grids"]}

    @suite.smoke
    def test_segments_of_a_segmentation_keep_their_names_and_colours(self):
        # The label 2 fills the image up to its faces, where it is the most frequent value.
        def label(i, j, k):
            return 7 if (i, j, k) == (2, 3, 4) else 2 if i > 0 else 0
        segments = ("Segment0_ID:=a", "Segment0_Name:=liver", "Segment0_LabelValue:=7",
                    "Segment0_Color:=0.5 0.25 1", "Segment0_Layer:=0", "Segment1_Name:=body: all",
                    "Segment1_LabelValue:=2", "Segment1_Color:=1 0 0 red", "Segment1_Tags:=T2022:=x|",
                    "Segment2_Name:=lost", "Segment2_LabelValue:=two", "Segment3_Name:=far", "Segment3_Layer:=4",
                    "Other:=1")
        header = nrrd("space: RAS", DIRECTIONS, ORIGIN, *segments, kind="uchar")
        path = self.write("a.seg.nrrd", header, "\n", bytes(label(*p) for p in INDICES))
        out = self.convert(path)
        self.holds(out, "labels", COLUMNS, AT, label, [(0, 0, 0), *INNER])
        self.assertEqual(self.labels(out), {"labels": [
            {"label": 7, "name": "liver", "colour": [0.5, 0.25, 1]}, {"label": 2, "name": "body: all"}]})
        outside = self.sample(out, "labels", [place(COLUMNS, AT, (40, 0, 0))])
        self.assertEqual(float(outside[0]["value"]), 0.0)
        notes = self.notes(path)
        self.assertIn('segment 2 "lost" keeps no name: its label value "two"', notes)
        self.assertIn('segment 3 "far" keeps no name: its layer "4" is not one of the 1', notes)
        for option, value in (("--smooth", "1"), ("--voxel", "0.5"), ("--tolerance", "1")):
            self.refused(path, "must not be blended", option, value)
        self.refused(path, "--bricks: labels has labels, which must not be blended", "--bricks",
                     out=self.dir / "bricks")

    def test_info_suggests_a_label_that_a_scene_can_use(self):
        def suggested(*names):
            segments = [f"Segment{n}_{field}" for n, name in enumerate(names)
                        for field in (f"Name:={name}", f"LabelValue:={n + 1}")]
            path = self.write("a.seg.nrrd", nrrd("space: RAS", DIRECTIONS, ORIGIN, *segments, kind="uchar"), "\n",
                              bytes((i + j + k) % 3 for i, j, k in INDICES))
            done = process.run([str(BIN / "palpate"), "info", str(self.convert(path))], capture_output=True, text=True,
                               timeout=120)
            return re.search(r"such as (.*)", done.stdout)[1]
        self.assertEqual(json.loads("{" + suggested('le "ber"') + "}"), {"label": 'le "ber"'})
        self.assertEqual(suggested("lung", "lung"), '"label": 1')

    def test_the_scene_of_a_segmentation_has_a_mode_for_each_segment_and_loads(self):
        fields = ("space: RAS", "kinds: list domain domain domain", "space directions: none (1,0,0) (0,1,0) (0,0,1)",
                  "Segment0_Name:=organ", "Segment0_LabelValue:=1", "Segment0_Layer:=0", "Segment1_Name:=tumour",
                  "Segment1_LabelValue:=2", "Segment1_Layer:=0", "Segment2_Name:=vessel", "Segment2_LabelValue:=1",
                  "Segment2_Layer:=1")

        def layers(i, j, k):
            inside = min(i, j, k) > 2 and max(i, j, k) < 17
            return (2 if (i - 9) ** 2 + (j - 9) ** 2 + (k - 9) ** 2 < 9 else int(inside)), int(inside and i < 7)
        values = bytes(v for k in range(20) for j in range(20) for i in range(20) for v in layers(i, j, k))
        path = self.write("a.seg.nrrd", nrrd(*fields, kind="uchar", sizes="2 20 20 20"), "\n", values)
        for words, name in (((), "out.vdb"), (("--time", "all"), "out_0000.vdb")):
            scene = self.dir / "scene.json"
            self.report(path, "--scene", str(scene), *words)
            modes = json.loads(scene.read_text())["modes"]
            self.assertEqual([(m["name"], m["of"], m["label"]) for m in modes], [
                ("organ", "labels_0", "organ"), ("tumour", "labels_0", "tumour"), ("vessel", "labels_1", "vessel")])
            done = process.run([str(BIN / "palpate"), "check", str(scene)], capture_output=True, text=True, timeout=120)
            self.assertEqual((done.returncode, done.stderr), (0, ""))
            for file in (scene, self.dir / name):
                file.unlink()

    def test_each_layer_of_a_segmentation_becomes_a_grid_of_labels(self):
        values = [[(i + j + k) % 3, int(i > 1), 0] for i, j, k in INDICES]
        segments = ("Segment0_Name:=a", "Segment0_LabelValue:=1", "Segment0_Layer:=0", "Segment1_Name:=b",
                    "Segment1_LabelValue:=2", "Segment1_Layer:=0", "Segment2_Name:=c", "Segment2_Layer:=1")
        fields = ("space: RAS", "kinds: list domain domain domain", "space directions: none (1,0,0) (0,1,0) (0,0,1)")
        path = self.write("a.seg.nrrd", nrrd(*fields, *segments, kind="uchar", sizes="3 4 5 6"), "\n",
                          bytes(v for voxel in values for v in voxel))
        out = self.convert(path)
        self.holds(out, "labels_0", IDENTITY, (0, 0, 0), lambda i, j, k: (i + j + k) % 3)
        self.holds(out, "labels_1", IDENTITY, (0, 0, 0), lambda i, j, k: int(i > 1))
        self.assertEqual(self.labels(out), {
            "labels_0": [{"label": 1, "name": "a"}, {"label": 2, "name": "b"}],
            "labels_1": [{"label": 1, "name": "c"}]})
        self.assertIn("labels_2: skipped", self.notes(path))
        # Older versions of Slicer write a layer for each segment, and no label values.
        old = ("Segment0_Name:=a", "Segment1_Name:=b")
        pairs = bytes(v for i, j, k in INDICES for v in (int(j > 2), int(k > 2)))
        out = self.convert(self.write("a.seg.nrrd", nrrd(*fields, *old, kind="uchar", sizes="2 4 5 6"), "\n", pairs))
        self.assertEqual(self.labels(out), {"labels_0": [{"label": 1, "name": "a"}],
                                            "labels_1": [{"label": 1, "name": "b"}]})

    def test_ignores_the_spacings_of_an_nrrd_file_that_states_directions(self):
        path = self.write("a.nrrd", nrrd("space: RAS", DIRECTIONS, ORIGIN, "spacings: 7 7 7",
                                         'units: "mm" "mm" "mm"'), "\n", SHORTS)
        self.holds(self.convert(path), "density", COLUMNS, AT, scalar)

    @suite.smoke
    def test_refuses_nrrd_axes_of_unsupported_kinds(self):
        for word, size in (("complex", 2), ("RGB-color", 3), ("3-color", 3), ("4-vector", 4),
                           ("quaternion", 4), ("2D-symmetric-matrix", 3)):
            path = self.write("a.nrrd", nrrd(f"kinds: {word} space space space", kind="uchar",
                                             sizes=f"{size} 4 5 6"), "\n", bytes(120 * size))
            self.refused(path, "palpate does not import")
        path = self.write("a.nrrd", nrrd("kinds: vector space space space", kind="uchar",
                                         sizes="2 4 5 6"), "\n", bytes(240))
        self.refused(path, "2 components")
        path = self.write("a.nrrd", nrrd(sizes="10 12"), "\n", SHORTS)
        self.refused(path, "fewer than three axes of space")
        path = self.write("a.nrrd", nrrd("block size: 2", kind="block"), "\n", SHORTS)
        self.refused(path, "blocks")

    @suite.smoke
    def test_refuses_damaged_nrrd_files(self):
        good = nrrd("spacings: 1 1 1")
        self.refused(self.write("a.nrrd", good, "\n", SHORTS[:100]), "truncated")
        self.refused(self.write("a.nrrd", good), "ends within its header")
        self.refused(self.write("a.nrrd", "NRRD0005\nsizes"), "ends within its header")
        self.refused(self.write("a.nrrd", "NRRD0005\nsizes: what\n\n"), "header is damaged")
        packed = gzip.compress(os.urandom(240))
        self.refused(self.write("a.nrrd", nrrd(encoding="gzip"), "\n", packed[:150]), "truncated")
        self.refused(self.write("a.nrrd", nrrd(encoding="gzip"), "\n", bytes(200)), "damaged")
        self.refused(self.write("a.nrrd", nrrd(encoding="bzip2"), "\n",
                                bz2.compress(SHORTS)[:60]), "read")
        self.refused(self.write("a.nrrd", nrrd(encoding="ascii"), "\n", "1 2 " * 30), "truncated")
        self.refused(self.write("a.nrrd", nrrd(encoding="ascii"), "\n", "9" * 5000), "too long for a number")
        self.refused(self.write("a.nrrd", nrrd(encoding="ascii"), "\n", "word " * 200), "read")
        self.refused(self.write("a.nrrd", nrrd(encoding="hex"), "\n", "zz" * 300), "read")
        self.refused(self.write("a.nrrd", nrrd("space: RAS", "space directions: (1,0,0) (0,1,0)"),
                                "\n", SHORTS), "header is damaged")
        self.refused(self.write("a.nrrd", nrrd("space: RAS",
                                               "space directions: (1,0,0) (0,1,0) (1,1,0)"),
                                "\n", SHORTS), "no volume")
        self.refused(self.write("a.nrrd", nrrd("spacings: 1 0 1"), "\n", SHORTS), "")
        self.refused(self.write("a.nrrd", nrrd("A" * 3000), "\n", SHORTS), "more than 800 characters")

    def test_accepts_nrrd_headers_with_long_comments_and_names(self):
        path = self.write("a.nrrd", nrrd("# " + "A" * 3000, "key:=" + "B" * 3000,
                                         "content: " + "C" * 3000), "\n", SHORTS)
        self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)

    @suite.smoke
    def test_refuses_nrrd_files_with_sizes_out_of_range(self):
        for sizes in ("100000 100000 100000", "4000000000 2 2",
                      "2000000000 2000000000 2000000000", "0 5 6", "-4 5 6",
                      "99999999999999999999 2 2"):
            self.refused(self.write("a.nrrd", nrrd(sizes=sizes), "\n", SHORTS), "a.nrrd")
            self.refused(self.write("a.nrrd", nrrd(sizes=sizes, encoding="gzip"), "\n",
                                    gzip.compress(SHORTS)), "a.nrrd")

        self.refused(self.write("a.nrrd", nrrd(sizes="40000 40000 40000", encoding="bzip2"), "\n",
                                bz2.compress(SHORTS)), "a.nrrd")

    def test_flipped_bits_in_a_compressed_nrrd_file_are_refused_or_change_no_voxel(self):
        self.bits_are_guarded("a.nrrd", nrrd(encoding="gzip") + "\n", gzip.compress(SHORTS), 60)

    @suite.smoke
    def test_skips_lines_and_bytes_before_compressed_nrrd_values(self):
        for skip, data in ((6, gzip.compress(b"before" + SHORTS)),
                           (-1, gzip.compress(b"before" + SHORTS)),
                           (-6, gzip.compress(SHORTS + b"after"))):
            self.write("a.raw.gz", "a line\n", data)
            path = self.write("a.nhdr", nrrd("line skip: 1", f"byte skip: {skip}",
                                             "data file: a.raw.gz", encoding="gzip"))
            self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)
        # A gzip file of two members, as bgzip writes, then one that is truncated within its checksum.
        self.write("a.raw.gz", gzip.compress(SHORTS[:77]) + gzip.compress(SHORTS[77:]))
        path = self.write("a.nhdr", nrrd("data file: a.raw.gz", encoding="gzip"))
        self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)
        self.write("a.raw.gz", gzip.compress(SHORTS)[:-5])
        (self.dir / "out.vdb").unlink()
        self.refused(path, "a.raw.gz is truncated")

    @suite.smoke
    def test_refuses_nrrd_headers_with_invalid_data_file_entries(self):
        self.write("a.raw", SHORTS)
        for field, says in (("none.raw", "cannot be read"), (".", "cannot be read"),
                            ("", "cannot be read"), ("-", "pipe"),
                            ("LIST\nnone.raw", "cannot be read"), ("LIST", "no data file"),
                            ("%s%d 1 2 1", "pattern"), ("%n 1 2 1", "pattern"),
                            ("%0999999d 1 2 1", "pattern"),
                            ("a%d 1 9 0", "the step between the numbers of the data files is 0"),
                            ("a%d 1 2000000000 1", "more than 1000000 data files"), ("a%d 1 7 1", "divide"),
                            ("/dev/zero", "cannot be read")):
            self.refused(self.write("a.nhdr", nrrd(f"data file: {field}")), says, "--follow")
        self.refused(self.write("a.nhdr", nrrd("byte skip: 100", "data file: a.raw")), "")
        self.refused(self.write("a.nhdr", nrrd("line skip: 100000", "data file: a.raw")), "")
        self.refused(self.write("a.nhdr", nrrd("byte skip: -500", "data file: a.raw")), "too short")


def meta(*fields, kind="MET_SHORT", data="LOCAL", **other):
    head = {"ObjectType": "Image", "NDims": "3", "BinaryData": "True",
            "BinaryDataByteOrderMSB": "False", "CompressedData": "False", "DimSize": "4 5 6",
            "ElementType": kind}
    head.update(other)
    return ("".join(f"{k} = {v}\n" for k, v in head.items() if v is not None)
            + "".join(f + "\n" for f in fields) + f"ElementDataFile = {data}\n")


class MetaImage(Case):
    # The first axis is y, the second is -x.
    PLACED = ("TransformMatrix = 0 1 0 -1 0 0 0 0 1", "Offset = 10 20 30",
              "ElementSpacing = 1 2 3")
    COLUMNS = ((0, 1, 0), (-2, 0, 0), (0, 0, 3))

    def holds(self, volume, grid, columns, origin, expected, **more):
        """Checks as Case.holds does, but columns, origin and expected vectors are in ITK's space, LPS."""
        def in_ras(*index):
            value = expected(*index)
            return times(RAS_FROM_LPS, value) if isinstance(value, tuple) else value
        super().holds(volume, grid, *turned(RAS_FROM_LPS, columns, origin), in_ras, **more)

    @suite.smoke
    def test_voxels_of_a_metaimage_have_exact_positions(self):
        # ITK ignores AnatomicalOrientation, and so must palpate.
        for axes in None, "???", "RAI", "LPS", "ASL":
            path = self.write("a.mha", meta(*self.PLACED, "CenterOfRotation = 1 2 3",
                                            AnatomicalOrientation=axes), SHORTS)
            out = self.convert(path)
            self.holds(out, "density", self.COLUMNS, (10, 20, 30), scalar)
            named = axes not in (None, "???")
            self.says_patient(out, says=named)
            self.assertEqual("as in ITK, x points to the patient's left" in self.notes(path),
                             not named)
        # The header has the field names of old files, and a sheared matrix.
        path = self.write("a.mha", meta("Rotation = 1 0.5 0 0 1 0 0 0 1", "Position = 1 2 3",
                                        "ElementSize = 2 2 2"), SHORTS)
        self.holds(self.convert(path), "density", ((2, 1, 0), (0, 2, 0), (0, 0, 2)), (1, 2, 3),
                   scalar)

    @suite.smoke
    def test_reads_metaimage_data_in_the_header_file_and_in_other_files(self):
        self.write("a.raw", SHORTS)
        self.write("a.zraw", zlib.compress(SHORTS))
        for k in range(6):
            self.write(f"s{k:02d}.raw", SHORTS[k * 40:k * 40 + 40])
        slices = "LIST\n" + "\n".join(f"s{k:02d}.raw" for k in range(6))
        for head in (meta(data="a.raw"), meta(data="a.zraw", CompressedData="True"),
                     meta(data="s%02d.raw 0 5 1"), meta(data=slices)):
            path = self.write("a.mhd", head)
            self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)
        self.write("h.raw", b"junk" + SHORTS)
        for size in (4, -1):
            path = self.write("a.mhd", meta(f"HeaderSize = {size}", data="h.raw"))
            self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)
        path = self.write("a.mha", meta(BinaryData="False"), " ".join(map(str, SCALARS)))
        self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)
        path = self.write("a.mha", meta(BinaryDataByteOrderMSB="True"), BIG_SHORTS)
        self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)
        packed = zlib.compress(BIG_SHORTS)
        path = self.write("a.mha", meta(f"CompressedDataSize = {len(packed)}",
                                        BinaryDataByteOrderMSB="True", CompressedData="True"),
                          packed)
        self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)

    @suite.smoke
    def test_reads_a_metaimage_of_every_number_type(self):
        for kind, letter in (("MET_CHAR", "b"), ("MET_UCHAR", "B"), ("MET_SHORT", "h"), ("MET_USHORT", "H"),
                             ("MET_INT", "i"), ("MET_UINT", "I"), ("MET_LONG", "i"),
                             ("MET_ULONG", "I"), ("MET_LONG_LONG", "q"), ("MET_ULONG_LONG", "Q"),
                             ("MET_FLOAT", "f"), ("MET_DOUBLE", "d")):
            path = self.write("a.mha", meta(kind=kind),
                              struct.pack("<120" + letter, *(v % 100 for v in SCALARS)))
            self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0),
                       lambda i, j, k: scalar(i, j, k) % 100)

    @suite.smoke
    def test_reads_vectors_and_tensors_of_a_metaimage(self):
        path = self.write("a.mha", meta("ElementNumberOfChannels = 3", kind="MET_FLOAT"), VECTORS)
        self.holds(self.convert(path), "vector", IDENTITY, (0, 0, 0), vector)
        path = self.write("a.mha", meta("ElementNumberOfChannels = 3",
                                        "AnatomicalOrientation = RAI", kind="MET_FLOAT"), VECTORS)
        self.holds(self.convert(path), "vector", IDENTITY, (0, 0, 0), vector)
        six = struct.pack("<720f", *([1, 0, 0, 1, 1, 1] * 120))  # xx, yy, yz and zz are 1
        path = self.write("a.mha", meta("ElementNumberOfChannels = 6", kind="MET_FLOAT"), six)
        self.holds(self.convert(path, "--as", "tensor"), "tensor_direction", IDENTITY, (0, 0, 0),
                   lambda *_: (0.0, -0.5 ** 0.5, -0.5 ** 0.5))  # the sign has no meaning
        self.refused(path, "6 channels")

    @suite.smoke
    def test_the_fourth_axis_of_a_metaimage_is_time(self):
        data = struct.pack("<240h", *(-v for v in SCALARS), *SCALARS)
        four = {"NDims": "4", "DimSize": "4 5 6 2"}
        turned = ("TransformMatrix = 0 1 0 0 -1 0 0 0 0 0 1 0 0 0 0 1", "Offset = 10 20 30 3",
                  "ElementSpacing = 1 2 3 0.5")
        for path in (self.write("a.mha", meta(*turned, **four), data),
                     self.write("b.mha", meta(*turned, CompressedData="True", **four), zlib.compress(data))):
            self.holds(self.convert(path, "--time", "1"), "density", self.COLUMNS, (10, 20, 30), scalar)
            self.assertEqual(self.report(path, "--time", "1")["time"], 3.5)
            self.assertIn("the first of 2 steps", self.notes(path))
        (self.dir / "out.vdb").unlink()
        mixed = "TransformMatrix = 1 0 0 0 0 1 0 0 0 0 1 0.5 0 0 0 1"
        self.refused(self.write("c.mha", meta(mixed, **four), data), "turns or inverts the fourth axis")
        self.refused(self.write("c.mha", meta("Offset = 1 2 3", **four), data), "Offset is not 4 numbers")
        self.refused(self.write("c.mha", meta(**four), SHORTS), "at least 480 bytes")
        self.refused(self.write("c.mha", meta(NDims="4", DimSize="1 1 1 200000"), bytes(400000)),
                     "200000 time steps, more than 100000")

    def test_refuses_a_metaimage_value_that_is_not_a_number_and_names_it(self):
        words = list(map(str, SCALARS))
        words[6] = "x7"
        text = meta(BinaryData="False")
        self.refused(self.write("a.mha", text, " ".join(words)),
                     "value 7 is not a number: correct the value")
        # The file has enough bytes, but too few values.
        self.refused(self.write("a.mha", text, " ".join(map(str, SCALARS[:100])) + " " * 100),
                     "the values end too early: copy or export the file again")

    def test_applies_slope_and_offset_of_a_metaimage(self):
        path = self.write("a.mha", meta("ElementToIntensityFunctionSlope = 0.5",
                                        "ElementToIntensityFunctionOffset = 3"), SHORTS)
        self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0),
                   lambda i, j, k: 0.5 * scalar(i, j, k) + 3)

    def test_reports_the_rounding_of_integer_vectors_that_were_rotated(self):
        data = struct.pack("<360i", *(2 ** 24 + 2 * int(c) + 1 for p in INDICES
                                      for c in vector(*p)))
        path = self.write("a.mha", meta("ElementNumberOfChannels = 3",
                                        "AnatomicalOrientation = RAI", kind="MET_INT"), data)
        self.assertIn("rounded", self.notes(path))

    def test_option_as_is_refused_if_it_does_not_match_the_number_of_components(self):
        one = self.write("one.mha", meta(), SHORTS)
        three = self.write("three.mha", meta("ElementNumberOfChannels = 3", kind="MET_FLOAT"),
                           VECTORS)
        self.refused(one, "has one value per voxel, not the 3 of a vector", "--as", "vector")
        self.refused(three, "has 3 values per voxel, not the 6 of a tensor", "--as", "tensor")
        self.convert(three, "--as", "vector")
        (self.dir / "out.vdb").unlink()
        nii = self.write("a.nii", nifti((4, 5, 6, 1, 3), *FLOAT, intent=1007), PLANES)
        self.refused(nii, "not the 6 of a tensor", "--as", "tensor")

    def test_refuses_metaimage_headers_with_numbers_out_of_range(self):
        for field in ("ElementToIntensityFunctionSlope", "ElementToIntensityFunctionOffset",
                      "ElementNumberOfChannels", "HeaderSize"):
            for value in ("1e999", "nan", "1x"):
                self.refused(self.write("a.mha", meta(f"{field} = {value}"), SHORTS),
                             f"the field {field} is not a number")
        self.refused(self.write("a.mha", meta("ElementSpacing = 1 1 -1e999"), SHORTS),
                     "ElementSpacing is not 3")
        self.convert(self.write("a.mha", meta("ElementSpacing = +1 1. 1e0"), SHORTS))

    def test_reports_an_output_that_exceeds_the_file_size_limit(self):
        noise = os.urandom(2 * 50 ** 3)
        path = self.write("a.mha", meta(DimSize="50 50 50"), noise)
        words = [str(BIN / "palpate-import"), str(path), str(self.dir / "out.vdb")]
        done = process.run(["prlimit", f"--fsize={2 ** 16}", *words], capture_output=True,
                              text=True, timeout=120)
        self.assertEqual(done.returncode, 2)
        self.assertIn(f"{self.dir / 'out.vdb'}: it cannot be written (File too large)", done.stderr)
        self.assertEqual(os.listdir(self.dir), ["a.mha"])

    def test_an_import_does_not_replace_an_output_that_is_a_pipe(self):
        path = self.write("a.mha", meta(), SHORTS)
        pipe = self.dir / "pipe.vdb"
        os.mkfifo(pipe)
        os.symlink("pipe.vdb", self.dir / "link.vdb")
        os.symlink("round", self.dir / "round")
        for out in (pipe, self.dir / "link.vdb"):
            self.refused(path, "it is a pipe or a device: name a file", out=out)
        self.assertTrue(pipe.is_fifo())
        self.refused(path, "pipe or a device", "--scene", str(pipe))
        self.refused(path, "symbolic links", "--scene", str(self.dir / "round" / "a.json"))
        # For a series, the message names the file of a step.
        os.mkfifo(self.dir / "out_0001.vdb")
        self.refused(self.write("a.nii", nifti((4, 5, 6, 2), *SHORT), SHORTS * 2),
                     "out_0001.vdb: it is a pipe", "--time", "all")

    @suite.smoke
    def test_refuses_damaged_metaimages(self):
        self.write("a.raw", SHORTS)
        self.refused(self.write("a.mha", meta(), SHORTS[:100]), "truncated")
        self.refused(self.write("a.mhd", meta(data="none.raw")), "none.raw cannot be read")
        self.refused(self.write("a.mhd", meta(data="")), "has no ElementDataFile")
        self.refused(self.write("a.mhd", meta().rsplit("Element", 1)[0]),
                     "has no ElementDataFile")
        self.refused(self.write("a.mhd", meta(data="LIST\nnone.raw")), "none.raw cannot be read")
        self.refused(self.write("a.mhd", meta(data="%s%n 1 6 1")), "pattern")
        self.refused(self.write("a.mhd", meta(data="s%02d.raw 0 5 1")), "")
        packed = zlib.compress(os.urandom(240))
        for short in (packed[:100], packed[:-4], packed[:-1], zlib.compress(SHORTS[:-1])):
            self.refused(self.write("a.mha", meta(CompressedData="True"), short), "truncated")
        self.refused(self.write("a.mha", meta(CompressedData="True"), bytes(200)), "damaged")
        self.write("a.zraw", zlib.compress(SHORTS)[:100])
        self.refused(self.write("a.mhd", meta(CompressedData="True", data="a.zraw")), "a.zraw is truncated")
        self.refused(self.write("a.mha", meta(kind="MET_WHAT"), SHORTS), "MET_WHAT")
        self.refused(self.write("a.mha", meta(BinaryData="False"), "word " * 100), "not a number")
        self.refused(self.write("a.mha", meta("HeaderSize = 9999999"), SHORTS), "truncated")
        self.refused(self.write("a.mhd", meta(data="LIST\n" + "a.raw\n" * 4)), "4 data files")
        self.refused(self.write("a.mha", meta("TransformMatrix = 1 0 0 0"), SHORTS), "9 numbers")
        self.refused(self.write("a.mha", meta("Offset = a b c"), SHORTS), "3 numbers")
        self.refused(self.write("a.mha", meta("TransformMatrix = 1 0 0 1 0 0 0 0 1"), SHORTS),
                     "no volume")
        self.refused(self.write("a.mha", meta(ObjectType="Tube"), SHORTS), "Tube")
        self.refused(self.write("a.mha", meta(NDims="2", DimSize="4 30"), SHORTS), "2 dimensions")
        self.refused(self.write("a.mha", meta(NDims="5", DimSize="4 5 3 2 1"), SHORTS),
                     "5 dimensions")
        self.refused(self.write("a.mha", meta(NDims=None), SHORTS), "no NDims")

    def test_flipped_bits_in_a_compressed_metaimage_are_refused_or_change_no_voxel(self):
        for pack in (zlib.compress, gzip.compress):
            self.bits_are_guarded("a.mha", meta(CompressedData="True"), pack(SHORTS))

    @suite.smoke
    def test_refuses_metaimages_with_sizes_out_of_range(self):
        for sizes in ("100000 100000 100000", "4000000000 2 2", "0 5 6", "-4 5 6", "4 5", "x y z"):
            self.refused(self.write("a.mha", meta(DimSize=sizes), SHORTS), "a.mha")
            self.refused(self.write("a.mha", meta(DimSize=sizes, CompressedData="True"),
                                    zlib.compress(SHORTS)), "a.mha")
        self.refused(self.write("a.mha", meta("ElementNumberOfChannels = 1000000"), SHORTS),
                     "Channels")


def nifti(dims, kind, bits, *, intent=0, sform=None, qfac=None, slope=0.0, inter=0.0, units=2,
          pixdim=(1.0, 1.0, 1.0), step=0.0, magic=b"n+1\0", order="<"):
    h = bytearray(348)
    dims = list(dims)
    struct.pack_into(order + "i", h, 0, 348)
    struct.pack_into(order + "8h", h, 40, len(dims), *dims, *([1] * (7 - len(dims))))
    struct.pack_into(order + "h", h, 68, intent)
    struct.pack_into(order + "hh", h, 70, kind, bits)
    struct.pack_into(order + "8f", h, 76, 1.0 if qfac is None else qfac, *pixdim, step, 0, 0, 0)
    struct.pack_into(order + "f", h, 108, 352.0 if magic == b"n+1\0" else 0.0)
    struct.pack_into(order + "ff", h, 112, slope, inter)
    h[123] = units
    if qfac is not None:
        struct.pack_into(order + "h", h, 252, 1)
        struct.pack_into(order + "6f", h, 256, 0, 0, 0, 5, 6, 7)  # identity rotation, and an offset
    if sform is not None:
        struct.pack_into(order + "h", h, 254, 1)
        for row in range(3):
            struct.pack_into(order + "4f", h, 280 + 16 * row, *sform[row])
    h[344:348] = magic
    return bytes(h) + (b"\0\0\0\0" if magic == b"n+1\0" else b"")


def nifti2(dims, kind, bits, *, rows=None, quaternion=None, order="<", magic=b"n+2\0\r\n\x1a\n"):
    h = bytearray(540)
    dims = list(dims)
    struct.pack_into(order + "i", h, 0, 540)
    h[4:12] = magic
    struct.pack_into(order + "hh", h, 12, kind, bits)
    struct.pack_into(order + "8q", h, 16, len(dims), *dims, *([1] * (7 - len(dims))))
    struct.pack_into(order + "8d", h, 104, 1.0, 2.0, 3.0, 4.0, 0, 0, 0, 0)
    struct.pack_into(order + "q", h, 168, 544)
    struct.pack_into(order + "dd", h, 176, 0.5, 3.0)
    h[240:244] = b"scan"
    if quaternion is not None:
        struct.pack_into(order + "i", h, 344, 1)
        struct.pack_into(order + "6d", h, 352, *quaternion, 5, 6, 7)
    if rows is not None:
        struct.pack_into(order + "i", h, 348, 1)
        struct.pack_into(order + "12d", h, 400, *(v for row in rows for v in row))
    struct.pack_into(order + "i", h, 500, 2)
    return bytes(h) + b"\0\0\0\0"


SHORT = (4, 16)
FLOAT = (16, 32)


class Nifti(Case):
    ROWS = ((2, 0, 0, 10), (0.5, 3, 0.25, -20), (0, 0, 4, 30))

    def test_voxels_of_a_nifti_file_have_exact_positions(self):
        path = self.write("a.nii", nifti(SIZE, *SHORT, sform=self.ROWS), SHORTS)
        out = self.convert(path)
        self.holds(out, "density", COLUMNS, AT, scalar)
        self.says_patient(out, says=True)
        mirrored = ((-2, 0, 0, 10), (0.5, 3, 0.25, -20), (0, 0, 4, 30))
        path = self.write("a.nii", nifti(SIZE, *SHORT, sform=mirrored), SHORTS)
        self.holds(self.convert(path), "density", ((-2, 0.5, 0), (0, 3, 0), (0, 0.25, 4)), AT,
                   scalar)
        for qfac in (1.0, -1.0):
            path = self.write("a.nii", nifti(SIZE, *SHORT, qfac=qfac, pixdim=(1, 2, 3)), SHORTS)
            out = self.convert(path)
            self.holds(out, "density", ((1, 0, 0), (0, 2, 0), (0, 0, 3 * qfac)), (5, 6, 7), scalar)
            self.says_patient(out, says=True)
        path = self.write("a.nii", nifti(SIZE, *SHORT, pixdim=(1, 2, 3)), SHORTS)
        out = self.convert(path)
        self.holds(out, "density", ((1, 0, 0), (0, 2, 0), (0, 0, 3)), (0, 0, 0), scalar)
        self.says_patient(out, says=False)

    @suite.smoke
    def test_reads_the_rotation_of_a_nifti_file_from_its_quaternion(self):
        half = 0.5 ** 0.5
        # The rotations are a quarter turn about z, half a turn about x (the first component is then 0), and half a turn
        # about y by a quaternion that is longer than 1, as after rounding.
        for quaternion, columns in (((0, 0, half), ((0, 2, 0), (-3, 0, 0), (0, 0, 4))),
                                    ((1, 0, 0), ((2, 0, 0), (0, -3, 0), (0, 0, -4))),
                                    ((0, 1 + 1e-7, 0), ((-2, 0, 0), (0, 3, 0), (0, 0, -4)))):
            path = self.write("a.nii", nifti2(SIZE, *SHORT, quaternion=quaternion), SHORTS)
            self.holds(self.convert(path), "density", columns, (5, 6, 7),
                       lambda i, j, k: 0.5 * scalar(i, j, k) + 3)

    @suite.smoke
    def test_reads_files_of_nifti_version_2(self):
        for order, values in (("<", SHORTS), (">", BIG_SHORTS)):
            path = self.write("a.nii", nifti2(SIZE, *SHORT, rows=self.ROWS, order=order), values)
            self.holds(self.convert(path), "density", COLUMNS, AT,
                       lambda i, j, k: 0.5 * scalar(i, j, k) + 3)
        header = self.write("a.hdr", nifti2(SIZE, *SHORT, magic=b"ni2\0\r\n\x1a\n"))
        self.write("a.img", bytes(544) + SHORTS)
        self.holds(self.convert(header), "density", ((2, 0, 0), (0, 3, 0), (0, 0, 4)), (0, 0, 0),
                   lambda i, j, k: 0.5 * scalar(i, j, k) + 3)
        self.refused(self.write("a.nii", nifti2(SIZE, *SHORT)[:400]), "truncated: it has 400 of 540 bytes")

    @suite.smoke
    def test_reads_gzipped_byte_swapped_scaled_and_paired_nifti_files(self):
        path = self.write("a.nii.gz", gzip.compress(nifti(SIZE, *SHORT) + SHORTS))
        self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)
        path = self.write("a.nii", nifti(SIZE, *SHORT, order=">"), BIG_SHORTS)
        self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)
        path = self.write("a.nii", nifti(SIZE, *SHORT, slope=0.5, inter=3.0), SHORTS)
        self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0),
                   lambda i, j, k: 0.5 * scalar(i, j, k) + 3)
        header = self.write("a.hdr", nifti(SIZE, *SHORT, magic=b"ni1\0"))
        image = self.write("a.img", SHORTS)
        for path in (header, image):
            self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)

    def test_the_first_time_step_of_a_nifti_series_is_imported_by_default(self):
        more = struct.pack("<240h", *SCALARS, *(-v for v in SCALARS))
        path = self.write("a.nii", nifti((4, 5, 6, 2), *SHORT, step=2.5), more)
        self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)
        self.assertNotIn("time step", self.notes(path))
        path = self.write("a.nii", nifti((4, 5, 6, 2), *SHORT), more)
        self.assertIn("no valid time step (pixdim[4]): a step of 1 is assumed", self.notes(path))
        path = self.write("a.nii", nifti((4, 5, 6, 1), *SHORT), SHORTS)
        self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)

    def test_a_time_step_without_contrast_becomes_a_frame_of_the_sequence(self):
        """A sequence needs all frames. A constant step keeps its value; one without data gets the last background."""
        def frame(radius):
            return [100.0 if sum((c - 4) ** 2 for c in (i, j, k)) < radius ** 2 else 7.0
                    for k in range(9) for j in range(9) for i in range(9)]
        steps = [[7.0] * 729, frame(2), [0.0] * 729, [math.nan] * 729, frame(3)]
        path = self.write("a.nii", nifti((9, 9, 9, 5), *FLOAT, step=0.5),
                          *(struct.pack("<729f", *s) for s in steps))
        notes = self.series(path)
        for says in ("density: all voxels have the same value", "background of the last step whose values vary, 7"):
            self.assertIn(says, notes)
        for n, middle in enumerate((7, 100, 0, 7, 100)):
            row = self.sample(self.dir / f"out_{n:04d}.vdb", "density", [(4, 4, 4)])[0]
            self.assertEqual((float(row["value"]), row["inside"]), (middle, "1"))
        scene = {"palpate": 1, "volumes": {"g": {"file": "out_%04d.vdb", "frames": {"rate": 2},
                                                 "place": {"scale": 0.001}}},
                 "modes": [{"mode": "isosurface", "of": "g", "value": 50, "strength": 5}]}
        done = process.run([str(BIN / "palpate"), "check", str(self.write("s.json", json.dumps(scene)))],
                           capture_output=True, text=True, timeout=120)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        # The import of the first step alone is refused, because the step is constant.
        self.refused(path, "all voxels have the same value")

    def series(self, path):
        done = process.run([str(BIN / "palpate-import"), str(path), str(self.dir / "out.vdb"), "--json",
                            "--time", "all"], capture_output=True, text=True, timeout=120)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        return "\n".join(note for step in json.loads(done.stdout) for note in step["notes"])

    def test_a_displacement_field_of_zeros_is_imported(self):
        path = self.write("zero.nii", nifti((4, 5, 6, 1, 3), *FLOAT, intent=1006), bytes(4 * 360))
        out = self.convert(path)
        self.holds(out, "vector", IDENTITY, (0, 0, 0), lambda *_: (0.0, 0.0, 0.0))
        # A warp can use a zero field as its reference phase.
        field = [v for c in (0.1, 0.2, 0.3) for v in [c] * 120]
        (self.dir / "u_0001.vdb").write_bytes(out.read_bytes())
        other = self.write("one.nii", nifti((4, 5, 6, 1, 3), *FLOAT, intent=1006), struct.pack("<360f", *field))
        (self.dir / "u_0002.vdb").write_bytes(self.convert(other).read_bytes())
        body = self.write("b.nii", nifti(SIZE, *SHORT), SHORTS)
        (self.dir / "b.vdb").write_bytes(self.convert(body).read_bytes())
        warp = {"field": "u", "times": [0, 1]}
        scene = {"palpate": 1, "volumes": {
            "u": {"file": "u_%04d.vdb", "place": {"scale": 0.001}},
            "b": {"file": "b.vdb", "place": {"scale": 0.001, "warp": warp}}},
            "modes": [{"mode": "isosurface", "of": "b", "value": 50, "strength": 5}]}
        done = process.run([str(BIN / "palpate"), "check", str(self.write("s.json", json.dumps(scene)))],
                           capture_output=True, text=True, timeout=120)
        self.assertEqual((done.returncode, done.stderr), (0, ""))

    @suite.smoke
    def test_the_fifth_dimension_of_a_nifti_file_becomes_the_components_of_vectors(self):
        for intent in (1007, 1006):
            path = self.write("a.nii", nifti((4, 5, 6, 1, 3), *FLOAT, intent=intent,
                                             sform=self.ROWS), PLANES)
            self.holds(self.convert(path), "vector", COLUMNS, AT, vector)
        # The slices run from top to bottom.
        path = self.write("a.nii", nifti((4, 5, 6, 1, 3), *FLOAT, intent=1007, qfac=-1.0), PLANES)
        self.holds(self.convert(path), "vector", ((1, 0, 0), (0, 1, 0), (0, 0, -1)), (5, 6, 7),
                   vector)

    @suite.smoke
    def test_reads_nifti_files_of_symmetric_matrices_as_tensors(self):
        # The order is xx yx yy zx zy zz. The elements xx, yy, zy and zz are 1.
        planes = [v * within(p) for v in (1, 0, 1, 0, 1, 1) for p in INDICES]
        path = self.write("a.nii", nifti((4, 5, 6, 1, 6), *FLOAT, intent=1005),
                          struct.pack("<720f", *planes))
        self.holds(self.convert(path), "tensor_direction", IDENTITY, (0, 0, 0),
                   lambda *_: (0.0, 0.5 ** 0.5, 0.5 ** 0.5))
        self.holds(self.dir / "out.vdb", "tensor_diffusivity", IDENTITY, (0, 0, 0), lambda *_: 1.0)

    def test_reads_vectors_in_four_dimensions_as_fsl_writes_them(self):
        # Radiological order: the voxels' x axis points to the left. Components are along the voxel axes.
        left = ((-2, 0, 0, 0), (0, 3, 0, 0), (0, 0, 4, 0))
        path = self.write("a.nii", nifti((4, 5, 6, 3), *FLOAT, sform=left), PLANES)
        self.holds(self.convert(path, "--as", "vector"), "vector",
                   ((-2, 0, 0), (0, 3, 0), (0, 0, 4)), (0, 0, 0),
                   lambda i, j, k: (-1.0 - i, 20.0 + j, 300.0 + k))
        # Neurological order: the voxels' x axis points to the right, and FSL mirrors x.
        right = ((2, 0, 0, 0), (0, 0, 4, 0), (0, -3, 0, 0))
        path = self.write("a.nii", nifti((4, 5, 6, 3), *FLOAT, sform=right), PLANES)
        self.holds(self.convert(path, "--as", "vector"), "vector",
                   ((2, 0, 0), (0, 0, -3), (0, 4, 0)), (0, 0, 0),
                   lambda i, j, k: (-1.0 - i, 300.0 + k, -20.0 - j))
        self.refused(path, "3 volumes", "--as", "tensor")

    @suite.smoke
    def test_reads_tensors_in_four_dimensions_as_fsl_writes_them(self):
        # The order is xx xy xz yy yz zz along the voxel axes, whose x points to the left. xx, xy, yy and zz are 1.
        planes = [v for v in (1, 1, 0, 1, 0, 1) for _ in range(120)]
        left = ((-1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0))
        path = self.write("a.nii", nifti((4, 5, 6, 6), *FLOAT, sform=left),
                          struct.pack("<720f", *planes))
        self.holds(self.convert(path, "--as", "tensor"), "tensor_direction",
                   ((-1, 0, 0), (0, 1, 0), (0, 0, 1)), (0, 0, 0),
                   lambda *_: (0.5 ** 0.5, -(0.5 ** 0.5), 0.0))
        self.refused(path, "6 volumes", "--as", "vector")

    @suite.smoke
    def test_refuses_nifti_files_of_unsupported_kinds(self):
        self.refused(self.write("a.nii", nifti(SIZE, 128, 24), bytes(360)), "colours")
        self.refused(self.write("a.nii", nifti(SIZE, 2304, 32), bytes(480)), "colours")
        self.refused(self.write("a.nii", nifti(SIZE, 32, 64), bytes(960)), "complex")
        self.refused(self.write("a.nii", nifti((4, 5, 6, 1, 2), *FLOAT), bytes(960)), "2 values")
        self.refused(self.write("a.nii", nifti((4, 30), *SHORT), SHORTS), "flat")

    @suite.smoke
    def test_refuses_damaged_nifti_files(self):
        whole = nifti(SIZE, *SHORT) + SHORTS
        self.refused(self.write("a.nii", whole[:500]), "truncated")
        packed = gzip.compress(nifti(SIZE, *SHORT) + os.urandom(240))
        self.refused(self.write("a.nii.gz", packed[:-100]), "a.nii.gz")
        # Flips a bit of the final checksum.
        packed = gzip.compress(nifti(SIZE, *SHORT) + SHORTS)
        self.refused(self.write("a.nii.gz", packed[:-8] + bytes([packed[-8] ^ 1]) + packed[-7:]),
                     "damaged")
        # Truncates the trailer, for an image and for a series of which one step is imported.
        two = gzip.compress(nifti((4, 5, 6, 2), *SHORT) + SHORTS + SHORTS)
        for whole_packed in (packed, two):
            for cut in (1, 4, 8, 9):
                self.refused(self.write("a.nii.gz", whole_packed[:-cut]), "truncated")
        self.refused(self.write("a.hdr", nifti(SIZE, *SHORT, magic=b"ni1\0")), "a.img cannot be read")
        os.symlink("a.img", self.dir / "a.img")
        self.refused(self.dir / "a.hdr", "a.img cannot be read")
        os.symlink("round.nii", self.dir / "round.nii")
        self.refused(self.dir / "round.nii", "symbolic links")
        self.refused(self.write("a.nii", nifti(SIZE, 1536, 128), bytes(2000)), "a.nii")
        self.refused(self.write("a.nii", nifti(SIZE, 77, 16), SHORTS), "a.nii")
        self.refused(self.write("a.nii", nifti(SIZE, 16, 16), SHORTS), "a.nii")
        flat = ((1, 0, 0, 0), (1, 0, 0, 0), (0, 0, 1, 0))
        self.refused(self.write("a.nii", nifti(SIZE, *SHORT, sform=flat), SHORTS), "no volume")

    def test_flipped_bits_in_a_compressed_nifti_file_are_refused_or_change_no_voxel(self):
        self.bits_are_guarded("a.nii.gz", "", gzip.compress(nifti(SIZE, *SHORT) + SHORTS))

    def test_recognises_gzip_by_its_first_bytes_and_not_by_the_file_name(self):
        whole = nifti((4, 5, 6, 400), *SHORT) + SHORTS * 400
        path = self.write("a.nii", gzip.compress(whole))
        self.assertLess(path.stat().st_size, len(whole) / 100)
        self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)
        path = self.write("a.nii.gz", whole)
        self.holds(self.convert(path), "density", IDENTITY, (0, 0, 0), scalar)
        (self.dir / "out.vdb").unlink()
        self.refused(self.write("a.nii.gz", whole[:-240]), "96112 of at least 96352 bytes")
        self.write("b.hdr", gzip.compress(nifti(SIZE, *SHORT, magic=b"ni1\0")))
        self.write("b.img", gzip.compress(SHORTS))
        self.holds(self.convert(self.dir / "b.img"), "density", IDENTITY, (0, 0, 0), scalar)
        (self.dir / "out.vdb").unlink()
        for name, data in (("a.mha", meta()), ("a.vti", "<VTKFile>")):
            self.refused(self.write(name, gzip.compress(data.encode() + SHORTS)), "gunzip")

    def test_reports_rounding_of_scaled_values(self):
        large = struct.pack("<120i", *(2 ** 24 + 2 ** 20 * v + 1 for v in SCALARS))
        long = struct.pack("<120q", *(2 ** 53 + 2 * v + 1 for v in SCALARS))
        wide = struct.pack("<120q", *(2 ** 53 + 2 ** 40 * v + 1 for v in SCALARS))
        huge = struct.pack("<120f", *(1e30 * v for v in SCALARS))
        for data, kind, scale, says in (
                (SHORTS, SHORT, {}, ""), (SHORTS, SHORT, {"slope": 0.1, "inter": -1024}, ""),
                (SHORTS, SHORT, {"slope": 1.0, "inter": 1e9}, "rounded"),
                (large, (8, 32), {}, "rounded"), (large, (8, 32), {"slope": 0.5}, "rounded"),
                (wide, (1024, 64), {}, "rounded"),
                (long, (1024, 64), {"slope": 1.0, "inter": -2.0 ** 53}, "rounded"),
                (huge, FLOAT, {"slope": 2.0}, ""), (huge, FLOAT, {"slope": 1e6}, "beyond")):
            told = self.notes(self.write("a.nii", nifti(SIZE, *kind, **scale), data))
            self.assertTrue(says in told if says else not told, (kind, scale, told))

    @suite.smoke
    def test_refuses_nifti_files_with_sizes_out_of_range(self):
        for dims in ((32767, 32767, 32767), (32767, 32767, 32767, 32767, 3), (-4, 5, 6),
                     (0, 5, 6)):
            self.refused(self.write("a.nii", nifti(dims, *SHORT), SHORTS), "a.nii")
            self.refused(self.write("a.nii.gz", gzip.compress(nifti(dims, *SHORT) + SHORTS)),
                         "a.nii.gz")


class Memory(Case):
    def test_volumes_that_exceed_the_memory_are_refused_before_they_are_loaded(self):
        side, count = 128, 60
        values = random.Random(7).randbytes(2 * side ** 3)
        volume = self.convert(self.write("a.nrrd", nrrd(sizes=f"{side} {side} {side}"), "\n", values))
        volumes = {f"v{n}": {"file": volume.name, "smooth": 0.1 + 0.01 * n, "place": {"unit": "mm"}}
                   for n in range(count)}
        mode = {"mode": "isosurface", "of": "v0", "value": 0, "strength": 1}
        scene = self.write("s.json", json.dumps({"palpate": 1, "volumes": volumes, "modes": [mode]}))
        done, line = refusal(self, self.dir, lambda: process.run(
            ["bash", "-c", 'ulimit -v 450000; exec "$0" "$@"', str(BIN / "palpate"), "check", str(scene)],
            capture_output=True, text=True, timeout=120))
        need = round(4e-6 * side ** 3 * count)
        self.assertRegex(line, rf"memory: {count} volumes need at least {need} MB, but [0-9]+ MB are available \(the "
                               r"largest volume: .*out.vdb, 8 MB\): use smaller volumes")
        self.assertEqual(done.returncode, 2)


class FillValues(Case):
    """Imports of images with fill values that the header does not state."""

    def image(self, values, kind="float"):
        letter = {"float": "f", "double": "d", "short": "h", "int": "i"}[kind]
        return self.write("a.nii", nifti(SIZE, *{"float": FLOAT, "double": (64, 64), "short": SHORT,
                                                 "int": (8, 32)}[kind]),
                          struct.pack(f"<120{letter}", *values))

    @suite.smoke
    def test_fill_values_are_missing_data_and_are_reported(self):
        for fill, kind in ((-9999, "float"), (-999, "short"), (-32768, "short"), (1e20, "float"),
                           (9.96921e36, "float"), (-1.7e308, "double"), (-2 ** 31, "int"),
                           (-99999.9, "float"), (-1e34, "double")):
            values = [fill if i % 7 == 3 else i % 31 + 270 for i in range(120)]
            path = self.image(values, kind)
            report = self.report(path)
            grid = report["grids"][0]
            self.assertEqual(grid["holes"], 17, (fill, kind))
            self.assertEqual((grid["lowest"], grid["highest"]), (270, 300))
            self.assertIn("counts as missing data: the data are between 270 and 300",
                          report["notes"][0])
            # After resampling, no voxel mixes data with the fill value.
            grid = self.report(path, "--voxel", "0.5")["grids"][0]
            self.assertGreaterEqual(grid["lowest"], 270)
            self.assertLessEqual(grid["highest"], 300)

    def test_several_fill_values_of_one_image_are_missing_data(self):
        values = [(-9999, -99999, 1e30)[i % 3] if i % 5 == 0 else i % 31 for i in range(120)]
        report = self.report(self.image(values))
        self.assertEqual(report["grids"][0]["holes"], 24)
        self.assertEqual(len([n for n in report["notes"] if "missing data" in n]), 3)

    def test_values_that_only_resemble_fill_values_are_kept_as_data(self):
        ramp = [i % 31 + 270 for i in range(120)]
        for values in ([0, -999] * 60,                        # two labels
                       [0, 1, -32768] + [-20000] * 117,       # nearer than the range of the others
                       [-1000, -999, 3000] * 40,              # next to other values
                       [50000] + ramp[1:],                    # one bright voxel
                       # steel in tissue [Pa]
                       [2.1e11] * 10 + [1000 + i for i in range(110)],
                       # a dense bubble in a plasma [1/m^3], and a shock [Pa]
                       [1e16] * 10 + [1e14 + 1e12 * i for i in range(110)],
                       [1e12] * 10 + [2e11 + 1e9 * i for i in range(110)]):
            report = self.report(self.image(values))
            self.assertEqual(report["grids"][0]["holes"], 0, values[:3])

    def test_both_values_of_an_image_with_two_values_are_data(self):
        for values, named in (([20, -9999] * 60, "-9999"), ([0, 1e30] * 60, "1e+30")):
            report = self.report(self.image(values))
            self.assertEqual(report["grids"][0]["holes"], 0)
            self.assertIn("both count as data, although programs write "
                          f"{named} for missing data", report["notes"][0])
        self.assertEqual(self.report(self.image([0, 255] * 60))["notes"], [])

    def test_the_lowest_integer_marks_missing_data_also_after_scaling(self):
        values = [-32768 if i % 7 == 3 else i % 31 for i in range(120)]
        path = self.write("a.nii", nifti(SIZE, *SHORT, slope=0.1),
                          struct.pack("<120h", *values))
        report = self.report(path)
        self.assertEqual(report["grids"][0]["holes"], 17)
        self.assertIn("the value -3276.8 counts as missing data", report["notes"][0])

    def test_two_opposite_fill_values_are_both_missing_data(self):
        values = [(-9999, 9999)[i % 2] if i % 5 == 0 else i % 31 for i in range(120)]
        self.assertEqual(self.report(self.image(values))["grids"][0]["holes"], 24)
        values = [9999 if i % 5 == 0 else i % 31 for i in range(120)]
        self.assertEqual(self.report(self.image(values))["grids"][0]["holes"], 0)


class Holes(Case):
    """Imports of images with voxels without data."""

    def image(self, fill=float("nan")):
        """Writes a ramp of 20^3 voxels, of which 5 x 5 x 20 have no data."""
        self.ramp = lambda i, j, k: i + 2 * j + 3 * k
        values = [fill if i < 5 and j < 5 else self.ramp(i, j, k)
                  for k in range(20) for j in range(20) for i in range(20)]
        return self.write("a.nii", nifti((20, 20, 20), *FLOAT), struct.pack("<8000f", *values))

    @suite.smoke
    def test_values_are_never_interpolated_from_missing_data(self):
        random.seed(4)
        points = [[random.uniform(0, 19) for _ in range(3)] for _ in range(1000)]
        for fill in float("nan"), -9999.0:
            for words in (), ("--voxel", "0.7"):
                out = self.convert(self.image(fill), *words)
                rows = self.sample(out, "density", points)
                inside = 0
                for p, row in zip(points, rows):
                    if p[0] >= 6 or p[1] >= 6:
                        # Cubes end up to 0.7 mm before the last voxel of the image.
                        self.assertTrue(row["inside"] == "1" or max(p) > 18, p)
                    if row["inside"] == "1" and max(p) < 18:
                        self.assertAlmostEqual(float(row["value"]), self.ramp(*p), delta=1e-3)
                        inside += 1
                self.assertGreater(inside, 600)

    def test_the_edge_of_missing_data_is_not_a_surface(self):
        out = self.convert(self.image())
        scene = self.dir / "scene.json"
        scene.write_text(json.dumps({
            "palpate": 1, "volumes": {"v": {"file": str(out), "place": {"scale": 0.002}}},
            "modes": [{"name": "s", "mode": "isosurface", "of": "v", "value": 40,
                       "solid": "above", "strength": 20}]}))

        # All values on this path are below 40 up to the missing data; the background is 60.
        done = process.run([str(BIN / "palpate"), "press", str(scene), "--json", "--at",
                            "0.018,0.004,0.006", "--along", "-0.018,0,0"], capture_output=True,
                           text=True, timeout=120)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(json.loads(done.stdout)["force_max"]["force"], 0.0)

    def test_an_image_without_missing_data_keeps_inactive_surroundings(self):
        values = [100 * (2 <= i < 4) for k in range(6) for j in range(6) for i in range(6)]
        path = self.write("a.nii", nifti((6, 6, 6), *FLOAT), struct.pack("<216f", *values))
        grid = self.report(path)["grids"][0]
        self.assertEqual((grid["active_voxels"], grid["holes"]), (72, 0))
        self.assertNotIn(b"inactive_is_missing", (self.dir / "out.vdb").read_bytes())


class LostDigits(Case):
    def test_the_rounding_of_doubles_to_floats_is_reported_if_it_is_large_for_their_range(self):
        for base, rounded in (1.6e9, True), (0.0, False), (1e5, False):
            values = [base + i + 10 * (i % 7) for i in range(120)]
            path = self.write("a.nii", nifti(SIZE, 64, 64), struct.pack("<120d", *values))
            self.assertEqual("values are rounded to floats, by up to" in self.notes(path), rounded,
                             base)


class WholeNumbers(Case):
    """Whole numbers that floats cannot represent are imported with an offset, which keeps their differences."""

    TYPES = {"int32": ("i", (8, 32), "int"), "uint32": ("I", (768, 32), "unsigned int"),
             "int64": ("q", (1024, 64), "int64"), "uint64": ("Q", (1280, 64), "uint64")}

    def files(self, values, kind):
        """Writes the values as NIfTI, NRRD and raw. Yields each path with the options for its import."""
        letter, nifti_type, nrrd_type = self.TYPES[kind]
        data = struct.pack(f"<120{letter}", *values)
        yield self.write("a.nii", nifti(SIZE, *nifti_type), data), ()
        yield self.write("a.nrrd", nrrd("content: a", kind=nrrd_type) + "\n", data), ()
        yield (self.write("a.raw", data),
               ("--raw", json.dumps({"size": list(SIZE), "type": kind, "name": "a"})))

    def value_offset(self, volume):
        """Returns the offset from the metadata, in OpenVDB's encoding of int64."""
        entry = b"".join(struct.pack("<i", len(w)) + w for w in (b"value_offset", b"int64"))
        data = volume.read_bytes()
        self.assertEqual(data.count(entry), 1)
        at = data.index(entry) + len(entry)
        self.assertEqual(struct.unpack("<i", data[at:at + 4]), (8,))
        return struct.unpack("<q", data[at + 4:at + 12])[0]

    @suite.smoke
    def test_differences_of_large_whole_numbers_are_exact(self):
        for kind, base in (("int64", 2 ** 53), ("int64", -2 ** 62), ("int32", 2 ** 30),
                           ("int32", -2 ** 31), ("uint32", 2 ** 32 - 2000), ("uint64", 2 ** 62),
                           ("int64", 2 ** 63 - 1001)):
            values = [base + (i * 367) % 1001 for i in range(120)]
            for path, words in self.files(values, kind):
                report = self.report(path, *words)
                (grid,) = report["grids"]
                offset = grid["value_offset"]
                self.assertEqual(len([n for n in report["notes"] if str(offset) in n]), 1, report)
                self.assertEqual([n for n in report["notes"] if "rounded" in n], [])
                volume = self.dir / "out.vdb"
                self.assertEqual(self.value_offset(volume), offset)
                rows = self.sample(volume, grid["name"], INDICES)
                found = [offset + int(float(row["value"])) for row in rows]
                self.assertEqual(found, values, (kind, base, path))
                self.assertEqual(offset + int(grid["lowest"]), min(found), (kind, base))

    def test_whole_numbers_above_the_signed_64_bit_range_are_stored_with_an_offset(self):
        values = [2 ** 64 - 1001 + (i * 367) % 1001 for i in range(120)]
        for path, words in self.files(values, "uint64"):
            (grid,) = self.report(path, *words)["grids"]
            rows = self.sample(self.dir / "out.vdb", grid["name"], INDICES)
            found = [grid["value_offset"] + int(float(row["value"])) for row in rows]
            self.assertEqual(found, values)

    def test_large_whole_numbers_beside_missing_data_are_stored_with_an_offset(self):
        for kind, fill, base in (("int64", -2 ** 63, 2 ** 53), ("int32", -2 ** 31, 2 ** 30),
                                 ("int64", -9999, 2 ** 52)):
            values = [fill if i % 7 == 3 else base + i % 31 for i in range(120)]
            for path, words in self.files(values, kind):
                (grid,) = self.report(path, *words)["grids"]
                self.assertEqual(grid["holes"], 17)
                self.assertEqual(grid["value_offset"] + int(grid["lowest"]), base)
                self.assertEqual(grid["value_offset"] + int(grid["highest"]), base + 30)

    def test_whole_numbers_get_no_offset_if_they_fit_into_floats_or_differ_too_much(self):
        for kind, values, rounded in (
                ("int32", [2 ** 24 - i for i in range(120)], False),
                ("int64", [2 ** 30 * (i % 9) + i for i in range(120)], True)):
            for path, words in self.files(values, kind):
                report = self.report(path, *words)
                self.assertNotIn("value_offset", report["grids"][0])
                self.assertEqual(any("rounded" in n for n in report["notes"]), rounded)

    def test_option_iso_takes_a_value_of_the_file_even_if_the_grid_has_an_offset(self):
        size, base = 24, 2 ** 53
        data = struct.pack(f"<{size ** 3}q", *(
            base + (1000 if math.dist((i, j, k), (11.5, 11.5, 11.5)) < 8 else 100)
            for k in range(size) for j in range(size) for i in range(size)))
        path = self.write("a.raw", data)
        words = ("--raw", json.dumps({"size": [size] * 3, "type": "int64"}))
        scene = self.dir / "a.json"
        (grid,) = self.report(path, *words, "--scene", str(scene))["grids"]
        (iso,) = [m["value"] for m in json.loads(scene.read_text())["modes"] if m["mode"] == "isosurface"]
        self.assertTrue(0 < iso < 900 and grid["value_offset"] == base + 100, (iso, grid))
        # --iso refers to the file's values.
        report = self.report(path, *words, "--iso", str(base + 550), "--voxel", "1")
        self.assertNotIn("value_offset", report["grids"][0])
        rows = self.sample(self.dir / "out.vdb", report["grids"][0]["name"],
                           [(11.5, 11.5, 3.5), (11.5, 11.5, 2.5), (11.5, 11.5, 4.5)])
        self.assertAlmostEqual(float(rows[0]["value"]), 0.0, delta=0.5)
        self.assertGreater(float(rows[1]["value"]), 0.0)
        self.assertLess(float(rows[2]["value"]), 0.0)

    def test_all_time_steps_of_a_series_are_stored_with_the_same_offset(self):
        data = struct.pack("<240q", *(2 ** 53 + 100 * (i // 120) + i % 31 for i in range(240)))
        path = self.write("a.nii", nifti((*SIZE, 2), 1024, 64), data)
        steps = self.report(path, "--time", "all")
        self.assertEqual([step["grids"][0]["value_offset"] for step in steps], [2 ** 53] * 2)
        self.assertEqual([step["grids"][0]["lowest"] for step in steps], [0, 100])


class OtherFormats(Case):
    def test_a_file_of_an_unsupported_format_is_refused_with_the_name_of_the_format(self):
        numpy = b"\x93NUMPY\1\0v\0{'descr': '<f4', 'fortran_order': False, 'shape': (6, 5, 4), }"
        header = bytearray(1024)
        header[208:212] = b"MAP "
        for name, content, says in (
                ("a.npy", numpy.ljust(128) + bytes(480), "NumPy (.npy), which palpate does not"),
                ("a.mrc", bytes(header), "MRC"),
                ("a.mgz", gzip.compress(struct.pack(">7i", 1, 4, 5, 6, 1, 3, 0).ljust(284, b"\0")),
                 "MGH (FreeSurfer"),
                ("a.xdmf", b'<?xml version="1.0"?>\n<Xdmf Version="3.0"></Xdmf>', "XDMF"),
                ("b.mnc", b"\x89HDF\r\n\x1a\n" + bytes(800) + b"minc-2.0" + bytes(100), "MINC")):
            self.refused(self.write(name, content), says)

    def test_a_neuroglancer_volume_is_refused_with_the_name_of_the_format(self):
        folder = self.dir / "segmentation"
        (folder / "8_8_40").mkdir(parents=True)
        scale = {"key": "8_8_40", "size": [64, 64, 64], "resolution": [8, 8, 40], "encoding": "raw",
                 "chunk_sizes": [[64, 64, 64]], "voxel_offset": [0, 0, 0]}
        info = {"data_type": "uint8", "num_channels": 1, "scales": [scale], "type": "image"}
        for content in {"@type": "neuroglancer_multiscale_volume", **info}, info:
            (folder / "info").write_text(json.dumps(content))
            self.refused(folder, "the folder is a neuroglancer precomputed volume")
            self.refused(folder / "info", "a neuroglancer precomputed volume, which palpate does not import")
        (folder / "info").write_text("{}")
        self.refused(folder, "")


if __name__ == "__main__":
    suite.main(sys.argv[2:])
