#!/usr/bin/env python3
"""Tests imports of slices as pictures, which this test writes: slices_test.py BIN_DIR."""
import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import images_test as images  # noqa: E402
import suite  # noqa: E402
from pictures import DEFLATE, FLOAT, INT, LZW, NONE, PACK, PACKBITS, UINT, Tiff, palette, png  # noqa: E402

WIDTH, HEIGHT, COUNT = 4, 5, 6
SPACING = ((0.5, 0, 0), (0, 0.25, 0), (0, 0, 2.0))
WORDS = ("--spacing", "0.5,0.25,2mm")


def value(i, j, k):
    """Returns the value of slice k at the pixel in column i, from the left, and row j, from the top."""
    return 1 + i + 4 * j + 20 * k


def rows_of(k, letter="B", order="<", shape=(WIDTH, HEIGHT), of=value):
    return [struct.pack(order + f"{shape[0]}{letter}", *(of(i, j, k) for i in range(shape[0])))
            for j in range(shape[1])]


def stack(letter="B", **how):
    tiff = Tiff(bits=8 * struct.calcsize(letter), **how)
    for k in range(COUNT):
        tiff.page(rows_of(k, letter, tiff.order), WIDTH)
    return tiff.bytes()


def picture(k, letter="B", **how):
    return Tiff(bits=8 * struct.calcsize(letter), **how).page(rows_of(k, letter), WIDTH).bytes()


IMAGEJ = f"ImageJ=1.54f\nimages={COUNT}\nslices={COUNT}\n"


class Case(images.Case):
    def folder(self, files, name="slices"):
        folder = self.dir / name
        folder.mkdir(exist_ok=True)
        for old in folder.iterdir():
            old.unlink()
        for file, data in files.items():
            (folder / file).write_bytes(data)
        return folder

    def is_stack(self, path, *words, spacing=SPACING, of=value):
        """Checks that each voxel has the value of the pixel, at its place."""
        out = self.convert(path, *(words or WORDS))
        self.holds(out, "density", spacing, (0, 0, 0), of, images.INDICES)
        return out

    def has_unit(self, volume, unit):
        entry = b"".join(struct.pack("<i", len(w)) + w for w in (b"length_unit", b"string", unit.encode()))
        self.assertIn(entry, volume.read_bytes())


