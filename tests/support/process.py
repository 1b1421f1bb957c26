"""Runs programs as subprocess.run does. A run of palpate is a fork of a process that has loaded its libraries.

The fork saves the time that loading takes (tests/support/fork_server.cpp). PALPATE_FORK_LIBRARY names the libraries to
preload. Without it, or with options that a fork cannot have, a new process is started. A fork of palpate-import runs
`palpate import`. All forks of a program share one address layout, and their libraries are not unloaded at the end. So
tests of layout or unloading use subprocess.run."""
import array
import atexit
import contextlib
import os
import selectors
import signal
import socket
import struct
import subprocess
import threading
import time
from pathlib import Path

LIBRARY = os.environ.get("PALPATE_FORK_LIBRARY")
FORKED = {"palpate", "palpate-import", "palpate-import-light"}
OPTIONS = {"input", "capture_output", "text", "timeout", "check", "env", "cwd"}
servers = {}


class Server:
    """A program that is stopped before its main()."""
    def __init__(self, program):
        self.socket, its = socket.socketpair()
        self.lock = threading.Lock()
        self.process = subprocess.Popen(  # pylint: disable=consider-using-with
            [program], stdin=subprocess.DEVNULL, pass_fds=[its.fileno()],
            env=dict(os.environ, LD_PRELOAD=LIBRARY, PALPATE_FORK_SERVER=str(its.fileno())))
        its.close()
        atexit.register(self.close)

    def close(self):
        self.socket.close()
        self.process.wait()

    def receive_number(self):
        return struct.unpack("i", self.socket.recv(4, socket.MSG_WAITALL))[0]

    def start(self, words, environment, folder, streams):
        """Starts a process. Returns its id. The next number that the server sends is the process's wait status."""
        strings = [folder, *words, *(name + b"=" + value for name, value in environment.items())]
        text = b"".join(string + b"\0" for string in strings)
        rights = array.array("i", streams)
        self.socket.sendmsg([struct.pack("II", len(text), len(words))],
                            [(socket.SOL_SOCKET, socket.SCM_RIGHTS, rights)])
        self.socket.sendall(text)
        return self.receive_number()


def exchange(given, ours, deadline):
    """Writes `given` to ours[0]. Returns all data from ours[1] and ours[2]; None at the deadline."""
    taken = {ours[1]: [], ours[2]: []}
    with selectors.DefaultSelector() as selector:
        for stream in taken:
            selector.register(stream, selectors.EVENT_READ)
        if ours[0] is not None:
            os.set_blocking(ours[0], False)
            selector.register(ours[0], selectors.EVENT_WRITE)
        while selector.get_map():
            events = selector.select(None if deadline is None else max(0, deadline - time.monotonic()))
            if not events and deadline is not None and time.monotonic() >= deadline:
                return None
            for key, _ in events:
                if key.fd == ours[0]:
                    try:
                        given = given[os.write(key.fd, given[:1 << 16]):]
                    except BrokenPipeError:
                        given = b""
                    if not given:
                        selector.unregister(key.fd)
                        os.close(key.fd)
                        ours[0] = None
                elif data := os.read(key.fd, 1 << 16):
                    taken[key.fd].append(data)
                else:
                    selector.unregister(key.fd)
    return [b"".join(taken[stream]) for stream in (ours[1], ours[2])]


def run_forked(server, words, how):
    given = how.get("input")
    if how.get("text") and given is not None:
        given = given.encode()
    pairs = [os.pipe(), os.pipe(), os.pipe()]
    if given is None:
        its = [os.dup(0), pairs[1][1], pairs[2][1]]
        for end in pairs[0]:
            os.close(end)
        ours = [None, pairs[1][0], pairs[2][0]]
    else:
        its = [pairs[0][0], pairs[1][1], pairs[2][1]]
        ours = [pairs[0][1], pairs[1][0], pairs[2][0]]
    environment = how.get("env") or os.environ
    environment = {os.fsencode(name): os.fsencode(value) for name, value in environment.items()}
    folder = os.fsencode(os.path.abspath(how.get("cwd") or "."))
    limit = how.get("timeout")
    deadline = None if limit is None else time.monotonic() + limit
    with server.lock:
        child = server.start(words, environment, folder, its)
        for end in its:
            os.close(end)
        taken = exchange(given, ours, deadline)
        server.socket.settimeout(None if deadline is None else max(0.001, deadline - time.monotonic()))
        try:
            status = server.receive_number()
        except TimeoutError:
            taken = None
            server.socket.settimeout(None)
            with contextlib.suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
            status = server.receive_number()
        status = os.waitstatus_to_exitcode(status)
    for end in filter(None, ours):
        os.close(end)
    if taken is None:
        raise subprocess.TimeoutExpired(words, limit)
    if how.get("text"):
        taken = [data.decode().replace("\r\n", "\n").replace("\r", "\n") for data in taken]
    done = subprocess.CompletedProcess(words, status, *taken)
    if how.get("check"):
        done.check_returncode()
    return done


def at_start(environment):
    """Returns the variables that libraries read before main()."""
    return {name: value for name, value in environment.items()
            if str(name).startswith(("ASAN_", "GLIBC_", "LD_", "LSAN_", "MALLOC_", "OMP_", "TBB_", "UBSAN_"))}


def run(words, **how):
    words = [os.fsencode(word) for word in words]
    program = Path(os.fsdecode(words[0]))
    if (not LIBRARY or set(how) - OPTIONS or not how.get("capture_output") or program.name not in FORKED
            or at_start(how.get("env") or {}) != at_start(os.environ if how.get("env") else {})
            or any(b"\0" in word for word in words)):
        return subprocess.run(words, **how)  # pylint: disable=subprocess-run-check
    program = program.resolve()
    if program.name == "palpate" and words[1:2] == [b"import"]:
        other = program.with_name("palpate-import")
        if other.exists():
            program, words = other, [b"palpate-import", *words[2:]]
    if program not in servers:
        servers[program] = Server(program)
    return run_forked(servers[program], words, how)
