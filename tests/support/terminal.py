"""A program at a terminal, as its user has it."""
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
    """Runs `words` with standard error and Ctrl-C at a terminal; what it draws is `drawn`."""

    def __init__(self, words, folder):
        self.own, its = pty.openpty()
        self.child = subprocess.Popen(
            list(map(str, words)), cwd=folder, stdin=its, stdout=subprocess.DEVNULL, stderr=its,
            start_new_session=True, preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0))
        os.close(its)
        self.drawn = ""

    def look(self, seconds):
        """Reads what is there within so long; False once it has ended."""
        if not select.select([self.own], [], [], seconds)[0]:
            return True
        try:
            self.drawn += os.read(self.own, 65536).decode()
        except OSError:  # it has ended
            return False
        return True

    def until(self, pattern, seconds=120):
        """Whether it draws what the regular expression matches. Where it does not, it is ended."""
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
        """Its status, and how long it took to end."""
        begin = time.monotonic()
        while self.look(0.1) and time.monotonic() < begin + seconds:
            pass
        status = self.child.wait(seconds)
        os.close(self.own)
        return status, time.monotonic() - begin