class Reading(Case):
    @suite.smoke
    def test_voxel_xyz_is_the_pixel_in_column_x_and_row_y_of_slice_z(self):
        self.is_stack(self.write("a.tif", stack()))
        self.is_stack(self.folder({f"a_{k}.tif": picture(k) for k in range(COUNT)}))
        out = self.is_stack(self.folder({f"a_{k}.png": png(rows_of(k), WIDTH) for k in range(COUNT)}))
        self.has_unit(out, "mm")

    def test_reads_every_number_type_and_byte_order_of_tiff(self):
        for letter, kind, how in (("B", UINT, {"big": True}), ("b", INT, {}), ("H", UINT, {"order": ">"}),
                                  ("h", INT, {"big": True}), ("I", UINT, {"order": ">", "big": True}), ("i", INT, {}),
                                  ("Q", UINT, {}), ("q", INT, {"order": ">"}), ("f", FLOAT, {"order": ">"}),
                                  ("d", FLOAT, {"big": True})):
            with self.subTest(letter=letter, **how):
                self.is_stack(self.write("a.tif", stack(letter, kind=kind, **how)))

    def test_reads_tiff_without_compression_and_with_lzw_deflate_and_packbits(self):
        for packing in PACK:
            for letter in "BHf":
                for predictor in (1, 2)[:1 + (packing in (LZW, DEFLATE) and letter != "f")]:
                    with self.subTest(packing=packing, letter=letter, predictor=predictor):
                        self.is_stack(self.write("a.tif", stack(letter, kind=FLOAT if letter == "f" else UINT,
                                                                packing=packing, _317=[predictor])))

    @suite.smoke
    def test_reads_tiles_of_tiff(self):
        def of(i, j, k):
            return 1 + i + 40 * j + 1000 * k
        for packing in (NONE, DEFLATE):
            tiff = Tiff(bits=16, packing=packing)
            for k in range(2):
                tiff.tiles(rows_of(k, "H", shape=(37, 21), of=of), 37)
            out = self.convert(self.write("a.tif", tiff.bytes()), *WORDS)
            points = [(0, 0, 0), (15, 15, 0), (16, 15, 1), (15, 16, 1), (36, 20, 1), (31, 3, 0), (32, 17, 1)]
            self.holds(out, "density", SPACING, (0, 0, 0), of, points)

    @suite.smoke
    def test_reads_single_bits_as_0_and_1(self):
        def bit(i, j, k):
            return (i * i + 3 * j + k) % 5 % 2

        def packed(j, k):
            return int("".join(str(bit(i, j, k)) for i in range(12)).ljust(16, "0"), 2).to_bytes(2, "big")
        pictures = [[packed(j, k) for j in range(3)] for k in range(2)]
        points = [(i, j, k) for i in range(12) for j in range(3) for k in range(2)]
        for white, of in ((1, bit), (0, lambda i, j, k: 1 - bit(i, j, k))):
            tiff = Tiff(bits=1, _262=[white])
            for rows in pictures:
                tiff.page(rows, width=12)
            out = self.convert(self.write("a.tif", tiff.bytes()), *WORDS)
            self.holds(out, "density", SPACING, (0, 0, 0), of, points)
        out = self.convert(self.folder({f"{k}.png": png(rows, 12, 1) for k, rows in enumerate(pictures)}), *WORDS)
        self.holds(out, "density", SPACING, (0, 0, 0), bit, points)

    def test_reads_png_of_16_bits_and_interlaced_png(self):
        def large(i, j, k):
            return 500 * value(i, j, k) + 3
        self.is_stack(self.folder({f"{k}.png": png(rows_of(k, "H", ">", of=large), WIDTH, 16) for k in range(COUNT)}),
                      of=large)
        self.is_stack(self.folder({f"{k}.png": png(rows_of(k), WIDTH, interlaced=True) for k in range(COUNT)}))

    def test_a_larger_value_is_brighter_if_0_is_white_in_the_file(self):
        for letter, most in (("B", 255), ("H", 65535)):
            path = self.write("a.tif", stack(letter, _262=[0]))
            self.is_stack(path, of=lambda i, j, k, most=most: most - value(i, j, k))
            self.assertIn("0 is white in the file", self.notes(path, *WORDS))
        folder = self.folder({f"a_{k}.tif": picture(k, _262=[0]) for k in range(COUNT)})
        self.is_stack(folder, of=lambda i, j, k: 255 - value(i, j, k))
        self.assertEqual(self.notes(folder, *WORDS).count("0 is white in the file"), 1)

    def test_signed_values_and_floats_are_kept_if_0_is_white_in_the_file(self):
        # The TIFF specification defines no largest value for them. libtiff, ITK and ImageJ keep them too.
        for letter, kind in (("b", INT), ("h", INT), ("f", FLOAT), ("d", FLOAT)):
            path = self.write("a.tif", stack(letter, kind=kind, _262=[0]))
            self.is_stack(path)
            self.assertNotIn("0 is white in the file", self.notes(path, *WORDS))

    def test_the_import_of_a_folder_prints_the_notes_of_its_files(self):
        preview = Tiff(_254=[1]).page(rows_of(3, shape=(2, 2)), 2)
        preview.tags = {}
        files = {f"a_{k}.tif": picture(k) for k in range(COUNT)}
        folder = self.folder(files | {"a_3.tif": preview.page(rows_of(3), WIDTH).bytes()})
        self.is_stack(folder)
        self.assertIn("skipped 1 pages that are previews", self.notes(folder, *WORDS))

    def test_previews_among_the_pages_are_skipped_with_a_note(self):
        tiff = Tiff()
        for k in range(COUNT):
            tiff.page(rows_of(k), WIDTH)
            tiff.tags = {254: [1]}
            tiff.page(rows_of(k, shape=(2, 2)), 2)
            tiff.tags = {}
        path = self.write("a.tif", tiff.bytes())
        self.is_stack(path)
        self.assertIn("skipped 6 pages that are previews", self.notes(path, *WORDS))


