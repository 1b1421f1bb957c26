#!/usr/bin/env python3
"""Tests displacement fields of registrations as other programs write them: displacement_test.py BIN_DIR."""
import csv
import json
import math
import struct
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import images_test as images  # noqa: E402
import process  # noqa: E402
import suite  # noqa: E402
from images_test import FLOAT, SHORT, nifti, nrrd  # noqa: E402

BIN = Path(sys.argv[1])
SIZE = (17, 15, 13)
STEP = 4.0
AT = (-30.0, -28.0, -20.0)     # position of the first voxel in RAS [mm]
INDICES = [(i, j, k) for k in range(SIZE[2]) for j in range(SIZE[1]) for i in range(SIZE[0])]
COLUMNS = tuple(tuple(STEP * (a == b) for b in range(3)) for a in range(3))
SFORM = tuple(tuple(STEP * (a == b) for b in range(3)) + (AT[a],) for a in range(3))
# Indices of voxels that are far from the faces.
INNER = [(5, 6, 5), (8, 7, 6), (10, 8, 7), (7, 5, 8), (12, 10, 6)]


def place(i, j, k):
    return tuple(AT[a] + STEP * n for a, n in enumerate((i, j, k)))


def flipped(v):
    """Converts a vector from RAS to LPS."""
    return (-v[0], -v[1], v[2])


def vectors(u):
    """Returns the vectors of a function u in RAS as ITK stores vectors: in LPS, components fastest."""
    return struct.pack(f"<{3 * len(INDICES)}f", *(c for p in INDICES for c in flipped(u(place(*p)))))


def planes(u, scale=1.0):
    """Returns the vectors of u in LPS as NIfTI stores vectors: one volume for each component."""
    all_of = [flipped(u(place(*p))) for p in INDICES]
    return struct.pack(f"<{3 * len(INDICES)}f", *(scale * v[c] for c in range(3) for v in all_of))


def meta(**more):
    fields = {"ObjectType": "Image", "NDims": "3", "BinaryData": "True", "BinaryDataByteOrderMSB": "False",
              "TransformMatrix": "1 0 0 0 1 0 0 0 1", "ElementSpacing": f"{STEP} {STEP} {STEP}",
              "DimSize": " ".join(map(str, SIZE)), "AnatomicalOrientation": "RAI", "ElementType": "MET_FLOAT",
              "ElementNumberOfChannels": "3", **more, "ElementDataFile": "LOCAL"}
    return "".join(f"{key} = {value}\n" for key, value in fields.items())


def translation(v):
    return lambda x: v


