#!/usr/bin/env python3
"""Tests that imported time steps become scenes that play them: play_test.py BIN_DIR."""
import csv
import json
import math
import struct
import sys
import tempfile
import unittest
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import process  # noqa: E402
import suite  # noqa: E402
from refusals import refusal  # noqa: E402

PALPATE = str(Path(sys.argv[1]) / "palpate")
N = 32


def call(*words):
    return process.run([PALPATE, *map(str, words)], capture_output=True, text=True, timeout=120)


def run(*words):
    done = call(*words)
    assert (done.returncode, done.stderr) == (0, ""), (words, done.stderr)
    return done.stdout


def ball(radius):
    """Returns the values of a ball in the middle of N^3 voxels: 0 outside and 1000 inside."""
    middle = (N - 1) / 2
    return [round(1000 * min(1, max(0, radius - math.dist((i, j, k), (middle,) * 3) + 0.5)))
            for k in range(N) for j in range(N) for i in range(N)]


def metaimage(volumes, step):
    head = (f"ObjectType = Image\nNDims = 4\nBinaryData = True\nBinaryDataByteOrderMSB = False\n"
            f"DimSize = {N} {N} {N} {len(volumes)}\nElementSpacing = 1 1 1 {step}\n"
            f"ElementType = MET_SHORT\nElementDataFile = LOCAL\n")
    return head.encode() + b"".join(struct.pack(f"<{N ** 3}h", *v) for v in volumes)


def image(arrays, size=3):
    """Returns an image of size^3 points in VTK's XML format. `arrays` has the values by name."""
    extent = " ".join([f"0 {size - 1}"] * 3)
    data = "".join(f'<DataArray type="Float64" Name="{name}" NumberOfComponents="{len(values) // size ** 3}" '
                   f'format="ascii">{" ".join(map(str, values))}</DataArray>' for name, values in arrays.items())
    return (f'<?xml version="1.0"?><VTKFile type="ImageData" version="1.0"><ImageData WholeExtent="{extent}" '
            f'Origin="0 0 0" Spacing="1 1 1"><Piece Extent="{extent}"><PointData>{data}</PointData></Piece>'
            "</ImageData></VTKFile>")


class Case(unittest.TestCase):
    def setUp(self):
        holder = tempfile.TemporaryDirectory()
        self.addCleanup(holder.cleanup)
        self.dir = Path(holder.name)
        self.scene = self.dir / "scene.json"
        self.out = self.dir / "out.vdb"

    def write(self, name, data):
        path = self.dir / name
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
        return path

    def series(self, times, arrays):
        """Writes a list of files with times. `arrays` has the arrays of each step."""
        for n, of in enumerate(arrays):
            self.write(f"{n}.vti", image(of))
        rows = [{"name": f"{n}.vti", "time": time} for n, time in enumerate(times)]
        return self.write("run.vti.series", json.dumps({"file-series-version": "1.0", "files": rows}))

    def played(self, source, *words):
        """Imports all steps with a scene, and checks the scene. Returns the scene and the steps' reports."""
        reports = json.loads(run("import", source, self.out, "--time", "all", "--scene", self.scene, "--json", *words))
        done = call("check", self.scene, "--json")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.checked, self.told = json.loads(done.stdout), done.stderr
        return json.loads(self.scene.read_text()), reports

    def refused(self, source, *words, says):
        done, line = refusal(self, self.dir, lambda: call("import", source, *words))
        self.assertEqual(done.returncode, 2, line)
        self.assertIn(says, line)