class Names(Case):
    def test_slices_are_in_the_order_of_their_numbers(self):
        names = ("s_1_x.tif", "s_2_x.tif", "s_3_x.TIF", "s_04_x.tif", "s_5_x.tif", "s_6_x.tif")
        self.is_stack(self.folder({name: picture(k) for k, name in enumerate(names)}))
        names = [f"scan7_slice{n}.png" for n in (8, 9, 10, 11, 12, 13)]
        self.is_stack(self.folder({name: png(rows_of(k), WIDTH) for k, name in enumerate(names)}))

    def test_the_largest_series_is_imported_and_a_note_counts_the_rest(self):
        files = {f"a_{k:03}.tif": picture(k) for k in range(COUNT)}
        files |= {"a_mean.tif": picture(0), "b_1.tif": picture(1), "b_2.tif": picture(1), "log.txt": b"made by a test",
                  "a_006.png": png(rows_of(1), WIDTH)}
        folder = self.folder(files)
        (folder / "logs").mkdir()
        self.is_stack(folder)
        self.assertIn("ignored 5 of 11 files, which are not slices of this series, such as a_006.png",
                      self.notes(folder, *WORDS))
        (folder / "logs").rmdir()
        self.assertNotIn("ignored", self.notes(self.folder({f"a_{k}.tif": picture(k) for k in range(COUNT)}), *WORDS))

    def test_two_series_of_the_same_size_are_refused(self):
        folder = self.folder({f"{name}_{k}.png": png(rows_of(k), WIDTH) for name in "ab" for k in range(3)})
        self.refused(folder, "several series of 3 pictures, a_#.png and b_#.png", *WORDS)

    def test_names_that_differ_in_two_numbers_are_refused(self):
        folder = self.folder({f"c{c}_z{k}.png": png(rows_of(k), WIDTH) for c in range(2) for k in range(3)})
        self.refused(folder, "differ in 2 numbers, such as c0_z0.png and", *WORDS)

    def test_missing_slices_are_refused_with_the_names_of_their_neighbours(self):
        folder = self.folder({f"a_{n}.tif": picture(1) for n in (1, 2, 3, 6, 7)})
        self.refused(folder, "slices are missing: after a_3.tif comes a_6.tif", *WORDS)

    def test_two_slices_of_the_same_number_are_refused(self):
        folder = self.folder({name: picture(1) for name in ("a_1.tif", "a_2.tif", "a_02.tif")})
        self.refused(folder, "two pictures have the number 2: a_02.tif and a_2.tif", *WORDS)

    def test_every_tenth_slice_is_a_volume_with_a_note(self):
        folder = self.folder({f"a_{10 * k}.tif": picture(k) for k in range(COUNT)})
        self.is_stack(folder)
        self.assertIn("increase by 10: the spacing along z is the distance between two files",
                      self.notes(folder, *WORDS))

    def test_every_second_slice_of_a_described_stack_requires_a_spacing(self):
        text = IMAGEJ + "unit=um\nspacing=2\n"
        tags = {"_270": text, "_282": [(2, 1)], "_283": [(4, 1)], "_296": [1]}
        folder = self.folder({f"s{2 * k}.tif": picture(k, **tags) for k in range(COUNT)})
        self.refused(folder, "the numbers of the slices increase by 2, so the distance of 2 um that ImageJ's "
                             "description states may not be that between two files: add --spacing 0.5,0.25,DISTANCEum")
        self.is_stack(folder)

    def test_a_note_states_that_the_folder_has_another_number_of_slices_than_the_description(self):
        ome = '<OME><Pixels SizeZ="6" SizeC="1" SizeT="1"/></OME>'
        for text in (IMAGEJ, ome):
            for count, says in ((3, True), (COUNT, False)):
                folder = self.folder({f"s{k}.tif": picture(k, _270=text) for k in range(count)})
                note = "the folder has 3 slices, but s0.tif states 6 pictures: check that none is missing"
                self.assertEqual(note in self.notes(folder, *WORDS), says)
        folder = self.folder({f"s{k}.tif": picture(k, _270="ImageJ=1.54f\nimages=1\n") for k in range(3)})
        self.assertNotIn("missing", self.notes(folder, *WORDS))

    def test_pictures_without_numbers_are_refused(self):
        self.refused(self.folder({"a.tif": picture(0), "b.tif": picture(1)}), "names differ only in a number", *WORDS)

    def test_jpeg_pictures_are_refused_with_a_remedy(self):
        jpeg = b"\xff\xd8\xff\xe0" + bytes(200)
        folder = self.folder({"a_1.jpg": jpeg, "a_2.jpg": jpeg})
        self.refused(folder, "their compression changes the values: convert all slices of the volume to PNG")
        self.refused(folder / "a_1.jpg", "looks like a JPEG picture")


