#!/usr/bin/env python3
"""Tests hands of several sites in one scene, through the command line: sites_test.py BIN_DIR RELAY [--runs N].

Separate programs use real DDS on this machine's loopback, or in networks of their own with a relay between them. With
--runs N, tests N networks instead of the few of a usual run. The tests mostly wait. So if no test is named, three
processes each run a part of the tests, in separate DDS domains.
"""
import json
import math
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import process  # noqa: E402
import suite  # noqa: E402
from cases import cases  # noqa: E402
from recordings import rows_of  # noqa: E402
from refusals import refusal  # noqa: E402

PALPATE = str(Path(sys.argv[1]).resolve() / "palpate")
RELAY = str(Path(sys.argv[2]).resolve())
STRANGER = Path(RELAY).with_name("palpate_stranger")
COMERS = Path(RELAY).with_name("palpate_comers")
KEYS = str(Path(__file__).resolve().parents[2] / "scenes/network/sites/site_keys.sh")
RUNS = int(sys.argv[sys.argv.index("--runs") + 1]) if "--runs" in sys.argv else min(3, cases(3, "networks"))
START = 1e-3  # LinkParams::start [J]
PEAK = 2.0  # LinkParams::peak [N]
ON_TIME = 1.4e-3  # [s]; within 1.58 ms, PEAK can do the work START at the acceleration kLinkNimble
SILENCE, RAMP, RISE = 0.2, 0.5, 0.1  # kLinkSilence, kLinkRamp, kLinkRise [s]


def domain():
    """Returns a DDS domain that other tests on this machine are unlikely to use."""
    # Domains differ by 2, because one test also uses the next domain, and the three processes have successive ids.
    return 1 + 2 * os.getpid() % 200


def pulled(rows):
    """Returns the sent force of the other sites' hands [N]."""
    return rows["left"][:, None] * rows["pull"]


def own(rows):
    """Returns the sent force of the scene [N]."""
    return rows["force"] - pulled(rows)


def came_within(rows):
    """Returns the time from the first force of the other sites' hands to 99 % of the largest one [s]."""
    size = np.linalg.norm(pulled(rows), axis=1)
    first, largest = np.flatnonzero(size)[0], np.flatnonzero(size > 0.99 * size.max())[0]
    return rows["time"][largest] - rows["time"][first]


def periods(rows):
    """Returns the time that a link expects until its next tick [s] (engine/loop/link.cpp)."""
    dt, mean, expected = rows["dt"], rows["dt"][0], []
    for now, before in zip(dt, [dt[0], *dt]):
        mean += (now - mean) / 16
        expected.append(max(mean, min(now, before)))
    return np.array(expected)


def since_late(rows):
    """Returns, for each tick, the time since the link last expected a period above ON_TIME [s]. Its energy may not
    suffice for such a period."""
    late = np.where(periods(rows) > ON_TIME, rows["time"], -1.0)
    return rows["time"] - np.maximum.accumulate(late)


def leaps(rows):
    """Returns the ticks in which the force changed faster than a link may. A link that expects a late tick may drop
    its force at once, and regains it within RISE."""
    size, dt, since = np.linalg.norm(pulled(rows), axis=1), rows["dt"], since_late(rows)
    grew = np.diff(size) / dt[1:]
    most = 1.1 * PEAK / np.where(since[1:] > 2 * RISE, RAMP, RISE)
    return np.flatnonzero((grew > most) | ((since[1:] > 0) & (grew < -1.1 * PEAK / RAMP))).tolist()


def work(rows):
    """Returns the work of the other sites' hands on this hand, up to each tick [J]."""
    return np.cumsum(np.sum(pulled(rows)[:-1] * np.diff(rows["hand"], axis=0), axis=1))


class Wire:
    """Captures the UDP packets of the DDS domain on this machine's loopback."""

    def __enter__(self):
        try:
            self.all = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(3))
            self.all.bind(("lo", 0))
            self.all.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 24)
            self.all.setblocking(False)
            self.works = True
        except PermissionError:
            self.works = False
        return self

    def __exit__(self, *_):
        if self.works:
            self.all.close()

    def heard(self):
        """Returns the packets since the last call."""
        found, first = [], 7400 + 250 * domain()
        while self.works:
            try:
                packet = self.all.recv(1 << 16)
            except BlockingIOError:
                break
            if packet[23] == socket.IPPROTO_UDP and first <= int.from_bytes(packet[36:38], "big") < first + 250:
                found.append(packet)
        return b"".join(found)


