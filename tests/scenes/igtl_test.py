#!/usr/bin/env python3
"""Tests a run with a client of OpenIGTLink: igtl_test.py BIN_DIR.

The client follows the protocol's published messages, and shares no code with palpate.
"""
import csv
import json
import re
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import unittest
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import process  # noqa: E402
import suite  # noqa: E402
from refusals import refusal  # noqa: E402

PALPATE = str(Path(sys.argv[1]) / "palpate")
PATIENCE = 20  # [s]
HEAD = struct.Struct(">H12s20sQQQ")
# Placement of the scene's volume, rotated by 90 degrees about z: x of the file is y of W.
SCALE = 0.001
SHIFT = (0.01, -0.02, 0.03)


def crc64_table():
    table = []
    for byte in range(256):
        word = byte << 56
        for _ in range(8):
            word = (word << 1) ^ (0x42F0E1EBA9EA3693 if word >> 63 else 0)
            word &= 0xFFFFFFFFFFFFFFFF
        table.append(word)
    return table


TABLE = crc64_table()


def crc64(data):
    crc = 0
    for byte in data:
        crc = TABLE[(crc >> 56) ^ byte] ^ (crc << 8 & 0xFFFFFFFFFFFFFFFF)
    return crc


def message(kind, name, body, version=1, crc=None, size=None):
    if version == 2:  # a message of OpenIGTLink protocol 3
        body = struct.pack(">HHIi", 14, 2, 0, 7) + b"\0\0" + body + b"\0\0"
    return HEAD.pack(version, kind.encode(), name if isinstance(name, bytes) else name.encode(),
                     int(time.time()) << 32, len(body) if size is None else size,
                     crc64(body) if crc is None else crc) + body


def transform(x, y, z):
    return struct.pack(">12f", 1, 0, 0, 0, 1, 0, 0, 0, 1, x, y, z)


def string(text):
    return struct.pack(">HH", 3, len(text)) + text.encode()


SCALARS = {2: "b", 3: "B", 4: "h", 5: "H", 6: "i", 7: "I", 10: "f", 11: "d"}


def image(values, size, scalar=4, big=False, space=1, spacing=2.0, middle=(0, 0, 0), part=None,
          components=1):
    flip = -1 if space == 2 else 1
    matrix = [flip * spacing, 0, 0, 0, flip * spacing, 0, 0, 0, spacing,
              flip * middle[0], flip * middle[1], middle[2]]
    head = struct.pack(">HBBBB3H12f3H3H", 1, components, scalar, 1 if big else 2, space, *size,
                       *matrix, 0, 0, 0, *(part or size))
    return head + struct.pack(f"{'>' if big else '<'}{len(values)}{SCALARS[scalar]}", *values)


SIZE = (24, 12, 12)


def wall(at):
    """Returns the values of a ramp along x of the file, with the value 5 at x = `at` [mm], for images of SIZE with
    voxels of 2 mm. The values are whole numbers if `at` is odd."""
    row = [max(0, min(10, 5 + 0.5 * (at - 2 * (i - 11.5)))) for i in range(SIZE[0])]
    return row * (SIZE[1] * SIZE[2])


class Client:
    def __init__(self, port):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE)

    def send(self, *words, **more):
        self.socket.sendall(message(*words, **more))

    def exactly(self, count):
        data = b""
        while len(data) < count:
            piece = self.socket.recv(count - len(data))
            if not piece:
                raise EOFError
            data += piece
        return data

    def next(self):
        """Returns type, name and content of the next message. Checks its version, checksum, time stamp and encoding."""
        version, kind, name, stamp, size, crc = HEAD.unpack(self.exactly(HEAD.size))
        body = self.exactly(size)
        if version != 1 or crc != crc64(body):
            raise AssertionError(f"version {version}, checksum {crc:x}, not {crc64(body):x}")
        self.stamp = stamp / 2**32
        if not time.time() - 2 * PATIENCE < self.stamp <= time.time():
            raise AssertionError(f"the time stamp of the message is {self.stamp} s")
        kind, name = (text.rstrip(b"\0").decode() for text in (kind, name))
        if kind == "TRANSFORM":
            numbers = struct.unpack(">12f", body)
            if numbers[:9] != (1, 0, 0, 0, 1, 0, 0, 0, 1):
                raise AssertionError(numbers)
            return kind, name, numbers[9:]
        if kind == "STRING":
            encoding, length = struct.unpack(">HH", body[:4])
            if encoding != 3 or length != len(body) - 4:
                raise AssertionError(body)
            return kind, name, body[4:].decode("ascii")
        if kind == "STATUS":
            return kind, name, (struct.unpack(">H", body[:2])[0],
                                body[30:].rstrip(b"\0").decode("ascii"))
        return kind, name, body

    def until(self, kind, name=None, good=lambda content: True):
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            got = self.next()
            if got[0] == kind and name in (None, got[1]) and good(got[2]):
                return got[2]
        raise AssertionError(f"no {kind} {name}")

    def numbers(self, name):
        content = self.until("STRING" if name == "PalpateForce" else "TRANSFORM", name)
        return [float(x) for x in content.split()] if isinstance(content, str) else list(content)

    def state(self, word):
        return self.until("STRING", "PalpateStatus",
                          lambda text: json.loads(text)["hands"][0]["state"] == word)

    def ended(self):
        """Returns True if the server closes the connection."""
        end = time.monotonic() + PATIENCE / 2
        try:
            while time.monotonic() < end:
                self.next()
            return False
        except (EOFError, ConnectionError):
            return True
        except socket.timeout:
            return False


