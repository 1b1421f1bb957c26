#!/usr/bin/env python3
"""Tests palpate-import with DICOM series that this test writes: dicom_test.py BIN_DIR."""
import csv
import io
import json
import math
import os
import random
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

CT = "1.2.840.10008.5.1.4.1.1.2"
MR = "1.2.840.10008.5.1.4.1.1.4"
ENHANCED_CT = "1.2.840.10008.5.1.4.1.1.2.1"
REPORT = "1.2.840.10008.5.1.4.1.1.88.11"
PLAIN = "1.2.840.10008.1.2.1"
RLE = "1.2.840.10008.1.2.5"
JPEG = "1.2.840.10008.1.2.4.70"
DEFLATED = "1.2.840.10008.1.2.1.99"
CAPTURE = "1.2.840.10008.5.1.4.1.1.7"
SEGMENTATION = "1.2.840.10008.5.1.4.1.1.66.4"
SECRET = "Mustermann^Erika"


def element(tag, vr, value):
    """Returns a data element with explicit VR, little endian."""
    group, number = tag >> 16, tag & 0xFFFF
    if vr == "SQ":
        value = b"".join(struct.pack("<HHI", 0xFFFE, 0xE000, len(item)) + item for item in value)
    elif vr in ("US", "SS"):
        value = struct.pack("<H" if vr == "US" else "<h", value)
    elif vr == "FD":
        value = struct.pack("<d", value)
    elif not isinstance(value, bytes):
        value = value.encode()
    if len(value) % 2:
        value += b"\0" if vr in ("UI", "OB", "OW") else b" "
    head = struct.pack("<HH", group, number) + vr.encode()
    if vr in ("OB", "OW", "SQ", "UN", "UT"):
        return head + struct.pack("<HI", 0, len(value)) + value
    return head + struct.pack("<H", len(value)) + value


def packed_bits(data):
    """Encodes with PackBits RLE, without runs."""
    out = b""
    for i in range(0, len(data), 128):
        part = data[i:i + 128]
        out += bytes([len(part) - 1]) + part
    return out + b"\0" * (len(out) % 2)


def rle(pixels):
    """Encodes 16-bit pixels with RLE: all high bytes, then all low bytes."""
    high, low = packed_bits(pixels[1::2]), packed_bits(pixels[0::2])
    return struct.pack("<16I", 2, 64, 64 + len(high), *[0] * 13) + high + low


