#!/usr/bin/env python3
"""Tests a scene whose "warp" is the result of a registration by elastix: elastix_test.py BIN_DIR.

The fixed image is the head of mricron-data, moved by a known field of a few mm. elastix registers the head to it. A
hand then touches the head, which the imported field warps, at many places of the skin. Prints the distance of the proxy
from the skin of the fixed image. The registration takes minutes, so the test runs with PALPATE_LONG only."""
import csv
import gzip
import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np

try:
    from scipy import ndimage
except ImportError:
    ndimage = None

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import suite  # noqa: E402

BIN = Path(sys.argv[1])
HEAD = Path("/usr/share/mricron/templates/ch2.nii.gz")
RAS = np.array([-1.0, -1.0, 1.0])    # from ITK's LPS
SKIN = 40.0                          # value of the isosurface
RAYS = 200
FORMS = "mhd", "nii", "nrrd"

PARAMETERS = """
(FixedInternalImagePixelType "float")
(MovingInternalImagePixelType "float")
(UseDirectionCosines "true")
(Registration "MultiResolutionRegistration")
(Interpolator "LinearInterpolator")
(ResampleInterpolator "FinalBSplineInterpolator")
(Resampler "DefaultResampler")
(FixedImagePyramid "FixedSmoothingImagePyramid")
(MovingImagePyramid "MovingSmoothingImagePyramid")
(Optimizer "AdaptiveStochasticGradientDescent")
(Transform "BSplineTransform")
(Metric "AdvancedMeanSquares")
(FinalGridSpacingInPhysicalUnits 16)
(NumberOfResolutions 3)
(MaximumNumberOfIterations 250)
(NumberOfSpatialSamples 4096)
(NewSamplesEveryIteration "true")
(ImageSampler "RandomCoordinate")
(RandomSeed 1)
(BSplineInterpolationOrder 1)
(FinalBSplineInterpolationOrder 3)
(DefaultPixelValue 0)
(WriteResultImage "false")
(ResultImagePixelType "float")
(ResultImageFormat "mhd")
"""


def head():
    """Returns the head at 2 mm, smoothed, as an array [z, y, x]."""
    data = gzip.decompress(HEAD.read_bytes())
    size = struct.unpack_from("<3h", data, 42)
    start = int(struct.unpack_from("<f", data, 108)[0])
    values = np.frombuffer(data, np.uint8, int(np.prod(size)), start).reshape(size[::-1])
    smooth = ndimage.gaussian_filter(values.astype(np.float32), 1.5)
    return np.pad(smooth[::2, ::2, ::2], 6)


def shifts(z, y, x):
    """Returns the known backward field [mm] at places [mm], one array for each of x, y and z."""
    out = [np.zeros_like(x) for _ in range(3)]
    for centre, way in (((90, 200, 110), (0, -3, 1)), ((170, 110, 120), (-3, 0, 0)), ((95, 110, 190), (1, 1, -3)),
                        ((20, 110, 120), (3, 1, 0)), ((95, 20, 110), (0, 3, 1))):
        far = sum((p - c) ** 2 for p, c in zip((x, y, z), centre))
        for axis in range(3):
            out[axis] += way[axis] * np.exp(-far / (2 * 28.0 ** 2))
    return out


def write_image(path, values):
    path.with_suffix(".raw").write_bytes(np.ascontiguousarray(values, "<f4").tobytes())
    nz, ny, nx = values.shape
    path.write_text("ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\n"
                    "TransformMatrix = 1 0 0 0 1 0 0 0 1\nOffset = 0 0 0\nElementSpacing = 2 2 2\n"
                    f"DimSize = {nx} {ny} {nz}\nAnatomicalOrientation = RAI\nElementType = MET_FLOAT\n"
                    f"ElementDataFile = {path.stem}.raw\n")


def skin_of(values, centre, direction):
    """Returns the distance from the centre at which a ray first meets the skin from outside [mm]."""
    radii = np.arange(140.0, 20.0, -0.1)
    places = (centre[:, None] + direction[:, None] * radii) / 2.0
    along = ndimage.map_coordinates(values, places[::-1], order=3, mode="nearest")
    inside = np.nonzero(along > SKIN)[0]
    return radii[inside[0]] if len(inside) else None


@unittest.skipUnless(os.environ.get("PALPATE_LONG") and shutil.which("elastix") and ndimage and HEAD.exists(),
                     "needs test.sh --long, elastix, scipy and mricron-data")