class Scenes(Case):
    @suite.smoke
    def test_the_scene_of_a_4d_image_plays_its_steps_under_the_hand(self):
        """A ball grows from 8 to 12 voxels in 0.4 s. A hand rests 6 voxels from its middle."""
        source = self.write("grow.mha", metaimage([ball(8 + n) for n in range(5)], 0.1))
        text = run("import", source, self.out, "--time", "all", "--scene", self.scene)
        self.assertRegex(text, rf"{self.scene}: a scene of \d modes? that plays 5 steps: ")
        self.assertTrue(text.endswith(f"next: palpate feel {self.scene} --seconds 10\n"), text)
        self.assertIn("takes them as seconds", text)
        scene = json.loads(self.scene.read_text())
        (volume,) = scene["volumes"].values()
        self.assertEqual((volume["file"], volume["frames"]), ("out_%04d.vdb", {"rate": 10}))
        self.assertEqual(scene["play"], {"speed": 1, "repeat": True})
        self.assertEqual(json.loads(run("check", self.scene, "--json"))["volumes"]["density"]["frames"]["count"], 5)
        # In millimetres, with one surface and without a repetition, the proxy's place is known.
        middle = 1e-3 * (N - 1) / 2
        volume["place"] = {"scale": 0.001, "translate": [middle, middle, -middle]}
        scene["modes"] = [{"mode": "isosurface", "of": "density", "value": 500, "strength": 8}]
        del scene["play"]["repeat"]
        self.scene.write_text(json.dumps(scene))
        path = self.write("hand.csv", "t,x,y,z\n0,0.02,0,0\n0.05,0.006,0,0\n1,0.006,0,0\n")
        run("feel", self.scene, "--device", f"path:{path}", "--trace", self.dir / "t.csv", "--seconds", 1)
        with open(self.dir / "t.csv", encoding="utf8") as file:
            rows = {round(1000 * float(row["t"])): 1e3 * float(row["proxy_x"]) for row in csv.DictReader(file)}
        for ms, radius in ((100, 9), (200, 10), (300, 11), (400, 12), (900, 12)):
            self.assertAlmostEqual(rows[ms], radius, delta=0.3)

    def test_the_scene_of_an_ome_zarr_image_plays_its_times_in_its_unit(self):
        def imported(unit):
            array = self.dir / "grow.zarr" / "0"
            array.mkdir(parents=True, exist_ok=True)
            axes = [{"name": "t", "type": "time", "unit": unit}, *({"name": a, "type": "space"} for a in "zyx")]
            scale = [{"type": "scale", "scale": [50, 1, 1, 1]}]
            (array.parent / ".zattrs").write_text(json.dumps({"multiscales": [{
                "axes": axes, "datasets": [{"path": "0", "coordinateTransformations": scale}]}]}))
            (array / ".zarray").write_text(json.dumps({
                "zarr_format": 2, "shape": [3, N, N, N], "chunks": [1, N, N, N], "dtype": "<i2", "order": "C",
                "filters": None, "compressor": None, "fill_value": 0}))
            for n in range(3):
                (array / f"{n}.0.0.0").write_bytes(struct.pack(f"<{N ** 3}h", *ball(8 + n)))
            scene, reports = self.played(array.parent)
            self.assertEqual([r["time"] for r in reports], [0, 50, 100])
            (volume,) = scene["volumes"].values()
            return scene["play"], volume["frames"], "".join(n for r in reports for n in r["notes"])

        play, frames, notes = imported("millisecond")
        self.assertEqual((play, frames), ({"speed": 1, "repeat": True}, {"rate": 20}))
        self.assertNotIn("unit of its times", notes)
        play, frames, notes = imported("nanosecond")
        self.assertEqual((play["speed"], frames), (2.5e-7, {"rate": 2e7}))
        self.assertIn("as in reality", play["description"])
        play, frames, notes = imported("fortnight")
        self.assertEqual((play["speed"], play["description"]), (250, "about 5 steps a second"))
        self.assertIn("states no unit of its times that palpate knows", notes)

    def test_a_scene_plays_uneven_steps_at_the_times_of_the_file(self):
        arrays = [{"s": [n * i for i in range(27)]} for n in range(4)]
        scene, reports = self.played(self.series([2, 2.1, 2.5, 3], arrays))
        self.assertEqual([r["time"] for r in reports], [2, 2.1, 2.5, 3])
        (volume,) = scene["volumes"].values()
        self.assertEqual(volume["frames"], {"times": [0, 0.1, 0.5, 1]})
        # The first step is constant, so the guess is for the second one. Nevertheless all steps play.
        frames = self.checked["volumes"]["s"]["frames"]
        self.assertEqual((frames["count"], frames["from"], frames["to"]), (4, 0, 1))

    def test_the_scene_of_a_flow_with_vortices_over_time_has_several_modes_and_is_valid_with_all_frames(self):
        def swirl(strength):
            def at(i, j, k):
                x, y = i - 7.5, j - 7.5
                turn = strength * math.exp(-(x * x + y * y) / 12)
                return (-turn * y, turn * x, 0.2)
            return [c for k in range(16) for j in range(16) for i in range(16) for c in at(i, j, k)]
        for n in range(2):
            self.write(f"{n}.vti", image({"velocity": swirl(1 + n)}, 16))
        rows = [{"name": f"{n}.vti", "time": n} for n in range(2)]
        source = self.write("run.vti.series", json.dumps({"file-series-version": "1.0", "files": rows}))
        scene, _ = self.played(source)
        self.assertGreater(len(scene["modes"]), 1)
        self.assertEqual(self.checked["volumes"]["velocity"]["frames"]["count"], 2)

    @suite.smoke
    def test_a_step_without_arrays_is_an_empty_frame(self):
        """With --iso, two constant scalars give no level set, also not an empty one."""
        flat, ramp = [5] * 27, [i % 9 for i in range(27)]
        arrays = [{"a": ramp, "b": flat}, {"a": flat, "b": flat}, {"a": ramp, "b": flat}]
        scene, reports = self.played(self.series([0, 1, 2], arrays), "--iso", 4)
        self.assertEqual([len(r["grids"]) for r in reports], [1, 0, 1])
        self.assertIn("a scene plays it as background", reports[1]["notes"][-1])
        self.assertEqual(self.checked["volumes"]["a"]["frames"]["count"], 3)
        self.assertIn("1 of the sequence's 3 frames have no data, and play as background: ", self.told)
        self.assertRegex(self.told, r"out_0001\.vdb: it does not have a grid")

    def test_frames_of_unlike_kinds_are_refused_by_name(self):
        arrays = [{"s": range(27)}, {"s": [float(i % 5) for i in range(81)]}]
        run("import", self.series([0, 1], arrays), self.out, "--time", "all", "--scene", self.scene)
        done = call("check", self.scene)
        self.assertEqual(done.returncode, 2)
        self.assertIn("out_0001.vdb", done.stderr)
        self.assertIn("give frames of one type", done.stderr)

    def test_a_single_step_keeps_a_scene_of_one_file(self):
        scene, _ = self.played(self.write("a.mha", metaimage([ball(8)], 1)))
        (volume,) = scene["volumes"].values()
        self.assertEqual(volume["file"], "out_0000.vdb")
        self.assertNotIn("frames", volume)
        self.assertNotIn("play", scene)


class Refusals(Case):
    def test_refuses_files_of_another_import_that_the_scene_would_play(self):
        source = self.write("a.mha", metaimage([ball(8), ball(9)], 1))
        self.write("out_0002.vdb", "old")
        self.refused(source, self.out, "--time", "all", "--scene", self.scene,
                     says="out_0002.vdb: the scene would play this file too, but the import has 2 steps")
        run("import", source, self.out, "--time", "all")

    def test_refuses_a_percent_sign_in_the_name_of_the_steps_if_a_scene_plays_them(self):
        source = self.write("a.mha", metaimage([ball(8), ball(9)], 1))
        self.refused(source, self.dir / "a%d.vdb", "--time", "all", "--scene", self.scene, says='has a "%"')
        run("import", source, self.dir / "a%d.vdb", "--time", "1", "--scene", self.scene)


if __name__ == "__main__":
    suite.main(sys.argv[2:])