class Case(unittest.TestCase):
    def setUp(self):
        holder = tempfile.TemporaryDirectory()
        self.addCleanup(holder.cleanup)
        self.dir = Path(holder.name)
        process.run([PALPATE, "make", "two-bodies", self.dir / "two.vdb"], check=True,
                       capture_output=True, timeout=60)
        self.scene = self.dir / "scene.json"
        self.scene.write_text(json.dumps({
            "palpate": 1,
            "volumes": {"bowl": {"file": "two.vdb", "grid": "bowl", "place": {"fit": 0.1}}},
            "modes": [{"mode": "isosurface", "of": "bowl", "value": 0, "strength": 2,
                       "solid": "below"}]}))

    def path(self, name, place, seconds=20.0):
        """Writes a hand's path, place(t) [m]. Without `place`, the hand rests 20 cm from the scene."""
        count = 2 if place is None else int(seconds * 200)
        rows = []
        for n in range(count + 1):
            t = n * seconds / count
            x, y, z = (0.2, 0.0, 0.0) if place is None else place(t)
            rows.append(f"{t},{x},{y},{z}")
        file = self.dir / f"{name}.csv"
        file.write_text("t,x,y,z\n" + "\n".join(rows) + "\n")
        return file

    def words(self, name, hand, seconds, *more, scene=None, site=None):
        return [PALPATE, "feel", scene or self.scene, "--realtime", "--site", f"{site or name}@{domain()}",
                "--device", f"path:{hand}", "--record", self.dir / f"{name}.rec",
                "--seconds", seconds, "--summary", self.dir / f"{name}.json", *more]

    def start(self, name, hand, seconds, *more, **which):
        # Writes to a file, because a pipe that no thread reads could fill up.
        said = open(self.dir / f"{name}.err", "a", encoding="utf-8")  # pylint: disable=R1732
        self.addCleanup(said.close)
        one = subprocess.Popen(list(map(str, self.words(name, hand, seconds, *more, **which))),
                               stdout=subprocess.DEVNULL, stderr=said)
        self.addCleanup(one.wait)
        self.addCleanup(one.kill)
        return one

    def said(self, name):
        return (self.dir / f"{name}.err").read_text(encoding="utf-8")

    def wait_for_ticks(self, name):
        """Waits until a site's loop runs."""
        end = time.monotonic() + 30
        file = self.dir / f"{name}.rec"
        while not file.exists() or file.stat().st_size < 1 << 16:
            self.assertLess(time.monotonic(), end, f"{name} does not run: {self.said(name)}")
            time.sleep(0.005)

    def wait_for(self, name, words, seconds=30.0, times=1):
        """Waits until the words have been printed `times` times. Returns the time."""
        end = time.monotonic() + seconds
        while self.said(name).count(words) < times:
            if time.monotonic() > end:
                self.fail(f"site {name} did not print \"{words}\" within {seconds:g} s: {self.said(name)}")
            time.sleep(0.005)
        return time.monotonic()

    def keys(self, folder, *names):
        process.run([KEYS, self.dir / folder, *names], check=True, capture_output=True, timeout=60)


