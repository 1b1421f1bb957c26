#!/usr/bin/env python3
"""Tests recordings through the command line: record_test.py BIN_DIR VOLUMES_PROGRAM [--host] [--without-hdf5]. With
--host runs the tests that depend on the scheduler, otherwise all others. With --without-hdf5 tests a program that was
built without HDF5."""
import csv
import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import suite  # noqa: E402
from refusals import refusal  # noqa: E402

BIN = Path(sys.argv[1])
VOLUMES = sys.argv[2]
PALPATE = str(BIN / "palpate")
ROOT = Path(__file__).resolve().parents[2]
WITHOUT_HDF5 = "--without-hdf5" in sys.argv

SCENE = {
    "palpate": 1,
    "coupling": {"stiffness": 500, "damping": 0.5},
    "volumes": {"ball": {"file": "ball.vdb", "grid": "ball", "place": {"fit": 0.1}}},
    "modes": [{"name": "skin", "mode": "isosurface", "of": "ball", "value": 0, "solid": "below",
               "strength": 3, "friction": 0.3, "viscosity": 0.1}],
}


def run(*words, status=0):
    done = subprocess.run([PALPATE, *map(str, words)], capture_output=True, text=True, timeout=300)
    if status is not None and done.returncode != status:
        raise AssertionError(f"{words}: status {done.returncode}, not {status}: {done.stderr}")
    return done


def rows_of(file):
    """Reads a recording with the code in docs/recording.md. Returns its header and its ticks."""
    text = (ROOT / "docs/recording.md").read_text(encoding="utf-8")
    lines = re.search(r"```python\n(.*?)```", text, re.DOTALL).group(1)
    names = {}
    exec(lines.replace("monday.rec", str(file)), names)  # pylint: disable=exec-used
    return names["head"], names["rows"]


class Case(unittest.TestCase):
    def setUp(self):
        holder = tempfile.TemporaryDirectory()
        self.addCleanup(holder.cleanup)
        self.dir = Path(holder.name)
        subprocess.run([VOLUMES, str(self.dir)], check=True)
        self.scene = self.write(SCENE)

    def write(self, scene, name="ball.json"):
        file = self.dir / name
        file.write_text(json.dumps(scene), encoding="utf-8")
        return file

    def compare(self, a, b, status=0):
        return json.loads(run("compare", self.dir / a, self.dir / b, "--json", status=status).stdout)