class Spacing(Case):
    def test_imagej_and_ome_state_the_spacing_in_their_description(self):
        per = {"_282": [(2, 1)], "_283": [(4, 1)]}
        ome = ('<?xml version="1.0" encoding="UTF-8"?><OME xmlns="x"><Image ID="Image:0"><Pixels ID="Pixels:0" '
               f'SizeX="4" SizeY="5" SizeZ="{COUNT}" SizeC="1" SizeT="1" PhysicalSizeX="0.5" PhysicalSizeY="0.25" '
               'PhysicalSizeZ="2"><TiffData/></Pixels></Image></OME>')
        for text, tags, unit, source in (
                (IMAGEJ + "unit=um\nspacing=2.0\n", {**per, "_296": [1]}, "um", "ImageJ's description"),
                (IMAGEJ + "unit=\\u00B5m\nspacing=2.0\n", {**per, "_296": [1]}, "um", "ImageJ's description"),
                (IMAGEJ + "spacing=2.0\nunit=mm\n", {**per, "_296": [1]}, "mm", "ImageJ's description"),
                (ome, {}, "um", "OME-XML"),
                (ome.replace('eX="0.5"', 'eX="500" PhysicalSizeXUnit="nm"'), {}, "um", "OME-XML"),
                (ome.replace('PhysicalSizeX=', 'PhysicalSizeXUnit="mm" PhysicalSizeYUnit="mm" PhysicalSizeZUnit="mm" '
                             'PhysicalSizeX='), {}, "mm", "OME-XML")):
            with self.subTest(text=text):
                path = self.write("a.tif", stack(_270=text, **tags))
                self.has_unit(self.is_stack(path, "--field", "density"), unit)
                self.assertIn(f"the spacing is 0.5 x 0.25 x 2 {unit}, as {source} states", self.notes(path))
                self.is_stack(path, "--spacing", "1,2,3", spacing=((1, 0, 0), (0, 2, 0), (0, 0, 3)))

    def test_a_description_by_imagej_without_a_distance_means_a_distance_of_1(self):
        path = self.write("a.tif", stack(_270=IMAGEJ + "unit=cm\n", _282=[(2, 1)], _283=[(4, 1)], _296=[3]))
        out = self.is_stack(path, "--field", "density", spacing=((0.5, 0, 0), (0, 0.25, 0), (0, 0, 1)))
        self.has_unit(out, "cm")

    def test_slices_without_a_spacing_are_refused_and_the_remedy_is_option_spacing(self):
        self.refused(self.write("a.tif", stack()), "do not state the spacing of the voxels: add the edges")
        for text in (IMAGEJ, IMAGEJ + "unit=pixel\nspacing=3\n", IMAGEJ + "unit=um\nspacing=nan\n", "<OME><Pixels",
                     "ImageJ=", "a sample"):
            self.refused(self.write("a.tif", stack(_270=text)), "as in --spacing 10,10,20um")
        for unit in (1, 2, 3):
            path = self.write("a.tif", stack(_282=[(100, 1)], _283=[(100, 1)], _296=[unit]))
            self.refused(path, "as in --spacing 10,10,20um")
        path = self.write("a.tif", stack(_270="ImageJ=1\nunit=mm\n", _282=[(2, 1)], _283=[(4, 1)]))
        self.refused(path, "add --spacing 0.5,0.25,DISTANCEmm")
        folder = self.folder({f"a_{k}.tif": picture(k, _282=[(50, 1)], _283=[(25, 1)], _296=[3]) for k in range(3)})
        self.refused(folder, "the resolution of the TIFF gives pixels of 0.2 x 0.4 mm, but no file states the distance "
                             "of the slices: add the edges of a voxel along x, y and z, as in --spacing 10,10,20um")
        self.refused(self.folder({f"a_{k}.png": png(rows_of(k), WIDTH) for k in range(3)}), "add the edges of a voxel")

    def test_option_spacing_takes_three_positive_lengths_and_a_unit(self):
        path = self.write("a.tif", stack())
        for text in ("1,2", "1,2,-3", "1,2,3km", ""):
            self.refused(path, "--spacing", f"--spacing={text}")
        self.has_unit(self.is_stack(path, "--spacing", "500,250,2e3nm"), "um")
        self.refused(self.write("a.nrrd", images.nrrd("spacings: 1 2 3"), "\n", images.SHORTS),
                     "read as NRRD, which does not use this option", *WORDS)
        self.refused(path, "which does not use this option", "--series", "1", *WORDS)