def rotation(degrees):
    """Returns the displacement by a rotation about z, as a function of the position."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return lambda x: (c * x[0] - s * x[1] - x[0], s * x[0] + c * x[1] - x[1], 0.0)


HEIGHT, WIDTH = 6.0, 14.0


def bump(x):
    """Returns a smooth displacement along x of at most HEIGHT [mm]."""
    return (HEIGHT * math.exp(-sum(c * c for c in x) / (2 * WIDTH ** 2)), 0.0, 0.0)


def bump_inverse(y):
    """Returns u with u + bump(y + u) = 0, by bisection."""
    low, high = -HEIGHT, 0.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        if middle + bump((y[0] + middle, y[1], y[2]))[0] > 0.0:
            high = middle
        else:
            low = middle
    return (low, 0.0, 0.0)


class Displacement(images.Case):
    FIELD = "--as", "displacement"

    def nii(self, u, intent=1007, scale=1.0, data=None, **more):
        more.setdefault("sform", SFORM)
        return self.write("u.nii", nifti((*SIZE, 1, 3), *FLOAT, intent=intent, **more),
                          planes(u, scale) if data is None else data)

    def means(self, path, expected, *words, places=4, indices=INNER):
        out = self.convert(path, *self.FIELD, *words)
        self.holds(out, "displacement", COLUMNS, AT, lambda *n: expected(place(*n)), indices, places)
        return out

    @suite.smoke
    def test_displacement_fields_in_nifti_metaimage_and_nrrd_are_converted_to_ras(self):
        u = rotation(10)
        for intent in (1006, 1007):
            self.means(self.nii(u, intent), u)
        lps = " ".join(map(str, flipped(AT)))
        # ITK's axes of x and y run against those of RAS.
        self.means(self.write("u.mha", meta(Offset=lps, TransformMatrix="-1 0 0 0 -1 0 0 0 1"), vectors(u)), u)
        origin = "({},{},{})".format(*flipped(AT))
        texts = [nrrd("space: left-posterior-superior", f"kinds: {kind} domain domain domain",
                      f"space directions: none ({-STEP},0,0) (0,{-STEP},0) (0,0,{STEP})", f"space origin: {origin}",
                      kind="float", sizes="3 17 15 13") for kind in ("vector", "list", "???")]
        if "without teem" not in process.run([str(BIN / "palpate-import"), str(self.write("a.nrrd", texts[0])),
                                              str(self.dir / "a.vdb")], capture_output=True, text=True,
                                             timeout=120).stderr:
            for text in texts:
                self.means(self.write("u.nrrd", text, "\n", vectors(u)), u)

    def test_displacements_in_mm_of_a_nifti_in_metres_are_converted_to_metres(self):
        metres = tuple(tuple(1e-3 * c for c in row) for row in SFORM)
        path = self.nii(rotation(10), sform=metres, units=1)
        out = self.convert(path, *self.FIELD)
        self.holds(out, "displacement", tuple(tuple(1e-3 * c for c in v) for v in COLUMNS),
                   tuple(1e-3 * c for c in AT), lambda *n: tuple(1e-3 * c for c in rotation(10)(place(*n))), INNER, 7)

    @suite.smoke
    def test_forward_fields_are_inverted(self):
        forward = "--direction", "forward"
        self.means(self.nii(translation((3, -2, 1))), translation((-3, 2, -1)), *forward)
        self.means(self.nii(rotation(10)), rotation(-10), *forward)
        # The spline of the inverse differs from the exact inverse by the error of interpolation.
        self.means(self.nii(bump), bump_inverse, *forward, places=2)
        self.means(self.nii(bump), bump, "--direction", "backward")

    def test_the_residual_of_an_inverted_field_is_reported(self):
        notes = self.notes(self.nii(bump), *self.FIELD, "--direction", "forward")
        self.assertIn("the forward displacements are inverted", notes)
        rms, most = (float(word.split()[-1]) for word in notes.split("residual is ")[1].split(" mm")[:2])
        self.assertLess(rms, most)
        self.assertTrue(1e-4 < most < 0.2, notes)
        # The field moves the image by half a voxel, so the resting places of one plane of voxels are outside the field.
        notes = self.notes(self.nii(translation((-0.5 * STEP, 0, 0))), *self.FIELD, "--direction", "forward")
        self.assertIn("the resting place of 5.9 % of the voxels is outside the field", notes)
        # Voxels on the faces are within the field, although positions are rounded.
        notes = self.notes(self.nii(translation((0.0, 0.0, 0.0))), *self.FIELD, "--direction", "forward")
        self.assertNotIn("outside the field", notes)

    def test_the_resampling_error_of_a_forward_field_is_that_of_the_given_vectors(self):
        path = self.nii(bump)
        errors = [self.report(path, *self.FIELD, "--voxel", "5", "--direction", direction)["grids"][0]["resampling"]
                  for direction in ("backward", "forward")]
        self.assertGreater(errors[0]["points"], 0)
        self.assertEqual(errors[0], errors[1])

    def test_refuses_to_resample_a_rotated_forward_field(self):
        c, s = math.cos(0.4), math.sin(0.4)
        turned = ((STEP * c, -STEP * s, 0.0, AT[0]), (STEP * s, STEP * c, 0.0, AT[1]), (0.0, 0.0, STEP, AT[2]))
        path = self.nii(bump, sform=turned)
        self.refused(path, "box have no displacement", *self.FIELD, "--voxel", "4", "--direction", "forward")

    def test_a_forward_field_that_stretches_threefold_is_inverted(self):
        # The matter stretches threefold: a plain fixed point u = -v(x + u) would diverge.
        self.means(self.nii(lambda x: (2 * x[0], 0.0, 0.0)), lambda x: (-2 * x[0] / 3, 0.0, 0.0), "--direction",
                   "forward")

    @suite.smoke
    def test_refuses_displacement_fields_that_fold_or_stretch_space_too_much(self):
        fold = self.nii(lambda x: (-2.0 * x[0], 0.0, 0.0))
        for direction in ("backward", "forward"):
            self.refused(fold, "folds space", *self.FIELD, "--direction", direction)
        self.refused(self.nii(lambda x: (20.0 * x[0], 0.0, 0.0)), "multiplies lengths by", *self.FIELD)

    @suite.smoke
    def test_refuses_an_image_that_is_not_a_displacement_field(self):
        zero = translation((0.0, 0.0, 0.0))
        self.refused(self.nii(zero, 0), "the header has the intent 0 and", *self.FIELD)
        self.refused(self.nii(zero, 2006), "the header has the intent 2006", *self.FIELD)
        self.refused(self.nii(zero, sform=None), "neither an sform nor a qform", *self.FIELD)
        header = bytearray(nifti((*SIZE, 1, 3), *FLOAT, intent=1007, sform=SFORM))
        header[328:338] = b"NREG_TRANS"
        self.refused(self.write("n.nii", bytes(header), planes(zero)), "NiftyReg wrote the field", *self.FIELD)
        holes = bytearray(planes(zero))
        holes[400:404] = struct.pack("<f", math.nan)
        self.refused(self.nii(zero, data=bytes(holes)), "1 voxels of the displacement field have no data", *self.FIELD)
        one = self.write("a.nii", nifti(images.SIZE, *SHORT), images.SHORTS)
        self.refused(one, "and the size 1 along the fifth axis", *self.FIELD)
        scalar = self.write("a.mha", meta(ElementNumberOfChannels="1"), vectors(zero)[:4 * len(INDICES)])
        self.refused(scalar, "not the 3 of a displacement", *self.FIELD)

    def test_refuses_options_that_do_not_apply_to_displacement_fields(self):
        path = self.nii(bump)
        self.refused(path, "only a displacement field has a direction", "--direction", "forward")
        for words in (("--iso", "1"), ("--tolerance", "1"), ("--scene", "s.json")):
            self.refused(path, f"{words[0]}: this option does not apply", *self.FIELD, *words)
        self.refused(path, "--bricks: this option does not apply", *self.FIELD, "--bricks", out=self.dir / "folder")

    def test_an_imported_warp_moves_the_surface_of_an_image_in_a_scene(self):
        """The image is a block of matter at x <= 0; the field of a MetaImage moves it by 5 mm along x."""
        block = [1000 if place(*p)[0] < 1.0 else 0 for p in INDICES]
        body = self.write("b.nii", nifti(SIZE, *SHORT, sform=SFORM), struct.pack(f"<{len(block)}h", *block))
        (self.dir / "b.vdb").write_bytes(self.convert(body).read_bytes())
        lps = " ".join(map(str, flipped(AT)))
        found = {}
        for name, u, words in (("rest", translation((0, 0, 0)), ()), ("backward", translation((-5, 0, 0)), ()),
                               ("forward", translation((5, 0, 0)), ("--direction", "forward"))):
            field = self.write("u.mha", meta(Offset=lps, TransformMatrix="-1 0 0 0 -1 0 0 0 1"), vectors(u))
            (self.dir / "u.vdb").write_bytes(self.convert(field, *self.FIELD, *words).read_bytes())
            scene = {"palpate": 1, "coupling": {"stiffness": 500}, "volumes": {
                "u": {"file": "u.vdb", "place": {"scale": 0.001}},
                "b": {"file": "b.vdb", "place": {"scale": 0.001, "warp": {"field": "u"}}}},
                "modes": [{"mode": "isosurface", "of": "b", "value": 500, "solid": "above", "strength": 5}]}
            path = self.write("s.json", json.dumps(scene))
            done = process.run([str(BIN / "palpate"), "press", str(path), "--at", "0.025,0,0", "--along=-0.03,0,0",
                                "--csv", str(self.dir / "p.csv")], capture_output=True, text=True,
                               timeout=120)
            self.assertEqual((done.returncode, done.stderr), (0, ""))
            with open(self.dir / "p.csv", encoding="utf-8") as file:
                found[name] = 0.025 - max(float(row["proxy_depth"]) for row in csv.DictReader(file))
        self.assertAlmostEqual(found["backward"] - found["rest"], 0.005, 5)
        self.assertAlmostEqual(found["forward"] - found["rest"], 0.005, 5)


if __name__ == "__main__":
    suite.main(sys.argv[2:])
