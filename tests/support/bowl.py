"""A bowl in bricks and a hand in it, for tests of brick stores. sys.argv[1] is the folder of the programs."""
import atexit
import csv
import json
import signal
import socket
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

from program import PALPATE, run
from refusals import refusal

PATIENCE = 60  # s


def free_port():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def ticks_in(recording):
    """Returns the number of ticks in a recording so far."""
    if not recording.exists() or recording.stat().st_size < 1 << 16:
        return 0
    with open(recording, "rb") as file:
        head = json.loads(file.readline())
    return (recording.stat().st_size - head["offset"]) // head["record"]


class Case(unittest.TestCase):
    dir = None

    @classmethod
    def setUpClass(cls):
        # All classes share one folder.
        if Case.dir is None:
            Case.make_folder()

    @classmethod
    def make_folder(cls):
        holder = tempfile.TemporaryDirectory()
        atexit.register(holder.cleanup)
        cls.dir = Path(holder.name)
        cls.dir.chmod(0o755)  # a server that root starts runs as another user
        run("make", "two-bodies", cls.dir / "bodies.vdb", "--voxel", 0.25)
        run("brick", cls.dir / "bodies.vdb", cls.dir / "bowl", "--grid", "bowl")
        facts = json.loads((cls.dir / "bowl/.zattrs").read_text())["palpate"]
        cls.levels = len(facts["levels"])
        (cls.dir / "hand.csv").write_text(
            "t,x,y,z\n" + "".join(f"{t / 10},{0.02 * (t % 7) / 7},{0.01},{0.08 - 0.002 * t}\n"
                                  for t in range(55)))

    def scene(self, place):
        file = self.dir / "scene.json"
        file.write_text(json.dumps({
            "palpate": 1, "coupling": {"stiffness": 500},
            "volumes": {"bowl": {"file": place, "place": {"unit": "mm"},
                                 "window": {"budget_mb": 80}}},
            "modes": [{"name": "skin", "mode": "isosurface", "of": "bowl", "value": 0,
                       "solid": "below", "strength": 6}]}))
        return file

    def feel(self, place, *words, status=0):
        """Runs `palpate feel` with the bowl's bricks at `place`. Returns the trace's rows, the summary and stderr."""
        trace, summary = self.dir / "t.csv", self.dir / "s.json"
        done = run("feel", self.scene(place), "--device", f"path:{self.dir / 'hand.csv'}", "--trace", trace,
                   "--summary", summary, *words, status=status)
        with open(trace, encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        for row in rows:
            del row["tick_ns"]
        return rows, json.loads(summary.read_text()), done.stderr

    def refused(self, place, says):
        _, line = refusal(self, self.dir, lambda: run("feel", place, "--seconds", 1, status=2))
        self.assertIn(says, line)


class Stored:
    """Tests that apply to all kinds of stores, with bricks at `address`."""

    def test_bricks_from_a_server_give_the_same_forces_as_the_local_folder(self):
        here, told, _ = self.feel(str(self.dir / "bowl"))
        there, told_there, _ = self.feel(self.address)
        self.assertEqual(here, there)
        self.assertGreater(max(float(row["force_z"]) for row in here), 0.1)
        # Several requests run at once, so the count can include bricks that arrived too late to be used.
        self.assertAlmostEqual(told["bricks"]["bowl"]["fetched"], told_there["bricks"]["bowl"]["fetched"], delta=20)
        self.assertEqual(told_there["bricks"]["bowl"]["failed"], 0)

    def test_the_commands_info_feel_and_check_accept_the_address_of_a_server(self):
        words = [json.loads(run("info", place, "--json").stdout)["grids"]
                 for place in (self.dir / "bowl", self.address)]
        self.assertEqual(*words)
        done = run("feel", self.address + "/", "--seconds", 0.2)
        self.assertIn("bricks", done.stdout)
        check = json.loads(run("check", self.scene(self.address), "--json").stdout)
        self.assertEqual(check["volumes"]["bowl"]["bricks"]["levels"], self.levels)

    def test_a_recording_with_bricks_from_a_server_replays_identically(self):
        record, again = self.dir / "served.rec", self.dir / "again.rec"
        run("feel", self.address, "--device", f"path:{self.dir / 'hand.csv'}", "--record", record)
        run("feel", record, "--device", f"replay:{record}", "--record", again)
        self.assertIn("identical to the last bit", run("compare", record, again).stdout)
        scene = json.loads(run("scene", self.address).stdout)
        self.assertEqual([volume["file"] for volume in scene["volumes"].values()], [self.address])


class Ended:
    """Tests of a hand whose store at `address` stops. setUp() starts the store; kill(signal) signals its process."""
    TICKS = 2500    # number of ticks after which the hand has rested in the wall for a second

    def on_time(self):
        """Starts a real-time run of a hand that stays in the bowl's wall. Returns the file of its summary."""
        self.said = ""
        self.addCleanup(self.kill, signal.SIGCONT)
        (self.dir / "held.csv").write_text("t,x,y,z\n0,0.01,0.01,0\n1.5,0.01,0.01,-0.024\n"
                                           "60,0.01,0.01,-0.024\n")
        summary, record = self.dir / "held.json", self.dir / "held.rec"
        for file in (summary, record):
            file.unlink(missing_ok=True)
        self.running = subprocess.Popen(
            [PALPATE, "feel", self.scene(self.address), "--device", f"path:{self.dir / 'held.csv'}",
             "--realtime", "--summary", summary, "--record", record],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        self.addCleanup(self.running.stderr.close)
        self.addCleanup(self.running.wait)
        self.addCleanup(self.running.kill)
        end = time.monotonic() + PATIENCE
        while ticks_in(record) < self.TICKS:
            self.assertLess(time.monotonic(), end, "the hand does not touch the volume")
            time.sleep(0.02)
        return summary

    def ends(self, how, told_within=None):
        """While the hand touches the volume, calls `how`, which stops the server or pauses it. Returns the run's
        faults."""
        summary = self.on_time()
        how()
        begin = time.monotonic()
        if told_within is not None:
            self.wait_for("the volume does not exist any more")
            self.assertLess(time.monotonic() - begin, told_within)
            if "the force is cut" not in self.said:
                self.wait_for("the force is cut")
        # Waits, so that a second fault would be counted.
        time.sleep(2.0)
        self.running.send_signal(signal.SIGINT)
        self.said += self.running.stderr.read()
        self.running.wait(timeout=PATIENCE)
        return json.loads(summary.read_text())["faults"]

    def test_killing_the_server_cuts_the_force_and_reports_that_the_volume_is_gone(self):
        self.assertEqual(self.ends(lambda: self.kill(signal.SIGKILL), told_within=4), {"volume": 1})

    def test_a_server_that_stops_answering_cuts_the_force(self):
        self.assertEqual(self.ends(lambda: self.kill(signal.SIGSTOP), told_within=6), {"volume": 1})

    def test_a_server_that_answers_again_is_reported(self):
        summary = self.on_time()
        self.kill(signal.SIGSTOP)
        self.wait_for("the volume does not exist any more")
        self.kill(signal.SIGCONT)
        self.wait_for("the volume is available again")
        self.running.send_signal(signal.SIGINT)
        self.running.wait(timeout=PATIENCE)
        self.assertFalse(json.loads(summary.read_text())["bricks"]["bowl"]["gone"])

    def wait_for(self, words):
        for line in self.running.stderr:
            self.said += line
            if words in line:
                return
        self.fail(f"palpate feel ended without the message \"{words}\"")

    def test_a_server_that_pauses_for_a_second_does_not_cut_the_force(self):
        def hesitate():
            self.kill(signal.SIGSTOP)
            time.sleep(1.0)
            self.kill(signal.SIGCONT)
        self.assertEqual(self.ends(hesitate), {})
