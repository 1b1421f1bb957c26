#!/usr/bin/env python3
"""Tests the window and its stills under Xvfb with a synthetic mouse: the picture must agree with the trace.
view_test.py BIN_DIR VOLUMES_PROGRAM [CLASS...]. Exit status 77 if Xvfb, xdotool or matplotlib is missing."""
import contextlib
import csv
import ctypes
import json
import math
import os
import re
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
import suite  # noqa: E402

BIN = Path(sys.argv[1]).resolve()
VOLUMES = str(Path(sys.argv[2]).resolve())
PALPATE = str(BIN / "palpate")
PATIENCE = int(os.environ.get("PALPATE_PATIENCE", "240"))  # [s]; for a busy machine

if not all(shutil.which(program) for program in ("Xvfb", "xdotool")):
    print("view_test: skipped: needs xvfb and xdotool")
    sys.exit(77)
try:
    import numpy as np
    from matplotlib.image import imread
except ImportError:
    print("view_test: skipped: needs python3-matplotlib")
    sys.exit(77)

RADIUS = 0.04  # [m]
SCENE = {
    "palpate": 1,
    "coupling": {"stiffness": 500, "damping": 0.5},
    "volumes": {"ball": {"file": "ball.vdb", "grid": "ball", "place": {"scale": 0.02}}},
    "modes": [{"name": "skin", "mode": "isosurface", "of": "ball", "value": 0, "solid": "below",
               "strength": 3},
              {"name": "pin", "mode": "guide", "shape": "point", "at": [0, 0, 0.2],
               "snap": 0.01, "strength": 1}],
}


def near(image, at, colour, reach):
    """Counts the pixels around a point that have a colour's hue."""
    height = image.shape[0]
    x, y = round(at[0]), round(height - 1 - at[1])
    part = image[max(0, y - reach):y + reach + 1, max(0, x - reach):x + reach + 1, :3]
    # Compares hues: each channel minus the mean of the three.
    grey = part.mean(axis=2, keepdims=True)
    hue = part - grey
    want = [c - sum(colour) / 3 for c in colour]
    size = math.sqrt(sum(c * c for c in want))
    along = (hue * [c / size for c in want]).sum(axis=2)
    across = ((hue**2).sum(axis=2) - along**2).clip(0)**0.5
    return int(((along > 0.12) & (across < 0.45 * along)).sum())


PROXY, FORCE, PROBE = (0.34, 0.71, 0.91), (0.80, 0.47, 0.65), (0.90, 0.62, 0.00)
HOLDS = (0.00, 0.45, 0.70)


def rows(path):
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))


def vector(row, of):
    return [float(row[f"{of}_{a}"]) for a in "xyz"]


def folder_until(cleanup):
    """Makes a folder. The registered cleanup removes it."""
    holder = tempfile.TemporaryDirectory()  # pylint: disable=consider-using-with
    cleanup(holder.cleanup)
    return Path(holder.name)