class Run:
    """A process of palpate feel with an OpenIGTLink server."""

    def __init__(self, folder, *more, device="igtl", scene="scene.json"):
        self.lines = []   # all lines
        self.errors = []  # lines since a test emptied this list
        self.child = subprocess.Popen(
            [PALPATE, "feel", str(folder / scene), "--realtime", "--igtl", "0", "--json",
             "--device", device, *map(str, more)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, stdin=subprocess.DEVNULL)
        self.reader = threading.Thread(target=self.read, daemon=True)
        self.reader.start()
        where = self.said(r"waiting for 3D Slicer at 127\.0\.0\.1:(\d+)")
        self.port = int(where.group(1))

    def read(self):
        for line in self.child.stderr:
            self.lines.append(line)
            self.errors.append(line)

    def said(self, pattern):
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            found = re.search(pattern, "".join(self.errors))
            if found:
                return found
            time.sleep(0.02)
        raise AssertionError(f"{pattern}: {self.errors}")

    def end(self):
        """Ends the run. Returns its summary."""
        self.child.send_signal(signal.SIGINT)
        out = self.child.stdout.read()
        self.status = self.child.wait(PATIENCE)
        self.reader.join()
        return json.loads(out)

    def kill(self):
        if self.child.poll() is None:
            self.child.kill()
        self.child.wait()
        self.reader.join()
        self.child.stdout.close()
        self.child.stderr.close()


def in_file(x, y, z):
    """Converts from W [m] to the file [mm]."""
    x, y, z = (a - b for a, b in zip((x, y, z), SHIFT))
    return (y / SCALE, -x / SCALE, z / SCALE)


class IgtlTest(unittest.TestCase):
    HOST = True

    @classmethod
    def setUpClass(cls):
        cls.holder = tempfile.TemporaryDirectory()
        cls.folder = Path(cls.holder.name)
        made = process.run([PALPATE, "make", "two-bodies", str(cls.folder / "two.vdb"),
                               "--voxel", "3", "--json"], capture_output=True, text=True,
                              check=True)
        del made
        half = 2 ** -0.5
        scene = {"palpate": 1, "coupling": {"stiffness": 500},
                 "volumes": {"head": {"file": "two.vdb", "grid": "bowl",
                                      "place": {"scale": SCALE, "rotation_wxyz": [half, 0, 0, half],
                                                "translate": SHIFT}}},
                 "modes": [{"name": "wall", "mode": "isosurface", "of": "head", "value": 5,
                            "solid": "above", "strength": 3}]}
        (cls.folder / "scene.json").write_text(json.dumps(scene))

    @classmethod
    def tearDownClass(cls):
        cls.holder.cleanup()

    def setUp(self):
        self.runs = []

    def start(self, *more, **how):
        run = Run(self.folder, *more, **how)
        self.runs.append(run)
        self.addCleanup(run.kill)
        return run

    def connect(self, run):
        client = Client(run.port)
        self.addCleanup(client.socket.close)
        return client

    def press(self, client, x):
        """Moves the hand to a position on the file's x axis. Returns hand, proxy and force once the hand rests."""
        client.send("TRANSFORM", "PalpateSteer", transform(x, 0, 0))
        begin = time.time()
        last, end = None, time.monotonic() + PATIENCE
        # Skips messages from before the request.
        while not last or client.stamp < begin + 0.4:
            last = client.numbers("PalpateHand")
        while time.monotonic() < end:
            hand = client.numbers("PalpateHand")
            still = last and max(abs(a - b) for a, b in zip(hand, last)) < 0.02
            if still and abs(hand[1]) < 1:
                return hand, client.numbers("PalpateProxy"), client.numbers("PalpateForce")
            last = hand
        raise AssertionError(f"the hand does not come to rest: {last}")

    def test_sent_forces_and_positions_equal_the_trace(self):
        trace = self.folder / "trace.csv"
        # If the machine delays the loop, the force is cut, but returns.
        run = self.start("--trace", trace, "--reengage", "0.1", device="simulated")
        client = self.connect(run)
        told = []
        begin = time.monotonic()

        def pressed():
            return sum(any(map(float, got.split())) for _, name, got in told if name == "PalpateForce")

        while time.monotonic() < begin + 2:
            told.append(client.next())
        shown = sum(name == "PalpateHand" for _, name, _ in told)
        while pressed() <= 5 and time.monotonic() < begin + 10:
            told.append(client.next())
        summary = run.end()
        with open(trace, encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        hands = [got for kind, name, got in told if name == "PalpateHand"]
        proxies = [got for kind, name, got in told if name == "PalpateProxy"]
        forces = [got for kind, name, got in told if name == "PalpateForce"]
        self.assertLessEqual(set(summary["faults"]), {"late"})
        self.assertGreater(pressed(), 5)
        self.assertTrue(20 <= shown <= 66, shown)  # 30 per second; fewer on a busy machine
        ticks = {}
        for row in rows:
            probe = in_file(*(float(row["probe_" + a]) for a in "xyz"))
            ticks.setdefault(tuple(round(x, 2) for x in probe), []).append(row)
        for hand, proxy, force in zip(hands, proxies, forces):
            near = [row for dx in (-0.01, 0, 0.01)
                    for row in ticks.get((round(hand[0] + dx, 2), round(hand[1], 2),
                                          round(hand[2], 2)), [])]
            near = near or rows
            of = min(near, key=lambda row: sum(
                abs(a - b) for a, b in zip(hand + proxy, in_file(
                    *(float(row["probe_" + a]) for a in "xyz")) + in_file(
                        *(float(row["proxy_" + a]) for a in "xyz")))))
            for name, got in (("probe_", hand), ("proxy_", proxy)):
                for a, b in zip(got, in_file(*(float(of[name + a]) for a in "xyz"))):
                    self.assertAlmostEqual(a, b, delta=1e-4)
            fx, fy, fz = (float(of["force_" + a]) for a in "xyz")
            for a, b in zip(map(float, force.split()), (fy, -fx, fz)):
                self.assertAlmostEqual(a, b, delta=1e-4)
        self.assertEqual(summary["igtl"]["ended"], 0)
        self.assertIn("STATUS".lower(), " ".join(name.lower() for _, name, _ in told))

    def test_an_image_that_a_client_sends_acts_at_its_placement(self):
        run = self.start()
        client = self.connect(run)
        client.state("felt")
        deep = 6.0
        for at, how in ((1.0, {}), (5.0, {"big": True}), (-3.0, {"space": 2, "scalar": 10}),
                        (2.0, {"scalar": 11, "big": True}), (1.0, {"scalar": 3}),
                        (3.0, {"scalar": 6, "middle": (5.0, 0.0, 0.0)})):
            version = 2 if at == 5.0 else 1
            values = [int(v) for v in wall(at)] if how.get("scalar", 4) < 10 else wall(at)
            client.send("TRANSFORM", "PalpateSteer", transform(40, 0, 0))
            client.send("IMAGE", "head", image(values, SIZE, **how), version=version)
            run.said("image is active")
            run.errors.clear()
            where = at + how.get("middle", (0,))[0]
            which = f"{where}: {how}"
            hand, proxy, force = self.press(client, where - deep)
            self.assertAlmostEqual(proxy[0], where, delta=0.15, msg=which)
            self.assertLess(hand[0], where - 1, which)
            # k (proxy - hand) [N]
            self.assertAlmostEqual(force[0], 500 * SCALE * (proxy[0] - hand[0]), delta=0.05, msg=which)
            self.assertGreater(force[0], 0.5, which)
        self.assertEqual(run.end()["igtl"]["images"], 6)

    def test_a_client_can_cut_the_force_before_the_run_begins_and_while_an_image_loads(self):
        # A cut works before the run has begun.
        run = self.start()
        early = self.connect(run)
        early.send("STRING", "PalpateCommand", string("cut"))
        self.assertEqual(early.until("STATUS")[0], 1)
        early.state("cut")
        self.assertEqual(run.end()["faults"], {"stopped": 1})
        # A cut does not wait for another client's image.
        run = self.start()
        slow, client = self.connect(run), self.connect(run)
        client.state("felt")
        values = [int(v) for v in wall(1)]
        slow.socket.sendall(message("IMAGE", "head", image(values, SIZE))[:200])
        time.sleep(0.3)
        client.send("IMAGE", "head", image(values, SIZE))
        client.send("STRING", "PalpateCommand", string("cut"))
        self.assertEqual(client.until("STATUS"),
                         (6, "IMAGE head: another image is still loading: send this image again"))
        self.assertEqual(client.until("STATUS")[0], 1)
        client.state("cut")
        run.end()

    def test_only_the_user_at_the_arm_can_clear_a_client_s_cut(self):
        run = self.start()
        client = self.connect(run)
        other = self.connect(run)
        client.send("IMAGE", "head", image([int(v) for v in wall(1)], SIZE))
        run.said("image is active")
        self.press(client, 8)
        self.assertGreater(self.press(client, -6)[2][0], 0.5)
        client.send("STRING", "PalpateCommand", string("cut"))
        self.assertEqual(client.until("STATUS")[0], 1)
        told = json.loads(other.state("cut"))
        self.assertIn("switched off", told["hands"][0]["fault"])
        self.assertEqual(self.press(client, -6)[2], [0, 0, 0])
        for word, code in (("clear", 5), ("Clear", 12), ("", 12), ("cut\n", 12)):
            client.send("STRING", "PalpateCommand", string(word))
            self.assertEqual(client.until("STATUS")[0], code, word)
        self.press(client, 8)
        self.assertEqual(self.press(client, -6)[2], [0, 0, 0])
        client.send("GET_STATUS", "x", b"")
        client.until("STATUS")
        told = json.loads(client.until("STRING", "PalpateStatus"))
        self.assertEqual(told["hands"][0]["state"], "cut")
        run.end()
        self.assertEqual(run.status, 130)

    def test_an_invalid_message_ends_only_its_own_connection(self):
        run = self.start()
        good = self.connect(run)
        hostile = {
            "a bad checksum": message("TRANSFORM", "PalpateSteer", transform(1, 2, 3), crc=1),
            "a bad checksum of an unknown message": message("POINT", "x", b"1234", crc=1),
            "2^63 bytes": message("IMAGE", "head", b"", size=2**63),
            "2^64 - 1 bytes": message("POINT", "x", b"", size=2**64 - 1),
            "a long string": message("STRING", "x", b"", size=2**20),
            "a future version": message("TRANSFORM", "x", transform(0, 0, 0), version=9),
            "another protocol": b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" + b" " * 40,
            "a short transform": message("TRANSFORM", "x", b"1234"),
            "a string whose length exceeds the message": message("STRING", "x", b"\0\x03\0\x09abc"),
            "a position of NaN": message("TRANSFORM", "PalpateSteer", transform(float("nan"), 0, 0)),
            "an infinite position": message("TRANSFORM", "PalpateSteer", transform(0, float("inf"), 0)),
            "a position that is too far away": message("TRANSFORM", "PalpateSteer", transform(0, 1e30, 0)),
            "an extended header longer than the message": message("TRANSFORM", "PalpateSteer", struct.pack(
                ">HHIi", 60000, 60000, 2**32 - 1, 0) + transform(0, 0, 0)).replace(
                    b"\0\1TRANS", b"\0\2TRANS", 1),
        }
        for what, data in hostile.items():
            bad = self.connect(run)
            bad.socket.sendall(data)
            self.assertTrue(bad.ended(), what)
            self.assertNotIn("head: the image", "".join(run.errors), what)
        good.until("TRANSFORM", "PalpateHand")
        summary = run.end()
        self.assertEqual(summary["igtl"]["ended"], len(hostile))
        self.assertLess(summary["late_ticks"], 20)
        lines = [line for line in run.errors if "igtl: 127" in line and "is closed" in line]
        self.assertTrue(lines)
        self.assertLess(len(lines), len(hostile))  # at most one line per second; it counts the lines not shown
        counted = re.findall(r"\((\d+) earlier lines not shown\)", "".join(lines))
        self.assertEqual(len(lines) + sum(map(int, counted)), len(hostile))  # no closed connection is missing
        for line in lines:
            self.assertTrue(line.startswith("palpate: "), line)

    def test_a_refused_image_is_answered_and_its_connection_continues(self):
        run = self.start()
        client, other = self.connect(run), self.connect(run)
        voxels = [0] * (SIZE[0] * SIZE[1] * SIZE[2])
        not_finite = wall(0)
        not_finite[7] = float("nan")
        refused = {
            "an image without a header": message("IMAGE", "head", b"12"),
            "an image with a missing value": message("IMAGE", "head", image(voxels[:-1], SIZE)),
            "an image with an additional value": message("IMAGE", "head", image(voxels + [1], SIZE)),
            "a part of an image": message("IMAGE", "head", image(voxels, SIZE, part=(1, 1, 1))),
            "a flat image": message("IMAGE", "head", image(voxels, SIZE, spacing=0.0)),
            "an image at NaN": message("IMAGE", "head",
                                        image(voxels, SIZE, middle=(float("nan"), 0, 0))),
            "an empty image": message("IMAGE", "head", image([], (0, 12, 12))),
            "a large image without values": message("IMAGE", "head", image([], (65535,) * 3)),
            "two components": message("IMAGE", "head", image(voxels, SIZE, components=2)),
            # The image's values are checked when the scene is built; the previous scene continues.
            "a value that is not finite": message("IMAGE", "head", image(not_finite, SIZE, scalar=10)),
        }
        for what, data in refused.items():
            client.socket.sendall(data)
            code, why = client.until("STATUS")
            self.assertEqual(code, 10, what)
            self.assertRegex(why, "head.*: .*: ", what)
            self.assertNotIn("head: the image is active", "".join(run.errors), what)
        # Only the sender gets the answer; all clients get the result of the last image.
        told = json.loads(client.until("STRING", "PalpateStatus", lambda text: json.loads(text)["image"]))
        self.assertIn("are NaN", told["image"])
        other.send("GET_STATUS", "x", b"")
        self.assertEqual(other.until("STATUS")[0], 1)
        client.send("IMAGE", "head", image([int(v) for v in wall(1)], SIZE))
        run.said("image is active")
        self.assertEqual(run.end()["igtl"]["ended"], 0)

    def test_unknown_messages_are_answered_or_skipped(self):
        run = self.start("--record", self.folder / "felt.rec", device="simulated")
        client = self.connect(run)
        client.send("POINT", "x", b"1" * 5000)
        client.send("GET_STATUS", "x", b"")
        self.assertEqual(client.until("STATUS")[0], 1)
        client.send("GET_CAPABIL", "x", b"")
        kinds = client.until("CAPABILITY")
        self.assertEqual(kinds[:12].rstrip(b"\0"), b"TRANSFORM")
        self.assertEqual(len(kinds) % 12, 0)
        for kind in ("GET_IMAGE", "STT_TDATA", "STP_TDATA"):
            client.send(kind, "x", b"")
            self.assertEqual(client.until("STATUS")[0], 12, kind)
        # A client cannot lead this run's hand, and cannot send images to a recorded run.
        client.send("TRANSFORM", "PalpateSteer", transform(0, 0, 0))
        self.assertEqual(client.until("STATUS")[0], 15)
        client.send("IMAGE", "head", image([0], (1, 1, 1)))
        self.assertEqual(client.until("STATUS")[0], 15)
        # Names can be arbitrary. A name of 20 bytes has no terminator.
        for name in (b"\xff\x1b[2J\n" * 3, b"12345678901234567890"):
            client.send("TRANSFORM", name, transform(0, 0, 0))
        run.end()
        run = self.start()
        client = self.connect(run)
        client.send("IMAGE", b"\x1b[2J", image([0], (1, 1, 1)))
        self.assertEqual(client.until("STATUS")[0], 4)
        self.assertNotIn("\x1b", "".join(run.errors))
        client.until("TRANSFORM", "PalpateHand")
        self.assertEqual(run.end()["igtl"]["ended"], 0)

    def test_a_slow_client_does_not_block_another_client(self):
        # The hand rests far from surfaces, so contacts cannot make ticks late.
        rest = self.folder / "rest.csv"
        rest.write_text("t,x,y,z\n0,1,1,1\n60,1,1,1\n")
        run = self.start("--igtl-rate", "100", device=f"path:{rest}")
        deaf = socket.socket()
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        self.addCleanup(deaf.close)
        deaf.connect(("127.0.0.1", run.port))
        # This client does not read the answers.
        deaf.sendall(message("GET_STATUS", "x", b"") * 2000)
        loris = self.connect(run)
        loris.socket.sendall(message("TRANSFORM", "PalpateSteer", transform(0, 0, 0))[:30])
        good = self.connect(run)
        begin = time.monotonic()
        hands = 0
        while time.monotonic() < begin + 7:
            hands += good.next()[1] == "PalpateHand"
        self.assertGreater(hands, 150)
        self.assertTrue(loris.ended())
        summary = run.end()
        self.assertEqual(summary["igtl"]["ended"], 2)  # the clients `deaf` and `loris`
        self.assertGreater(summary["igtl"]["skipped"], 100)
        self.assertEqual(summary["faults"], {})
        self.assertLess(summary["late_ticks"], 0.005 * summary["ticks"])

    def test_connections_that_send_nothing_do_not_block_another_client_s_cut(self):
        run = self.start(device="simulated")
        silent = [self.connect(run) for _ in range(4)]
        silent[0].until("TRANSFORM", "PalpateProxy")
        # If too many clients wait, the server closes those that have waited longest.
        waiting = [self.connect(run) for _ in range(20)]
        self.assertTrue(all(one.ended() for one in waiting[:4]))
        late = waiting[-1]
        late.send("TRANSFORM", "PalpateSteer", transform(0, 0, 0))
        late.send("STRING", "PalpateCommand", string("cut"))
        # A waiting client gets only answers. Because a late tick also cuts the force, the answer's code shows whether
        # the client's cut came first.
        kind, _, (code, _) = late.next()
        self.assertEqual((kind, code), ("STATUS", 1))
        self.assertEqual(json.loads(silent[0].state("cut"))["hands"][0]["state"], "cut")
        # When a client leaves, the server serves the one that has waited longest.
        silent[1].socket.close()
        waiting[4].until("TRANSFORM", "PalpateProxy")
        run.end()

    def test_the_server_survives_thousands_of_connections(self):
        run = self.start(device="simulated")
        good = self.connect(run)
        good.next()
        for _ in range(2000):
            with socket.socket() as one:
                one.connect(("127.0.0.1", run.port))
        many = [Client(run.port) for _ in range(20)]
        time.sleep(0.3)
        for one in many:
            self.addCleanup(one.socket.close)
        good.until("TRANSFORM", "PalpateProxy")
        summary = run.end()
        self.assertGreaterEqual(summary["igtl"]["connections"], 2000)
        self.assertGreaterEqual(summary["igtl"]["refused"], 17)

    def test_invalid_options_of_the_igtl_server_are_refused(self):
        def refused(*words, says):
            done, line = refusal(self, self.folder, lambda: process.run(
                [PALPATE, *map(str, words)], capture_output=True, text=True, timeout=60))
            self.assertEqual(done.returncode, 2)
            self.assertIn(says, line)
        scene = self.folder / "scene.json"
        refused("feel", scene, "--igtl", "18944", says="add --realtime")
        refused("feel", scene, "--igtl-rate", "50", says="add --igtl")
        refused("feel", scene, "--device", "igtl", "--realtime", says="add --igtl")
        for place in ("", "x", "65536", "-1", ":5", "1.2.3.4:", "18944 "):
            if place:
                refused("feel", scene, "--realtime", "--igtl", place, says="is not a port")
        refused("feel", scene, "--realtime", "--igtl", "nowhere:5", says="not a numeric address")
        refused("feel", scene, "--realtime", "--igtl", "5", "--igtl-rate", "101", says="1 to 100")
        with socket.socket() as taken:
            taken.bind(("127.0.0.1", 0))
            taken.listen()
            refused("feel", scene, "--realtime", "--igtl", taken.getsockname()[1], says="in use")


if __name__ == "__main__":
    suite.main(sys.argv[2:])
