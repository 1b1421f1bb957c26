#!/usr/bin/env python3
"""Tests folders of Zarr arrays and of OME-Zarr images, which this test writes: zarr_test.py BIN_DIR."""
import ctypes
import gzip
import itertools
import json
import math
import shutil
import struct
import subprocess
import sys
import zlib
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import images_test as images  # noqa: E402
import suite  # noqa: E402

BIN = Path(sys.argv[1])
SHAPE = (6, 5, 4)      # along z, y and x
CHUNKS = (4, 3, 3)     # the last chunks along each axis are incomplete
COLUMNS = images.IDENTITY
ZERO = (0, 0, 0)
CODES = {"u1": "B", "i1": "b", "u2": "H", "i2": "h", "u4": "I", "i4": "i", "u8": "Q", "i8": "q", "f4": "f", "f8": "d",
         "f2": "e", "c8": "Q"}


def library(name):
    try:
        return ctypes.CDLL(name)
    except OSError:
        return None


ZSTD, BLOSC = library("libzstd.so.1"), library("libblosc.so.1")


def zstd(data):
    out = ctypes.create_string_buffer(len(data) + 1000)
    ZSTD.ZSTD_compress.restype = ctypes.c_size_t
    size = ZSTD.ZSTD_compress(out, ctypes.c_size_t(len(out)), data, ctypes.c_size_t(len(data)), 3)
    return out.raw[:size]


def blosc(name, shuffle, width):
    def pack(data):
        out = ctypes.create_string_buffer(len(data) + 1000)
        size = BLOSC.blosc_compress_ctx(5, shuffle, ctypes.c_size_t(width), ctypes.c_size_t(len(data)), data, out,
                                        ctypes.c_size_t(len(out)), name.encode(), ctypes.c_size_t(0), 1)
        assert size > 0
        return out.raw[:size]
    return pack


# Name in the metadata, function.
CODECS = [(None, lambda data: data), ("zlib", zlib.compress), ("gzip", gzip.compress)]
CODECS += [("zstd", zstd)] if ZSTD else []
CODECS += [("blosc", blosc(name, shuffle, 2)) for name in ("lz4", "zstd", "zlib", "blosclz") for shuffle in (0, 1, 2)
           if BLOSC and (name != "zlib" or shuffle == 1)]


def value(index):
    """Returns a value that differs between neighbours in an array, and fits into a byte for SHAPE."""
    number = 1
    for n in index:
        number = number * 5 + n
    return number % 120 + 1 + (1000 * sum(index[:-3]) if len(index) > 3 else 0)


def xyz(i, j, k):
    return value((k, j, i))