class Elastix(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        holder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(holder.cleanup)
        cls.dir = Path(holder.name)
        moving = head()
        z, y, x = (2.0 * n.astype(np.float32) for n in np.indices(moving.shape))
        u = shifts(z, y, x)
        cls.fixed = ndimage.map_coordinates(moving, [(z + u[2]) / 2, (y + u[1]) / 2, (x + u[0]) / 2], order=3,
                                            mode="nearest")
        write_image(cls.dir / "fixed.mhd", cls.fixed)
        write_image(cls.dir / "moving.mhd", moving)
        (cls.dir / "p.txt").write_text(PARAMETERS)
        cls.run_program("elastix", "-f", "fixed.mhd", "-m", "moving.mhd", "-p", "p.txt", "-out", ".", "-threads", "2")
        for form in FORMS:
            folder = cls.dir / form
            folder.mkdir()
            text = (cls.dir / "TransformParameters.0.txt").read_text()
            (cls.dir / "t.txt").write_text(text.replace('(ResultImageFormat "mhd")', f'(ResultImageFormat "{form}")'))
            cls.run_program("transformix", "-def", "all", "-tp", "t.txt", "-out", form)
        cls.run_program(BIN / "palpate-import", "moving.mhd", "head.vdb")
        for form in FORMS:
            cls.run_program(BIN / "palpate-import", f"{form}/deformationField.{form}", f"{form}.vdb", "--as",
                            "displacement")

    @classmethod
    def run_program(cls, *words):
        done = subprocess.run(list(map(str, words)), cwd=cls.dir, capture_output=True, text=True, timeout=500)
        if done.returncode != 0:
            raise AssertionError(f"{words}: {done.stdout[-2000:]}{done.stderr[-2000:]}")
        return done.stdout

    def distances(self, warp):
        """Presses on the head along rays. Returns the distances of the proxies from the fixed image's skin [mm]."""
        centre = np.array([100.0, 120.0, 110.0])
        rows = []
        ends = []
        at = angle = 0.0
        for n in range(RAYS):
            # A spiral from the top, so that the hand passes from ray to ray outside the head.
            up = 1.0 - 1.2 * (n + 0.5) / RAYS
            side = (1.0 - up * up) ** 0.5
            angle += 3.6 / (RAYS ** 0.5 * side)
            direction = np.array([side * np.cos(angle), side * np.sin(angle), up])
            radius = skin_of(self.fixed, centre, direction)
            if radius is None:
                continue
            for far, seconds in ((150.0, 0.5), (radius - 3.0, 0.3), (150.0, 0.3)):
                at += seconds
                rows.append((at, *(1e-3 * RAS * (centre + far * direction))))
                if far < 150.0:
                    ends.append(at)
        (self.dir / "hand.csv").write_text("t,x,y,z\n" + "".join("%.6f,%.9f,%.9f,%.9f\n" % r for r in rows))
        place = {"scale": 0.001}
        volumes = {"head": {"file": "head.vdb", "place": place}}
        if warp:
            volumes["u"] = {"file": warp, "place": {"scale": 0.001}}
            place["warp"] = {"field": "u"}
        scene = {"palpate": 1, "coupling": {"stiffness": 500}, "volumes": volumes,
                 "modes": [{"mode": "isosurface", "of": "head", "value": SKIN, "solid": "above", "strength": 10}]}
        (self.dir / "s.json").write_text(json.dumps(scene))
        self.run_program(BIN / "palpate", "feel", "s.json", "--device", "path:hand.csv", "--seconds", at - rows[0][0],
                         "--trace", "out.csv")
        with open(self.dir / "out.csv", encoding="utf-8") as file:
            ticks = list(csv.DictReader(file))
        out = []
        for end in ends:
            tick = ticks[round(1000 * (end - rows[0][0])) - 2]
            force = [float(tick["force_" + a]) for a in "xyz"]
            if not any(force):
                continue
            p = 1e3 * RAS * np.array([float(tick["proxy_" + a]) for a in "xyz"]) / 2.0
            near = p[::-1, None] + np.c_[np.zeros(3), 0.1 * np.eye(3), -0.1 * np.eye(3)]
            values = ndimage.map_coordinates(self.fixed, near, order=3, mode="nearest")
            slope = np.linalg.norm(values[1:4] - values[4:7]) / (0.2 * 2.0)
            out.append((values[0] - SKIN) / slope)
        return np.array(out)

    def test_a_warp_by_elastix_moves_the_skin_to_that_of_the_fixed_image(self):
        rms = {}
        for warp in (None, *(form + ".vdb" for form in FORMS)):
            off = self.distances(warp)
            self.assertGreater(len(off), 0.9 * RAYS)
            rms[warp] = np.sqrt(np.mean(off ** 2))
            print(f"{warp or 'no warp'}: {len(off)} places, {rms[warp]:.3f} mm rms, {np.abs(off).max():.2f} mm at most")
        self.assertGreater(rms[None], 1.0)
        self.assertLess(rms["mhd.vdb"], 0.6)
        for form in FORMS:
            self.assertAlmostEqual(rms[form + ".vdb"], rms["mhd.vdb"], 3)


if __name__ == "__main__":
    suite.main(sys.argv[2:])