class OneMachine(Case):
    HOST = True

    def test_two_linked_hands_pull_each_other_and_their_recordings_replay_identically(self):
        hands = {"A": self.path("A", None), "B": self.path("B", lambda t: (0.21, 0, 0))}
        both = [self.start(name, hand, 3) for name, hand in hands.items()]
        status = [one.wait(timeout=30) for one in both]
        self.assertEqual(status, [0, 0], self.said("A") + self.said("B"))
        for name, other, sign in (("A", "B", 1), ("B", "A", -1)):
            self.assertIn(f"site {other}: its hand is connected", self.said(name))
            rows = rows_of(self.dir / f"{name}.rec")
            # The largest force is 200 N/m times 10 mm. It grows by a ramp.
            force = pulled(rows)[:, 0] * sign
            self.assertAlmostEqual(force.max(), PEAK, delta=1e-4)
            self.assertGreater(came_within(rows), 0.9 * RAMP)
            self.assertEqual(leaps(rows), [])
            self.assertTrue((pulled(rows)[:, 1:] == 0).all())
            facts = json.loads((self.dir / f"{name}.json").read_text())["sites"][other]
            self.assertEqual(facts["lives"], 1)
            self.assertGreater(facts["heard"], 30)  # 20 per second for a resting hand
            if since_late(rows)[-1] > 2 * RISE:
                self.assertEqual(facts["paid"], 1)
            again = self.dir / f"{name}2.rec"
            process.run([PALPATE, "feel", self.dir / f"{name}.rec", "--device",
                            f"replay:{self.dir / name}.rec", "--record", again], check=True,
                           capture_output=True, timeout=60)
            told = process.run([PALPATE, "compare", self.dir / f"{name}.rec", again], check=True,
                                  capture_output=True, text=True, timeout=60).stdout
            self.assertIn("identical to the last bit", told)

    def test_a_second_site_with_the_same_name_waits_and_joins_after_the_first_was_killed(self):
        alone = self.start("A", self.path("A", None), 60)
        killed = self.start("B", self.path("B", lambda t: (0.205, 0, 0)), 60)
        self.wait_for("A", "site B: its hand is connected")
        another = self.start("C", self.path("C", lambda t: (0.195, 0, 0)), 60, site="B")
        self.wait_for("C", "another site has the same name")
        time.sleep(0.5)
        before = self.said("A").count("site B: its hand is connected")
        killed.send_signal(signal.SIGKILL)
        self.wait_for("A", "site B: its hand is connected", times=before + 1)
        time.sleep(1.0)
        for one in (alone, another):
            one.send_signal(signal.SIGINT)
            one.wait(timeout=30)

        rows = rows_of(self.dir / "A.rec")
        force = pulled(rows)[:, 0]
        self.assertAlmostEqual(force.max(), 1.0, delta=1e-3)
        self.assertAlmostEqual(force[-1], -1.0, delta=1e-3)
        self.assertEqual(leaps(rows), [])

    def test_a_site_that_was_killed_no_longer_pulls_and_can_join_again(self):
        mine = self.path("A", None)
        his = self.path("B", lambda t: (0.205, 0, 0))
        alone = self.start("A", mine, 60)
        killed = self.start("B", his, 60)
        self.wait_for("A", "site B: its hand is connected")
        time.sleep(1.0)
        killed.send_signal(signal.SIGKILL)
        gone = time.monotonic()
        heard = self.wait_for("A", "site B: no message for")
        self.assertLess(heard - gone, 1.0)
        time.sleep(1.0)
        back = self.start("B", his, 2)
        back.wait(timeout=30)
        self.wait_for("A", "site B: it has left")
        time.sleep(0.5)
        alone.send_signal(signal.SIGINT)
        alone.wait(timeout=30)

        rows = rows_of(self.dir / "A.rec")
        force = pulled(rows)[:, 0]
        self.assertAlmostEqual(force.max(), 1.0, delta=1e-3)
        self.assertEqual(leaps(rows), [])
        held = np.flatnonzero(force > 0.99)
        let_go = np.flatnonzero(force[held[0]:] == 0)[0] + held[0]
        self.assertTrue((force[let_go:] > 0.9).any(), "the force did not return")
        facts = json.loads((self.dir / "A.json").read_text())["sites"]["B"]
        self.assertEqual(facts["lives"], 2)
        self.assertIn("site B: it has left", self.said("A"))  # the second run of B told that it ends

    def test_sites_in_another_domain_are_not_linked(self):
        mine = self.start("A", self.path("A", None), 30)
        other = process.run(
            [PALPATE, "feel", self.scene, "--realtime", "--site", f"B@{domain() + 1}", "--device",
             f"path:{self.path('B', None)}", "--seconds", "1", "--json"],
            capture_output=True, text=True, timeout=30)
        self.wait_for("A", "no other site is heard yet")
        mine.send_signal(signal.SIGINT)
        mine.wait(timeout=30)
        self.assertEqual(json.loads(other.stdout)["sites"], {})
        self.assertEqual(json.loads((self.dir / "A.json").read_text())["sites"], {})
        self.assertEqual(self.said("A").count("no other site is heard yet"), 1)

    def test_a_site_whose_name_is_in_use_is_reported_and_not_linked(self):
        first = self.start("A", self.path("A", None), 3)
        self.dir.joinpath("A.err").replace(self.dir / "first.err")
        second = process.run(
            [PALPATE, "feel", self.scene, "--realtime", "--site", f"A@{domain()}", "--device",
             f"path:{self.path('B', lambda t: (0.21, 0, 0))}", "--seconds", "2", "--json"],
            capture_output=True, text=True, timeout=30)
        first.wait(timeout=30)
        self.assertIn("another site has the same name", second.stderr)
        self.assertEqual(json.loads(second.stdout)["force_max"], 0)

    def test_random_network_packets_do_not_disturb_a_site(self):
        alone = self.start("A", self.path("A", None), 4)
        time.sleep(1.0)
        chance = random.Random(1)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as throws:
            for _ in range(4000):
                size = chance.randrange(1, 1400)
                packet = bytearray(chance.randbytes(size))
                if chance.random() < 0.8:
                    packet[:4] = b"RTPS"
                # Ports of the first participants of the domain, by DDS's rules.
                port = 7400 + 250 * domain() + chance.choice((0, 1, 10, 11, 12, 13))
                throws.sendto(packet, ("127.0.0.1", port))
                if _ % 40 == 0:
                    time.sleep(0.01)
        status = alone.wait(timeout=30)
        self.assertIn(status, (0, 1, 4), self.said("A"))
        facts = json.loads((self.dir / "A.json").read_text())
        self.assertEqual(facts["sites"], {})
        self.assertEqual(facts["force_max"], 0)

    def test_sites_with_other_keys_are_not_linked(self):
        self.keys("ours", "A", "B")
        self.keys("theirs", "C")

        hands = {name: self.path(name, lambda t, n=n: (0.2 + 0.005 * n, 0, 0)) for n, name in enumerate("ABCDE")}
        keys = {"A": "ours/A", "B": "ours/B", "C": "theirs/C"}
        with Wire() as wire:
            secured = [self.start(name, hands[name], 60, "--site-keys", self.dir / keys[name]) for name in keys]
            self.wait_for("A", "site B: its hand is connected")
            self.wait_for("B", "site A: its hand is connected")
            time.sleep(1.0)
            secret = wire.heard()
            for one in [self.start(name, hands[name], 2) for name in "DE"]:
                one.wait(timeout=30)
            for one in secured:
                one.send_signal(signal.SIGINT)
                one.wait(timeout=30)
            told = wire.heard()
        said = {name: self.said(name) for name in hands}
        # All sites together print at most one line about DDS, even if a request is repeated.
        self.assertLessEqual(max(words.count("site: DDS:") for words in said.values()), 1, said)
        met = {name: set(json.loads((self.dir / f"{name}.json").read_text())["sites"]) for name in hands}
        self.assertEqual(met, {"A": {"B"}, "B": {"A"}, "C": set(), "D": {"E"}, "E": {"D"}})
        if wire.works:
            # Certificates are readable, hand messages are not. Without keys, hand messages are readable.
            self.assertGreater(len(secret), 10000)
            self.assertFalse(b"palpate_hand" in secret, "hand messages are not encrypted")
            self.assertTrue(b"palpate_hand" in told, "no hand message was captured")
        felt = np.linalg.norm(pulled(rows_of(self.dir / "A.rec")), axis=1)
        self.assertGreater(felt.max(), 0.5, said)

    def test_the_lines_printed_about_joining_sites_are_limited_per_second(self):
        alone = self.start("A", self.path("A", None), 30)
        self.wait_for("A", "no other site is heard yet")
        process.run([COMERS, str(domain()), "3"], check=True, timeout=60)
        self.wait_for("A", "more lines about sites that join and leave")
        alone.send_signal(signal.SIGINT)
        alone.wait(timeout=30)
        # At most 21 lines per second. Departures are reported when the hands have been silent.
        self.assertLess(self.said("A").count("site Z"), 21 * 5)

    def test_at_most_seven_other_hands_are_linked(self):
        def stay(first, count):
            with open(self.dir / "comers.err", "a", encoding="utf-8") as said:
                process.run([COMERS, str(domain()), "1.5", str(first), str(count)], check=True, timeout=60,
                               stderr=said)
            time.sleep(2 * SILENCE)

        full = "more than 7 hands of other sites: some are not felt"
        alone = self.start("A", self.path("A", None), 30)
        self.wait_for("A", "no other site is heard yet")
        stay(0, 7)
        self.assertNotIn(full, self.said("A"))
        # New sites get the slots of silent ones.
        stay(10, 9)
        self.assertIn(full, self.said("A"))
        # Twice, more sites join than a site remembers.
        for first in (100, 200):
            stay(first, 40)
        alone.send_signal(signal.SIGINT)
        alone.wait(timeout=30)
        for first, count in ((0, 7), (10, 9), (100, 40), (200, 40)):
            felt = sum(f"site Z{n}: its hand is connected" in self.said("A") for n in range(first, first + count))
            self.assertEqual(felt, 7, f"{first}: {self.said('A')}")
        self.assertEqual(self.said("A").count(full), 1)
        self.assertLessEqual(len(json.loads((self.dir / "A.json").read_text())["sites"]), 4 * 7)

    def test_the_command_that_makes_keys_changes_no_other_files(self):
        mine = [self.dir / "mine" / name for name in ("thesis.new", "draft.new/page")]
        mine[1].parent.mkdir(parents=True)
        for one in mine:
            one.write_text("mine")
        self.keys("mine", "A")
        self.assertEqual([one.read_text() for one in mine], ["mine", "mine"])
        for names, says in ((("A",), "exists"), (("B", "B"), "given twice"), (("ca",), "not a name"),
                            (("draft",), "without keys")):
            done = process.run([KEYS, self.dir / "mine", *names], capture_output=True, text=True, timeout=60)
            self.assertNotEqual(done.returncode, 0)
            self.assertIn(says, done.stderr)
        self.assertEqual(mine[1].read_text(), "mine")

    def test_the_command_that_makes_keys_resumes_after_an_interruption(self):
        self.keys("cut", "A")
        for made in (True, False):
            (self.dir / "cut/B.new").mkdir()
            if made:
                (self.dir / "cut/B.new/key.pem").write_text("half")
            self.keys("cut", "B")
            self.assertFalse((self.dir / "cut/B.new").exists())
            self.assertIn("PRIVATE KEY", (self.dir / "cut/B/key.pem").read_text())
            shutil.rmtree(self.dir / "cut/B")

    def test_mixed_or_missing_keys_of_a_site_are_refused(self):
        self.keys("ours", "A")
        self.keys("theirs", "A")
        hand = self.path("A", None)

        def refused(says):
            _, line = refusal(self, self.dir, lambda: process.run(
                [PALPATE, "feel", str(self.scene), "--device", f"path:{hand}", "--realtime", "--seconds", "1", "--site",
                 f"A@{domain()}", "--site-keys", str(self.dir / "ours/A")], capture_output=True, text=True, timeout=60))
            self.assertIn(says, line)
        for file in ("cert.pem", "governance.p7s", "key.pem"):
            shutil.copy(self.dir / "theirs/A" / file, self.dir / "ours/A" / file)
            refused("DDS rejects the keys in")
        (self.dir / "ours/A/permissions.p7s").unlink()
        refused(" is missing")

    def test_invalid_options_of_a_site_are_refused(self):
        hand = self.path("A", None)
        for words, says in (
                (["--site", "A"], "add --realtime"),
                (["--realtime", "--site", "A B"], "is not a valid name of a site"),
                (["--realtime", "--site", "A" * 32], "is not a valid name of a site"),
                (["--realtime", "--site", "A@231"], "is not a domain"),
                (["--realtime", "--with", "10.0.0.1"], "add --site NAME"),
                (["--realtime", "--own-scene"], "add --site NAME"),
                (["--realtime", "--site-keys", "k"], "add --site NAME"),
                (["--realtime", "--site", "A", "--site-keys", "none"], " is missing"),
                (["--realtime", "--site", "A", "--with", "host\"/>"], "is not a numeric address")):
            with self.subTest(words=words):
                _, line = refusal(self, self.dir, lambda words=words: process.run(
                    [PALPATE, "feel", str(self.scene), "--device", f"path:{hand}", *words],
                    capture_output=True, text=True, timeout=60))
                self.assertIn(says, line)


