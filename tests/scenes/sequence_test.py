#!/usr/bin/env python3
"""Tests sequences through the command line: sequence_test.py BIN_DIR VOLUMES_PROGRAM."""
import json
import os
import sys
import tempfile
import time
import unittest
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import suite  # noqa: E402
from program import PALPATE, run  # noqa: E402
from refusals import refusal  # noqa: E402
from terminal import Terminal  # noqa: E402

FRAMES = 8


def write_nrrd(file, values):
    """Writes a centred scalar volume with voxels of 1 mm."""
    size = values.shape
    head = ("NRRD0004\ntype: float\ndimension: 3\nsizes: {} {} {}\nencoding: raw\nendian: little\n"
            "space: left-posterior-superior\nspace directions: (1,0,0) (0,1,0) (0,0,1)\n"
            "space origin: ({},{},{})\n\n").format(*size, *[-(n - 1) / 2 for n in size])
    file.write_bytes(head.encode() + values.astype("<f4").tobytes(order="F"))


def ball(radius, middle=(0, 0, 0), n=40):
    axis = np.arange(n) - (n - 1) / 2
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    off = np.sqrt((x - middle[0])**2 + (y - middle[1])**2 + (z - middle[2])**2)
    return np.clip(100 * (radius - off), -300, 300) + 400


def rows_of(record):
    with open(record, "rb") as file:
        head = json.loads(file.readline())
    rows = np.fromfile(record, [tuple(f) for f in head["dtype"]], offset=head["offset"])
    return rows[rows["tick"] > 0]