def write_array(folder, shape=SHAPE, chunks=CHUNKS, dtype="<u2", order="C", separator=None, codec=CODECS[0], fill=0,
                without=(), of=value, **more):
    """Writes an array whose value at an index is of(index). Leaves out the chunks in `without`."""
    folder.mkdir(parents=True, exist_ok=True)
    meta = {"zarr_format": 2, "shape": shape, "chunks": chunks, "dtype": dtype, "order": order, "filters": None,
            "fill_value": fill, "compressor": codec[0] and {"id": codec[0]}, **more}
    if separator:
        meta["dimension_separator"] = separator
    (folder / ".zarray").write_text(json.dumps(meta))
    code = (">" if dtype[0] == ">" else "<") + CODES[dtype[1:]]
    for at in itertools.product(*(range(-(-n // c)) for n, c in zip(shape, chunks))):
        if at in without:
            continue
        inside = list(itertools.product(*(range(c) for c in chunks)))
        if order == "F":
            inside = [p[::-1] for p in itertools.product(*(range(c) for c in chunks[::-1]))]
        # Values beyond the array are part of a chunk, and mean nothing.
        indices = [tuple(a * c + n for a, c, n in zip(at, chunks, p)) for p in inside]
        data = b"".join(struct.pack(code, of(p) if all(n < s for n, s in zip(p, shape)) else 77) for p in indices)
        file = folder / (separator or ".").join(map(str, at))
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(codec[1](data))
    return folder


def write_group(folder, attributes):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / ".zgroup").write_text('{"zarr_format": 2}')
    (folder / ".zattrs").write_text(json.dumps(attributes))
    return folder


def axes(names, unit="micrometer"):
    kinds = {"t": {"type": "time", "unit": "second"}, "c": {"type": "channel"}}
    return [{"name": n, **kinds.get(n, {"type": "space", "unit": unit})} for n in names]


def scaled(*scale, translation=None):
    list_of = [{"type": "scale", "scale": scale}]
    return list_of + ([{"type": "translation", "translation": translation}] if translation else [])


def multiscales(names, *levels, **more):
    """Returns attributes. Levels are pairs of a path and transformations."""
    return {"multiscales": [{"version": "0.4", "name": "made by a test", "axes": axes(names),
                             "datasets": [{"path": path, "coordinateTransformations": transformations}
                                          for path, transformations in levels], **more}]}


class Zarr(images.Case):
    def folder(self, name="a.zarr"):
        shutil.rmtree(self.dir / name, ignore_errors=True)
        return self.dir / name

    def test_a_zarr_array_is_read_exactly_without_compression_and_with_zlib_gzip_zstd_and_blosc(self):
        for n, codec in enumerate(CODECS):
            with self.subTest(codec=codec[0], number=n):
                out = self.convert(write_array(self.folder(), codec=codec))
                self.holds(out, "density", COLUMNS, ZERO, xyz, images.INDICES[::3])

    @suite.smoke
    def test_a_zarr_array_is_read_exactly_in_every_order_and_type(self):
        for dtype, order, separator in (
                ("|u1", "C", None), ("|i1", "F", "."), ("<u2", "F", "/"), (">u2", "C", "/"), ("<i2", "C", "."),
                (">i2", "F", "."), ("<u4", "C", None), (">i4", "F", "/"), ("<u8", "C", "."), (">i8", "C", "/"),
                ("<f2", "C", "."), (">f2", "F", "/"),
                ("<f4", "F", "."), (">f4", "C", None), ("<f8", "C", "/"), (">f8", "F", ".")):
            with self.subTest(dtype=dtype, order=order, separator=separator):
                codec = CODECS[1] if dtype[1] == "f" else CODECS[0]
                less = 0 if dtype[1] == "u" else 60
                out = self.convert(write_array(self.folder("plain"), dtype=dtype, order=order, separator=separator,
                                               codec=codec, of=lambda p, less=less: value(p) - less))
                self.holds(out, "density", COLUMNS, ZERO, lambda *p, less=less: xyz(*p) - less, images.INNER)
        self.assertIn("states no spacing", self.notes(self.dir / "plain"))

    def test_missing_chunks_of_a_zarr_array_have_its_fill_value(self):
        gone = [(1, 1, 1), (0, 0, 0)]

        def expected(fill):
            return lambda i, j, k: fill if (k // 4, j // 3, i // 3) in gone else xyz(i, j, k)
        for dtype, fill, says in (("<u2", 7, 7), ("<i4", -3, -3), ("<f4", 2.5, 2.5), ("<u2", None, 0)):
            for order in "C", "F":
                folder = write_array(self.folder(), dtype=dtype, fill=fill, order=order, without=gone)
                self.holds(self.convert(folder), "density", COLUMNS, ZERO, expected(says), images.INDICES[::2])
        self.assertIn("2 of 8 chunks are missing: their voxels have the array's fill value, 0", self.notes(folder))

    def test_voxels_with_the_fill_value_nan_have_no_data(self):
        folder = write_array(self.folder(), dtype="<f4", fill="NaN", without=[(1, 1, 1)])
        self.assertEqual(self.report(folder)["grids"][0]["holes"], 4)

    def test_positions_of_an_ome_zarr_image_follow_its_scales_and_translations(self):
        folder = write_group(self.folder(), multiscales(
            "zyx", ("0", scaled(4, 3, 2, translation=(40, 30, 20))), ("s/1", scaled(8, 6, 4)),
            coordinateTransformations=scaled(0.5, 2, 1, translation=(1, 2, 3))))
        write_array(folder / "0")
        write_array(folder / "s" / "1", of=lambda p: 300 - value(p))
        out = self.convert(folder)
        # Scale of the image times that of the level; the image's transformation is applied last.
        self.holds(out, "density", ((2, 0, 0), (0, 6, 0), (0, 0, 2)), (23, 62, 21), xyz)
        self.assertIn("the image has 2 levels", self.notes(folder))
        self.assertNotIn("the image has 2 levels", self.notes(folder, "--level", "0"))
        out = self.convert(folder, "--level", "1")
        self.holds(out, "density", ((4, 0, 0), (0, 12, 0), (0, 0, 4)), (3, 2, 1), lambda *p: 300 - xyz(*p))
        self.refused(folder, 'the image has no level 2: give 0 to 1', "--level", "2")

    def test_the_unit_of_an_ome_zarr_image_is_kept_and_unlike_units_are_converted(self):
        attributes = multiscales("zyx", ("0", scaled(400, 0.3, 0.2)))
        folder = write_group(self.folder(), attributes)
        write_array(folder / "0")
        self.assertEqual(self.length_unit(self.convert(folder)), b"um")
        for unit in ("nanometer", "nm"):
            attributes["multiscales"][0]["axes"][0]["unit"] = unit
            out = self.convert(write_group(folder, attributes))
            self.assertEqual(self.length_unit(out), b"um")
            self.holds(out, "density", ((0.2, 0, 0), (0, 0.3, 0), (0, 0, 0.4)), ZERO, xyz)
        attributes["multiscales"][0]["axes"][0]["unit"] = "furlong"
        self.assertIn("different units (micrometer, micrometer, furlong)",
                      self.notes(write_group(folder, attributes)))

    def length_unit(self, volume):
        """Returns the metadata "length_unit" of the first grid, in OpenVDB's encoding of strings."""
        key = b"".join(struct.pack("<i", len(w)) + w for w in (b"length_unit", b"string"))
        rest = volume.read_bytes().split(key)[1]
        return rest[4:4 + struct.unpack("<i", rest[:4])[0]]

    def test_voxels_of_an_ome_zarr_image_with_the_axes_x_z_y_keep_their_positions(self):
        folder = write_group(self.folder(), multiscales("xzy", ("0", scaled(2, 3, 4, translation=(1, 2, 5)))))
        write_array(folder / "0")
        # The array's axes are x, z and y: i is along y, j along z, and k along x.
        self.holds(self.convert(folder), "density", ((0, 4, 0), (0, 0, 3), (2, 0, 0)), (1, 5, 2), xyz)

    @suite.smoke
    def test_channels_of_an_ome_zarr_image_become_arrays_and_times_become_steps(self):
        attributes = multiscales("tczyx", ("0", scaled(1.5, 1, 1, 1, 1, translation=(10, 0, 0, 0, 0))))
        attributes["omero"] = {"channels": [{"label": "DAPI"}, {"color": "FF0000"}]}
        folder = write_group(self.folder(), attributes)
        write_array(folder / "0", shape=(2, 2, *SHAPE), chunks=(1, 2, *CHUNKS), separator="/",
                    of=lambda p: value(p[2:]) + 1000 * p[1] + 2000 * p[0])
        for step in 0, 1:
            out = self.convert(folder, "--time", str(step))
            for channel, name in enumerate(("DAPI", "channel_1")):
                self.holds(out, name, COLUMNS, ZERO,
                           lambda *p, add=1000 * channel + 2000 * step: xyz(*p) + add)
        report = self.report(folder, "--field", "channel_1", "--time", "1")
        self.assertEqual([grid["name"] for grid in report["grids"]], ["channel_1"])
        steps = self.report(folder, "--field", "DAPI", "--time", "all")
        self.assertEqual([step["time"] for step in steps], [10, 11.5])
        self.refused(folder, 'no array "CD4" can be imported: choose from DAPI, channel_1', "--field", "CD4")

    def test_a_zarr_group_without_an_image_names_the_folders_in_it(self):
        folder = write_group(self.folder("many.zarr"), {"bioformats2raw.layout": 3})
        write_array(folder / "1")
        write_group(folder / "0", {})
        self.refused(folder, "without an OME-Zarr image (\"multiscales\"): give one of the folders in it: 0, 1")
        self.refused(folder / "0", "give the folder of an OME-Zarr image or of a Zarr array")

    def test_metadata_of_zarr_that_palpate_cannot_read_are_refused_by_name(self):
        folder = self.folder()
        for says, more in (
                ("the array has filters, which palpate does not read: delta", {"filters": [{"id": "delta"}]}),
                ("compressed by bz2, which palpate does not read", {"codec": ("bz2", zlib.compress)}),
                ("(dtype) is <c8, which palpate does not read", {"dtype": "<c8"}),
                ("(dtype) is a structure", {"dtype": [["r", "<u1"]]}),
                ("\"order\" is not C or F", {"order": "K"}),
                ("\"fill_value\" is 70000, which is not a value", {"fill": 70000}),
                ("\"zarr_format\" is not 2", {"zarr_format": 3}),
                ("\"shape\" and \"chunks\" have different numbers of axes", {"chunks": (2, 2)}),
                ("the Zarr array has 2 axes", {"chunks": (2, 2), "shape": (5, 5)}),
                ("a size in \"chunks\" is not a whole number", {"chunks": (0, 2, 2)})):
            with self.subTest(says=says):
                meta = {"zarr_format": 2, "shape": SHAPE, "chunks": CHUNKS, "dtype": "<u2", "order": "C",
                        "filters": None, "fill_value": more.pop("fill", 0), "compressor": None}
                if "codec" in more:
                    meta["compressor"] = {"id": more.pop("codec")[0]}
                meta.update((key, text) for key, text in more.items() if key != "of")
                folder.mkdir(exist_ok=True)
                (folder / ".zarray").write_text(json.dumps(meta))
                self.refused(folder, says)
        (folder / ".zarray").write_text("[")
        self.refused(folder, "the metadata are not JSON")
        (folder / ".zarray").unlink()
        self.refused(folder, "none of the files .zarray, .zgroup and .zattrs")

    def test_metadata_of_ome_zarr_that_palpate_cannot_read_are_refused_by_name(self):
        level = ("0", scaled(1, 1, 1))
        folder = write_array(self.folder() / "0").parent
        for says, attributes in (
                ("the image is OME-Zarr 0.3", multiscales("zyx", level, version="0.3")),
                ("the image has 2 axes in space", multiscales("yx", ("0", scaled(1, 1)))),
                ("the scale of level 0 is not a list of 3 positive numbers", multiscales("zyx", ("0", scaled(1, 1)))),
                ("the scale of level 0 is not", multiscales("zyx", ("0", scaled(1, -1, 1)))),
                ("no transformation \"scale\"", multiscales("zyx", ("0", []))),
                ("the transformation \"affine\"", multiscales("zyx", ("0", [{"type": "affine"}]))),
                ("the axes a and c are both", multiscales(
                    "aczyx", level, axes=[{"name": "a", "type": "channel"}, *axes("czyx")])),
                ("the array has 3 axes, but its image has 4", multiscales("czyx", ("0", scaled(1, 1, 1, 1)))),
                ("the data file 7/.zarray cannot be read", multiscales("zyx", ("7", scaled(1, 1, 1)))),
                ("in another folder", multiscales("zyx", ("../b", scaled(1, 1, 1)))),
                ("\"multiscales\" is not a list", {"multiscales": 3})):
            with self.subTest(says=says):
                write_array(self.dir / "b")
                self.refused(write_group(folder, attributes), says)

    def test_options_of_other_formats_are_refused_for_a_zarr_folder(self):
        folder = write_array(self.folder())
        self.refused(folder, "is read as Zarr, which does not use this option", "--series", "1")
        self.refused(folder, "a single Zarr array, which has no levels", "--level", "0")
        self.refused(self.write("a.nrrd", "NRRD0004\n\n"), "which does not use this option", "--level", "1")

    def test_other_formats_of_chunks_are_refused_with_a_remedy(self):
        for name, text, says in (
                ("zarr.json", {"zarr_format": 3}, "a Zarr store of version 3"),
                ("attributes.json", {"n5": "2.5.1"}, "an N5 container"),
                ("attributes.json", {"dimensions": [4, 4, 4], "blockSize": [2, 2, 2]}, "an N5 container"),
                ("info", {"@type": "neuroglancer_multiscale_volume"}, "a neuroglancer precomputed volume")):
            folder = self.folder("other")
            folder.mkdir()
            (folder / name).write_text(json.dumps(text))
            self.refused(folder, f"the folder is {says}, which palpate does not import: convert it to OME-Zarr 0.4")

    def test_a_damaged_chunk_is_refused_with_the_name_of_its_file(self):
        for codec in CODECS[:4] + CODECS[5::5]:
            folder = write_array(self.folder(), codec=codec)
            chunk = folder / "1.0.1"
            whole = chunk.read_bytes()
            for damaged in whole[:len(whole) // 2], b"", whole[:20] + bytes(40), bytes(len(whole)), whole * 2000:
                if (codec[0], len(damaged)) in ((None, len(whole)), ("zlib", 2000 * len(whole))):
                    # Without compression, zeros are values, too. zlib ignores bytes after its stream.
                    continue
                with self.subTest(codec=codec[0], bytes=len(damaged)):
                    chunk.write_bytes(damaged)
                    self.refused(folder, "1.0.1")
            chunk.write_bytes(codec[1](bytes(2 * 36 + 2)))
            self.refused(folder, "1.0.1")

    def test_a_chunk_that_is_not_a_file_of_the_store_is_refused(self):
        folder = write_array(self.folder())
        chunk = folder / "0.0.0"
        (self.dir / "other").write_bytes(chunk.read_bytes())
        chunk.unlink()
        chunk.symlink_to("../other")
        self.refused(folder, "in another folder")
        self.convert(folder, "--follow")
        (self.dir / "out.vdb").unlink()
        chunk.unlink()
        chunk.symlink_to("nowhere")
        self.refused(folder, "0.0.0 cannot be read")
        chunk.unlink()
        chunk.mkdir()
        self.refused(folder, "0.0.0 cannot be read (it is not a regular file)")

    def test_absurd_sizes_in_zarr_metadata_are_refused_within_900_mb_of_address_space(self):
        for shape, chunks, says in (((10 ** 6,) * 3, CHUNKS, "more than the limit of 1e15"),
                                    ((10 ** 4,) * 3, CHUNKS, "more than the limit of 4e+09"),
                                    ((1500,) * 3, (1, 1, 1), "chunks, more than the limit of 4e+06"),
                                    ((1500,) * 3, (64,) * 3, "has only 0 of its 13824 chunks"),
                                    (SHAPE, (2000,) * 3, "more than the limit of 2 GiB"),
                                    (SHAPE, (1000,) * 3, "has 72 of at least"),
                                    ((2 ** 33, 4, 4), CHUNKS, "is not a whole number from 1 to")):
            with self.subTest(shape=shape, chunks=chunks):
                folder = write_array(self.folder())
                meta = json.loads((folder / ".zarray").read_text())
                (folder / ".zarray").write_text(json.dumps({**meta, "shape": shape, "chunks": chunks}))
                if says.startswith("has only"):
                    for chunk in folder.glob("?.?.?"):
                        chunk.unlink()
                done = subprocess.run(
                    ["bash", "-c", 'ulimit -v 900000; exec "$0" "$@"', str(BIN / "palpate-import-light"), str(folder),
                     str(self.dir / "out.vdb")], capture_output=True, text=True, timeout=120, check=False)
                self.assertEqual(done.returncode, 2, done.stderr)
                self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
                self.assertIn(says, done.stderr)

    def test_palpates_own_bricks_are_refused_with_a_remedy(self):
        bricks = self.dir / "bricks"
        done = subprocess.run([str(BIN / "palpate-import"), str(write_array(self.folder())), str(bricks), "--bricks"],
                              capture_output=True, text=True, timeout=120, check=False)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        self.refused(bricks, "the folder has palpate's own bricks: run palpate scene on the folder, without an import")


if __name__ == "__main__":
    suite.main(sys.argv[2:])