class Edits(Case):
    """Tests edits of a site's scene. Each site has its own folder."""
    HOST = True

    def setUp(self):
        super().setUp()
        self.hand = self.path("hand", None)

    def write(self, name, strengths, **more):
        """Writes a site's scene: distant planes that pull with these forces along x, y and z [N]."""
        folder = self.dir / f"of-{name}"
        if not folder.exists():
            folder.mkdir()
            (folder / f"{name}-s.vdb").symlink_to(self.dir / "two.vdb")
        modes = [{"name": axis, "mode": "guide", "shape": "plane", "strength": strength,
                  "at": [9 * (axis == a) for a in "xyz"], "along": [int(axis == a) for a in "xyz"]}
                 for axis, strength in zip("xyz", strengths)]
        scene = {"palpate": 1, "modes": modes + more.pop("modes", []),
                 "volumes": {"bowl": {"file": f"{name}-s.vdb", "grid": "bowl"}, **more}}
        new = folder / "new"
        new.write_text(json.dumps(scene))
        new.replace(folder / "scene.json")
        return folder / "scene.json"

    def site(self, name, seconds, *more, strengths=(1, 1, 1)):
        return self.start(name, self.hand, seconds, *more, scene=self.write(name, strengths))

    def last(self, name):
        """Returns the scene's last force [N]."""
        return own(rows_of(self.dir / f"{name}.rec"))[-1]

    def test_an_edit_reaches_other_sites_and_also_a_late_joiner_after_its_author_was_killed(self):
        killed = self.site("A", 60, "--watch")
        other = self.site("B", 60)
        self.wait_for("B", "site A: its hand is connected")
        self.wait_for("A", "site B: its hand is connected")
        self.write("A", (2, 1, 1))
        begin = time.monotonic()
        self.wait_for("A", "has changed: the new scene is active")
        took = self.wait_for("B", 'site A: its edit of mode "x" is active') - begin
        self.write("A", (3, 1, 1))
        self.wait_for("B", 'site A: its edit of mode "x" is active', times=2)
        killed.kill()
        self.wait_for("B", "site A: no message for")
        late = self.site("C", 2)
        self.wait_for("C", 'site A: its edit of mode "x" is active')
        late.wait(timeout=30)
        other.send_signal(signal.SIGINT)
        other.wait(timeout=30)
        print(f"an edit was active at another site after {took:.2f} s", flush=True)
        self.assertLess(took, 2.0)

        # The second edit waits until the first has taken full effect.
        rows = rows_of(self.dir / "B.rec")
        times = rows["time"][1:][np.diff(rows["scene"].astype(np.int64)) != 0][-2:]
        self.assertGreater(times[1] - times[0], 1.9)
        for name in "BC":
            np.testing.assert_allclose(self.last(name), [3, 1, 1], atol=1e-6)
            file = json.loads((self.dir / f"of-{name}/scene.json").read_text())
            self.assertEqual(file["modes"][0]["strength"], 1, "palpate changed the site's file")
        again = self.dir / "again.rec"
        process.run([PALPATE, "feel", self.dir / "B.rec", "--device",
                        f"replay:{self.dir}/B.rec", "--record", again], check=True,
                       capture_output=True, timeout=60)
        told = process.run([PALPATE, "compare", self.dir / "B.rec", again], check=True,
                              capture_output=True, text=True, timeout=60).stdout
        self.assertIn("identical to the last bit", told)

    def test_simultaneous_edits_at_several_sites_converge_to_the_same_scene(self):
        both = [self.site(name, 60, "--watch") for name in "AB"]
        self.wait_for("A", "site B: its hand is connected")
        self.wait_for("B", "site A: its hand is connected")
        # Each site edits one mode that the other does not edit. Both edit a third mode.
        self.write("A", (2, 1, 1.5))
        self.write("B", (1, 2, 2.5))
        for name, other in ("AB", "BA"):
            self.wait_for(name, "has changed: the new scene is active")
            self.wait_for(name, f"site {other}: its edit of mode")
        time.sleep(1.2)
        for one in both:
            one.send_signal(signal.SIGINT)
            one.wait(timeout=30)

        np.testing.assert_allclose(self.last("A"), self.last("B"), atol=1e-6)
        np.testing.assert_allclose(self.last("A")[:2], [2, 2], atol=1e-6)
        self.assertIn(round(float(self.last("A")[2]), 6), (1.5, 2.5))

    def test_edits_are_not_applied_to_a_missing_volume_or_to_a_site_s_own_scene(self):
        sites = [self.site("A", 60, "--watch", strengths=(1, 1, 2)), self.site("B", 60),
                 self.site("C", 60, "--own-scene", "--watch")]
        for name in "AB":
            self.wait_for(name, "site C: its hand is connected")
        self.wait_for("B", "site A: its scene differs from this site's scene: mode \"z\"")
        more = {"tumour": {"file": "A-s.vdb", "grid": "bowl"},
                "modes": [{"mode": "isosurface", "of": "tumour", "value": 0, "strength": 1,
                           "name": "rim"}]}
        self.write("A", (1, 1, 2), **more)
        self.wait_for("B", 'site A: its edit of mode "rim", volume "tumour" is rejected: '
                           'volume "tumour": the scene of this site does not have it')
        self.write("A", (2.5, 1, 2), **more)
        self.wait_for("B", 'site A: its edit of mode "x" is active')
        self.write("C", (1, 3, 1))
        self.wait_for("C", "has changed: the new scene is active")
        time.sleep(0.6)
        for one in sites:
            one.send_signal(signal.SIGINT)
            one.wait(timeout=30)

        np.testing.assert_allclose(self.last("B"), [2.5, 1, 1], atol=1e-6)
        np.testing.assert_allclose(self.last("C"), [1, 3, 1], atol=1e-6)
        self.assertEqual(self.said("B").count("is rejected"), 1)
        for name in "AB":
            self.assertNotIn("site C: its edit", self.said(name))
        self.assertNotIn("edit", self.said("C"))


    def test_invalid_edits_of_another_site_are_rejected_and_keep_the_force_limited(self):
        def says(is_, of=("modes", "x", "0"), count=1):
            return json.dumps({"palpate_edits": 1, "rest": [],
                               "edits": [{"of": of, "at": [count, "C"], "is": is_}]})

        x = {"name": "x", "mode": "guide", "shape": "plane", "strength": 2, "at": [9, 0, 0],
             "along": [1, 0, 0]}
        def in_many_names():
            edits = [{"of": ("modes", f"n{n}", "0"), "at": [1, f"S{n}"],
                      "is": {**x, "name": f"n{n}", "strength": 1e-3}} for n in range(6)]
            return json.dumps({"palpate_edits": 1, "rest": [], "edits": edits})

        bad = ["[" * 60000, says({"file": "/etc/passwd"}, ("volumes", "bowl")),
               says({**x, "strength": 7}).replace("7", "1e999"), says({**x, "name": "y"}),
               says({**x, "strength": 1e30}), in_many_names(), says({**x, "strength": 1e6}, count=2)]

        begin = self.site("B", 60)
        # The unauthenticated peer publishes each text for 0.5 s.
        self.wait_for_ticks("B")
        stranger = subprocess.Popen([STRANGER, f"C@{domain()}", *bad])
        self.addCleanup(stranger.wait)
        self.addCleanup(stranger.kill)
        self.wait_for("B", 'site C: its edit of mode "x" is active')
        time.sleep(0.5)
        stranger.kill()
        begin.send_signal(signal.SIGINT)
        begin.wait(timeout=30)

        self.assertEqual(self.said("B").count("the message is ignored"), 1)
        self.assertLessEqual(self.said("B").count('its edit of mode "n'), 4)
        self.assertRegex(self.said("B"), "[23] more sites have edited the scene")
        self.assertEqual(self.said("B").count("1e+30 N is beyond"), 1)
        with open(self.dir / "B.rec", "rb") as recording:
            limits = json.loads(recording.readline())["device"]["limits"]
        size = np.linalg.norm(rows_of(self.dir / "B.rec")["force"], axis=1)
        self.assertGreater(size[-1], 2)
        self.assertLessEqual(size.max(), limits["peak"] * (1 + 1e-9))