def lossless_jpeg(pixels, columns, rows):
    """Encodes 16-bit pixels as lossless JPEG, predicted from the left neighbour. The 17 categories have codes of 5
    bits."""
    values = struct.unpack(f"<{columns * rows}H", pixels)
    bits = ""
    for at, value in enumerate(values):
        before = (values[at - 1] if at % columns else values[at - columns]) if at else 1 << 15
        difference = (value - before + 32767) % 65536 - 32767
        length = abs(difference).bit_length()
        bits += f"{length:05b}"
        if 0 < length < 16:
            bits += f"{difference if difference > 0 else difference - 1 + (1 << length):0{length}b}"
    bits += "1" * (-len(bits) % 8)
    data = int(bits, 2).to_bytes(len(bits) // 8, "big").replace(b"\xff", b"\xff\0")
    frame = struct.pack(">HHBHHBBBB", 0xFFC3, 11, 16, rows, columns, 1, 1, 0x11, 0)
    table = struct.pack(">HHB", 0xFFC4, 19 + 17, 0) + bytes([0, 0, 0, 0, 17] + [0] * 11 +
                                                            list(range(17)))
    scan = struct.pack(">HHBBBBBB", 0xFFDA, 8, 1, 1, 0, 1, 0, 0)
    whole = b"\xff\xd8" + frame + table + scan + data + b"\xff\xd9"
    return whole + b"\0" * (len(whole) % 2)


def encapsulated(item):
    part = lambda number, length: struct.pack("<HHI", 0xFFFE, number, length)
    return part(0xE000, 0) + part(0xE000, len(item)) + item + part(0xE0DD, 0)


def bit_rle(frames):
    """Encodes frames of bits with RLE: eight pixels per byte, the lowest bit first."""
    items = struct.pack("<HHI", 0xFFFE, 0xE000, 0)
    for bits in frames:
        data = bytes(sum(bit << n for n, bit in enumerate(bits[at:at + 8]))
                     for at in range(0, len(bits), 8))
        item = struct.pack("<16I", 1, 64, *[0] * 14) + packed_bits(data)
        items += struct.pack("<HHI", 0xFFFE, 0xE000, len(item)) + item
    return items + struct.pack("<HHI", 0xFFFE, 0xE0DD, 0)


def data_set(file):
    """Returns the offset of the data set, after the preamble and group 0002."""
    return 144 + struct.unpack("<I", file[140:144])[0]


def deflated(file):
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    at = data_set(file)
    return file[:at] + packer.compress(file[at:]) + packer.flush()


def dicom(elements, pixels=b"", kind=CT, syntax=PLAIN):
    """Returns a whole file. `elements` maps tags to (VR, value), or to None for a missing element. With RLE or
    JPEG, pixels that begin with an item are already encoded."""
    meta = element(0x00020002, "UI", kind) + element(0x00020003, "UI", "1.2.3.4")
    meta += element(0x00020010, "UI", syntax)
    body = b"".join(element(tag, *elements[tag]) for tag in sorted(elements) if elements[tag])
    if syntax in (RLE, JPEG):
        size = [elements[tag][1] for tag in (0x00280011, 0x00280010)]
        if not pixels.startswith(b"\xfe\xff\x00\xe0"):
            pixels = encapsulated(rle(pixels) if syntax == RLE else lossless_jpeg(pixels, *size))
        body += struct.pack("<HH2sHI", 0x7FE0, 0x10, b"OB", 0, 0xFFFFFFFF) + pixels
    elif pixels:
        body += element(0x7FE00010, "OW", pixels)
    return (b"\0" * 128 + b"DICM" + element(0x00020000, "UL", struct.pack("<I", len(meta))) + meta +
            body)


def text(numbers):
    return "\\".join(f"{n:.12g}"[:16] for n in numbers)


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


class Volume:
    """A series in which voxel (i, j, k) has the value stored(i, j, k) and the centre at(i, j, k) in LPS."""

    def __init__(self, size=(5, 4, 6), row=(1, 0, 0), column=(0, 1, 0), across=0.5, down=0.75,
                 origin=(-10.25, 20.5, 100.0), step=None, uid="1.2.3", number=1,
                 description="Thorax", modality="CT", **more):
        self.size, self.row, self.column = size, row, column
        self.across, self.down, self.origin = across, down, origin
        self.step = step or [2.5 * c for c in cross(row, column)]
        self.uid, self.number, self.description = uid, number, description
        self.modality, self.more = modality, more
        self.stored = lambda i, j, k: 1000 + 7 * i + 31 * j + 101 * k
        self.slope, self.intercept = 1, -1024

    def at(self, i, j, k):
        return [self.origin[a] + self.row[a] * self.across * i + self.column[a] * self.down * j +
                self.step[a] * k for a in range(3)]

    def pixels(self, k):
        columns, rows, _ = self.size
        return b"".join(struct.pack("<h", self.stored(i, j, k))
                        for j in range(rows) for i in range(columns))

    def elements(self, k, **more):
        out = {
            0x00080008: ("CS", "ORIGINAL\\PRIMARY\\AXIAL"),
            0x00080016: ("UI", CT),
            0x00080060: ("CS", self.modality),
            0x00081030: ("LO", "Chest study"),
            0x0008103E: ("LO", self.description),
            0x00100010: ("PN", SECRET),
            0x00100020: ("LO", "Patient 4711"),
            0x00100030: ("DA", "19640229"),
            0x0020000E: ("UI", self.uid),
            0x00200011: ("IS", str(self.number)),
            0x00200032: ("DS", text(self.at(0, 0, k))),
            0x00200037: ("DS", text([*self.row, *self.column])),
            0x00280002: ("US", 1),
            0x00280004: ("CS", "MONOCHROME2"),
            0x00280010: ("US", self.size[1]),
            0x00280011: ("US", self.size[0]),
            0x00280030: ("DS", text([self.down, self.across])),
            0x00280100: ("US", 16),
            0x00280101: ("US", 16),
            0x00280102: ("US", 15),
            0x00280103: ("US", 1),
            0x00281052: ("DS", text([self.intercept])),
            0x00281053: ("DS", text([self.slope])),
        }
        for tags in (self.more, more):
            out.update({int(tag[1:], 16): value for tag, value in tags.items()})
        return out

    def file(self, k, syntax=PLAIN, **more):
        return dicom(self.elements(k, **more), self.pixels(k), syntax=syntax)

    def write(self, folder, prefix="IM", shuffle=True, syntax=PLAIN, slices=None):
        """Writes the series with file names in another order than the slices."""
        folder.mkdir(parents=True, exist_ok=True)
        names = list(range(self.size[2]))
        if shuffle:
            random.Random(1).shuffle(names)
        for k in slices or range(self.size[2]):
            (folder / f"{prefix}{names[k]:03d}").write_bytes(self.file(k, syntax))
        return folder


def turned(a, b, c):
    """Returns the rows of the matrix of a rotation by c about x, then b about y, then a about z [rad]."""
    ca, sa, cb, sb, cc, sc = (f(t) for t in (a, b, c) for f in (math.cos, math.sin))
    return [[ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc],
            [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc],
            [-sb, cb * sc, cb * cc]]


class Case(unittest.TestCase):
    def setUp(self):
        holder = tempfile.TemporaryDirectory()
        self.addCleanup(holder.cleanup)
        self.dir = Path(holder.name)
        self.out = self.dir / "out.vdb"

    def run_import(self, source, *more):
        return process.run([str(BIN / "palpate-import"), str(source), str(self.out), *more],
                              capture_output=True, text=True, timeout=120)

    def imported(self, source, *more):
        done = self.run_import(source, *more)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertNotIn(SECRET.encode(), self.out.read_bytes())
        self.assertNotIn(b"Patient 4711", self.out.read_bytes())
        self.assertNotIn(b"19640229", self.out.read_bytes())

    def report(self, source, *more):
        done = self.run_import(source, "--json", *more)
        self.assertEqual(done.returncode, 0, done.stderr)
        return json.loads(done.stdout)

    def refused(self, source, *more, says):
        """Checks that the import is refused: one line on stderr, nothing on stdout, no file left."""
        done, line = refusal(self, self.dir, lambda: self.run_import(source, *more))
        self.assertEqual(done.returncode, 2, line)
        for part in [says] if isinstance(says, str) else says:
            self.assertIn(part, line)
        self.assertNotIn(SECRET, line)

    def sampled(self, points, interpolation):
        """Returns the values at points (RAS) [mm], and whether there are data."""
        table = "x,y,z\n" + "".join(",".join(repr(c) for c in p) + "\n" for p in points)
        done = process.run([str(BIN / "palpate"), "sample", str(self.out), "--grid", "density",
                               "--points", "-", "--interpolation", interpolation], input=table,
                              capture_output=True, text=True, timeout=120)
        self.assertEqual(done.returncode, 0, done.stderr)
        return [(float(row["value"]), row["inside"] == "1")
                for row in csv.DictReader(io.StringIO(done.stdout))]

    def same(self, volume, expected=None, hidden=(), places=4):
        """Checks that every voxel has its value at its position, and that hidden voxels have no data."""
        expected = expected or (lambda i, j, k: volume.slope * volume.stored(i, j, k) +
                                volume.intercept)
        voxels = [(i, j, k) for k in range(volume.size[2]) for j in range(volume.size[1])
                  for i in range(volume.size[0])]
        # Converts LPS to RAS.
        ras = [(-p[0], -p[1], p[2]) for p in (volume.at(*v) for v in voxels)]
        # Trilinear values at voxel centres have rounding errors; the nearest voxel's value is exact.
        between = self.sampled(ras, "trilinear")
        nearest = self.sampled(ras, "nearest")
        without = {v for v, (_, inside) in zip(voxels, nearest) if not inside}
        self.assertLessEqual(set(hidden), without)
        # Voxels equal to the surroundings are inactive, too.
        self.assertLessEqual(len({expected(*v) for v in without - set(hidden)}), 1)
        for voxel, (value, _), (own, _) in zip(voxels, between, nearest):
            if voxel not in hidden:
                self.assertAlmostEqual(own, expected(*voxel), 2, voxel)
                self.assertAlmostEqual(value, expected(*voxel), places, voxel)


class Places(Case):
    @suite.smoke
    def test_imports_an_axial_series_and_ignores_other_files(self):
        volume = Volume()
        folder = volume.write(self.dir / "ct")
        (folder / "readme.txt").write_text("no image")
        (folder / "empty").write_bytes(b"")
        (folder / "inner").mkdir()
        self.imported(folder)
        self.same(volume)
        self.assertIn(b"space\6\0\0\0string\3\0\0\0RAS", self.out.read_bytes())

    def test_imports_an_oblique_sagittal_series(self):
        rotation = turned(0.2, -0.15, 0.1)
        axes = [[sum(rotation[a][b] * v[b] for b in range(3)) for a in range(3)]
                for v in ((0, 1, 0), (0, 0, -1))]
        for modality in "MR", "CT":
            volume = Volume(row=axes[0], column=axes[1], modality=modality)
            self.imported(volume.write(self.dir / modality))
            # The file states directions with 12 digits.
            self.same(volume, places=3)

    def test_imports_a_coronal_series_in_reverse_order(self):
        volume = Volume(row=(-1, 0, 0), column=(0, 0, -1), step=[0, 1.25, 0])
        self.imported(volume.write(self.dir / "mr"))
        self.same(volume)

    @suite.smoke
    def test_a_tilted_gantry_shears_the_imported_volume(self):
        tilt = math.radians(20)
        # The slices are tilted about x, but the table moves along z.
        volume = Volume(column=(0, math.cos(tilt), math.sin(tilt)), step=[0, 0, 2.5])
        self.imported(volume.write(self.dir / "ct"))
        self.same(volume)

    def test_importing_one_file_of_a_series_imports_the_whole_series(self):
        volume = Volume()
        folder = volume.write(self.dir / "ct")
        Volume(uid="9.9", size=(3, 3, 3)).write(folder, "other")
        for name in "IM000", "IM004":
            self.imported(folder / name)
            self.same(volume)
        os.chdir(folder)
        self.addCleanup(os.chdir, "/")
        self.imported("IM003")
        self.same(volume)

    @suite.smoke
    def test_the_frames_of_one_file_become_the_slices_of_a_volume(self):
        volume = Volume()
        # The frames are not in the order of the slices.
        order = [3, 0, 5, 1, 4, 2]

        def frame(k):
            groups = {
                0x00209113: [element(0x00200032, "DS", text(volume.at(0, 0, k)))],
                0x00289145: [element(0x00281052, "DS", "-1024") + element(0x00281053, "DS", "1")],
            }
            return b"".join(element(tag, "SQ", groups[tag]) for tag in sorted(groups))

        shared = element(0x00209116, "SQ",
                         [element(0x00200037, "DS", text([*volume.row, *volume.column]))])
        shared += element(0x00289110, "SQ", [
            element(0x00280030, "DS", text([volume.down, volume.across]))])
        elements = volume.elements(0, t00280008=("IS", "6"), t00200032=None, t00200037=None,
                                   t00280030=None, t00281052=None, t00281053=None,
                                   t52009229=("SQ", [shared]),
                                   t52009230=("SQ", [frame(k) for k in order]))
        file = self.dir / "enhanced.dcm"
        file.write_bytes(dicom(elements, b"".join(volume.pixels(k) for k in order), ENHANCED_CT))
        self.imported(file)
        self.same(volume)

    @suite.smoke
    def test_reads_compressed_pixels_unless_they_are_damaged(self):
        for syntax in RLE, JPEG:
            volume = Volume(size=(20, 17, 4))
            stored = volume.stored
            volume.stored = lambda i, j, k: stored(i, j, k) * (-1) ** i
            folder = volume.write(self.dir / syntax, syntax=syntax)
            self.imported(folder)
            self.same(volume)
            file = folder / "IM001"
            whole = file.read_bytes()
            file.write_bytes(whole[:len(whole) - 200])
            self.out.unlink()
            self.refused(folder, says=["IM001", "bytes are missing"])
            # Removes the only fragment.
            at = whole.index(b"OB\0\0\xff\xff\xff\xff") + 8
            file.write_bytes(whole[:at + 8] + whole[-8:])
            self.refused(folder, says="fewer pixels")
        # The pixels end in invalid codes.
        file.write_bytes(whole[:-400] + b"\xfe" * 392 + whole[-8:])
        self.refused(folder, says=["IM001: the pixels are damaged", "JPEG"])
        file.write_bytes(whole.replace(JPEG.encode(), b"1.2.840.10008.1.2.4.99"))
        self.refused(folder, says="unsupported compression (1.2.840.10008.1.2.4.99)")


    @suite.smoke
    def test_reads_files_without_preamble_and_deflated_files(self):
        volume = Volume()
        for name, syntax, made in (("no preamble", PLAIN, lambda file: file[132:]),
                                   ("no group 0002", PLAIN, lambda file: file[data_set(file):]),
                                   ("deflated", DEFLATED, deflated)):
            folder = self.dir / name
            folder.mkdir()
            for k in range(6):
                (folder / f"{k}").write_bytes(made(volume.file(k, syntax)))
            for source in folder, folder / "3":
                self.imported(source)
                self.same(volume)
        self.out.unlink()
        whole = (folder / "3").read_bytes()
        (folder / "3").write_bytes(whole[:-40])
        self.refused(folder, says=["deflated/3: ", "the deflated data set is truncated"])
        bad = bytearray(whole)
        bad[-40:-30] = b"\xff" * 10
        (folder / "3").write_bytes(bad)
        self.refused(folder, says="deflated/3: ")

    @suite.smoke
    def test_a_segmentation_of_single_bits_compressed_by_rle_is_read(self):
        volume = Volume(size=(13, 5, 6), modality="SEG")
        volume.stored = lambda i, j, k: int((i - 6) ** 2 + 4 * (j - 2) ** 2 + 4 * (k - 3) ** 2 < 30)
        volume.slope, volume.intercept = 1, 0
        shared = element(0x00209116, "SQ",
                         [element(0x00200037, "DS", text([*volume.row, *volume.column]))])
        shared += element(0x00289110, "SQ", [
            element(0x00280030, "DS", text([volume.down, volume.across]))])
        places = [element(0x00209113, "SQ", [element(0x00200032, "DS", text(volume.at(0, 0, k)))])
                  for k in range(6)]
        one = ("US", 1)
        elements = volume.elements(0, t00280008=("IS", "6"), t00200032=None, t00200037=None,
                                   t00280030=None, t00281052=None, t00281053=None, t00280100=one,
                                   t00280101=one, t00280102=("US", 0), t00280103=("US", 0),
                                   t52009229=("SQ", [shared]), t52009230=("SQ", places))
        frames = [[volume.stored(i, j, k) for j in range(5) for i in range(13)] for k in range(6)]
        file = self.dir / "segmentation.dcm"
        whole = dicom(elements, bit_rle(frames), SEGMENTATION, RLE)
        file.write_bytes(whole)
        self.imported(file)
        self.same(volume)
        # The last frame has too few pixels.
        file.write_bytes(dicom(elements, bit_rle([*frames[:5], frames[5][:40]]), SEGMENTATION, RLE))
        self.out.unlink()
        self.refused(file, says="the pixels of frame 6 are damaged (RLE)")


class Distances(Case):
    def check(self, heights, name, largest_error, **more):
        """Imports slices at `heights` [mm] with linear values, which resampling must keep. Returns folder and step."""
        volume = Volume(size=(5, 4, len(heights)), **more)
        folder = self.dir / name
        folder.mkdir()
        value = lambda i, j, z: round(1000 + 10 * i + 6 * j + 4 * z)
        for k, z in enumerate(heights):
            volume.at = lambda i, j, _, z=z: [0.5 * i, 0.75 * j, z]
            volume.stored = lambda i, j, _, z=z: value(i, j, z)
            (folder / f"{k}").write_bytes(volume.file(k, t00200013=("IS", str(k + 1))))
        grid = self.report(folder)["grids"][0]
        self.assertLess(grid["resampling"]["largest"], largest_error)
        self.assertGreater(grid["resampling"]["points"], 100)
        step = grid["voxel"][2]
        points = [(i, j, step * n) for i in range(1, 4) for j in range(1, 3)
                  for n in range(round(heights[-1] / step) + 1)]
        for (i, j, z), (found, _) in zip(points, self.sampled(
                [(-0.5 * i, -0.75 * j, z) for i, j, z in points], "trilinear")):
            self.assertAlmostEqual(found, 1000 + 10 * i + 6 * j + 4 * z - 1024, delta=0.51)
        return folder, step

    @suite.smoke
    def test_slices_at_changing_distances_are_resampled_to_even_distances(self):
        folder, step = self.check([0, 2.5, 5, 7.5, 10, 15, 20, 25], "head", 1e-6)
        self.assertAlmostEqual(step, 2.5, 9)
        notes = "\n".join(self.report(folder)["notes"])
        self.assertIn("the slices are 2.5 to 5 mm apart: they are resampled every 2.5 mm", notes)
        # Resampled slices can be resampled again, to cubes.
        cubes = self.report(folder, "--voxel", "0.25")["grids"][0]
        self.assertEqual(cubes["voxel"], [0.25] * 3)
        self.assertLess(cubes["resampling"]["largest"], 1e-6)
        _, step = self.check([0, 7.5, 15, 22.5, 35, 47.5], "abdomen", 0.01)
        self.assertAlmostEqual(step, 47.5 / 6, 9)

    def test_the_report_states_the_error_of_resampled_slices(self):
        volume = Volume(size=(5, 4, 6))
        volume.stored = lambda i, j, k: 1000 * (k % 2) + i
        heights = [0, 7.5, 15, 22.5, 35, 47.5]
        folder = self.dir / "steps"
        folder.mkdir()
        for k, z in enumerate(heights):
            volume.at = lambda i, j, _, z=z: [0.5 * i, 0.75 * j, z]
            (folder / f"{k}").write_bytes(volume.file(k))
        error = self.report(folder)["grids"][0]["resampling"]
        # The lattice has a slice at 23.75 mm, which is beyond the peak at 22.5 mm by a tenth of the gap to 35 mm.
        self.assertGreater(error["largest"], 0.05)
        self.assertLess(error["rms"], error["largest"])

    def test_only_voxels_that_are_interpolated_from_padding_have_no_data(self):
        plain = Volume().stored
        volume = Volume(size=(5, 4, 6), t00280120=("SS", -2000))
        volume.stored = lambda i, j, k: -2000 if (i, j, k) == (2, 2, 4) else plain(i, j, k)
        heights = [0, 2.5, 5, 7.5, 12.5, 17.5]
        folder = self.dir / "padded"
        folder.mkdir()
        for k, z in enumerate(heights):
            volume.at = lambda i, j, _, z=z: [0.5 * i, 0.75 * j, z]
            (folder / f"{k}").write_bytes(volume.file(k))
        self.imported(folder)
        inside = [there for _, there in self.sampled(
            [(-1.0, -1.5, 2.5 * n) for n in range(8)], "nearest")]
        self.assertEqual(inside, [True] * 4 + [False] * 3 + [True])


class Values(Case):
    @suite.smoke
    def test_reads_pixels_of_every_type_with_slope_and_intercept(self):
        # The slopes are integers or fractions, and some values exceed 16 bits.
        for slope, intercept in (1, 0), (2, -5), (0.25, 3.5), (100, -7), (-1, 0):
            volume = Volume()
            volume.slope, volume.intercept = slope, intercept
            self.imported(volume.write(self.dir / f"{slope} {intercept}"))
            self.same(volume, places=2 if slope == 100 else 4)
        for bits, representation in (12, 0), (16, 0), (16, 1):
            volume = Volume(t00280101=("US", bits), t00280102=("US", bits - 1),
                            t00280103=("US", representation))
            self.imported(volume.write(self.dir / f"{bits} {representation}"))
            self.same(volume)

    def test_each_slice_is_scaled_by_its_own_rescale_slope(self):
        volume = Volume(modality="PT")
        folder = self.dir / "pet"
        folder.mkdir()
        for k in range(6):
            (folder / f"{k}").write_bytes(volume.file(k, t00281053=("DS", f"{0.5 + k}")))
        self.imported(folder)
        self.same(volume, lambda i, j, k: (0.5 + k) * volume.stored(i, j, k) - 1024, places=2)

    @suite.smoke
    def test_voxels_with_the_padding_value_have_no_data(self):
        hidden = {(0, 0, 0), (4, 3, 5), (2, 1, 3)}
        plain = Volume().stored
        stored = lambda i, j, k: -2000 if (i, j, k) in hidden else plain(i, j, k)
        # Scanners write the padding value as a signed or as an unsigned number.
        for tag in ("SS", -2000), ("US", 63536):
            volume = Volume(t00280120=tag)
            volume.stored = stored
            self.imported(volume.write(self.dir / tag[0]))
            self.same(volume, hidden=hidden)

        values = {(0, 0, 0): -2000, (4, 3, 5): -1990, (2, 1, 3): -1980}
        volume = Volume(t00280120=("SS", -2000), t00280121=("SS", -1990))
        volume.stored = lambda i, j, k: values.get((i, j, k), plain(i, j, k))
        self.imported(volume.write(self.dir / "range"))
        self.same(volume, hidden={(0, 0, 0), (4, 3, 5)})


class Choice(Case):
    @suite.smoke
    def test_option_series_selects_one_of_several_series(self):
        first = Volume(uid="1.2.30", number=7, description="Lung 1.0")
        second = Volume(uid="1.2.4", number=9, description="Head", size=(3, 3, 3), modality="MR")
        folder = first.write(self.dir / "both")
        second.write(folder, "MR")
        (folder / "report").write_bytes(dicom({0x0020000E: ("UI", "1.2.99")}, kind=REPORT))
        self.refused(folder, says=["the input has 2 series", '1: "Lung 1.0" CT 6 images',
                                   '2: "Head" MR 3 images', "--series"])
        for name, volume in (("1", first), ("2", second), ("1.2.30", first), ("1.2.4", second),
                             ("Lung 1.0", first), ("Head", second)):
            self.imported(folder, "--series", name)
            self.same(volume)
        self.out.unlink()
        self.refused(folder, "--series", "3", says='no series matches "3"')
        self.refused(folder, "--series", "head", says="Lung 1.0")
        self.refused(folder / "report", says="no image")

    def test_refuses_a_description_that_two_series_share(self):
        folder = Volume(uid="1.1").write(self.dir / "both")
        Volume(uid="1.2").write(folder, "B")
        self.refused(folder, "--series", "Thorax", says="more than one")

    def test_finds_series_in_subfolders(self):
        first = Volume(uid="1.2.30", number=7, description="Lung 1.0")
        first.write(self.dir / "patient" / "study" / "lung")
        (self.dir / "patient" / "study" / "again").symlink_to(self.dir / "patient")
        # Pictures beside DICOM files, or beside folders that have some, are previews, which the import skips.
        for folder in (self.dir / "patient", self.dir / "patient" / "study" / "lung"):
            (folder / "preview.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(200))
        for folder in (self.dir / "patient" / "study", self.dir / "patient"):
            self.imported(folder)
            self.same(first)
        second = Volume(uid="1.2.4", number=9, description="Head", size=(3, 3, 3), modality="MR")
        second.write(self.dir / "patient" / "study" / "head")
        self.out.unlink()
        self.refused(self.dir / "patient", says=["the input has 2 series", '1: "Lung 1.0" CT 6 images',
                                                 '2: "Head" MR 3 images', "--series"])
        self.imported(self.dir / "patient", "--series", "Head")
        self.same(second)

    def test_refuses_a_folder_without_dicom_files(self):
        empty = self.dir / "empty"
        empty.mkdir()
        self.refused(empty, says="the folder has no DICOM file")
        (empty / "in" / "the" / "depth").mkdir(parents=True)
        self.refused(empty, says="the folder has no DICOM file")
        self.refused(self.dir / "none", says="no such file")


class Trouble(Case):
    @suite.smoke
    def test_refuses_a_series_with_missing_slices(self):
        volume = Volume(size=(4, 4, 30), origin=(0, 0, 0))
        self.refused(volume.write(self.dir / "one", slices=[k for k in range(30) if k != 6]),
                     says="slices are missing between z = 12.5 and 17.5 mm: 1 of 30")
        self.refused(volume.write(self.dir / "few", slices=[0, 1, 4, 5]),
                     says="slices are missing between z = 2.5 and 10 mm: 2 of 6")
        sagittal = Volume(row=(0, 1, 0), column=(0, 0, -1), origin=(0, 0, 0))
        self.refused(sagittal.write(self.dir / "x", slices=[0, 1, 3, 4]), says="x = ")

    def test_refuses_slices_that_are_not_on_a_line(self):
        volume = Volume()
        folder = volume.write(self.dir / "gap", shuffle=False)
        moved = volume.at(0, 0, 3)
        moved[0] += 1
        (folder / "IM003").write_bytes(volume.file(3, t00200032=("DS", text(moved))))
        self.refused(folder, says="the slices are not on a line: the slice at z = ")
        # An offset of less than 5 % of the spacing is ignored.
        moved = volume.at(0, 0, 3)
        moved[2] += 0.1
        (folder / "IM003").write_bytes(volume.file(3, t00200032=("DS", text(moved))))
        self.assertNotIn("resampling", self.report(folder)["grids"][0])

    def test_refuses_duplicate_slices(self):
        folder = Volume().write(self.dir / "ct")
        (folder / "copy").write_bytes((folder / "IM002").read_bytes())
        self.refused(folder, says=["2 images are at the same position, z = ", "copy", "IM002"])
        for name in os.listdir(folder):
            (folder / ("again" + name)).write_bytes((folder / name).read_bytes())
        (folder / "again" "copy").unlink()
        (folder / "copy").unlink()
        self.refused(folder, says="2 images are at the same position")

    @suite.smoke
    def test_skips_localisers_and_screen_saves_with_a_note_that_names_a_file(self):
        volume = Volume()
        for uid, number in ("1.2.3", 1), ("9.9", 2):  # in the same and in another series
            folder = volume.write(self.dir / uid)
            (folder / "scout").write_bytes(Volume(
                size=(9, 9, 1), row=(0, 1, 0), column=(0, 0, -1), uid=uid, number=number,
                description="Scout", t00080008=("CS", "ORIGINAL\\PRIMARY\\LOCALIZER")).file(0))
            screen = Volume(size=(9, 9, 1), uid="1.2.3" if number == 1 else "9.8", number=3,
                            t00200032=None, t00200037=None)
            (folder / "screen").write_bytes(dicom(screen.elements(0), screen.pixels(0), CAPTURE))
            notes = "\n".join(self.report(folder)["notes"])
            self.same(volume)
            self.assertIn("such as scout: a localiser" if number == 1 else "in scout: a localiser",
                          notes)
            if number == 2:
                self.assertIn("in screen: a screen save", notes)

    def test_skips_a_screen_save_that_has_a_position(self):
        volume = Volume()
        for z in 115.0, 101.25, 150.0:  # next to the slices, between them and far away
            folder = volume.write(self.dir / f"{z}")
            screen = Volume(origin=(-10.25, 20.5, z),
                            t00080008=("CS", "DERIVED\\SECONDARY\\SCREEN SAVE"))
            (folder / "screen").write_bytes(dicom(screen.elements(0), screen.pixels(0), CAPTURE))
            notes = "\n".join(self.report(folder)["notes"])
            self.same(volume)
            self.assertIn("such as screen: a screen save", notes)

    def test_ignores_a_structured_report_that_has_rows_and_columns(self):
        volume = Volume()
        folder = volume.write(self.dir / "ct")
        report = Volume(uid="1.2.9", modality="SR")
        (folder / "report").write_bytes(dicom(report.elements(0), kind=REPORT))
        self.imported(folder)
        self.same(volume)

    def test_refuses_big_endian_files_without_a_transfer_syntax(self):
        folder = self.dir / "big"
        folder.mkdir()
        (folder / "a").write_bytes(b"\0\x08\0\x16UI\0\x1a1.2.840.10008.5.1.4.1.1.2\0" +
                                   b"\0\x08\0\x60CS\0\x02CT")
        self.refused(folder, says="the file has big-endian values, but states no transfer syntax: "
                                  "convert it to little endian")

    def test_refuses_a_series_with_an_image_of_another_shape(self):
        folder = Volume().write(self.dir / "ct")
        Volume(size=(9, 9, 1)).write(folder, "size")
        self.refused(folder, says=["1 of 7 images differ", "such as size000", "localiser"])
        (folder / "size000").unlink()
        Volume(row=(0, 1, 0), column=(0, 0, -1), size=(5, 4, 2)).write(folder, "turned")
        self.refused(folder, says="2 of 8 images differ")

    def test_refuses_images_without_a_position(self):
        screen = Volume(t00200032=None, t00200037=None, modality="OT")
        self.refused(screen.write(self.dir / "screen"), says="do not state their position")
        part = Volume().write(self.dir / "part", shuffle=False)
        (part / "IM002").write_bytes(Volume().file(2, t00280030=None))
        self.refused(part, says="1 of 6 images do not state their position")
        for tag in ({"t00200037": ("DS", "1\\0\\0\\1\\0\\0")}, {"t00280030": ("DS", "0\\0")},
                    {"t00200037": ("DS", "0\\0\\0\\0\\0\\0")}, {"t00200032": ("DS", "0\\0")}):
            self.refused(Volume(**tag).write(self.dir / "nonsense"),
                         says="do not state their position")

    @suite.smoke
    def test_refuses_colour_images(self):
        volume = Volume(t00280002=("US", 3), t00280004=("CS", "RGB"), t00280006=("US", 0))
        volume.pixels = lambda k: bytes(5 * 4 * 3 * 2)
        self.refused(volume.write(self.dir / "rgb"), says="colour images")

    def test_refuses_a_single_slice(self):
        self.refused(Volume(size=(5, 4, 1)).write(self.dir / "one"), says="flat")

    @suite.smoke
    def test_refuses_truncated_files_and_reads_or_refuses_damaged_ones(self):
        folder = Volume().write(self.dir / "ct")
        file = folder / "IM002"
        whole = file.read_bytes()
        file.write_bytes(whole[:-10])
        for source in folder, file, folder / "IM001":
            self.refused(source, says=["IM002", "10 bytes are missing"])
        cuts = cases((len(whole) - 134) // 7, "cuts")
        for length in range(133, len(whole) - 1, max(7, (len(whole) - 134) // cuts)):
            file.write_bytes(whole[:length])
            self.refused(folder, says="IM002")
        fuzz = random.Random(3)
        for _ in range(cases(100, "damages")):
            bad = bytearray(whole)
            for _ in range(fuzz.randrange(1, 4)):
                bad[fuzz.randrange(132, len(whole))] = fuzz.randrange(256)
            file.write_bytes(bad)
            done = self.run_import(folder)
            self.assertIn(done.returncode, (0, 2), done.stderr)
            self.assertLessEqual(len(done.stderr.splitlines()), 1, done.stderr)
            self.out.unlink(missing_ok=True)

    @suite.smoke
    def test_refuses_an_image_with_fewer_pixels_than_its_size_states(self):
        volume = Volume(t00280010=("US", 60000), t00280011=("US", 60000))
        self.refused(volume.write(self.dir / "ct"), says="fewer pixels")


class Time(Case):
    def series(self, **tags):
        """Writes two time steps. The values of the later step are larger by 5000."""
        volume = Volume()
        folder = self.dir / "4d"
        folder.mkdir(exist_ok=True)
        for k in range(6):
            for t in range(2):
                own = {tag: (vr, texts[t]) for tag, (vr, texts) in tags.items()}
                volume.intercept = -1024 + 5000 * t
                (folder / f"{(5 * k + 7 * t) % 13:02d}-{k}-{t}").write_bytes(volume.file(k, **own))
        volume.intercept = -1024
        return folder, volume

    @suite.smoke
    def test_the_first_time_step_is_the_one_with_the_earliest_time(self):
        for tags in ({"t00181060": ("DS", ["20", "520"])}, {"t00200100": ("IS", ["1", "2"])},
                     {"t00080032": ("TM", ["095959.5", "100000.25"])}):
            folder, volume = self.series(**tags)
            self.imported(folder)
            self.same(volume)

    def test_images_that_differ_in_echo_time_or_diffusion_are_not_time_steps(self):
        folder, _ = self.series(t00181060=("DS", ["20", "520"]), t00180081=("DS", ["10", "90"]))
        self.refused(folder, says="differ in echo time")
        folder, _ = self.series(t00080032=("TM", ["100000", "100100"]),
                                t00189087=("FD", [0.0, 1000.0]))
        self.refused(folder, says="differ in diffusion weighting")

    @suite.smoke
    def test_refuses_a_series_of_which_one_time_step_lacks_a_slice(self):
        folder, _ = self.series(t00181060=("DS", ["20", "520"]))
        next(folder.glob("*-3-1")).unlink()
        self.refused(folder, says="2 images are at the same position")


class Phases(Case):
    """Several series of one volume: the phases of a 4-D CT."""
    SIZE = (24, 24, 24)

    def phase(self, percent, shift, **more):
        """Returns a series with a ball of soft tissue, `shift` voxels along x, above a table."""
        volume = Volume(size=self.SIZE, across=2, down=2, step=(0, 0, 2), uid=f"1.2.{percent}", number=percent + 1,
                        description=f"Gated {percent}%", **more)

        def stored(i, j, k):
            if j == 22:
                return 1324
            off = math.dist((i, j, k), (10 + shift, 11, 12))
            return round(24 + 1040 * min(1, max(0, 7.5 - off)))
        volume.stored = stored
        return volume

    @suite.smoke
    def test_the_phases_of_a_4d_ct_become_a_scene_that_plays_them(self):
        folder = self.dir / "4d"
        for percent, shift in ((50, 2), (0, 0), (20, 1)):
            self.phase(percent, shift).write(folder, f"P{percent}")
        (folder / "average").write_bytes(
            Volume(uid="1.9", description="Average", size=self.SIZE).file(0))
        scene = self.dir / "scene.json"
        self.refused(folder, says=["the input has 4 series", "with --time all, or choose a series with --series"])
        reports = self.report(folder, "--time", "all", "--scene", str(scene))
        self.assertEqual([r["time"] for r in reports], [0, 1, 2])
        notes = "\n".join(reports[0]["notes"])
        self.assertIn('skipped series 2: "Average" CT 1 image: a single image', notes)
        self.assertIn("a time step of 1 s is assumed", notes)
        for n, shift in enumerate((0, 1, 2)):
            self.out = self.dir / f"out_{n:04}.vdb"
            self.assertIn(f"Gated {(0, 20, 50)[n]}%".encode(), self.out.read_bytes())
            self.same(self.phase(0, shift))
            # The table is not in the region of the body, which each frame has.
            self.assertEqual([g["name"] for g in reports[n]["grids"]], ["density", "density_body"])
        text = json.loads(scene.read_text())
        self.assertEqual({v["file"] for v in text["volumes"].values()}, {"out_%04d.vdb"})
        self.assertEqual([v["frames"] for v in text["volumes"].values()], 2 * [{"rate": 1}])
        told = process.run([str(BIN / "palpate"), "check", str(scene), "--json"], capture_output=True, text=True,
                           timeout=120)
        self.assertEqual((told.returncode, told.stderr), (0, ""))
        self.assertEqual(json.loads(told.stdout)["volumes"]["density"]["frames"]["count"], 3)
        self.out = self.dir / "out.vdb"
        self.imported(folder, "--time", "1")
        self.same(self.phase(20, 1))

    def test_in_a_phase_without_a_table_the_region_of_the_body_is_the_whole_volume(self):
        folder = self.dir / "4d"
        for percent in (0, 50):
            phase = self.phase(percent, 0)
            if percent == 50:
                inner = phase.stored
                phase.stored = lambda i, j, k, inner=inner: 24 if j == 22 else inner(i, j, k)
            phase.write(folder, f"P{percent}")
        reports = self.report(folder, "--time", "all", "--scene", str(self.dir / "scene.json"))
        regions = [r["grids"][1]["active_voxels"] for r in reports]
        self.assertLess(regions[0], 24 ** 3 / 2)
        self.assertEqual(regions[1], 24 ** 3)

    def test_series_with_the_time_of_a_trigger_play_at_these_times(self):
        folder = self.dir / "heart"
        for n, delay in enumerate(("0", "100", "450")):
            self.phase(n, n, t00181060=("DS", delay)).write(folder, f"P{n}")
        reports = self.report(folder, "--time", "all", "--scene", str(self.dir / "scene.json"))
        self.assertEqual([r["time"] for r in reports], [0, 0.1, 0.45])
        text = json.loads((self.dir / "scene.json").read_text())
        self.assertEqual(text["volumes"]["density"]["frames"], {"times": [0, 0.1, 0.45]})

    @suite.smoke
    def test_refuses_to_join_series_that_are_not_steps_of_one_volume(self):
        folder = self.dir / "4d"
        self.phase(0, 0).write(folder, "A")
        self.phase(50, 0).write(folder, "B", slices=range(23))
        self.refused(folder, "--time", "all", says=["series 1 and 2 differ in number of images", "--series"])
        self.phase(50, 0, t00200052=("UI", "1.2.3")).write(folder, "B")
        self.refused(folder, "--time", "all", says="series 1 and 2 differ in frame of reference")
        self.phase(50, 0, t0008103E=("LO", "Gated 0%")).write(folder, "B")
        self.refused(folder, "--time", "all", says="series 1 and 2 have the same percentage")
        self.imported(folder, "--time", "0", "--series", "2")


def built_without():
    with tempfile.TemporaryDirectory() as name:
        folder = Volume().write(Path(name) / "ct")
        done = process.run([str(BIN / "palpate-import"), str(folder), f"{name}/out.vdb"],
                              capture_output=True, text=True, timeout=120)
        return "built without vtk-dicom" in done.stderr


if __name__ == "__main__":
    if built_without():
        print("palpate-import was built without vtk-dicom")
        sys.exit(77)
    suite.main(sys.argv[2:])