class Refusals(Case):
    def test_slices_of_unlike_size_or_type_are_refused_by_name(self):
        files = {f"a_{k}.tif": picture(k) for k in range(4)}
        wide = Tiff().page(rows_of(2, shape=(6, 5)), 6).bytes()
        self.refused(self.folder(files | {"a_2.tif": wide}), "a_2.tif is 6 x 5 uint8, but a_0.tif is 4 x 5 uint8",
                     *WORDS)
        self.refused(self.folder(files | {"a_3.tif": picture(3, "H")}), "a_3.tif is 4 x 5 uint16, but", *WORDS)
        tiff = Tiff().page(rows_of(0), WIDTH).page(rows_of(1), WIDTH).page(rows_of(1)[:4], WIDTH)
        self.refused(self.write("a.tif", tiff.bytes()), "page 3 is 4 x 4 uint8, but page 1 is 4 x 5 uint8", *WORDS)
        self.refused(self.folder({"a_1.tif": picture(1), "a_2.tif": stack()}), "the file has 6 pages", *WORDS)

    def test_slices_of_unlike_photometric_interpretation_are_refused_by_name(self):
        files = {f"s{k}.tif": picture(k) for k in range(COUNT)}
        self.refused(self.folder(files | {"s3.tif": picture(3, _262=[0])}),
                     "s3.tif is 4 x 5 uint8 with 0 as white, but s0.tif is 4 x 5 uint8: give slices of equal size, "
                     "number type and PhotometricInterpretation", *WORDS)
        tiff = Tiff(_262=[0]).page(rows_of(0), WIDTH)
        tiff.tags = {}
        self.refused(self.write("a.tif", tiff.page(rows_of(1), WIDTH).bytes()), "page 2 is 4 x 5 uint8, but page 1 is",
                     *WORDS)

    def test_colours_are_refused_with_a_remedy(self):
        says = "has colours, a colour map or transparency, not grey values: convert the slices to grey"
        for colour, each, extra in ((2, 3, b""), (3, 1, palette()), (4, 2, b""), (6, 4, b"")):
            rows = [bytes(each * WIDTH)] * HEIGHT
            one = png(rows, WIDTH, colour=colour, extra=extra)
            self.refused(self.folder({"1.png": one, "2.png": one}), says, *WORDS)
        rows = [bytes(3 * WIDTH)] * HEIGHT
        tiff = Tiff(_262=[2], _277=[3], _258=[8, 8, 8], _339=[1, 1, 1]).page(rows, WIDTH).page(rows, WIDTH)
        self.refused(self.write("a.tif", tiff.bytes()), "page 1 " + says, *WORDS)
        tiff = Tiff(_262=[3], _320=[0] * 768).page(rows_of(0), WIDTH).page(rows_of(1), WIDTH)
        self.refused(self.write("a.tif", tiff.bytes()), "page 1 " + says, *WORDS)

    def test_a_single_picture_is_refused_with_a_remedy(self):
        self.refused(self.write("a.tif", picture(0)), "one picture, which is not a volume: give the folder", *WORDS)
        one = png(rows_of(0), WIDTH)
        self.refused(self.write("a.png", one), "looks like a PNG picture, which palpate does not import: give the "
                                               "folder of all slices", *WORDS)
        self.refused(self.folder({"a_1.png": one}), "the folder has no two TIFF or PNG pictures", *WORDS)

    def test_pages_that_are_not_one_volume_are_refused(self):
        for text, says in ((IMAGEJ + "channels=2\n", "channels: 2, times: 1"),
                           (IMAGEJ + "frames=3\n", "channels: 1, times: 3"),
                           (IMAGEJ.replace("=6", "=9"), "states 9 pictures, but the file has 6 pages: copy"),
                           ('<OME><Pixels SizeZ="4" SizeC="1" SizeT="1"/></OME>', "states 4 pictures")):
            self.refused(self.write("a.tif", stack(_270=text)), says, *WORDS)
        self.refused(self.write("a.tif", picture(0, _270=IMAGEJ)), "save an image sequence", *WORDS)

    def test_files_of_a_folder_that_state_several_channels_or_times_are_refused(self):
        for text, says in ((IMAGEJ + "channels=2\n", "channels: 2, times: 1"),
                           (IMAGEJ + "frames=6\n", "channels: 1, times: 6"),
                           ('<OME><Pixels SizeZ="3" SizeC="2" SizeT="1"/></OME>', "channels: 2, times: 1")):
            files = {f"s{k}.tif": picture(k, _270=text) for k in range(COUNT)}
            self.refused(self.folder(files), says, *WORDS)
            files["s0.tif"] = picture(0)
            self.refused(self.folder(files), f"s1.tif: the description states several volumes ({says}", *WORDS)

    def test_pages_that_cannot_be_read_are_refused_by_number(self):
        for tags, says in (({"_259": [7]}, "page 1 has the compression 7"),
                           ({"_274": [3]}, "page 1 does not begin with the left pixel of its top row (Orientation 3)"),
                           ({"_258": [12]}, "page 1 has numbers of 12 bits"),
                           ({"_339": [6]}, "page 1 has numbers of 8 bits in the sample format 6")):
            self.refused(self.write("a.tif", stack(**tags)), says, *WORDS)