class Recorded(Case):
    def record(self, name, *words, status=0):
        run("feel", *words, "--record", self.dir / name, status=status)
        return self.dir / name

    @suite.smoke
    def test_a_replay_gives_the_recorded_forces_bit_for_bit(self):
        a = self.record("a.rec", self.scene, "--seconds", 4)
        for scene in (self.scene, a):
            self.record("b.rec", scene, "--device", f"replay:{a}")
            told = self.compare("a.rec", "b.rec")
            self.assertTrue(told["identical"])
            self.assertEqual(told["ticks"], [4000, 4000])
        self.assertIn("identical to the last bit, 4000 ticks", run("compare", a, a).stdout)
        # The replay's summary equals the run's, except for times.
        told = [json.loads(run("feel", self.scene, "--json", *words).stdout)
                for words in (("--seconds", 4), ("--device", f"replay:{a}"))]
        for key in ("force_max", "samples", "status", "net_energy"):
            self.assertEqual(told[0].get(key), told[1].get(key), key)

    def test_forces_of_volumes_at_rest_do_not_depend_on_the_cores_or_the_c_library(self):
        run("make", "wind-tunnel", self.dir / "wind.vdb", "--voxel", 0.02)
        wind = self.dir / "wind.json"
        wind.write_text(run("scene", self.dir / "wind.vdb").stdout, encoding="utf-8")
        for scene in (self.scene, wind):
            a = self.record("a.rec", scene, "--seconds", 3)
            # First replays on one core instead of all, then with the C library without FMA.
            for words, more in ((["taskset", "-c", "0"], {}),
                                ([], {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-AVX2"})):
                subprocess.run([*words, PALPATE, "feel", scene, "--device", f"replay:{a}",
                                "--record", self.dir / "b.rec"], env={**os.environ, **more},
                               capture_output=True, check=True)
                self.assertTrue(self.compare("a.rec", "b.rec")["identical"], (scene, words))
        # Rotations of moving volumes use the C library's sine. Its versions may differ in the last bits, so forces may
        # differ by up to 1e-9 N.
        moving = json.loads(json.dumps(SCENE))
        moving["volumes"]["ball"]["place"] = {
            "fit": 0.1, "repeat": True, "keyframes": [
                {"time": 0}, {"time": 1, "translate": [0.004, 0, 0],
                              "rotation_wxyz": [0.98, 0.1, 0, 0.17]}, {"time": 2}]}
        a = self.record("a.rec", self.write(moving, "moving.json"), "--seconds", 3)
        subprocess.run([PALPATE, "feel", self.dir / "moving.json", "--device", f"replay:{a}",
                        "--record", self.dir / "b.rec"], capture_output=True, check=True,
                       env={**os.environ, "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-AVX2"})
        told = self.compare("a.rec", "b.rec", status=None)
        self.assertLess((told["force"] or {"by": 0})["by"], 1e-9)

    @suite.smoke
    def test_the_command_compare_reports_the_first_and_the_largest_difference_of_two_recordings(self):
        a = self.record("a.rec", self.scene, "--seconds", 4)
        other = json.loads(json.dumps(SCENE))
        other["modes"][0]["strength"] = 2.9
        self.record("b.rec", self.write(other, "other.json"), "--device", f"replay:{a}")
        told = self.compare("a.rec", "b.rec", status=1)
        self.assertFalse(told["identical"])
        self.assertGreater(told["first"]["tick"], 1)
        self.assertIsNone(told["given_otherwise"])
        self.assertAlmostEqual(told["force"]["by"], 0.1, delta=0.05)
        words = run("compare", a, self.dir / "b.rec", status=1).stdout
        self.assertIn(f"first in tick {told['first']['tick']} ", words)
        self.assertIn("largest   force difference in tick", words)
        # The output has a command that explains the tick of the largest difference in the first recording.
        line = re.search(r"explain +palpate (explain .*)", words).group(1)
        self.assertEqual("palpate " + line, told["explain"])
        explained = json.loads(run(*line.split(), "--json").stdout)
        _, rows = rows_of(a)
        row = rows[rows["tick"] == told["force"]["tick"]][0]
        spring = row["stiffness"] * np.linalg.norm(row["proxy"] - row["hand"])
        self.assertAlmostEqual(np.linalg.norm(explained["force"]["spring"]), spring,
                               delta=0.001 * spring)
        # A difference in the input is reported, here the duration of a tick.
        self.record("c.rec", self.scene, "--seconds", 4, "--rate", 900)
        told = self.compare("a.rec", "c.rec", status=1)
        self.assertEqual(told["given_otherwise"]["tick"], 1)
        self.assertEqual(told["given_otherwise"]["field"], "dt")

    def test_a_replay_can_start_at_a_given_time(self):
        path = self.dir / "path.csv"
        path.write_text("t,x,y,z\n0,0,0,0.06\n1,0,0,0.04\n2,0.01,0,0.04\n", encoding="utf-8")
        a = self.record("a.rec", self.scene, "--device", f"path:{path}", "--seconds", 2)
        self.record("b.rec", self.scene, "--device", f"replay:{a}@0.25")
        _, rows = rows_of(self.dir / "b.rec")
        self.assertEqual(list(rows["tick"]), list(range(251, 2001)))
        # Ticks are compared with those of the same number.
        told = self.compare("a.rec", "b.rec", status=1)
        self.assertEqual(told["alone"], [250, 0])
        self.assertEqual(told["lost"], [0, 0])
        self.assertIsNone(told["given_otherwise"])

    def test_a_replay_can_run_at_a_given_speed(self):
        a = self.record("a.rec", self.scene, "--seconds", 1)
        for speed, least in ((2, 0.5), (1, 1.0)):
            begun = time.monotonic()
            self.record("b.rec", self.scene, "--device", f"replay:{a}", "--speed", speed)
            self.assertGreater(time.monotonic() - begun, 0.99 * least)
            self.assertTrue(self.compare("a.rec", "b.rec")["identical"])

    def test_a_run_along_a_path_can_be_recorded_and_replayed_identically(self):
        path = self.dir / "path.csv"
        path.write_text("t,x,y,z\n0,0,0,0.06\n0.5,0,0,0.045\n1,0.01,0,0.045\n", encoding="utf-8")
        self.record("a.rec", self.scene, "--device", f"path:{path}")
        self.record("b.rec", self.dir / "a.rec", "--device", f"replay:{self.dir / 'a.rec'}")
        self.assertTrue(self.compare("a.rec", "b.rec")["identical"])

    def test_a_replay_runs_at_the_recorded_tick_rate(self):
        a = self.record("a.rec", self.scene, "--seconds", 1, "--rate", 4000)
        # 1000 Hz is the default. If the user states it, the run must not use 4000 Hz.
        done = run("feel", self.scene, "--device", f"replay:{a}", "--rate", 1000, status=2)
        self.assertIn("recorded at 4000 Hz", done.stderr)
        told = json.loads(run("feel", a, "--device", f"replay:{a}", "--json").stdout)
        self.assertEqual((told["rate_asked"], told["ticks"], told["seconds"]), (4000, 4000, 1))

    @suite.smoke
    def test_each_of_two_hands_has_its_own_recording(self):
        self.record("a.rec", self.scene, "--seconds", 1, "--device", "simulated", "--device",
                    "simulated")
        for name in ("a.rec", "a.2.rec"):
            self.assertEqual(len(rows_of(self.dir / name)[1]), 1000)

    @suite.smoke
    def test_a_recording_is_readable_by_numpy_and_as_csv(self):
        a = self.record("a.rec", self.scene, "--seconds", 1)
        head, rows = rows_of(a)
        self.assertEqual(head["rate"], 1000)
        self.assertEqual(head["units"]["force"], "N")
        self.assertEqual(list(rows["tick"]), list(range(1, 1001)))
        run("convert", a, self.dir / "a.csv")
        lines = (self.dir / "a.csv").read_text(encoding="utf-8").splitlines()
        names = lines[0].split(",")
        self.assertEqual(len(lines), 1001)
        for i in (0, 499, 999):
            values = dict(zip(names, lines[1 + i].split(",")))
            for axis, name in enumerate("xyz"):
                self.assertEqual(float(values[f"force_{name}"]), rows["force"][i][axis])
            self.assertEqual(int(values["iterations"]), rows["iterations"][i])

    @suite.smoke
    def test_a_recording_that_is_converted_to_hdf5_is_readable_by_h5py(self):
        # The table has several blocks, the last one incomplete.
        a = self.record("a.rec", self.scene, "--seconds", 2.5)
        out = self.dir / "a.h5"
        if WITHOUT_HDF5:
            call = lambda: subprocess.run([PALPATE, "convert", a, out], capture_output=True,
                                          text=True, check=False)
            done, line = refusal(self, self.dir, call)
            self.assertEqual(done.returncode, 2)
            self.assertIn("a.h5: palpate_hdf5.so is missing in ", line)
            self.assertIn("build palpate with libhdf5-dev", line)
            return
        import h5py  # pylint: disable=import-outside-toplevel
        head, rows = rows_of(a)
        self.assertEqual(run("convert", a, out).stderr, "")
        with h5py.File(out) as file:
            ticks = file["ticks"]
            self.assertEqual(ticks.dtype.names, tuple(n for n in rows.dtype.names if n != "zero"))
            self.assertEqual(ticks.dtype.itemsize, rows.dtype.itemsize - rows.dtype["zero"].itemsize)
            self.assertEqual((len(rows), ticks.shape), (2500, (2500,)))
            for name in ticks.dtype.names:
                self.assertEqual(ticks.dtype[name], rows.dtype[name], name)
                self.assertEqual(ticks[name].tobytes(), rows[name].tobytes(), name)
            self.assertEqual(ticks["force"].shape, (2500, 3))
            self.assertGreater(abs(ticks["force"]).max(), 0.1)
            self.assertEqual((ticks.compression, ticks.compression_opts, ticks.shuffle),
                             ("gzip", 1, True))
            self.assertEqual(file.attrs["rate"], 1000.0)
            for name in ("units", "device", "about"):
                self.assertEqual(json.loads(file.attrs[name]), head[name], name)
            scenes = file["scenes"]
            self.assertEqual(list(scenes["id"]), sorted(set(rows["scene"]) - {0}))
            told = json.loads(scenes["text"][0])
            self.assertEqual(json.loads(told["text"]), SCENE)
        # Converts again with the other file extension, over an existing file. The bytes must be equal.
        (self.dir / "b.hdf5").write_bytes(b"another")
        run("convert", a, self.dir / "b.hdf5")
        self.assertEqual((self.dir / "b.hdf5").read_bytes(), out.read_bytes())
        # A recording without ticks gives only the description.
        none = self.dir / "none.rec"
        none.write_bytes(a.read_bytes()[:head["offset"]])
        run("convert", none, out)
        with h5py.File(out) as file:
            self.assertEqual((len(file["ticks"]), len(file["scenes"])), (0, 0))
            self.assertEqual(file.attrs["rate"], 1000.0)

    @unittest.skipIf(WITHOUT_HDF5, "built without HDF5")
    @suite.smoke
    def test_a_failed_conversion_of_a_recording_keeps_the_existing_file(self):
        a = self.record("a.rec", self.scene, "--seconds", 20)
        out = self.dir / "a.h5"
        out.write_bytes(b"what stood there")

        def ended(command, status, says):
            call = lambda: subprocess.run(["bash", "-c", f"{command} {PALPATE} convert {a} {out}"],
                                          capture_output=True, text=True, check=False)
            done, line = refusal(self, self.dir, call)
            self.assertEqual(done.returncode, status)
            self.assertIn(says, line)
            self.assertEqual(out.read_bytes(), b"what stood there")

        # The limits allow no byte, a part, or all but the end of the file.
        size = self.dir / "whole.h5"
        run("convert", a, size)
        for blocks in (0, 4, size.stat().st_size // 2048, size.stat().st_size // 1024 - 1):
            ended(f"ulimit -f {blocks};", 2,
                  "a.h5: writing failed (File too large): make room on the disk")
        for what, says in (("pipe.h5", "it is a pipe or a device"), ("dir.h5", "it is a folder")):
            place = self.dir / what
            (os.mkfifo if what == "pipe.h5" else os.mkdir)(place)
            done = run("convert", a, place, status=2)
            self.assertIn(says, done.stderr)
            self.assertEqual(len(done.stderr.splitlines()), 1)

    @suite.smoke
    def test_a_replay_reports_files_that_have_changed_since_the_recording(self):
        a = self.record("a.rec", self.scene, "--seconds", 0.1)
        with open(self.dir / "ball.vdb", "r+b") as file:
            file.seek(-1, os.SEEK_END)
            last = file.read(1)
            file.seek(-1, os.SEEK_END)
            file.write(bytes([last[0] ^ 1]))
        done = subprocess.run([PALPATE, "feel", a, "--device", f"replay:{a}"], capture_output=True,
                              text=True, check=False)
        self.assertIn("ball.vdb: the file has changed since the recording", done.stderr)

    @suite.smoke
    def test_invalid_uses_of_recordings_are_refused_in_one_line_and_keep_files(self):
        a = self.record("a.rec", self.scene, "--seconds", 0.1)

        def refused(*words, says):
            call = lambda: subprocess.run([PALPATE, *map(str, words)], capture_output=True,
                                          text=True, check=False)
            done, line = refusal(self, self.dir, call)
            self.assertEqual(done.returncode, 2)
            self.assertIn(says, line)

        replay = f"replay:{a}"
        refused("feel", self.scene, "--device", replay, "--realtime", says="leave out --realtime")
        refused("feel", self.scene, "--device", replay, "--device", "simulated", says="only with other recorded hands")
        refused("feel", self.scene, "--device", f"{replay}@9", says="it ends at 0.099 s")
        refused("feel", self.scene, "--device", f"{replay}@x", says="a.rec@x: it cannot be read")
        refused("feel", self.scene, "--device", f"replay:{self.scene}", says="it is not a recording")
        refused("feel", self.scene, "--device", "replay:none.rec", says="it cannot be read")
        refused("feel", self.scene, "--record", "-", says="a recording is binary")
        refused("feel", self.scene, "--record", self.scene, says="ball.json")
        refused("feel", self.scene, "--record", self.dir, says="it is a folder")
        refused("feel", self.scene, "--device", replay, "--record", a, says="a.rec")
        refused("feel", a, "--record", a, says="a.rec")
        refused("feel", a, "--record", self.scene, says="ball.json")
        refused("feel", a, "--trace", self.dir / "ball.vdb", says="ball.vdb")
        refused("feel", self.scene, "--device", replay, "--passive", says="leave out --passive")
        refused("feel", self.scene, "--speed", 1, says="only to recorded hands")
        refused("feel", self.scene, "--device", replay, "--speed", 0, says="0 is not in 0.001 to 1000")
        refused("feel", self.scene, "--device", replay, "--rate", 500, says="recorded at 1000 Hz")
        # A refused run keeps existing files.
        (self.dir / "b.2.rec").mkdir()
        (self.dir / "b.rec").write_bytes(a.read_bytes())
        refused("feel", self.scene, "--device", "simulated", "--device", "simulated", "--record",
                self.dir / "b.rec", says="it is a folder")
        self.assertTrue(self.compare("a.rec", "b.rec")["identical"])
        refused("feel", self.scene, "--record", "/dev/full", says="it is a pipe or a device")
        refused("compare", a, self.scene, says="it is not a recording")
        refused("check", a, says="the file is a recording, not a scene")
        refused("explain", a, "--at", "0,0,0", "--push", "0,0,0", says="the file is a recording, not a scene")
        refused("convert", a, a, says="a.rec")
        (self.dir / "a.h5").symlink_to(a)
        refused("convert", a, self.dir / "a.h5", says="a.h5")
        self.assertGreater(len(rows_of(a)[1]), 0)


    @suite.smoke
    def test_simulated_faults_cut_the_force(self):
        for word, cause in (("nan", "not finite"), ("late", "too old"), ("jumping", "jumped")):
            done = run("feel", self.scene, "--device", f"simulated:{word}@1.5", "--seconds", 3,
                       "--record", self.dir / "a.rec", status=1)
            self.assertIn(cause, done.stderr)
            _, rows = rows_of(self.dir / "a.rec")
            first = rows["tick"][rows["fault"] != 0][0]
            self.assertEqual(first, 1551 if word == "late" else 1501, word)
            self.assertIn(f"\nstatus    1 fault, force off for {3001 - first} ms", done.stdout)
            self.assertTrue((rows["force"][rows["fault"] != 0] == 0).all())
            # The fault is in the recorded input, so the replay repeats it.
            run("feel", self.scene, "--device", f"replay:{self.dir / 'a.rec'}", "--record",
                self.dir / "b.rec", status=1)
            self.assertTrue(self.compare("a.rec", "b.rec")["identical"])
        for words, says in (("simulated:nam", '"nam" is not a failure that palpate can simulate'),
                            ("simulated:nan@x", '"nan@x" is not a failure'),
                            ("simulated:hung", "add --realtime")):
            done = subprocess.run([PALPATE, "feel", self.scene, "--device", words],
                                  capture_output=True, text=True, check=False)
            self.assertEqual(done.returncode, 2)
            self.assertIn(says, done.stderr)

    def test_a_recording_that_reaches_the_limit_of_file_sizes_ends_and_the_run_continues(self):
        full = f"ulimit -f 300; exec {PALPATE} feel {self.scene} --seconds 3 --record {self.dir}/a.rec"
        done = subprocess.run(["bash", "-c", full], capture_output=True, text=True, check=False)
        self.assertEqual(done.returncode, 1, done.stderr)
        self.assertIn(f"--record {self.dir}/a.rec: writing stopped (File too large)", done.stderr)
        self.assertIn("3000 ticks", done.stdout)
        self.assertLess(len(rows_of(self.dir / "a.rec")[1]), 3000)
        self.assertEqual(self.compare("a.rec", "a.rec", status=None)["torn"], [0, 0])


class OnTime(Case):
    """Tests with a real clock."""
    HOST = True

    def test_simulated_delays_cut_the_force_of_a_realtime_run(self):
        for word, cause in (("blocked", "did not take a force in time"), ("hung", "was late")):
            done = run("feel", self.scene, "--device", f"simulated:{word}@0.5", "--realtime",
                       "--seconds", 0.55, status=1)
            self.assertIn(f"the force is cut: the {'device' if word == 'blocked' else 'loop'} {cause}",
                          done.stderr)

    def feel(self, name, seconds, **more):
        program = subprocess.Popen([PALPATE, "feel", str(self.scene), "--realtime", "--seconds",
                                    str(seconds), "--record", str(self.dir / name), *more.get("words", ())],
                                   stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.addCleanup(program.communicate)
        self.addCleanup(program.kill)
        return program

    def wait_for_ticks(self, feeling, name, ticks):
        """Waits until a running program has recorded this many ticks."""
        file = self.dir / name
        while not file.exists() or file.stat().st_size < 100000 or len(rows_of(file)[1]) < ticks:
            self.assertIsNone(feeling.poll())
            time.sleep(0.01)

    def test_a_replay_repeats_the_edits_of_the_scene(self):
        # The hand slides back and forth on the ball, in all scenes.
        path = self.dir / "path.csv"
        path.write_text("t,x,y,z\n0,0,0,0.06\n" + "".join(
            f"{0.5 * i},{0.01 * (i % 2)},0,0.045\n" for i in range(1, 9)), encoding="utf-8")
        feeling = self.feel("a.rec", 4, words=["--watch", "--device", f"path:{path}"])
        # Each scene lasts at least a second.
        for strength, name, ticks in ((2, "skin", 1200), (1, "hide", 2400)):
            self.wait_for_ticks(feeling, "a.rec", ticks)
            edited = json.loads(json.dumps(SCENE))
            edited["modes"][0].update(strength=strength, name=name)
            self.write(edited)
        feeling.communicate(timeout=60)
        _, rows = rows_of(self.dir / "a.rec")
        self.assertEqual(len(set(rows["scene"]) - {0}), 3)
        run("feel", self.dir / "a.rec", "--device", f"replay:{self.dir / 'a.rec'}", "--record",
            self.dir / "b.rec", "--trace", self.dir / "b.csv")
        self.assertTrue(self.compare("a.rec", "b.rec")["identical"])
        # The trace has a mode's load while a mode of that name exists.
        with open(self.dir / "b.csv", encoding="utf-8") as file:
            trace = list(csv.DictReader(file))
        self.assertEqual([name for name in trace[0] if name.startswith("load_")], ["load_skin"])
        self.assertEqual(len(trace), len(rows))
        for scene, bears in zip(sorted(set(rows["scene"]) - {0}), (True, True, False)):
            of_scene = [row for row, number in zip(trace, rows["scene"]) if number == scene]
            self.assertTrue(any(float(row["force_z"]) != 0 for row in of_scene))
            self.assertEqual(any(float(row["load_skin"]) > 0.1 for row in of_scene), bears)
        # The replay's recording has the scenes, too, so it can be replayed.
        run("feel", self.dir / "b.rec", "--device", f"replay:{self.dir / 'b.rec'}", "--record",
            self.dir / "c.rec")
        self.assertTrue(self.compare("a.rec", "c.rec")["identical"])

    def test_a_killed_program_loses_less_than_a_second_of_its_recording(self):
        kills = int(os.environ.get("PALPATE_KILLS", "5"))
        chance = random.Random(12)
        worst = 0.0
        torn = 0
        # The next program starts while this one runs.
        waiting = self.feel("0.rec", 60)
        for kill in range(kills):
            name, feeling = f"{kill}.rec", waiting
            file = self.dir / name
            self.wait_for_ticks(feeling, name, 1)
            if kill + 1 < kills:
                waiting = self.feel(f"{kill + 1}.rec", 60)
            time.sleep(chance.uniform(0.0, 1.0))
            # Computes the start of the loop from the growing file.
            begun = time.monotonic() - len(rows_of(file)[1]) / 1000.0
            feeling.send_signal(signal.SIGKILL)
            killed = time.monotonic() - begun
            feeling.communicate()
            # A kill during a write leaves an incomplete chunk. The chunks before it count.
            told = self.compare(name, name)
            torn += told["torn"][0] > 0
            worst = max(worst, killed - told["ticks"][0] / 1000.0)
            self.assertLess(worst, 1.0, f"kill {kill}")
        print(f"{kills} kills: at most {worst:.3f} s lost, {torn} of them within a chunk")


if __name__ == "__main__":
    suite.main(word for word in sys.argv[3:] if word != "--without-hdf5")
