#!/usr/bin/env python3
"""Tests the picture of a run: picture_test.py BIN_DIR VOLUMES_PROGRAM. The tests capture the drawing script's input,
and read the drawn texts and shapes from an SVG and from the figure."""
import json
import math
import os
import re
import shutil
import struct
import subprocess
import sys
import unittest
import xml.etree.ElementTree as ET
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent))
sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import drawing  # noqa: E402
import process  # noqa: E402
import suite  # noqa: E402
from cli_test import BIN, Case, run  # noqa: E402

SCENES = Path(__file__).resolve().parents[2] / "scenes" / "apps" / "cli"
SVG = "{http://www.w3.org/2000/svg}"
PLANES = [[0, 1], [0, 2], [1, 2]]
# Prints properties of feel_picture.py's figure: grey scales, alphas of the path, positions of axes and legend.
LOOK = """
import json, sys
sys.path.insert(0, sys.argv[1])
sys.dont_write_bytecode = True
import feel_picture
feel_picture.use()
figure = feel_picture.Picture(json.load(sys.stdin)).figure
figure.canvas.draw()
slices = [ax for ax in figure.axes if ax.images]
box = lambda artist: artist.get_window_extent().extents.tolist()
legend = figure.legends[0]
handles = getattr(legend, "legend_handles", None) or legend.legendHandles
json.dump({
    "page": figure.bbox.extents.tolist(),
    "title": box(figure.texts[-2]),
    "names": [{"text": t.get_text(), "box": box(t), "start": ax.transData.transform((t.xy[0], 0)).tolist()}
              for ax in figure.axes for t in ax.texts if hasattr(t, "xy")],
    "boxes": [{t.get_text(): box(t.get_bbox_patch()) for t in ax.texts} for ax in slices],
    "marks": [[ax.transData.transform(l.get_xydata()[0]).tolist() for l in ax.lines] for ax in slices],
    "colours": {t.get_text(): h.get_color() for t, h in zip(legend.get_texts(), handles)},
    "path colours": [c.get_colors().tolist() for c in legend.findobj(feel_picture.LineCollection)],
    "greys": [ax.images[0].get_clim() for ax in slices],
    "alphas": [[list(map(float, c.get_colors()[:, 3])) for c in ax.collections
                if type(c).__name__ == "LineCollection"] for ax in slices],
    "letters": [{t.get_text(): t.get_position() for t in ax.texts} for ax in slices],
    "axes": [ax.get_window_extent().extents.tolist() for ax in figure.axes],
    "legend": legend.get_window_extent().extents.tolist()}, sys.stdout)
"""


def nrrd(file, size, values, *head, kind="float"):
    """Writes an NRRD file of values(i, j, k), i fastest, with these additional header lines."""
    lines = ["NRRD0004", f"type: {kind}", "endian: little", "encoding: raw", *head]
    numbers = [values(i, j, k) for k in range(size[2]) for j in range(size[1])
               for i in range(size[0])]
    flat = [c for n in numbers for c in (n if isinstance(n, tuple) else (n,))]
    file.write_bytes("\n".join(lines).encode() + b"\n\n" + struct.pack(f"<{len(flat)}f", *flat))


def ball(i, j, k):
    """Returns 1000 in a ball, -1000 around it, and 2000 in a spot that is off centre towards +i."""
    if math.dist((i, j, k), (24, 15, 15)) < 3:
        return 2000.0
    return 1000.0 if math.dist((i, j, k), (15, 15, 15)) < 12 else -1000.0


def texts(svg):
    return ["".join(t.itertext()).strip() for t in ET.fromstring(svg).iter(f"{SVG}text")]


