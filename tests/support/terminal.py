"""Runs a program in a terminal."""
import fcntl
import os
import pty
import re
import select
import signal
import subprocess
import termios
import time


class Terminal:
    """Runs `words` with stdin and stderr in a terminal, so that Ctrl-C reaches the program. `drawn` is the text that
    the terminal shows."""

    def __init__(self, words, folder):
        self.own, its = pty.openpty()
        self.child = subprocess.Popen(
            list(map(str, words)), cwd=folder, stdin=its, stdout=subprocess.DEVNULL, stderr=its,
            start_new_session=True, preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0))
        os.close(its)
        self.drawn = ""

    def look(self, seconds):
        """Waits for output for up to `seconds` and reads it. Returns False if the program has ended."""
        if not select.select([self.own], [], [], seconds)[0]:
            return True
        try:
            self.drawn += os.read(self.own, 65536).decode()
        except OSError:  # the program has ended
            return False
        return True

    def until(self, pattern, seconds=120):
        """Returns True once the output matches the regular expression. If the time runs out or the program ends
        before, kills the program and returns False."""
        end = time.monotonic() + seconds
        while not re.search(pattern, self.drawn):
            if time.monotonic() > end or not self.look(0.1):
                os.killpg(self.child.pid, signal.SIGKILL)
                self.child.wait()
                return False
        return True

    def press(self, key):
        os.write(self.own, key)

    def ended(self, seconds=120):
        """Returns the program's exit status, and the time that it took to end [s]."""
        begin = time.monotonic()
        while self.look(0.1) and time.monotonic() < begin + seconds:
            pass
        status = self.child.wait(seconds)
        os.close(self.own)
        return status, time.monotonic() - begin
