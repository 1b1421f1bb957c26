#!/usr/bin/env python3
"""The kill table: kill_test.py VICTIM. If a program ends, is stopped or hangs, its device has zero force within 25 ms,
and keeps it. Prints the table.

A victim presses its hand a second after its start, so the victims of the next tests start ahead of their tests.

If permitted, this program and its victim have a priority above all programs without real-time priority, as on an
arm's machine. Otherwise the test measures the time from the last force to zero force, and limits the number of forces
after the signal or action."""
import contextlib
import mmap
import os
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
import unittest
from collections import Counter
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import suite  # noqa: E402

VICTIM = sys.argv[1]
LIMIT = 0.025
MOST_FORCES = 25   # at 1 kHz
SIGNALS = ["SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGSEGV", "SIGBUS", "SIGABRT", "SIGXCPU",
           "SIGSTOP", "SIGTSTP", "SIGKILL"]
OWN = ["exception", "exit", "return", "hang"]
ACTIONS = {"a_write_of_40_ms_followed_by_one_that_hangs_ends_with_zero_force": "slow",
           "a_blocked_device_does_not_delay_another": "blocked",
           "the_guardian_sends_zero_force_again_while_the_device_s_queue_is_full": "fast"}   # by test
SO_TIMESTAMP = 29   # Linux; Python has no name for it
QUIET = 120.0      # [s]; longest time until a hand presses, if the machine does not stall
LONGEST = 600.0    # [s]; longest time until a hand presses, in all cases
AHEAD = 2          # number of victims that start ahead
PRESSES = 1.3      # [s]; a victim of this age presses its hand
TABLE = []
try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(5))   # victims inherit this priority
    ABOVE_OTHERS = True
except PermissionError:
    ABOVE_OTHERS = False
# State of the program after the signal or action. A stop or a hang does not end the program. All others end the
# program as they would without a guardian.
AFTERWARDS = {name: f"ended with {-getattr(signal, name)}" for name in SIGNALS}
AFTERWARDS |= dict.fromkeys(["SIGSTOP", "SIGTSTP", "hang"], "lives")
AFTERWARDS |= {"exception": f"ended with {-signal.SIGABRT}", "exit": "ended with 0",
               "return": "ended with 0"}


def newtons(data):
    return sum(x * x for x in struct.unpack("3d", data)) ** 0.5


def stamp(ancillary):
    """Returns the time at which the kernel received a datagram [s]."""
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == SO_TIMESTAMP:
            seconds, micro = struct.unpack("ll", data)
            return seconds + 1e-6 * micro
    return time.time()


class Witness:
    """A process that only sleeps, if permitted with a higher priority than the victim. If it wakes late, the machine
    has stalled."""
    STILL = 0.01   # [s]; half of a guardian's timeout

    def __init__(self):
        self.page = mmap.mmap(-1, 8)
        test = os.getpid()
        if os.fork() != 0:
            return
        if ABOVE_OTHERS:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(90))
        before = time.monotonic()
        while os.getppid() == test:
            time.sleep(0.001)
            now = time.monotonic()
            if now - before > self.STILL:
                self.page[:8] = struct.pack("q", self.times() + 1)
            before = now
        os._exit(0)

    def times(self):
        """Returns the number of times that the process woke late."""
        return struct.unpack("q", self.page[:8])[0]