class Pictures(Case):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.fork = drawing.Fork(cls.addClassCleanup, BIN)
        (cls.fork.folder / "look.py").write_text(LOOK, encoding="utf-8")
        cls.looker = cls.fork.add("look", cls.fork.folder / "look.py")
        cls.shared = {}  # drawings and inputs that tests share
        # A copy of the program with a drawing script that stores its input.
        cls.tee = cls.dir / "tee"
        cls.tee.mkdir()
        shutil.copy2(BIN / "palpate", cls.tee)
        (cls.tee / "feel_picture.py").write_text(
            "#!/bin/sh\n[ \"$1\" = --check ] || cat >\"$PALPATE_TEE\"\n")
        os.chmod(cls.tee / "feel_picture.py", 0o755)
        space = ("dimension: 3", "sizes: 31 31 31", "space directions: (2,0,0) (0,2,0) (0,0,2)",
                 "space origin: (10,20,30)", "sample units: HU",
                 'space units: "mm" "mm" "mm"')
        nrrd(cls.dir / "lps.nrrd", (31, 31, 31), ball, "space: left-posterior-superior", *space)
        nrrd(cls.dir / "bare.nrrd", (31, 31, 31), ball, "space dimension: 3", *space)
        flow = ("dimension: 4", "kinds: vector space space space", "sizes: 3 21 21 21",
                "space directions: none (1,0,0) (0,1,0) (0,0,1)",
                "measurement frame: (1,0,0) (0,1,0) (0,0,1)")
        for name, axes in (("flow", "space: right-anterior-superior"), ("air", "space dimension: 3")):
            nrrd(cls.dir / f"{name}.nrrd", (21, 21, 21), lambda i, j, k: (1.0 + j, 0.5, 0.0), axes, *flow)
        for name in ("lps", "bare", "flow", "air"):
            done = subprocess.run([str(BIN / "palpate-import-light"), cls.dir / f"{name}.nrrd",
                                   cls.dir / f"{name}.vdb"], capture_output=True, text=True,
                                  timeout=300, check=False)
            if "without teem" in done.stderr:
                raise unittest.SkipTest("built without teem")
            if done.returncode != 0:
                raise AssertionError(done.stderr)

    def path(self, *rows):
        """Returns a device whose hand moves through these positions, one per second."""
        file = self.dir / "path.csv"
        file.write_text("t,x,y,z\n" + "".join(f"{t},{x},{y},{z}\n"
                                              for t, (x, y, z) in enumerate(rows)))
        return f"path:{file}"

    def scene(self, name, volumes, *modes, **rest):
        file = self.dir / f"{name}.json"
        file.write_text(json.dumps({"palpate": 1, "coupling": {"stiffness": 500, "damping": 0.5},
                                    "volumes": volumes, "modes": list(modes), **rest}))
        return file

    def once(self, make, *words):
        """Returns the result of the first call with these arguments. Callers must not change it."""
        if (make.__name__, words) not in self.shared:
            self.shared[make.__name__, words] = make(*words)
        return self.shared[make.__name__, words]

    def given_head(self):
        """Returns the drawing script's input for head("lps")."""
        if "head" not in self.shared:
            self.shared["head"] = self.given("feel", *self.head("lps"))
        return json.loads(json.dumps(self.shared["head"]))

    def given(self, *words):
        """Returns the drawing script's input for a command."""
        kept = self.dir / "kept.json"
        place = self.dir / "kept.svg"
        subprocess.run([str(self.tee / "palpate"), *map(str, words), "--picture", place],
                       check=True, capture_output=True, timeout=300,
                       env={**os.environ, "PALPATE_TEE": str(kept)})
        place.unlink()
        return json.loads(kept.read_text())

    def drawn(self, *words):
        process.run([str(self.fork.folder / "palpate"), *map(str, words)], check=True, capture_output=True, text=True,
                    timeout=300)

    def svg(self, *words):
        place = self.dir / "drawn.svg"
        self.drawn(*words, "--picture", place)
        text = place.read_text(encoding="utf-8")
        place.unlink()
        return text

    def look(self, data):
        done = subprocess.run([str(self.looker), str(SCENES)], input=json.dumps(data),
                              capture_output=True, text=True, check=True, timeout=300)
        return json.loads(done.stdout)

    def head(self, name, **place):
        """Returns words of a command: a scene of an imported ball, and a hand that enters it from the front."""
        place = {"scale": 0.001, "translate": [0.04, 0.05, -0.06], **place}
        volume = {"file": f"{name}.vdb", "place": place}
        scene = self.scene(f"{name}-scene", {"body": volume},
                           {"name": "skin", "mode": "isosurface", "of": "body", "value": 0,
                            "solid": "above", "strength": 5})
        return scene, "--device", self.path((0, 0.04, 0), (0, 0.02, 0), (0, 0.04, 0))

    @suite.smoke
    def test_a_picture_of_a_patient_has_orientation_letters_and_units_and_millimetres(self):
        words = texts(self.once(self.svg, "feel", *self.head("lps")))
        for letter in "LRPAIS":
            self.assertEqual(words.count(letter), 2, letter)  # in two of three slices
        self.assertEqual([words.count(f"{axis} [mm]") for axis in "xyz"], [2, 2, 2])
        self.assertIn("body [HU]", words)
        self.assertIn("skin: body = 0 HU", words)
        self.assertIn("force on the hand [N]", words)

    def test_orientation_letters_are_at_the_correct_sides_of_a_picture(self):
        ends = [("L", "R"), ("P", "A"), ("I", "S")]  # at -x, +x, and so on
        letters = self.look(self.given_head())["letters"]
        for seen, (a, b) in zip(letters, PLANES):
            (left, right), (low, high) = ends[a], ends[b]
            self.assertEqual(set(seen), {left, right, low, high})
            self.assertLess(seen[left][0], 0.1)
            self.assertGreater(seen[right][0], 0.9)
            self.assertLess(seen[low][1], 0.1)
            self.assertGreater(seen[high][1], 0.9)

    def test_orientation_letters_are_beside_the_mark_of_the_largest_force(self):
        data = self.given_head()
        low, high = data["extent"]
        middle = [(x + y) / 2 for x, y in zip(low, high)]
        for axis in range(3):
            for end, of in ((0.02, low), (0.98, high)):
                place = list(middle)
                place[axis] = low[axis] + end * (high[axis] - low[axis])
                data["strongest"] = data["through"] = place
                look = self.look(data)
                for letters, [(x, y)] in zip(look["boxes"], look["marks"]):
                    self.assertEqual(len(letters), 4)
                    for letter, (left, bottom, right, top) in letters.items():
                        off = math.hypot(max(left - x, 0, x - right), max(bottom - y, 0, y - top))
                        self.assertGreater(off, 4, (letter, place))  # [pixels], 100 per inch; the mark's radius is 3.5

    def test_positions_in_a_picture_of_a_patient_are_in_patient_space(self):
        # LPS to RAS: the centre, 15 voxels of 2 mm from (10, 20, 30), is (-40, -50, 60). The bright spot, at larger i,
        # is on the patient's left.
        half = math.sqrt(0.5)
        for turned in (False, True):
            words = self.head("lps")
            if turned:  # a quarter turn about z: the patient's front is W's -x
                scene, *_ = self.head("lps", rotation_wxyz=[half, 0, 0, half],
                                      translate=[-0.05, 0.04, -0.06])
                way = self.path((-0.04, 0, 0), (-0.02, 0, 0), (-0.04, 0, 0))
                words = (scene, "--device", way)
            data = self.given("feel", *words)
            self.assertEqual(data["space"], {"name": "patient", "unit": "mm", "hand_mm": 1.0, "heights": ""})
            for row in (data["ticks"][0], data["ticks"][-1]):
                for shown, place in zip(row[1:4], (-40, -10, 60)):
                    self.assertAlmostEqual(shown, place, delta=0.5)
            strongest = max(data["ticks"], key=lambda row: math.hypot(*row[4:7]))
            self.assertGreater(strongest[5], 1.0)  # the force points to the front
            for got, place in zip(data["extent"], ((-62, -72, 38), (-18, -28, 82))):
                for a in range(3):
                    self.assertAlmostEqual(got[a], place[a], delta=1e-3)
            self.assertAlmostEqual(data["through"][0], -40.0, delta=0.5)
            self.assertEqual([s["axes"] for s in data["fields"][0]["slices"]], PLANES)
            values = data["fields"][0]["slices"][0]["values"]
            bright = [i for line in values for i, v in enumerate(line) if v > 1500]
            self.assertTrue(bright)
            self.assertLess(max(bright), len(values[0]) / 2)

    def test_a_picture_without_patient_axes_has_no_orientation_letters(self):
        scene, *hand = self.head("bare", translate=[-0.04, -0.05, -0.06])
        words = texts(self.svg("feel", scene, *hand))
        self.assertFalse([w for w in words if w in tuple("LRPAIS")])
        self.assertIn("axes: the file's; 1 mm of the file is 1 mm of the hand", words)
        self.assertIn("body [HU]", words)
        words = texts(self.once(self.svg, "feel", self.dir / "ball.vdb", "--seconds", 1))
        self.assertIn("ball", words)  # without a unit, the field's name

    def test_a_picture_of_a_flow_is_in_the_coordinates_of_its_file(self):
        follow = {"name": "along", "mode": "follow", "of": "air", "strength": 1}
        # A quarter turn about z: the file's x is the hand's y. The file's centre, (10, 10, 10), is the hand's origin.
        half = math.sqrt(0.5)
        place = {"scale": 0.005, "rotation_wxyz": [half, 0, 0, half], "translate": [0.05, -0.05, -0.05]}
        scene = self.scene("turned", {"air": {"file": "air.vdb", "place": place}}, follow)
        way = self.path((0, 0.01, 0), (0, 0.02, 0.01))
        data = self.given("feel", scene, "--device", way)
        self.assertEqual((data["space"]["name"], data["space"]["hand_mm"]), ("file", 5.0))
        for shown, given in zip(data["ticks"][0][1:4], (12, 10, 10)):
            self.assertAlmostEqual(shown, given, delta=0.1)
        for x, y in (v for line in data["fields"][0]["slices"][0]["vectors"] for v in line if v):
            self.assertGreater(x, 0.9)
            self.assertAlmostEqual(y, 0.5, delta=1e-6)
        # A field that is computed at load has the coordinates of its volume.
        scene = self.scene("computed", {"air": {"file": "air.vdb", "place": place}},
                           {"name": "fast", "mode": "isosurface", "of": "speed", "value": 12.3, "solid": "above",
                            "strength": 1}, fields={"speed": {"magnitude": "air"}})
        data = self.given("feel", scene, "--device", self.path((0, 0.01, 0), (-0.015, 0.01, 0)))
        self.assertEqual(([field["name"] for field in data["fields"]], data["space"]["name"]), (["speed"], "file"))
        # Volumes with different placements have no common coordinates.
        volumes = {name: {"file": "air.vdb", "place": {**place, "scale": scale}}
                   for name, scale in (("a", 0.005), ("b", 0.004))}
        scene = self.scene("two", volumes, *({**follow, "name": name, "of": name} for name in volumes))
        self.assertEqual(self.given("feel", scene, "--device", way)["space"]["name"], "hand")

    def test_the_title_names_the_scene_without_its_folder(self):
        for words in (self.head("lps"), (self.dir / "ball.vdb", "--seconds", 1)):
            text = self.once(self.svg, "feel", *words)
            self.assertNotIn(str(self.dir), text)
            self.assertNotIn(str(self.fork.folder), text)
            self.assertNotIn(str(BIN), text)
            self.assertIn(Path(words[0]).name, "\n".join(texts(text)))

    def test_the_user_chooses_the_title_and_where_the_slices_meet(self):
        scene, *hand = self.head("lps")
        way = ("press", scene, "--at", "0,0.04,0", "--along", "0,-0.02,0")
        for words in (("feel", scene, *hand), way):
            usual = self.given(*words)
            data = self.given(*words, "--slices", "-30,-50,70", "--title", "My $title\n")
            self.assertEqual(data["through"], [-30, -50, 70])  # in the patient's coordinates
            self.assertEqual(data["title"], "My $title\\n")
            self.assertEqual(data["strongest"], usual["strongest"])
            self.assertEqual(self.given(*words, "--slices", "-30,-50,70")["title"],
                             "lps-scene.json: slices through the chosen place")
        data["title"] = "long title " * 18
        look = self.look(data)
        left, low, right, top = look["title"]
        self.assertGreater(left, 0)
        self.assertLess(right, look["page"][2])
        self.assertGreaterEqual(low, look["legend"][3])
        done = run(*way, "--slices", "0,-50,1e3", "--picture", self.dir / "p.svg")
        (self.dir / "p.svg").unlink()
        self.assertIn("--slices: 0,-50,1000 is outside the drawn volumes, -62,-72,38 to -18,-28,82 mm: the slices meet "
                      "at -18,-50,82", done.stderr)
        for words in (("feel", scene, *hand), way):
            for option in ("--slices", "--title"):
                self.refused(*words, option, "1,2,3", says=f"{option}: it has no effect without --picture")
            self.refused(*words, "--picture", "p.svg", "--slices", "1,2", says='--slices: "1,2" is not x,y,z')

    def test_all_slices_of_a_field_have_the_same_grey_scale(self):
        data = self.given_head()
        slices = data["fields"][0]["slices"]
        slices[0]["values"] = [[v / 2 for v in line] for line in slices[0]["values"]]
        slices[2]["values"][0][0] = 1e9  # one outlier
        greys = self.look(data)["greys"]
        self.assertEqual(greys, [greys[0]] * 3)
        self.assertLess(greys[0][0], -900)
        self.assertTrue(900 < greys[0][1] < 3000, greys)
        other = json.loads(json.dumps(data["fields"][0]))
        for piece in other["slices"]:
            piece["values"] = [[0.1 * v for v in line] for line in piece["values"]]
        data["fields"].append(other)
        greys = self.look(data)["greys"]
        self.assertEqual([greys[0], greys[3]], [greys[1], greys[5]])
        self.assertAlmostEqual(greys[3][1], 0.1 * greys[0][1], delta=60)

    def test_vectors_are_drawn_as_arrows_and_axial_vectors_as_lines(self):
        volume = {"file": "flow.vdb", "place": {"fit": 0.1}}
        follow = {"name": "along", "mode": "follow", "of": "flow", "strength": 1}
        for axial, here, there in ((False, "arrows", "fibres"), (True, "fibres", "arrows")):
            scene = self.scene("flow", {"flow": {**volume, "axial": axial}}, follow)
            words = ("feel", scene, "--device", self.path((0, 0, 0), (0, 0.02, 0.03)))
            text = self.svg(*words)
            groups = [g for g in ET.fromstring(text).iter(f"{SVG}g") if g.get("id") == here]
            self.assertEqual(len(groups), 3)
            self.assertGreater(len(groups[0].findall(f".//{SVG}path")), 100)
            self.assertNotIn(f'id="{there}"', text)
            field = self.given(*words)["fields"][0]
            self.assertEqual(field["kind"], "axial" if axial else "vector")
            # The flow points right and grows with y. In the slice across x, the vectors show its y component.
            for x, y in (v for line in field["slices"][0]["vectors"] for v in line if v):
                self.assertGreater(abs(x), 0.9)
                self.assertAlmostEqual(abs(y), 0.5, delta=1e-6)
            first = [v for line in field["slices"][0]["vectors"] for v in line[:1] if v]
            self.assertGreater(abs(first[-1][0]), abs(first[0][0]) + 10)
            for y, z in (v for line in field["slices"][2]["vectors"] for v in line if v):
                self.assertAlmostEqual(abs(y), 0.5, delta=1e-6)
                self.assertEqual(z, 0.0)
        text = self.once(self.svg, "feel", self.dir / "ball.vdb", "--seconds", 1)
        self.assertNotIn('id="arrows"', text)

    def test_the_field_that_acts_most_is_drawn_first(self):
        place = {"scale": 0.001, "translate": [0.04, 0.05, -0.06]}
        volumes = {name: {"file": "lps.vdb", "place": place} for name in "ab"}
        drag = {"name": "drag", "mode": "viscosity", "of": "a", "strength": 0.05}
        wall = {"name": "wall", "mode": "isosurface", "of": "b", "value": 0, "solid": "above",
                "strength": 5}
        # The drag acts all the time; the wall acts for a second.
        device = self.path((0, 0.029, 0), (0.005, 0.029, 0), (-0.005, 0.029, 0), (0, 0.029, 0),
                           (0, 0.018, 0), (0, 0.029, 0))
        data = self.given("feel", self.scene("two", volumes, drag, wall), "--device", device)
        self.assertEqual(data["fields"][0]["name"], "b")
        wall["strength"] = 0.001
        data = self.given("feel", self.scene("two", volumes, drag, wall), "--device", device)
        self.assertEqual(data["fields"][0]["name"], "a")

    def test_a_path_fades_with_its_distance_from_the_slice(self):
        data = self.given_head()
        x, y, z = data["through"]
        far = 0.5 * (data["extent"][1][0] - data["extent"][0][0])
        data["ticks"] = [[0.1 * i, x + 0.02 * i, y, z + (0 if i < 100 else far), 0, 0, 0.01 * i]
                         for i in range(200)]
        for colours in self.look(data)["alphas"][0]:  # in the slice across z: the path's rim and its line
            self.assertGreater(max(colours), 3 * min(colours))
            self.assertEqual(colours, sorted(colours))  # near pieces are drawn last

    @suite.smoke
    def test_a_moving_volume_is_drawn_at_the_time_of_the_largest_force(self):
        place = {"scale": 0.001, "translate": [0.04, 0.05, -0.06],
                 "keyframes": [{"time": 0, "translate": [0, 0, 0]},
                               {"time": 2, "translate": [0, 0.02, 0]}]}
        wall = {"name": "wall", "mode": "isosurface", "of": "body", "value": 0, "solid": "above",
                "strength": 5}
        scene = self.scene("moves", {"body": {"file": "lps.vdb", "place": place}}, wall)
        data = self.given("feel", scene, "--device", self.path(*[(0, 0.035, 0)] * 3))
        self.assertEqual(data["space"]["name"], "hand")  # because the volume moves
        # The volume moves towards the hand. The force is largest at the end, when its front is at 0.024 + 0.02 m.
        self.assertAlmostEqual(data["stands_at"], 2.0, delta=0.1)
        column = [line[len(line) // 2] for line in data["fields"][0]["slices"][0]["values"]]
        low, high = data["extent"][0][1], data["extent"][1][1]
        last = max(j for j, v in enumerate(column) if v > 0)
        front = low + (last + 1) / len(column) * (high - low)
        self.assertAlmostEqual(front, 44.0, delta=1.5)

    def test_the_legend_is_outside_the_axes_at_a_fixed_place(self):
        places = []
        for words in (self.head("lps"), (self.dir / "ball.vdb", "--seconds", 1)):
            look = self.look(self.given("feel", *words))
            left, low, *_ = look["legend"]
            for _, _, _, top in look["axes"]:
                self.assertLess(top, low)
            places.append(left)
        self.assertEqual(places[0], places[1])

    def test_the_legend_has_the_colours_that_are_drawn(self):
        data = self.given_head()
        look = self.look(data)
        for colours in look["path colours"]:  # the legend's path has colours from no force to the largest force
            self.assertGreater(len({tuple(c) for c in colours}), 10)
        field = json.loads(json.dumps(data["fields"][0]))
        for piece in field["slices"]:
            piece["vectors"] = [[[1, 1]] * 3] * 3
        data["fields"].append({**field, "name": "flow", "kind": "vector", "levels": []})
        colours = self.look(data)["colours"]
        [arrows] = [c for label, c in colours.items() if label.startswith("flow, component")]
        [skin] = [c for label, c in colours.items() if label.startswith("skin: ")]
        self.assertNotEqual(arrows, skin)
        self.assertEqual(look["colours"]["skin: body = 0 HU"], arrows)  # without arrows, the surface gets their colour

    def test_names_above_a_press_neither_overlap_nor_leave_the_page(self):
        scene, *_ = self.head("lps")
        data = self.given("press", scene, "--at", "0,0.04,0", "--along", "0,-0.02,0")
        deep = data["press"]["in"][-1][0]
        names = ["bowl", "bowl yields", "stream, of a long name", "tissue", "skin", "a mode with a very long name " * 3]
        for near in (0.001, 0.01, 0.05, 0.3):
            for last in (0.1, 1.0):
                depths = [max(0.0, last - near * i) * deep for i in range(len(names))]
                data["press"]["marks"] = [{"name": n, "depth": d} for n, d in zip(names, depths)]
                look = self.look(data)
                shown = " ".join(name["text"] for name in look["names"]).replace("\n", " ")
                for name in names:
                    self.assertIn(name.strip(), shown)
                boxes = [name["box"] for name in look["names"]] + look["axes"]
                for i, name in enumerate(look["names"]):
                    left, low, right, top = name["box"]
                    self.assertGreater(left, 0)
                    self.assertLess(right, look["page"][2], name)
                    self.assertAlmostEqual(left, name["start"][0], delta=5)
                    for a, b, c, d in boxes[i + 1:]:
                        self.assertFalse(min(right, c) - max(left, a) > 1 and min(top, d) - max(low, b) > 1, name)
                    # The line of another name does not cross this name.
                    for other in look["names"]:
                        self.assertFalse(left + 1 < other["start"][0] < right and other["box"][3] > low + 1,
                                         (name, other))

    def test_a_picture_is_written_in_every_format(self):
        words = ("feel", self.dir / "ball.vdb", "--seconds", 0.5, "--picture")
        pictures = {"svg": self.once(self.svg, "feel", self.dir / "ball.vdb", "--seconds", 1).encode()}
        run(*words, self.dir / "p.png")  # with the real script, not its fork
        self.drawn(*words, self.dir / "p.pdf")
        for ending in ("png", "pdf"):
            place = self.dir / f"p.{ending}"
            pictures[ending] = place.read_bytes()
            place.unlink()
        for ending, begin in (("png", b"\x89PNG\r\n\x1a\n"), ("pdf", b"%PDF-"), ("svg", b"<?xml")):
            self.assertTrue(pictures[ending].startswith(begin), ending)
            self.assertIn(run("--version").stdout.split("\n")[0].split(" (")[0].encode(), pictures[ending])
        picture = pictures["png"]
        at = picture.index(b"pHYs") + 4
        self.assertEqual(round(0.0254 * struct.unpack(">I", picture[at:at + 4])[0]), 300)
        self.assertFalse([f for f in os.listdir(self.dir) if "partial" in f])

    @suite.smoke
    def test_invalid_picture_names_are_refused_before_the_run(self):
        long = ("feel", self.dir / "ball.vdb", "--seconds", 1e6, "--picture")
        for name in ("p.gif", "p", "-", "p.PNG"):
            self.refused(*long, name, says="it is not named .png, .pdf or .svg")
        self.refused("feel", "none.vdb", "--picture", "p.gif", says="p.gif: it is not named .png")
        self.refused(*long, self.dir / "none" / "p.svg", says="cannot be written")
        self.refused("press", self.dir / "ball.vdb", "--at", "0,0,0.06", "--along", "0,0,-0.1",
                     "--picture", "p.txt", says="it is not named .png, .pdf or .svg")

    def test_a_failed_picture_leaves_no_file(self):
        drawer = self.tee / "feel_picture.py"
        kept = drawer.read_text()
        self.addCleanup(drawer.write_text, kept)
        drawer.write_text("#!/bin/sh\n[ \"$1\" = --check ] || { echo half; exit 1; }\n")
        before = sorted(os.listdir(self.dir))
        done = subprocess.run([str(self.tee / "palpate"), "feel", self.dir / "ball.vdb",
                               "--seconds", "0.1", "--picture", self.dir / "p.svg"],
                              capture_output=True, text=True, timeout=300, check=False)
        self.assertNotEqual(done.returncode, 0)
        self.assertIn("could not be drawn", done.stderr)
        self.assertEqual(sorted(os.listdir(self.dir)), before)

    def test_special_characters_in_names_are_drawn(self):
        place = {"fit": 0.1}
        name = "k=$5^{2}$ <b> & 直"
        scene = self.scene("odd", {name: {"file": "ball.vdb", "grid": "ball", "place": place}},
                           {"name": "$x$", "mode": "isosurface", "of": name, "value": 0,
                            "solid": "below", "strength": 1})
        words = texts(self.svg("feel", scene, "--seconds", 1))
        self.assertIn(name, words)
        self.assertTrue([w for w in words if w.startswith("$x$: " + name)])

    def test_the_trajectory_of_the_command_press_is_drawn(self):
        scene, *_ = self.head("lps")
        text = self.svg("press", scene, "--at", "0,0.04,0", "--along", "0,-0.02,0")
        words = texts(text)
        self.assertEqual(words.count("L"), 2)
        self.assertIn("body [HU]", words)
        self.assertTrue(re.search(r"slices through the place of the largest force", "\n".join(words)))
        # The force is drawn over the depth, with a mode's name where its contact begins, yields or ends.
        self.assertIn("depth of the hand [mm]", words)
        self.assertNotIn("time [s]", words)
        told = json.loads(run("press", scene, "--at", "0,0.04,0", "--along", "0,-0.02,0", "--json").stdout)
        touched = [mode["mode"] for mode in told["modes"] if mode["touched_at"] is not None]
        self.assertTrue(touched)
        for name in touched:
            self.assertTrue([w for w in words if re.search(rf"(^|, ){re.escape(name)}(,|$)", w)], (name, words))


if __name__ == "__main__":
    suite.main(sys.argv[3:])