class Far(Case):
    """Tests over networks that lose, delay, duplicate and reorder packets."""
    HOST = True

    def sway(self, seed):
        """Returns a smooth path whose accelerations are below kLinkNimble."""
        chance = random.Random(seed)
        swings = [(chance.uniform(0.005, 0.02), chance.uniform(0.3, 3.0), chance.uniform(0, 7))
                  for _ in range(3)]
        return lambda t: tuple(
            (0.2 if i == 0 else 0) + a * math.sin(2 * math.pi * f * t + p)
            for i, (a, f, p) in enumerate(swings))

    def through(self, one, other, *network, act=None):
        """Runs two commands with a relay between them. Calls `act` when both sites feel the other's hand. Returns the
        messages of all three."""
        with open(self.dir / "relay.err", "w", encoding="utf-8") as file:
            relay = subprocess.Popen([RELAY, *map(str, network), "--seconds", "60", "--", *map(str, one), "--",
                                      *map(str, other)], stdout=subprocess.DEVNULL, stderr=file)
        self.addCleanup(relay.wait)
        self.addCleanup(relay.kill)
        if act:
            # If the relay cannot make networks, it ends at once.
            while relay.poll() is None and self.said("relay").count(": its hand is connected") < 2:
                time.sleep(0.01)
            act(relay)
        relay.wait(timeout=100)
        said = self.said("relay")
        if relay.returncode == 77:
            self.skipTest("needs separate networks: " + said)
        return said

    def test_a_network_with_delays_and_losses_adds_at_most_the_initial_energy_to_linked_hands(self):
        worst = -math.inf
        for seed in range(RUNS):
            chance = random.Random(seed)
            hands = [self.path(name, self.sway(2 * seed + n)) for n, name in enumerate("AB")]
            network = ["--delay-ms", round(chance.choice((0, 1, 5, 20, 80)) * chance.random(), 2),
                       "--jitter-ms", round(chance.choice((0, 5, 40)) * chance.random(), 2),
                       "--loss", (loss := round(chance.choice((0, 0.1, 0.5)) * chance.random(), 3)),
                       "--twice", round(0.5 * chance.random(), 3),
                       "--overtaken", round(0.5 * chance.random(), 3), "--seed", seed]
            # The relay ends the first command after the second has ended.
            said = self.through(self.words("A", hands[0], 30, "--with", "10.77.0.2"),
                                self.words("B", hands[1], 5, "--with", "10.77.0.1"), *network)
            rows = {name: rows_of(self.dir / f"{name}.rec") for name in "AB"}
            # Sums both hands, because one hand can get energy that the other has put in.
            both = sum(work(of)[-1] for of in rows.values())
            worst = max(worst, both)
            self.assertLessEqual(both, 2 * START + 1e-12, f"seed {seed}: {network}")
            for of in rows.values():
                self.assertLessEqual(np.linalg.norm(of["pull"], axis=1).max(), PEAK + 1e-9)
                self.assertFalse((of["fault"] != 0).any(), f"seed {seed}: {said}")
            # If a third of the packets is lost, sites can take longer to find each other.
            for name, of in rows.items() if loss < 0.3 else ():
                felt = np.linalg.norm(pulled(of), axis=1) > 0.01
                self.assertGreater(felt.sum(), 100, f"seed {seed}: {name} felt nothing: {said}")
        print(f"{RUNS} networks: both hands together got at most {1e3 * worst:.3g} mJ", flush=True)

    def test_edits_of_a_site_without_keys_are_not_sent_to_other_machines(self):
        before = self.scene.read_text()

        def act(_):
            time.sleep(0.5)
            self.scene.write_text(before.replace('"strength": 2', '"strength": 3'))

        hands = [self.path("A", None), self.path("B", lambda t: (0.205, 0, 0))]
        # A does not name B's machine. --with opens a site to other machines; it is not a list of permitted machines.
        said = self.through(self.words("A", hands[0], 30, "--with", "10.77.0.9", "--watch"),
                            self.words("B", hands[1], 6, "--with", "10.77.0.1"), act=act)
        self.assertIn("site A: its hand is connected", said)
        self.assertIn("has changed: the new scene is active", said)
        self.assertNotIn("its edit", said)

    def test_sites_that_were_separated_reconnect(self):
        before = self.scene.read_text()

        def act(relay):
            time.sleep(1.0)   # waits for the full force
            relay.send_signal(signal.SIGUSR1)
            self.scene.write_text(before.replace('"strength": 2', '"strength": 3'))
            time.sleep(2.0)
            relay.send_signal(signal.SIGUSR1)

        hands = [self.path("A", None), self.path("B", lambda t: (0.205, 0, 0))]
        # Only sites with keys send edits to other machines.
        self.keys("ours", "A", "B")
        keys = [("--site-keys", self.dir / "ours" / name) for name in "AB"]
        said = self.through(self.words("A", hands[0], 30, "--with", "10.77.0.2", "--watch", *keys[0]),
                            self.words("B", hands[1], 9, "--with", "10.77.0.1", *keys[1]),
                            "--delay-ms", 5, "--loss", 0.01, act=act)
        # Edits made while the sites were disconnected arrive later.
        self.assertIn('site A: its edit of isosurface of "bowl" is active', said)
        rows = rows_of(self.dir / "B.rec")
        force = np.linalg.norm(pulled(rows), axis=1)
        self.assertAlmostEqual(force.max(), 1.0, delta=1e-3)
        self.assertEqual(leaps(rows), [])
        held = np.flatnonzero(force > 0.99)
        let_go = np.flatnonzero(force[held[0]:] == 0)[0] + held[0]
        # After the last message, the force stays during the silence. Then it falls by a ramp.
        begins = np.flatnonzero(force[:let_go] > 0.99)[-1]
        self.assertLess(rows["time"][let_go] - rows["time"][begins], RAMP + 0.1)
        self.assertTrue((force[let_go:] > 0.99).any(), "the force did not return")


def parts():
    """Returns the tests of three processes, which take about equally long."""
    names = unittest.defaultTestLoader.getTestCaseNames(OneMachine)
    with_edits = names[::4]
    others = [one.__name__ for one in Case.__subclasses__() if one not in (Far, OneMachine)]
    return [["Far"], [*others, *(f"OneMachine.{name}" for name in with_edits)],
            [f"OneMachine.{name}" for name in names if name not in with_edits]]


def run_parts(words):
    """Runs the parts at the same time. Returns 0 if all pass."""
    running = [subprocess.Popen([sys.executable, __file__, *sys.argv[1:3], *words, *part], stdout=subprocess.PIPE,
                                stderr=subprocess.STDOUT, text=True) for part in parts()]
    for one in running:
        print(one.communicate()[0], end="", flush=True)
    return int(any(one.returncode != 0 for one in running))


if __name__ == "__main__":
    which = sys.argv[3:]
    if "--host" in which and all(word.startswith("--") for word in which):
        sys.exit(run_parts(which))
    if "--runs" in which:
        at = which.index("--runs")
        del which[at:at + 2]
    suite.main(which)