class Memory(Case):
    def run_limited(self, path, *words):
        """Returns the only line that an import prints on stderr if its address space is limited."""
        done = subprocess.run(["bash", "-c", 'ulimit -v 1500000; exec "$0" "$@"', str(images.BIN / "palpate-import"),
                               str(path), str(self.dir / ("out" if "--bricks" in words else "out.vdb")), *words],
                              capture_output=True, text=True, timeout=120, check=False)
        self.assertNotEqual(done.returncode, 0)
        self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
        return done.stderr

    def test_slices_that_do_not_fit_in_memory_are_refused_by_name_with_a_remedy(self):
        size = 8000
        folder = self.folder({"a_1.png": png([bytes(size)] * size, size)})
        for k in range(2, 71):
            os.link(folder / "a_1.png", folder / f"a_{k}.png")
        says = f"{folder}: the slices need more memory than is free: "
        self.assertIn(says + "import them with --bricks, without --voxel and --iso", self.run_limited(folder, *WORDS))
        for k in range(31, 71):
            (folder / f"a_{k}.png").unlink()
        # The folder now has 30 slices, fewer than a brick's 64, so --bricks would not help.
        for words in ((), ("--bricks",)):
            self.assertIn(says + "end other programs, or scale", self.run_limited(folder, *words, *WORDS))

    def test_the_message_that_memory_ran_out_names_the_file_and_bricks(self):
        path = self.dir / "zeros.raw"
        with path.open("wb") as file:
            file.truncate(4 * 10 ** 9)
        self.assertIn(f"{path}: memory ran out: import fewer arrays (--field), resample to a larger --voxel, or write an "
                      "image as bricks (--bricks)", self.run_limited(path, "--raw", '{"size":[1000,1000,1000],"type":"float32"}'))