class Victim:
    """A program that presses a hand, and the forces that its device received."""

    def __init__(self, action):
        self.folder = tempfile.TemporaryDirectory()
        path = str(Path(self.folder.name) / "device")
        self.device = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.device.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self.device.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMP, 1)
        self.device.bind(path)
        self.faults = open(Path(self.folder.name) / "faults", "w+", encoding="utf-8")
        self.program = subprocess.Popen([VICTIM, path, action], stdin=subprocess.PIPE,
                                        stdout=subprocess.PIPE, stderr=self.faults,
                                        start_new_session=True)
        self.guardian = int(self.program.stdout.readline().split()[1])
        self.begun = time.monotonic()
        self.seen = []   # (time, force)

    def listen(self, seconds):
        """Receives forces for this time [s]."""
        end = time.time() + seconds
        while time.time() < end:
            self.device.settimeout(max(1e-3, end - time.time()))
            try:
                data, ancillary, _, _ = self.device.recvmsg(24, 64)
            except TimeoutError:
                break
            self.seen.append((stamp(ancillary), newtons(data)))

    def press(self):
        # If the host pauses the machine's cores, the loop may cut the force. So the time limit QUIET starts again after
        # each pause.
        begin = time.time()
        still = WITNESS.times()
        left = QUIET
        while left > 0 and time.time() < begin + LONGEST:
            before = WITNESS.times()
            self.listen(0.05)
            left = left - 0.05 if WITNESS.times() == before else QUIET
            if self.seen and self.seen[-1][1] > 1.0:
                self.listen(0.05)
                return
        self.faults.seek(0)
        raise AssertionError(f"no force above 1 N: {len(self.seen)} forces, {self.seen[-1:]}, "
                             f"the machine stalled {WITNESS.times() - still} times, "
                             f"{Counter(self.faults.read().splitlines())}, {self.program.poll()}")

    def close(self):
        for pid in (self.program.pid, self.guardian):
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
        self.program.communicate()
        self.device.close()
        self.faults.close()
        self.folder.cleanup()


class Ahead:
    """Victims that are started before their tests."""

    def __init__(self):
        self.victims = []   # (action, victim)

    def start(self, actions):
        """Starts victims for the next tests, unless they are already started."""
        waiting = [action for action, _ in self.victims]
        for action in actions:
            if action in waiting:
                waiting.remove(action)
            elif action != "fast":   # a "fast" victim presses its hand after 0.1 s
                self.victims.append((action, Victim(action)))

    def take(self, action):
        """Returns a victim that presses its hand or will do so soon."""
        for i, (of, victim) in enumerate(self.victims):
            if of == action:
                del self.victims[i]
                if time.monotonic() - victim.begun < PRESSES:
                    return victim
                victim.listen(0.05)
                if victim.seen and victim.seen[-1][1] > 1.0:
                    return victim
                # The victim's loop was late after the hand had pressed, so the loop has cut the force.
                victim.close()
                break
        return Victim(action)

    def close(self):
        while self.victims:
            self.victims.pop()[1].close()


STARTED = Ahead()


def action_of(test):
    """Returns the victim's action for a test."""
    action = test.removeprefix("test_")
    return ACTIONS.get(action, action if action in OWN else "nothing")


def late(row):
    """Returns the time from the signal or action, without priority from the last force, until the force stays zero [s],
    and the state of the program. The time is infinite if the force stays or if too many forces follow."""
    victim = STARTED.take(row if row in OWN else "nothing")
    try:
        victim.press()
        blow = time.time()
        if row in OWN:
            victim.program.stdin.write(b"now\n")
            victim.program.stdin.flush()
        else:
            victim.program.send_signal(getattr(signal, row))
        victim.listen(0.3)
        after = [(t - blow, f) for t, f in victim.seen if t >= blow]
        if not after or after[-1][1] != 0.0:
            return float("inf"), "force"
        pressed = [t - blow for t, f in victim.seen if f != 0.0]
        zero = next(t for t, f in after if f == 0.0 and t > pressed[-1])
        state = None
        if AFTERWARDS[row] != "lives":
            with contextlib.suppress(subprocess.TimeoutExpired):
                state = victim.program.wait(5)
        if not ABOVE_OTHERS:
            if sum(t > 0.0 for t in pressed) > MOST_FORCES:
                return float("inf"), "forces"
            zero -= pressed[-1]
        return zero, "lives" if state is None else f"ended with {state}"
    finally:
        victim.close()