class Case(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        holder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(holder.cleanup)
        cls.dir = Path(holder.name)
        for i in range(FRAMES):
            cls.frame(f"ball_{i:02d}", ball(10 + i / 2))
        cls.scene = {
            "palpate": 1, "coupling": {"stiffness": 500},
            "volumes": {"ball": {"file": "ball_%02d.vdb", "frames": {"rate": 10},
                                 "place": {"scale": 0.001}}},
            "modes": [{"name": "skin", "mode": "isosurface", "of": "ball", "value": 400,
                       "solid": "above", "strength": 6}]}
        cls.write("scene.json", cls.scene)
        # The hand rests on the ball's side, 1 mm deep in the first frame.
        (cls.dir / "hand.csv").write_text("t,x,y,z\n0,0.02,0,0\n0.2,0.009,0,0\n2,0.009,0,0\n")

    @classmethod
    def frame(cls, name, values):
        write_nrrd(cls.dir / f"{name}.nrrd", values)
        run("import", cls.dir / f"{name}.nrrd", cls.dir / f"{name}.vdb")

    @classmethod
    def write(cls, name, scene):
        (cls.dir / name).write_text(json.dumps(scene))
        return cls.dir / name

    def felt(self, scene, *more):
        trace = self.dir / "trace.csv"
        done = run("feel", scene, "--device", f"path:{self.dir / 'hand.csv'}", "--trace", trace,
                   "--summary", self.dir / "summary.json", *more)
        rows = np.genfromtxt(trace, delimiter=",", names=True)
        return rows, json.loads((self.dir / "summary.json").read_text()), done


class Play(Case):
    @suite.smoke
    def test_a_ball_grows_with_the_frames_of_its_sequence(self):
        rows, summary, _ = self.felt(self.dir / "scene.json")
        for at in (0.3, 0.45, 0.6, 1.5):
            row = rows[np.searchsorted(rows["t"], at)]
            self.assertAlmostEqual(1e3 * row["proxy_x"], 10 + 5 * min(at, 0.7), delta=0.05)
        self.assertEqual(summary["sequences"]["ball"]["frames"], FRAMES)
        self.assertEqual(summary["sequences"]["ball"]["failed"], 0)
        self.assertEqual(summary["coarse_share"], 0)
        growth = np.diff(rows["force_x"])
        self.assertLess(np.abs(growth).max(), 0.3)

    def test_check_reports_the_number_of_frames(self):
        told = json.loads(run("check", self.dir / "scene.json", "--json").stdout)
        self.assertEqual(told["volumes"]["ball"]["frames"]["count"], FRAMES)

    def test_check_reports_the_play_and_the_rotation(self):
        scene = json.loads(json.dumps(self.scene))
        scene["play"] = {"speed": 0.5, "repeat": True, "from": 0.1}
        half = 0.5 ** 0.5
        scene["volumes"]["ball"]["place"]["rotation_wxyz"] = [half, 0, 0, half]
        file = self.write("turned.json", scene)
        told = json.loads(run("check", file, "--json").stdout)
        self.assertEqual(told["play"], {"begin": 0.1, "from": 0.1, "to": (FRAMES - 1) / 10, "speed": 0.5, "repeat": True,
                                        "paused": False})
        np.testing.assert_allclose(told["volumes"]["ball"]["rotation_wxyz"], [half, 0, 0, half], atol=1e-12)
        text = run("check", file).stdout
        self.assertIn(", turned by 90 degrees about 0, 0, 1\n", text)
        self.assertIn("play      begins at 0.1 s, from 0.1 s, to 0.7 s, 0.5 s/s, repeated\n", text)
        self.assertNotIn("turned", run("check", self.dir / "scene.json").stdout)

    def test_the_playback_follows_the_play_settings_of_the_scene(self):
        scene = json.loads(json.dumps(self.scene))
        scene["play"] = {"paused": True, "from": 0.4}
        rows, _, _ = self.felt(self.write("paused.json", scene))
        self.assertAlmostEqual(1e3 * rows["proxy_x"][-1], 12.0, delta=0.05)
        scene["play"] = {"speed": -1, "from": 0.1, "to": 0.5, "repeat": True}
        rows, _, _ = self.felt(self.write("back.json", scene))
        settled = rows[rows["t"] > 0.4]
        self.assertLess(1e3 * settled["proxy_x"].min(), 10.7)
        # In reverse play, the radius shrinks from 12.5 mm to 10.5 mm. Then play starts again at 12.5 mm.
        self.assertGreater(1e3 * settled["proxy_x"].max(), 12.2)
        # When play starts again, the force changes over 50 ms.
        self.assertLess(np.abs(np.diff(settled["force_x"])).max(), 0.1)

    def test_forces_do_not_depend_on_the_memory_for_frames(self):
        scene = json.loads(json.dumps(self.scene))
        scene["play"] = {"from": 0, "to": 0.65, "repeat": True}
        rows, _, _ = self.felt(self.write("all.json", scene))
        frame = json.loads(run("info", self.dir / f"ball_{FRAMES - 1:02d}.vdb", "--json").stdout)
        scene["volumes"]["ball"]["frames"]["budget_mb"] = \
            5.9 * frame["grids"][0]["memory_bytes"] / 2**20
        little, summary, _ = self.felt(self.write("little.json", scene))
        self.assertEqual(summary["sequences"]["ball"]["slots"], 5)
        self.assertGreater(summary["sequences"]["ball"]["fetched"], FRAMES)
        for name in ("force_x", "force_y", "force_z", "proxy_x"):
            np.testing.assert_array_equal(rows[name], little[name])

    def test_a_recording_of_a_sequence_replays_identically(self):
        record = self.dir / "a.rec"
        scene = json.loads(json.dumps(self.scene))
        scene["play"] = {"from": 0.1, "to": 0.4, "repeat": True, "speed": 1.5}
        self.felt(self.write("again.json", scene), "--record", record)
        again = self.dir / "b.rec"
        run("feel", record, "--device", f"replay:{record}", "--record", again)
        self.assertIn("identical to the last bit", run("compare", record, again).stdout)
        rows = rows_of(record)
        self.assertAlmostEqual(rows["play"].max(), 0.4, delta=0.002)
        self.assertAlmostEqual(rows["play"].min(), 0.1, delta=0.002)

    @suite.smoke
    def test_missing_frames_of_a_sequence_are_reported_in_one_line(self):
        scene = json.loads(json.dumps(self.scene))
        scene["volumes"]["ball"]["file"] = "none_%02d.vdb"
        file = self.write("none.json", scene)
        _, line = refusal(self, self.dir, lambda: run("check", file, status=2))
        self.assertIn("/volumes/ball", line)
        self.assertIn("none_", line)

    @suite.smoke
    def test_keys_step_and_start_and_accelerate_and_rewind_the_playback(self):
        scene = json.loads(json.dumps(self.scene))
        scene["play"] = {"paused": True}
        # The second interval is three times as long as the others.
        times = [0.1 * i if i < 2 else 0.1 * i + 0.2 for i in range(FRAMES)]
        scene["volumes"]["ball"]["frames"] = {"times": times}
        record = self.dir / "keys.rec"
        terminal = Terminal([PALPATE, "feel", self.write("keys.json", scene), "--realtime",
                             "--device", "simulated", "--seconds", "3", "--record", record], self.dir)
        terminal.until("space: pause")
        time.sleep(0.5)
        for key in (b".", b".", b",", b" ", b"+"):
            os.write(terminal.own, key)
            time.sleep(0.2)
        os.write(terminal.own, b"0")
        while terminal.look(0.2):
            pass
        terminal.child.wait()
        rows = rows_of(record)
        play, rate = rows["play"], rows["play_rate"]
        # The keys step twice forward from 0 and once back, start play, double its speed, and jump back to the start.
        steps = play[np.flatnonzero(np.diff(play)) + 1]
        self.assertEqual(play[0], 0)
        np.testing.assert_allclose(steps[:3], times[1:3] + times[1:2])
        self.assertTrue(np.any(np.isclose(rate, 1)))
        self.assertTrue(np.any(np.isclose(rate, 2)))
        self.assertTrue(np.any((np.diff(play) < -0.1) & (play[1:] < 0.01)))


if __name__ == "__main__":
    suite.main(sys.argv[2:])