class Damage(Case):
    def test_sizes_that_the_file_cannot_hold_are_refused(self):
        for packing in (NONE, LZW, DEFLATE, PACKBITS):
            for tags in ({"_256": [2 ** 31 - 1], "_257": [2 ** 31 - 1], "_278": [2 ** 31 - 1]},
                         {"_256": [10 ** 6], "_278": [5]}, {"_256": [2 ** 32 - 1]}, {"_257": [0]},
                         {"_279": [2 ** 32 - 1] * 3}):
                with self.subTest(packing=packing, tags=tags):
                    self.refused(self.write("a.tif", stack(packing=packing, **tags)), "", *WORDS)
        big = png(rows_of(0), WIDTH).replace(struct.pack(">II", WIDTH, HEIGHT), struct.pack(">II", 900000, 900000), 1)
        crc = struct.pack(">I", zlib.crc32(big[12:29]))
        self.refused(self.folder({f"a_{k}.png": big[:29] + crc + big[33:] for k in range(2)}), "at least", *WORDS)

    def test_pages_that_share_their_pixels_or_form_a_loop_are_refused(self):
        tiff = Tiff(strip=HEIGHT)
        at = tiff.add(bytes(WIDTH * HEIGHT))
        for _ in range(200):
            tiff.directory({**tiff.basic(WIDTH, HEIGHT), 273: [at], 278: [HEIGHT], 279: [2000]})
        self.refused(self.write("a.tif", tiff.bytes()), "it is truncated, or its tags are wrong", *WORDS)
        tiff = Tiff().page(rows_of(0), WIDTH).page(rows_of(1), WIDTH)
        first = struct.unpack_from("<I", tiff.out, 4)[0]
        struct.pack_into("<I", tiff.out, tiff.link, first)
        self.refused(self.write("a.tif", tiff.bytes()), "the TIFF file is damaged", *WORDS)

    def test_truncated_files_are_refused(self):
        for how in ({}, {"order": ">", "packing": DEFLATE}, {"big": True}):
            tiff = Tiff(bits=16, **how)
            links = []
            for k in range(3):
                tiff.page(rows_of(k, "H", tiff.order), WIDTH)
                links += [tiff.link, tiff.link + 3]
            for size in (9, 20, 60, 100, *links):
                self.refused(self.write("a.tif", tiff.bytes()[:size]), "a.tif", *WORDS)
        one = png(rows_of(0), WIDTH)
        for size in range(20, len(one) - 12, 5):
            self.refused(self.folder({"a_1.png": one, "a_2.png": one[:size]}), "a_2.png", *WORDS)

    @suite.smoke
    def test_flipped_bits_in_compressed_pixels_are_refused(self):
        one = png(rows_of(0), WIDTH)
        at = one.index(b"IDAT")
        for n in range(5):
            bad = bytearray(one)
            bad[at + 4 + n] ^= 1 << n % 8
            self.refused(self.folder({"a_1.png": one, "a_2.png": bytes(bad)}), "the PNG file is damaged", *WORDS)
        tiff = stack(packing=DEFLATE, strip=HEIGHT)
        for n in range(12, 30, 3):
            path = self.write("a.tif", tiff[:n], bytes([tiff[n] ^ 4]), tiff[n + 1:])
            self.refused(path, "the TIFF file is damaged", *WORDS)


if __name__ == "__main__":
    suite.main(sys.argv[2:])