class KillTable(unittest.TestCase):
    HOST = True

    def setUp(self):
        names = unittest.defaultTestLoader.getTestCaseNames(type(self))
        at = names.index(self._testMethodName)
        STARTED.start(action_of(name) for name in names[at:at + 1 + AHEAD])

    @classmethod
    def tearDownClass(cls):
        STARTED.close()
        print("\ncause      | zero force after | then")
        for row, seconds, state in TABLE:
            print(f"{row:10} | {1e3 * seconds:7.2f} ms       | {state}")
        TABLE.clear()

    def check(self, row):
        seconds, state = late(row)
        TABLE.append((row, seconds, state))
        self.assertLessEqual(seconds, LIMIT, row)
        self.assertEqual(state, AFTERWARDS[row], row)

    def test_a_guardian_process_ends_after_its_program(self):
        victim = STARTED.take("nothing")
        victim.press()
        victim.program.kill()
        victim.program.wait()
        end = time.time() + 5
        while time.time() < end and os.path.exists(f"/proc/{victim.guardian}"):
            status = Path(f"/proc/{victim.guardian}/stat")
            if not status.exists() or status.read_text().split(") ")[1][0] == "Z":
                break
            time.sleep(0.01)
        else:
            self.fail("the guardian still runs 5 s after its program ended")
        victim.close()

    def ends_without_force(self, victim, seconds):
        """Checks that the last force is zero, and all forces in the second half of the time. Returns the time until the
        last force that was not zero [s]."""
        start = time.time()
        victim.listen(seconds)
        late = [f for t, f in victim.seen if t > start + seconds / 2]
        self.assertEqual(victim.seen[-1][1], 0.0)
        self.assertEqual(max(late, default=0.0), 0.0)
        return max((t for t, f in victim.seen if f != 0.0), default=start) - start

    def unguarded(self, victim):
        """Returns the longest permitted time of a force without a guardian [s]."""
        return 0.2 if os.sched_getscheduler(victim.guardian) == os.SCHED_FIFO else 0.45

    def notices(self, blow, seconds):
        victim = STARTED.take("nothing")
        try:
            victim.press()
            limit = self.unguarded(victim)
            os.kill(victim.guardian, blow)
            self.assertLess(self.ends_without_force(victim, seconds), limit)
            self.assertIsNone(victim.program.poll())
        finally:
            victim.close()

    def test_killing_the_guardian_process_ends_the_force_but_not_the_program(self):
        self.notices(signal.SIGKILL, 2.0)

    def test_stopping_the_guardian_process_ends_the_force_but_not_the_program(self):
        self.notices(signal.SIGSTOP, 1.0)

    def test_a_stopped_guardian_is_resumed_and_still_ends_the_force(self):
        victim = STARTED.take("nothing")
        try:
            victim.press()
            os.kill(victim.guardian, signal.SIGSTOP)
            victim.program.send_signal(signal.SIGSTOP)
            self.ends_without_force(victim, 0.3)
        finally:
            victim.close()

    def test_a_write_of_40_ms_followed_by_one_that_hangs_ends_with_zero_force(self):
        victim = STARTED.take("slow")
        try:
            victim.press()
            victim.program.stdin.write(b"now\n")
            victim.program.stdin.flush()
            self.ends_without_force(victim, 0.4)
        finally:
            victim.close()

    def test_a_resumed_program_has_no_force(self):
        victim = STARTED.take("nothing")
        try:
            victim.press()
            victim.program.send_signal(signal.SIGSTOP)
            victim.listen(0.3)
            victim.program.send_signal(signal.SIGCONT)
            self.ends_without_force(victim, 0.6)
            self.assertIsNone(victim.program.poll())
        finally:
            victim.close()

    def test_a_blocked_device_does_not_delay_another(self):
        STARTED.start(["blocked", "blocked"])
        for kill in (True, False):
            victim = STARTED.take("blocked")
            try:
                victim.press()
                victim.program.send_signal(signal.SIGKILL if kill else signal.SIGSTOP)
                self.ends_without_force(victim, 0.3)
            finally:
                victim.close()

    def test_the_guardian_sends_zero_force_again_while_the_device_s_queue_is_full(self):
        # The test does not read for a while, so the device's queue is full of forces when the program is killed.
        victim = Victim("fast")
        try:
            victim.press()
            time.sleep(0.5)
            victim.program.kill()
            victim.listen(0.5)
            self.assertEqual(victim.seen[-1][1], 0.0)
        finally:
            victim.close()

    def test_without_a_guardian_a_killed_program_leaves_its_force(self):
        # As a control for the table, the test kills the guardian first.
        victim = STARTED.take("nothing")
        try:
            victim.press()
            os.kill(victim.guardian, signal.SIGKILL)
            victim.program.send_signal(signal.SIGKILL)
            victim.listen(0.2)
            self.assertGreater(victim.seen[-1][1], 1.0)
        finally:
            victim.close()


for name in SIGNALS + OWN:
    setattr(KillTable, "test_" + name, lambda self, row=name: self.check(row))


WITNESS = Witness()

if __name__ == "__main__":
    suite.main(sys.argv[2:])