class Case(unittest.TestCase):
    SCENE = SCENE

    @classmethod
    def setUpClass(cls):
        cls.volumes = folder_until(cls.addClassCleanup)
        subprocess.run([VOLUMES, str(cls.volumes)], check=True)

    def setUp(self):
        self.use(folder_until(self.addCleanup))
        self.write_scene(self.SCENE)

    def use(self, folder):
        """Uses this folder and the scene file in it."""
        self.dir = folder
        self.scene = folder / f"{folder.name}.json"   # the window's title has this name
        self.told_file = folder / "told.json"
        self.env = {**os.environ, "PALPATE_VIEW_TOLD": str(self.told_file), "PALPATE_VIEW_TOLD_EVERY": "0.05"}

    def text_of(self, scene):
        scene = json.loads(json.dumps(scene))
        for volume in scene["volumes"].values():
            volume["file"] = str(self.volumes / volume["file"])
        return json.dumps(scene)

    def write_scene(self, scene):
        """Writes the scene by renaming, so that a run that watches the file never reads a part of it."""
        partial = self.dir / "partial.json"
        partial.write_text(self.text_of(scene), encoding="utf-8")
        partial.rename(self.scene)

    def told(self):
        try:
            return json.loads(self.told_file.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return {}


class Still(Case):
    first = None  # folder of the picture that tests share

    def still(self, *words, env=None, status=0):
        done = subprocess.run([PALPATE, "view", str(self.scene), *words], cwd=self.dir, text=True,
                              env=env or self.env, capture_output=True, timeout=PATIENCE, check=False)
        self.assertEqual(done.returncode, status, done.stderr)
        return done

    def press_drawn(self, env=None):
        """Draws a hand that moves from the camera's side into the ball, 3 mm deep."""
        (self.dir / "path.csv").write_text("t,x,y,z\n0,0.01,-0.06,0.01\n1,0.01,-0.034,0.01\n",
                                           encoding="utf-8")
        self.still("--device", "path:path.csv", "--picture", "still.png", "--trace", "t.csv", env=env)

    def use_the_first(self):
        """Uses a picture that tests share. It is drawn without a display, so palpate starts a server. A client without
        a cookie tries to connect even before palpate knows the number of the display."""
        if Still.first is None:
            self.use(folder_until(self.addClassCleanup))
            self.write_scene(SCENE)
            self.press_drawn(self.beside(f"""
cd '{self.dir}' && mkfifo number
{shutil.which("Xvfb")} "$@" 3> number &
trap "kill $!" TERM
read -r number < number
DISPLAY=:$number XAUTHORITY=/dev/null xdotool getmouselocation > stranger 2>&1
echo $? >> stranger
echo $number >&3
wait
wait
"""))
            Still.first = self.dir
        self.use(Still.first)

    def test_a_picture_from_the_command_view_shows_the_last_tick(self):
        self.use_the_first()
        told = self.told()
        trace = {round(1e6 * float(row["t"])): row for row in rows(self.dir / "t.csv")}
        row = trace[round(1e6 * told["time"])]
        self.assertEqual(float(rows(self.dir / "t.csv")[-1]["t"]), told["time"])
        for of in ("probe", "proxy", "force"):
            for mine, his in zip(told[of], vector(row, of)):
                self.assertAlmostEqual(mine, his, places=15)
        force = math.hypot(*told["force"])
        self.assertGreater(force, 0.5)
        # The proxy is on the ball. The bar shows the spring's force without damping.
        self.assertAlmostEqual(math.hypot(*told["proxy"]), RADIUS, delta=0.02 * RADIUS)
        skin, pin = told["bars"]
        self.assertEqual((skin["name"], skin["strength"], skin["state"]), ("skin", 3.0, "holds"))
        self.assertAlmostEqual(skin["load"], 500 * math.dist(told["probe"], told["proxy"]), delta=1e-6)
        self.assertEqual((pin["load"], pin["state"]), (0.0, "idle"))
        # The image shows force, proxy and probe at the reported positions.
        image = imread(self.dir / "still.png")
        self.assertEqual(image.shape[:2][::-1], tuple(told["size"]))
        pixels = told["pixels"]
        self.assertGreater(near(image, pixels["tip"], FORCE, 12), 5)
        self.assertGreater(near(image, pixels["proxy"], PROXY, 14), 8)
        self.assertGreater(near(image, pixels["probe"], PROBE, 14), 8)
        nowhere = [told["size"][0] * 0.04, told["size"][1] * 0.95]
        for colour in (FORCE, PROXY, PROBE):
            self.assertEqual(near(image, nowhere, colour, 14), 0)
        self.assertEqual([p for p in self.dir.iterdir() if "partial" in p.name], [])

    def test_an_inner_surface_is_visible_through_the_outer_one(self):
        """Beside the inner ball, the background is visible through the outer ball. Stills have 300 dpi for print."""
        own = self.dir
        scene = json.loads(json.dumps(SCENE))
        scene["modes"].append({"name": "core", "mode": "isosurface", "of": "ball", "value": -0.25, "solid": "below",
                               "strength": 3})
        self.write_scene(scene)
        self.press_drawn()
        self.use_the_first()
        light = []
        for folder in (self.dir, own):
            self.use(folder)
            told = self.told()
            image = imread(self.dir / "still.png")
            x, y = told["pixels"]["centre"][0], told["size"][1] - 1 - told["pixels"]["centre"][1]
            # The difference from the background, along the picture's row through the ball's centre.
            wide = np.abs(image[round(y), :, :3].mean(axis=1) - image[round(y), 20, :3].mean())
            light.append(wide)
        right = next(i for i in range(round(x), round(x) + 600) if light[0][i] < 0.1)
        rim = round(x + 0.95 * (right - x))
        self.assertLess(light[1][rim], 0.7 * light[0][rim])
        self.assertGreater(light[1][round(x)], 0.7 * light[0][round(x)])
        png = (self.dir / "still.png").read_bytes()
        at = png.index(b"pHYs")
        self.assertEqual(struct.unpack(">IIB", png[at + 4:at + 13]), (11811, 11811, 1))
        self.assertEqual(struct.unpack(">I", png[at + 13:at + 17])[0], zlib.crc32(png[at:at + 13]))

    def test_the_surface_of_a_label_has_the_colour_of_its_segment(self):
        (self.dir / "path.csv").write_text("t,x,y,z\n0,0.03,0.06,0\n0.1,0.03,0.06,0\n", encoding="utf-8")
        values = [7 * (math.dist((x, y, z), (8, 8, 8)) < 6) for z in range(17) for y in range(17) for x in range(17)]
        (self.dir / "ball.seg.nrrd").write_text(
            "NRRD0004\ntype: uchar\ndimension: 3\nspacings: 1 1 1\nsizes: 17 17 17\nencoding: ascii\n"
            "Segment0_Name:=ball\nSegment0_LabelValue:=7\nSegment0_Color:=0.1 0.2 0.9\n\n"
            + "\n".join(map(str, values)) + "\n", encoding="utf-8")
        subprocess.run([PALPATE, "import", "ball.seg.nrrd", "own.vdb"], cwd=self.dir, check=True, capture_output=True)
        blue = []
        for key in ({"label": "ball"}, {"value": 3.5}):
            self.scene.write_text(json.dumps({
                "palpate": 1, "volumes": {"ball": {"file": "own.vdb", "place": {"fit": 0.1}}},
                "modes": [{"mode": "isosurface", "of": "ball", **key, "strength": 1}]}), encoding="utf-8")
            self.still("--device", "path:path.csv", "--picture", "still.png")
            blue.append(near(imread(self.dir / "still.png"), self.told()["pixels"]["centre"], (0.1, 0.2, 0.9), 10))
            self.still("--device", "path:path.csv", "--picture", "still.png", "--slice", "all")
            self.assertEqual(self.told()["legend"], ["slices of ball", "/modes/0"])
            blue.append(near(imread(self.dir / "still.png"), self.told()["pixels"]["centre"], (0.1, 0.2, 0.9), 150))
        self.assertGreater(blue[0], 400)
        self.assertGreater(blue[1], 50)   # the label's line on slices of the labels
        self.assertEqual(blue[2:], [0, 0])

    def test_a_volume_without_a_scene_is_drawn(self):
        self.scene = self.volumes / "ball.vdb"
        self.still("--seconds", "0.1", "--picture", "still.png")
        told = self.told()
        x, y = told["pixels"]["centre"][0], told["size"][1] - 1 - told["pixels"]["centre"][1]
        image = imread(self.dir / "still.png")
        self.assertGreater(image[round(y), round(x), :3].mean() - image[round(y), 20, :3].mean(), 0.1)
        self.assertTrue(told["bars"])

    def test_a_patient_is_seen_from_the_front(self):
        """In RAS, +x is the patient's right. From the front it is on the left of the picture."""
        (self.dir / "path.csv").write_text("t,x,y,z\n0,0.03,0.06,0\n0.1,0.03,0.06,0\n", encoding="utf-8")
        values = [7 - math.dist((x, y, z), (8, 8, 8)) for z in range(17) for y in range(17) for x in range(17)]
        for space, left in (("space: right-anterior-superior\nspace directions: (1,0,0) (0,1,0) (0,0,1)", True),
                            ("spacings: 1 1 1", False)):
            with self.subTest(space=space):
                (self.dir / "ball.nrrd").write_text(
                    f"NRRD0004\ntype: float\ndimension: 3\n{space}\nsizes: 17 17 17\nencoding: ascii\n\n"
                    + "\n".join(map(str, values)) + "\n", encoding="utf-8")
                subprocess.run([PALPATE, "import", "ball.nrrd", "own.vdb"], cwd=self.dir, check=True,
                               capture_output=True)
                self.scene.write_text(json.dumps({
                    "palpate": 1, "volumes": {"ball": {"file": "own.vdb", "place": {"fit": 0.1}}},
                    "modes": [{"mode": "isosurface", "of": "ball", "value": value, "solid": "above", "strength": 1}
                              for value in (0, 3)]}), encoding="utf-8")
                self.still("--device", "path:path.csv", "--picture", "still.png")
                pixels = self.told()["pixels"]
                self.assertEqual(pixels["probe"][0] < pixels["centre"][0], left)
                letters = self.told()["letters"]
                self.assertEqual(sorted(letters), list("AILPRS") if left else [])
                if left:
                    self.assertLess(letters["R"][0], pixels["centre"][0])
                    self.assertGreater(letters["L"][0], pixels["centre"][0])
                    self.assertGreater(letters["S"][1], pixels["centre"][1])
                    self.assertLess(letters["I"][1], pixels["centre"][1])
                    # Each letter is light on a dark ground, also above the transparent outer surface.
                    image = imread(self.dir / "still.png")
                    for letter, at in letters.items():
                        x, y = round(at[0]), round(self.told()["size"][1] - 1 - at[1])
                        part = image[y - 12:y + 12, x - 12:x + 12, :3]
                        self.assertGreater(int((part.min(axis=2) > 0.8).sum()), 20, letter)
                        self.assertGreater(int((part.max(axis=2) < 0.25).sum()), 100, letter)
                (self.dir / "own.vdb").unlink()

    def test_a_strong_force_and_its_number_stay_inside_the_picture(self):
        """At full length, the first two arrows would leave the picture. The last one points at the camera."""
        scene = json.loads(json.dumps(SCENE))
        scene["modes"][0]["strength"] = 30
        self.write_scene(scene)
        for name, start, end, short in (("up", (0.001, 0, 0.06), (0.001, 0, 0.003), True),
                                        ("left", (-0.05, -0.02, -0.03), (-0.007, -0.0028, -0.0042), True),
                                        ("near", (0.02, -0.06, 0.03), (0.004, -0.012, 0.006), False)):
            with self.subTest(arrow=name):
                (self.dir / "path.csv").write_text("t,x,y,z\n" + "".join(
                    f"{t},{x},{y},{z}\n" for t, (x, y, z) in enumerate((start, end))), encoding="utf-8")
                self.still("--device", "path:path.csv", "--picture", "still.png")
                told = self.told()
                force = math.hypot(*told["force"])
                self.assertGreater(force, 12)
                self.assertEqual(told["words"], f"{force:.2f} N" + " (arrow shortened)" * short)
                wide, high = told["size"][0] - 600, told["size"][1]
                tip, proxy = told["pixels"]["tip"], told["pixels"]["proxy"]
                self.assertTrue(0.04 * wide < tip[0] < 0.96 * wide and 0.04 * high < tip[1] < 0.96 * high, tip)
                left, bottom, right, top = told["newtons"]
                self.assertGreater(right - left, 60)
                self.assertTrue(0 <= left and 0 <= bottom and right <= wide and top <= high, told["newtons"])
                for share in np.linspace(0, 1, 50):
                    x, y = (a + share * (b - a) for a, b in zip(proxy, tip))
                    self.assertFalse(left < x < right and bottom < y < top, told)
                image = imread(self.dir / "still.png")[:, :wide]
                if short:  # an arrow that points at the camera is dark
                    self.assertGreater(near(image, tip, FORCE, 12), 5)
                self.assertGreater(near(image, ((left + right) / 2, (bottom + top) / 2), FORCE, 20), 100)
                # The number has a margin to all sides, so no letter is cut.
                for edge in (image[:6], image[-6:], image[:, :6], image[:, -6:]):
                    self.assertLess(float((edge[..., 0] - edge[..., 1]).max()), 0.1)

    def test_a_picture_shows_the_scene_from_the_chosen_side_with_the_chosen_slice(self):
        """The hand is at (0.01, -0.034, 0.01) m. A slice across x faces the camera only from the left and the right."""
        (self.dir / "path.csv").write_text("t,x,y,z\n0,0.01,-0.06,0.01\n1,0.01,-0.034,0.01\n", encoding="utf-8")
        lines = {}
        for side, right, up in (("front", 1, 1), ("back", -1, 1), ("left", 1, 1), ("right", -1, 1), ("top", 1, -1),
                                ("bottom", 1, 1)):
            with self.subTest(side=side):
                self.still("--device", "path:path.csv", "--picture", "still.png", "--camera", side, "--slice", "x")
                told = self.told()
                probe, centre = told["pixels"]["probe"], told["pixels"]["centre"]
                self.assertGreater(right * (probe[0] - centre[0]), 20)
                self.assertGreater(up * (probe[1] - centre[1]), 20)
                self.assertEqual((told["sliced"], told["legend"]), ("ball", ["slices of ball", "skin", "pin"]))
                part = imread(self.dir / "still.png")[:, :1320, :3]
                lines[side] = int(((part[..., 0] > 0.9) & (part[..., 1] > 0.7) & (part[..., 2] < 0.3)).sum())
        self.assertGreater(min(lines["left"], lines["right"]), 1000)
        self.assertLess(max(lines[side] for side in ("front", "back", "top", "bottom")), 300)

    def test_an_impossible_camera_or_slice_is_refused_in_one_line(self):
        picture = ("--picture", "still.png")
        still_only = r"it applies only to a picture: add --picture FILE\.png, or press "
        for words, said in ((("--camera", "above", *picture),
                             '--camera: "above" is not a side of the scene: use front, back, left, right, top, bottom'),
                            (("--camera", "left"), f"--camera: {still_only}v in the window"),
                            (("--slice", "w", *picture), '--slice: "w" is not an axis: use x, y, z, all'),
                            (("--slice", "x"), f"--slice: {still_only}s in the window")):
            done = self.still(*words, status=2)
            self.assertRegex(done.stderr, f"^palpate: {said}\n$")
        subprocess.run([PALPATE, "make", "wind-tunnel", "wind.vdb", "--voxel", "0.02"], cwd=self.dir, check=True,
                       capture_output=True)
        self.scene.write_text(json.dumps({
            "palpate": 1, "volumes": {"wind": {"file": "wind.vdb", "grid": "velocity", "place": {"fit": 0.1}}},
            "modes": [{"mode": "follow", "of": "wind", "strength": 1}]}), encoding="utf-8")
        done = self.still("--slice", "x", *picture, status=2)
        self.assertRegex(done.stderr, "palpate: --slice: the scene has no scalar volume: leave out --slice\n$")

    def make_volume(self, name, value, depth=17):
        """Imports a volume of 17 x 17 x depth voxels from a function of their indices."""
        values = [value(x, y, z) for z in range(depth) for y in range(17) for x in range(17)]
        (self.dir / f"{name}.nrrd").write_text(
            f"NRRD0004\ntype: float\ndimension: 3\nspacings: 1 1 1\nsizes: 17 17 {depth}\nencoding: ascii\n\n"
            + "\n".join(map(str, values)) + "\n", encoding="utf-8")
        subprocess.run([PALPATE, "import", f"{name}.nrrd", f"{name}.vdb"], cwd=self.dir, check=True,
                       capture_output=True)

    def test_a_cloud_is_drawn_only_where_all_factors_of_its_strength_are_above_zero(self):
        (self.dir / "path.csv").write_text("t,x,y,z\n0,0.03,0.06,0\n0.1,0.03,0.06,0\n", encoding="utf-8")
        self.make_volume("all", lambda x, y, z: 5 + 0.1 * x)
        self.make_volume("left", lambda x, y, z: float(x < 8))
        fog = {"piecewise": [[0, 0], [1, 1]]}
        light = {}
        for factors in (1, 2):
            self.scene.write_text(json.dumps({
                "palpate": 1, "volumes": {"all": {"file": "all.vdb", "place": {"fit": 0.1}},
                                          "left": {"file": "left.vdb", "place": {"like": "all"}}},
                "modes": [{"mode": "viscosity", "of": "all", "strength": {"product": [
                    {"by": "all", **fog}, {"by": "left", **fog}][:factors]}}]}), encoding="utf-8")
            self.still("--device", "path:path.csv", "--picture", "still.png", "--camera", "front")
            image = imread(self.dir / "still.png")[:, :1320, :3]
            x, y = round(self.told()["pixels"]["centre"][0]), 640
            light[factors] = [float(np.abs(image[y, x + side * 200] - image[y, 20]).max()) for side in (-1, 1)]
        self.assertGreater(min(*light[1], light[2][0]), 0.05)
        self.assertLess(light[2][1], 0.01)

    def test_a_surface_is_closed_where_the_data_end(self):
        """The data end in the middle of a ball. A flat surface has one shade, and a bowl has many."""
        (self.dir / "path.csv").write_text("t,x,y,z\n0,0.03,0.06,0\n0.1,0.03,0.06,0\n", encoding="utf-8")
        self.make_volume("half", lambda x, y, z: max(0.0, 7 - math.dist((x, y, z), (8, 8, 8))), depth=9)
        self.scene.write_text(json.dumps({
            "palpate": 1, "volumes": {"half": {"file": "half.vdb", "place": {"fit": 0.1}}},
            "modes": [{"mode": "isosurface", "of": "half", "value": 1, "solid": "above", "strength": 1}]}),
            encoding="utf-8")
        self.still("--device", "path:path.csv", "--picture", "still.png", "--camera", "top")
        image = imread(self.dir / "still.png")
        x, y = (round(a) for a in self.told()["pixels"]["centre"])
        self.assertLess(float(image[y, x - 120:x + 120, :3].std(axis=0).max()), 0.02)
        self.assertGreater(float(np.abs(image[y, x, :3] - image[y, 20, :3]).max()), 0.1)

    def test_axial_vectors_and_vortex_cores_are_drawn(self):
        for made, modes, colours in (
                ("fibres", [{"name": "fibres", "mode": "follow", "of": "field", "strength": 1}], 200),
                ("wind-tunnel", [{"name": "cores", "mode": "vortex_tube", "of": "field", "strength": 1}], 200)):
            with self.subTest(made=made):
                grid = {"fibres": "direction", "wind-tunnel": "velocity"}[made]
                coarse = {"fibres": "3", "wind-tunnel": "0.02"}[made]
                subprocess.run([PALPATE, "make", made, "made.vdb", "--voxel", coarse], cwd=self.dir,
                               check=True, capture_output=True)
                volume = {"file": "made.vdb", "grid": grid, "place": {"fit": 0.1}}
                if made == "fibres":
                    volume["axial"] = True
                self.scene.write_text(json.dumps({"palpate": 1, "volumes": {"field": volume}, "modes": modes}),
                                      encoding="utf-8")
                self.still("--seconds", "0.1", "--picture", "still.png")
                told = self.told()
                self.assertEqual(told["legend"], [modes[0]["name"]])
                image = imread(self.dir / "still.png")[:, :1300, :3]
                # Only lines at the light end of the colour scale are yellow.
                yellow = (image[..., 0] > 0.6) & (image[..., 1] > 0.5) & (image[..., 2] < 0.5)
                self.assertGreater(int(yellow.sum()), colours)

    def beside(self, server):
        """Returns an environment without a display, in which the script `server` replaces Xvfb."""
        place = self.dir / "bin"
        place.mkdir(exist_ok=True)
        (place / "Xvfb").write_text("#!/bin/sh\n" + server, encoding="utf-8")
        (place / "Xvfb").chmod(0o755)
        env = {name: value for name, value in self.env.items() if name != "DISPLAY"}
        return {**env, "PATH": f"{place}:{env['PATH']}"}

    def test_ctrl_c_ends_the_drawing_of_a_picture(self):
        """Ends palpate while it waits for a server that prints its number without end."""
        env = self.beside(f"touch '{self.dir}/begun'\nwhile printf 1 >&3; do sleep 1; done\n")
        for asked in (signal.SIGINT, signal.SIGTERM):
            with self.subTest(asked=asked.name):
                with subprocess.Popen([PALPATE, "view", str(self.scene), "--seconds", "0.1", "--picture", "still.png",
                                       "--trace", "t.csv"], cwd=self.dir, env=env, text=True,
                                      stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as feel:
                    end = time.monotonic() + PATIENCE
                    while not (self.dir / "begun").exists() and time.monotonic() < end:
                        time.sleep(0.01)
                    feel.send_signal(asked)
                    said = feel.communicate(timeout=PATIENCE)[1]
                self.assertEqual(feel.returncode, 130, said)
                self.assertIn("palpate: feel: interrupted: the picture was not drawn\n", said)
                self.assertTrue((self.dir / "t.csv").exists())
                self.assertEqual([p.name for p in self.dir.iterdir() if "still" in p.name], [])
                (self.dir / "begun").unlink()
                (self.dir / "t.csv").unlink()

    def test_a_failed_picture_is_reported_if_sigchld_is_ignored(self):
        env = {**self.env, "PATH": str(self.dir), "DISPLAY": ":7777"}
        done = subprocess.run(["/usr/bin/env", "--ignore-signal=CHLD", PALPATE, "view", str(self.scene), "--seconds",
                               "0.1", "--picture", "still.png"], cwd=self.dir, env=env, text=True,
                              capture_output=True, timeout=PATIENCE, check=False)
        self.assertEqual(done.returncode, 2, done.stderr)
        self.assertIn("the picture was not drawn: its exit status is 2", done.stderr)
        self.assertEqual([p.name for p in self.dir.iterdir() if "still" in p.name], [])

    def test_an_opengl_version_that_is_too_old_is_reported(self):
        env = {**self.env, "MESA_GL_VERSION_OVERRIDE": "2.1"}
        env.pop("DISPLAY", None)
        done = self.still("--seconds", "0.1", "--picture", "still.png", env=env, status=2)
        self.assertRegex(done.stderr, r"palpate: display: OpenGL does not start, or its version is below 3\.2: .*\n"
                         r"palpate: \S+: the picture was not drawn: its exit status is 2: .*\n$")
        self.assertEqual([p.name for p in self.dir.iterdir() if "still" in p.name], [])

    def test_other_clients_cannot_connect_to_the_display(self):
        self.use_the_first()
        said = (self.dir / "stranger").read_text(encoding="utf-8")
        self.assertEqual(said.split()[-1], "1", said)
        self.assertTrue((self.dir / "still.png").exists())

    def test_a_picture_that_fails_leaves_no_file(self):
        done = self.still("--picture", "still.gif", status=2)
        self.assertRegex(done.stderr, r"^palpate: .*still\.gif: it is not named \.png: .*\n$")
        bare = {**self.env, "PATH": str(self.dir), "DISPLAY": ":7777"}
        done = self.still("--seconds", "0.1", "--picture", "still.png", env=bare, status=2)
        self.assertRegex(done.stderr, r"palpate: display: :7777 cannot be opened: install xvfb")
        self.assertEqual([p.name for p in self.dir.iterdir() if "still" in p.name], [])


class Window(Case):
    """Tests of windows on one X server. The windows are small, so that they draw fast."""
    SIZE = (700, 400)  # [pixels]; the panel is 300 wide

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.screens = folder_until(cls.addClassCleanup)
        cls.display, _ = cls.serve(cls.addClassCleanup, "-fbdir", str(cls.screens))

    def use(self, folder):
        super().use(folder)
        self.env.update(DISPLAY=self.display, PALPATE_VIEW_WIDTH=str(self.SIZE[0]),
                        PALPATE_VIEW_HEIGHT=str(self.SIZE[1]))

    def image(self, window):
        """Returns the part of the screen that shows a window, with colours from 0 to 1."""
        words = self.do("getwindowgeometry", "--shell", window)
        at = {name: int(value) for name, value in (word.split("=") for word in words)}
        screen = (self.screens / "Xvfb_screen0").read_bytes()
        # The xwd format: a header of 32-bit numbers, 12 bytes per colour of a map, then rows of blue, green, red.
        head = struct.unpack(">25I", screen[:100])
        height, line = head[5], head[12]
        pixels = np.frombuffer(screen, np.uint8, height * line, head[0] + 12 * head[19]).reshape(height, -1, 4)
        return pixels[at["Y"]:at["Y"] + at["HEIGHT"], at["X"]:at["X"] + at["WIDTH"], 2::-1] / 255

    @staticmethod
    def serve(cleanup, *words):
        """Starts a server, which the registered cleanup ends. Returns its display and its process."""
        ends = os.pipe()
        # -noreset: the server continues after its last client has left. -r: keys do not repeat.
        server = subprocess.Popen(["Xvfb", "-displayfd", str(ends[1]), "-screen", "0", "1100x760x24", "-noreset", "-r",
                                   "-nolisten", "tcp", *words], pass_fds=[ends[1]], stderr=subprocess.DEVNULL)
        cleanup(server.wait)
        cleanup(server.kill)
        os.close(ends[1])
        with os.fdopen(ends[0]) as number:
            return ":" + number.readline().strip(), server

    def start(self, *words, program=PALPATE):
        feel = self.launch(self.addCleanup, *words, program=program)
        self.feel = feel
        return feel

    def launch(self, cleanup, *words, program=PALPATE):
        """Starts a run. The registered cleanup ends it and its window."""
        if self.env["DISPLAY"] == self.display:
            self.do("mousemove", 1090, 750)  # outside the window
        with open(self.dir / "log", "w", encoding="utf-8") as log:
            feel = subprocess.Popen([program, "view", str(self.scene), *words], cwd=self.dir, env=self.env,
                                    stdout=subprocess.DEVNULL, stderr=log, start_new_session=True)

        def end():
            with contextlib.suppress(ProcessLookupError):
                os.killpg(feel.pid, signal.SIGKILL)
            feel.wait()
        cleanup(end)
        return feel

    def said(self):
        return (self.dir / "log").read_text(encoding="utf-8")

    def until(self, what, true):
        """Waits until the window's state satisfies a condition. Returns the state."""
        end = time.monotonic() + PATIENCE
        ended = None
        while time.monotonic() < end:
            if ended is None:
                ended = self.feel.poll()
                if ended is not None:
                    end = min(end, time.monotonic() + 10)  # the window may show that the run has ended
            told = self.told()
            if told and true(told):
                return told
            time.sleep(0.03)
        state = "the run continues" if ended is None else f"the run has ended with {ended}"
        raise AssertionError(f"never {what}: {state}: {self.told()}, {self.said()}")

    def until_said(self, words):
        end = time.monotonic() + PATIENCE
        while words not in self.said() and time.monotonic() < end:
            time.sleep(0.03)
        self.assertIn(words, self.said())

    def until_at_rest(self):
        """Waits until the window has written its state five times without a new frame. Returns the state."""
        end = time.monotonic() + PATIENCE
        frames = -1
        while time.monotonic() < end:
            for _ in range(5):
                before = os.stat(self.told_file).st_mtime_ns
                while os.stat(self.told_file).st_mtime_ns == before and time.monotonic() < end:
                    time.sleep(0.02)
            told = self.told()
            if told["frames"] == frames and time.monotonic() < end:
                return told
            frames = told["frames"]
        raise AssertionError(f"the window still draws: {self.told()}")

    def cover(self):
        """Covers the screen with another window. Returns a function that removes it."""
        x11 = ctypes.CDLL("libX11.so.6")
        x11.XOpenDisplay.restype = ctypes.c_void_p
        display = ctypes.c_void_p(x11.XOpenDisplay(self.env["DISPLAY"].encode()))
        x11.XDefaultRootWindow.restype = x11.XCreateSimpleWindow.restype = ctypes.c_ulong
        root = ctypes.c_ulong(x11.XDefaultRootWindow(display))
        window = x11.XCreateSimpleWindow(display, root, 0, 0, 1100, 760, 0, ctypes.c_ulong(0), ctypes.c_ulong(0))
        x11.XMapRaised(display, ctypes.c_ulong(window))
        x11.XSync(display, 0)
        return lambda: x11.XCloseDisplay(display)

    def until_shown(self, what, window, true):
        """Waits until a window's image satisfies a condition."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            if true(self.image(window)):
                return
            time.sleep(0.05)
        raise AssertionError(f"never {what} on the screen: {self.told()}")

    def do(self, *words):
        done = subprocess.run(["xdotool", *map(str, words)], env=self.env, text=True,
                              capture_output=True, timeout=PATIENCE, check=False)
        self.assertEqual(done.returncode, 0, f"xdotool {words}: {done.stderr} {self.told()}")
        return done.stdout.split()

    def keys(self, window, *names):
        """Presses and releases keys. For a window that has the focus, xdotool presses the server's keys, for others it
        sends events. If the focus changes in between, a key stays down, so this releases it by another command."""
        for name in names:
            self.do("key", "--window", window, name)
            self.do("keyup", name)

    def close(self, window):
        """Closes a window with the key q. xdotool fails if the window closes before xdotool can release the key."""
        subprocess.run(["xdotool", "key", "--window", window, "q"], env=self.env, timeout=PATIENCE,
                       stderr=subprocess.DEVNULL, check=False)
        self.do("keyup", "q")

    def window(self):
        """Returns the window of this test's scene once it draws. The shared run may have a window too."""
        self.until("a frame", lambda told: told["frames"] > 0)
        return self.do("search", "--onlyvisible", "--name", f"^palpate: {self.scene.name}")[0]

    def child(self, feel):
        return int(subprocess.run(["pgrep", "-P", str(feel.pid), "-x", "palpate-view"], text=True,
                                  capture_output=True, check=True).stdout.split()[0])

    def ended(self, feel):
        return feel.wait(timeout=PATIENCE)

    def ends_well(self, feel):
        """Checks that the run ends without a fault, or with the fault "late", as on a busy machine."""
        if self.ended(feel) != 0:
            self.assertEqual(feel.returncode, 1, self.said())
            self.assertIn("the force was cut: the loop was late", self.said())
            self.assertNotIn("the window has ended", self.said())

    def press(self, window):
        """Moves the mouse until the hand presses into the ball."""
        told = self.until("a hand", lambda told: told["tick"] > 0)
        x, y = told["pixels"]["centre"][0], told["size"][1] - told["pixels"]["centre"][1]
        end = time.monotonic() + PATIENCE
        step = 0
        while math.hypot(*told["force"]) < 0.3 and time.monotonic() < end:
            step += 1
            self.do("mousemove", "--window", window, round(x + step % 2), round(y))
            before = self.told()["hand"]
            # A wheel step is 0.9 mm. In front of the ball, several steps are made at once.
            free = int((math.hypot(*before) - RADIUS) / 9e-4) - 3
            if free > 1:
                self.do("click", "--repeat", free, "--delay", 5, 4)
                told = self.until("steps", lambda told, before=before, free=free:
                                  math.dist(told["hand"], before) > (free - 1) * 8e-4)
                continue
            self.do("click", 4)
            # Waits for each step's result: the skin yields to a hand that is too deep.
            told = self.until("a step", lambda told, before=before: math.dist(told["hand"], before) > 5e-4)
            told = self.until("a later tick", lambda later, told=told: later["time"] > told["time"] + 0.15)


class Drawn(Window):
    """Tests of the picture while a hand feels. Tests without options share a run, and restore its first state."""
    COMMON = json.loads(json.dumps(SCENE))
    COMMON["modes"][1]["strength"] = 9e5  # [N]; the key + would exceed the limit of 1e6 N
    common = None  # folder and process of the run that tests share
    busy = False   # a test uses the run, or failed before it released the run

    def join(self):
        """Uses the run that tests share. Returns its window. Starts the run if there is none, or if the last test
        ended it or failed."""
        kind = type(self)
        if kind.common is not None and kind.busy:
            os.killpg(kind.common[1].pid, signal.SIGKILL)
            kind.common = None
        fresh = kind.common is None
        self.use(folder_until(self.addClassCleanup) if fresh else kind.common[0])
        if fresh:
            self.write_scene(self.COMMON)
            kind.common = (self.dir, self.launch(self.addClassCleanup, "--seconds", "3600", "--watch", "--trace",
                                                 "t.csv"))
        self.feel = kind.common[1]
        self.read = len(self.said())
        kind.busy = True
        return self.window()

    def leave(self, window):
        """Releases the shared run with the first scene, all modes on, and the first view."""
        if self.scene.read_text(encoding="utf-8") != self.text_of(self.COMMON):
            self.write_scene(self.COMMON)  # the window reads it again, which ends its slices
        self.keys(window, "1", "r")
        self.until("the first scene", lambda t: [(bar["name"], bar["dial"]) for bar in t["bars"]]
                   == [("skin", 1), ("pin", 1)] and t["legend"] == ["skin", "pin"] and t["sliced"] == "")
        type(self).busy = False

    def end(self, window):
        """Closes the window of the run that tests share."""
        self.close(window)
        self.ends_well(self.feel)
        type(self).common = None

    @classmethod
    def tearDownClass(cls):
        """Checks that the last shared run ends without a fault."""
        if cls.common is not None and not cls.busy:
            last = cls("test_the_key_s_shows_slices_with_the_line_of_the_surface_and_hides_them")
            last.end(last.join())

    def test_a_mouse_hand_is_held_by_a_ball_and_keys_change_the_strength_and_cut_the_force(self):
        window = self.join()
        self.keys(window, "Return")  # late ticks may have cut the force
        self.press(window)
        felt = lambda told: math.hypot(*told["force"]) > 0.2 and told["bars"][0]["state"] == "holds"
        told = self.until("a force", felt)
        # The proxy is on the ball, and the probe is inside.
        self.assertAlmostEqual(math.hypot(*told["proxy"]), RADIUS, delta=0.02 * RADIUS)
        self.assertLess(math.hypot(*told["probe"]), math.hypot(*told["proxy"]))
        # The panel shows a bar in the colour of "holds".
        self.until_shown("a bar", window, lambda image: near(image, (480, 330), HOLDS, 50) > 40)
        # Strengthens the skin, switches it off and on again.
        self.keys(window, "plus")
        self.until("a stronger skin", lambda t: abs(t["bars"][0]["strength"] - 3.75) < 1e-6)
        self.keys(window, "o")
        self.until("no skin", lambda t: t["bars"][0]["dial"] == 0 and math.hypot(*t["force"]) < 0.05)
        self.until_shown("no bar", window, lambda image: near(image, (480, 330), HOLDS, 50) == 0)
        self.keys(window, "o")
        self.until("a skin", lambda t: t["bars"][0]["dial"] == 1.25)
        # The force is off until Enter is pressed.
        cut_after = self.told()["time"]
        self.keys(window, "Escape")
        off = self.until("the force off", lambda t: t["status"][0].startswith("FORCE OFF"))
        self.assertEqual(off["force"], [0, 0, 0])
        self.keys(window, "Return")
        self.until("the force on", lambda t: not t["status"][0].startswith("FORCE OFF"))
        self.end(window)
        words = {row["status"] for row in rows(self.dir / "t.csv") if float(row["t"]) >= cut_after}
        self.assertIn("fault", words)

    def test_after_late_ticks_the_window_shows_when_the_force_will_return(self):
        feel = self.start("--device", "simulated", "--seconds", "900", "--reengage", "5")
        self.window()
        self.until("a tick", lambda told: told["time"] > 0.1)
        feel.send_signal(signal.SIGSTOP)
        time.sleep(0.2)
        feel.send_signal(signal.SIGCONT)
        off = self.until("the force off", lambda t: t["status"][0].startswith("FORCE OFF"))
        self.assertTrue(any("the force returns 5 s after the last late tick, at most 3 times a minute" in line
                            for line in off["status"]), off["status"])
        self.until("the force on", lambda t: not t["status"][0].startswith("FORCE OFF"))
        feel.send_signal(signal.SIGINT)
        feel.wait(PATIENCE)

    def test_a_run_in_a_window_is_recorded_and_names_the_mouse(self):
        feel = self.start("--seconds", "1", "--record", "a.rec", "--summary", "s.json")
        self.ends_well(feel)
        self.assertEqual(json.loads((self.dir / "s.json").read_text(encoding="utf-8"))["device"], "mouse")
        with open(self.dir / "a.rec", "rb") as recording:
            self.assertEqual(json.loads(recording.readline())["device"]["name"], "mouse")
        again = subprocess.run([PALPATE, "feel", "a.rec", "--device", "replay:a.rec", "--record", "b.rec"],
                               cwd=self.dir, text=True, capture_output=True, check=False)
        self.assertIn(again.returncode, (0, 1, 4), again.stderr)
        self.assertIn("device mouse, ", again.stdout)
        subprocess.run([PALPATE, "compare", "a.rec", "b.rec"], cwd=self.dir, check=True, capture_output=True)

    def test_a_window_is_not_larger_than_the_screen(self):
        self.env.update(PALPATE_VIEW_WIDTH="3000", PALPATE_VIEW_HEIGHT="2000")
        feel = self.start("--seconds", "900")
        window = self.window()
        self.assertEqual(self.told()["size"], [1100, 684])
        self.close(window)
        self.ends_well(feel)

    def test_a_recorded_hand_is_shown_at_the_requested_speed(self):
        (self.dir / "path.csv").write_text(
            "t,x,y,z\n0,0.01,-0.06,0.01\n1,0.01,-0.034,0.01\n900,0.01,-0.034,0.01\n",
            encoding="utf-8")
        recorded = self.dir / "a.rec"
        subprocess.run([PALPATE, "feel", str(self.scene), "--device", "path:path.csv", "--seconds",
                        "20", "--record", str(recorded)], cwd=self.dir, check=True,
                       stdout=subprocess.DEVNULL)
        begun = time.monotonic()
        feel = self.start("--device", "replay:a.rec", "--speed", "0.5", "--trace", "t.csv")
        told = self.until("a force", lambda told: math.hypot(*told["force"]) > 0.5)
        self.assertAlmostEqual(math.hypot(*told["proxy"]), RADIUS, delta=0.02 * RADIUS)
        self.close(self.window())
        self.ends_well(feel)
        # At half speed, the trace covers at most half of the elapsed time.
        felt = float(rows(self.dir / "t.csv")[-1]["t"])
        self.assertLess(felt, 0.5 * (time.monotonic() - begun) + 0.1)
        # Draws a still of the whole recording, with the recording's scene.
        self.still = subprocess.run([PALPATE, "view", "a.rec", "--device", "replay:a.rec", "--picture",
                                     "still.png", "--trace", "t.csv"], cwd=self.dir, env=self.env,
                                    capture_output=True, text=True, timeout=PATIENCE, check=False)
        self.assertEqual(self.still.returncode, 0, self.still.stderr)
        self.assertEqual(len(rows(self.dir / "t.csv")), 20000)

    def test_the_picture_in_the_window_moves_with_the_mouse_and_is_then_refined(self):
        window = self.join()
        self.until("a fine backdrop", lambda told: not told["coarse"])
        before = self.until("a frame", lambda told: told["pixels"])["pixels"]["centre"]
        self.do("mousemove", "--window", window, 200, 200, "mousedown", 2, "mousemove", "--window", window,
                260, 230, "mouseup", 2)
        after = self.until("another view", lambda t: math.dist(t["pixels"]["centre"], before) > 30)
        self.assertAlmostEqual(after["pixels"]["centre"][0] - before[0], 60, delta=8)
        self.until("a fine backdrop again", lambda told: not told["coarse"])
        self.keys(window, "r")
        self.until("the first view", lambda t: math.dist(t["pixels"]["centre"], before) < 2)
        self.until_shown("a picture", window, lambda image: image[..., :3].std() > 0.05)
        self.leave(window)

    def test_the_key_s_shows_slices_with_the_line_of_the_surface_and_hides_them(self):
        window = self.join()
        self.until("a fine backdrop", lambda told: not told["coarse"])

        def grey(image):
            """Returns the numbers of nearly black and nearly white pixels in the picture."""
            part = image[:, :390, :3]
            plain = part.max(axis=2) - part.min(axis=2) < 0.02
            return int((plain & (part.mean(axis=2) < 0.05)).sum()), int((plain & (part.mean(axis=2) > 0.9)).sum())

        def skin(image):
            """Returns the number of pixels of the line of the skin."""
            part = image[:, :390, :3]
            return int(((part[..., 0] > 0.9) & (part[..., 1] > 0.7) & (part[..., 2] < 0.3)).sum())

        self.until_shown("a ball", window, lambda image: grey(image)[1] < 195 and skin(image) == 0)
        self.keys(window, "s")
        self.until("slices", lambda told: told["sliced"] == "ball")
        self.until_shown("slices", window, lambda image: grey(image)[0] > 39 and grey(image)[1] > 1950
                         and skin(image) > 30)
        self.keys(window, "s")
        self.until("none", lambda told: told["sliced"] == "")
        self.until_shown("no slices", window, lambda image: grey(image)[1] < 195)
        self.leave(window)

    def test_an_edited_scene_is_drawn_in_the_window_and_keeps_its_gains(self):
        window = self.join()
        self.keys(window, "o")
        self.until("no skin", lambda t: t["bars"][0]["dial"] == 0)
        scene = json.loads(json.dumps(self.COMMON))
        scene["modes"].insert(0, {"name": "core", "mode": "isosurface", "of": "ball", "value": -0.25,
                                  "solid": "below", "strength": 2})
        self.write_scene(scene)
        told = self.until("the new scene", lambda t: len(t["bars"]) == 3 and "core" in t["legend"])
        self.assertEqual([(bar["name"], bar["dial"]) for bar in told["bars"]],
                         [("core", 1), ("skin", 0), ("pin", 1)])
        # Switched on again, the mode is still selected, at its new index.
        self.keys(window, "o")
        self.until("a skin", lambda t: t["bars"][1]["dial"] == 1)
        self.leave(window)

    def test_the_panel_marks_requests_that_the_loop_has_not_yet_applied(self):
        window = self.join()
        # While the loop is stopped, requests are pending.
        self.feel.send_signal(signal.SIGSTOP)
        self.keys(window, "o")
        told = self.until("a pending request", lambda t: t["bars"][0]["words"] == "skin: off (not yet)")
        self.assertEqual(told["bars"][0]["dial"], 1)
        self.feel.send_signal(signal.SIGCONT)
        told = self.until("no skin", lambda t: t["bars"][0]["dial"] == 0)
        self.assertEqual(told["bars"][0]["words"], "skin: off")
        # A refused request has no effect, and the panel stops showing it.
        self.keys(window, "2")
        self.keys(window, "plus")
        self.until("a refusal", lambda t: any("change rejected" in note for note in t["notes"]))
        self.until("no pending request", lambda t: [bar["words"] for bar in t["bars"]] == ["skin: off", "pin: idle"])
        self.assertRegex(self.said()[self.read:], "/modes/1/strength: .* N is beyond the limit of 1e.06 N: .*; "
                         "the previous scene stays active\n")
        self.keys(window, "1", "o")
        self.leave(window)

    def test_a_window_draws_frames_while_a_changed_scene_is_read(self):
        window = self.join()
        before = self.told()["frames_reading"]
        scene = json.loads(json.dumps(self.COMMON))
        for i in range(4):
            scene["modes"].append({"name": f"core {i}", "mode": "isosurface", "of": "ball", "value": -0.02 * i,
                                   "solid": "below", "strength": 2})
        self.write_scene(scene)
        told = self.until("the new scene", lambda t: "core 3" in t["legend"])
        self.assertGreater(told["frames_reading"], before)
        self.leave(window)

    def test_a_hidden_window_draws_no_frames(self):
        window = self.join()

        def rests():
            before = self.told()
            self.assertGreater(self.until_at_rest()["tick"], before["tick"])

        self.do("windowunmap", "--sync", window)
        rests()
        at_rest = self.told()["frames"]
        self.do("windowmap", "--sync", window)
        self.until("frames", lambda told: told["frames"] > at_rest + 5)
        uncover = self.cover()
        rests()
        at_rest = self.told()["frames"]
        uncover()
        self.until("frames again", lambda told: told["frames"] > at_rest + 5)
        self.leave(window)

    def test_a_hand_far_behind_a_scene_is_visible(self):
        (self.dir / "far.csv").write_text("t,x,y,z\n0,0,-0.1,0.1\n1,-0.012,0.3,-0.105\n900,-0.012,0.3,-0.105\n",
                                          encoding="utf-8")
        shot = self.dir / "shot.png"
        self.env["PALPATE_VIEW_SHOT"] = str(shot)
        feel = self.start("--device", "path:far.csv")
        window = self.window()
        told = self.until("a hand behind the scene", lambda told: told["time"] > 1.2 and not told["coarse"])
        x, y = round(told["pixels"]["probe"][0]), round(told["size"][1] - 1 - told["pixels"]["probe"][1])
        self.until_shown("the hand", window, lambda image: image[y - 6:y + 7, x - 6:x + 7].std() > 0.03)
        # The window saves the same picture.
        self.assertGreater(imread(shot)[y - 6:y + 7, x - 6:x + 7, :3].std(), 0.03)
        self.close(window)
        self.ends_well(feel)

    def test_no_thread_of_the_window_runs_on_the_core_of_the_loop(self):
        """All threads of the window, including graphics threads, leave the core of the real-time loop."""
        window = self.join()
        feel = self.feel
        cores = os.sched_getaffinity(0)
        left = cores - {max(cores)} if len(cores) > 1 else cores
        tasks = list(Path(f"/proc/{self.child(feel)}/task").iterdir())
        self.assertEqual({frozenset(os.sched_getaffinity(int(task.name))) for task in tasks}, {frozenset(left)})
        of_run = [int(task.name) for task in Path(f"/proc/{feel.pid}/task").iterdir()]
        loop = [task for task in of_run if os.sched_getscheduler(task) == os.SCHED_FIFO]
        self.assertLessEqual(len(loop), 1)
        for task in loop:
            self.assertEqual(os.sched_getaffinity(task), {max(cores)})
        self.leave(window)

    def test_a_slow_background_is_drawn_coarser_and_reported(self):
        self.env["PALPATE_VIEW_PATIENCE"] = "1e-6"
        feel = self.start("--seconds", str(PATIENCE))
        window = self.window()
        # Each move of the mouse can reduce the detail once. On a busy machine the window can miss a move.
        for step in range(40):
            if self.until("at rest", lambda told: not told["coarse"])["detail"] == 4:
                break
            before = self.told()["pixels"]["centre"]
            self.do("mousemove", "--window", window, 200, 200 + step, "mousedown", 2, "mousemove", "--window",
                    window, 210, 200, "mouseup", 2)
            end = time.monotonic() + 0.5
            while self.told()["pixels"]["centre"] == before and time.monotonic() < end:
                time.sleep(0.03)
        self.until("a coarser one", lambda t: t["detail"] == 4 and not t["coarse"]
                   and any("reduced detail" in note for note in t["notes"]))
        self.close(window)
        self.ends_well(feel)


class Lost(Window):
    """Tests in which the window, the display or the loop fails, and of the keys. No two windows are open at once, so
    that xdotool finds the right one. This class is a separate CTest entry, because it waits more than it computes.
    Its scene has no surface, so that it draws fast."""
    SCENE = {**SCENE, "modes": SCENE["modes"][1:]}

    def test_the_keys_fit_into_a_small_window(self):
        self.env.update(PALPATE_VIEW_WIDTH="640", PALPATE_VIEW_HEIGHT="480")
        feel = self.start("--seconds", "900")
        window = self.window()
        self.keys(window, "question")
        left, bottom, right, top = self.until("the keys", lambda told: told["help"])["help"]
        self.assertGreater(right - left, 150)
        self.assertTrue(0 <= left and 0 <= bottom and right <= 340 and top <= 480, (left, bottom, right, top))
        self.close(window)
        self.ends_well(feel)

    def test_without_memory_for_a_window_the_loop_continues(self):
        self.write_scene(SCENE)  # a surface needs more than this memory
        self.env["PALPATE_VIEW_MEMORY"] = "30e6"
        feel = self.start("--device", "simulated", "--seconds", "900")
        self.goes_on(feel)
        self.assertRegex(self.said(), "palpate: window: not enough memory to draw this scene: free memory, or run "
                         "palpate feel, which does not draw\n")

    def goes_on(self, feel):
        """Checks that the run continues until it is interrupted."""
        self.until_said("view: the window has ended")
        self.assertIsNone(feel.poll())
        feel.send_signal(signal.SIGINT)
        self.assertEqual(self.ended(feel), 130)

    def test_the_loop_survives_a_killed_window(self):
        feel = self.start("--device", "simulated", "--seconds", "900", "--trace", "t.csv")
        self.window()
        os.kill(self.child(feel), signal.SIGKILL)
        self.goes_on(feel)
        self.assertIn("view: the window has ended: it was ended by signal 9 (Killed): the run continues "
                      "without it; Ctrl-C ends the run", self.said())

    def test_a_run_ends_if_a_mouse_is_its_only_hand_and_the_window_ends(self):
        feel = self.start("--trace", "t.csv")
        self.window()
        os.kill(self.child(feel), signal.SIGKILL)
        self.assertEqual(self.ended(feel), 1)
        self.assertIn("view: the window has ended: it was ended by signal 9 (Killed): its mouse was the only "
                      "hand: the run ends\n", self.said())
        self.assertTrue(rows(self.dir / "t.csv"))

    def test_the_loop_survives_a_lost_display(self):
        self.env["DISPLAY"], server = self.serve(self.addCleanup)
        feel = self.start("--device", "simulated", "--seconds", "900")
        self.window()
        server.kill()
        self.goes_on(feel)
        self.assertIn("palpate: display: the connection to the X server is lost: the window closes\n",
                      self.said())

    def test_a_request_that_the_display_rejects_is_reported_in_one_line(self):
        """The test destroys the window, so the X server rejects the window's next request."""
        feel = self.start("--device", "simulated", "--seconds", "900")
        self.do("windowclose", self.window())
        self.goes_on(feel)
        self.assertRegex(self.said(), r"(?m)^palpate: display: the X server rejected request \d+\.\d+, Bad[^:\n]*: "
                         r"the window closes$")
        self.assertIn("view: the window has ended: its exit status is 1: ", self.said())
        self.assertNotIn("X Error", self.said())

    def test_a_mouse_that_moves_over_a_hidden_window_does_not_end_the_window(self):
        """VTK requests the keyboard focus, which the X server refuses to hidden windows."""
        feel = self.start("--seconds", "900")
        window = self.window()
        child = self.child(feel)
        self.do("mousemove", 1090, 750)
        os.kill(child, signal.SIGSTOP)
        self.do("mousemove", 300, 300, "windowunmap", window)
        os.kill(child, signal.SIGCONT)
        self.until_at_rest()
        frames = self.told()["frames"]
        self.do("windowmap", window)
        self.until("frames", lambda told: told["frames"] > frames)
        self.close(window)
        self.ends_well(feel)

    def told_its_end(self, window, child):
        """Checks that the window shows that the loop has stopped, draws no more frames, and ends when it is closed."""
        self.until("the end", lambda told: told["stalled"])
        self.until_at_rest()
        self.assertTrue(Path(f"/proc/{child}").exists())
        self.close(window)
        end = time.monotonic() + PATIENCE
        while re.search(r"State:\s+[^ZX]", self.state(child)) and time.monotonic() < end:
            time.sleep(0.1)
        self.assertNotRegex(self.state(child), r"State:\s+[^ZX]")

    def test_a_killed_loop_is_reported(self):
        feel = self.start("--seconds", "900")
        window = self.window()
        child = self.child(feel)
        feel.kill()
        feel.wait()
        self.told_its_end(window, child)

    def test_a_loop_that_is_killed_before_its_first_tick_is_reported(self):
        place = self.dir / "bin"
        place.mkdir()
        shutil.copy(PALPATE, place)
        (place / "palpate-view").write_text(f"#!/bin/sh\nkill -KILL $PPID\necho $$ > '{self.dir}/child'\n"
                                            f"exec '{BIN}/palpate-view' \"$@\"\n", encoding="utf-8")
        (place / "palpate-view").chmod(0o755)
        feel = self.start(program=str(place / "palpate"))
        self.assertEqual(self.ended(feel), -signal.SIGKILL, self.said())
        end = time.monotonic() + PATIENCE
        while not self.told() and time.monotonic() < end:
            time.sleep(0.1)  # until() fails for a loop that has ended
        self.told_its_end(self.window(), int((self.dir / "child").read_text(encoding="utf-8")))

    @staticmethod
    def state(pid):
        try:
            return Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
        except FileNotFoundError:
            return ""

    def test_without_a_display_the_loop_continues(self):
        self.env["DISPLAY"] = ":7777"
        feel = self.start("--device", "simulated", "--seconds", "900")
        self.goes_on(feel)
        self.assertRegex(self.said(), r"palpate: display: :7777 cannot be opened: run palpate view on a desktop "
                         r"with OpenGL, or add --picture FILE\.png\n")
        self.assertIn("view: the window has ended: its exit status is 2", self.said())

    def test_a_display_without_opengl_is_reported_and_a_picture_is_still_drawn(self):
        """For a picture, palpate starts its own server."""
        self.env["DISPLAY"], _ = self.serve(self.addCleanup, "-extension", "GLX")
        feel = self.start()
        self.assertEqual(self.ended(feel), 1)
        self.assertRegex(self.said(), r"(?m)^palpate: display: :\d+ has no OpenGL: run palpate view on a desktop with "
                         r"OpenGL, or add --picture FILE\.png\n"
                         r"palpate: view: the window has ended: its exit status is 2: its mouse was the only hand: the "
                         r"run ends$")
        feel = self.start("--seconds", "0.1", "--picture", "still.png")
        self.assertEqual(self.ended(feel), 0, self.said())
        self.assertTrue((self.dir / "still.png").exists())


if __name__ == "__main__":
    suite.main(sys.argv[3:])
