"""Makes a folder with the program, whose drawing scripts run in forks of one process that has imported matplotlib.

    fork = drawing.Fork(cleanup, BIN)    fork.folder holds a copy of the program in BIN, and a stand-in for each script
    fork.add(NAME, SCRIPT)               adds a stand-in for another Python script, and returns its path

The import is slow, so the forks share it. A fork has its own memory, files and status, and runs the script from its
file."""
import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

PYTHON = "/usr/bin/python3"  # the scripts' interpreter
SCRIPTS = ("feel_picture.py", "trace_picture.py")
# A stand-in sends its descriptors, folder and arguments to the server. It ends with the fork's status.
STAND_IN = """#!{python} -IS
import os, socket, sys
server = socket.socket(socket.AF_UNIX)
server.connect({socket!r})
files = [file for file in range(32) if file != server.fileno() and os.path.exists(f"/proc/self/fd/{{file}}")]
words = [",".join(map(str, files)), os.getcwd(), {script!r}, *sys.argv[1:]]
socket.send_fds(server, ["\\0".join(words).encode()], files)
sys.exit(server.recv(1)[0])
"""


class Fork:
    def __init__(self, cleanup, programs):
        holder = tempfile.TemporaryDirectory()  # pylint: disable=consider-using-with
        cleanup(holder.cleanup)
        self.folder = Path(holder.name)
        shutil.copy2(programs / "palpate", self.folder)
        self.socket = str(self.folder / "socket")
        for script in SCRIPTS:
            self.add(script, programs.resolve() / script)
        server = subprocess.Popen(  # pylint: disable=consider-using-with
            [PYTHON, __file__, self.socket], stdout=subprocess.PIPE)
        cleanup(server.wait)
        cleanup(server.kill)
        server.stdout.read(1)  # the server listens
        server.stdout.close()

    def add(self, name, script):
        stand_in = self.folder / name
        stand_in.write_text(STAND_IN.format(python=PYTHON, socket=self.socket, script=str(script)), encoding="utf-8")
        stand_in.chmod(0o755)
        return stand_in


def serve(place):
    """Runs scripts, several at a time, until the process is killed."""
    import fcntl
    import runpy
    import socket
    import traceback

    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.collections
    import matplotlib.pyplot  # noqa: F401

    listener = socket.socket(socket.AF_UNIX)
    listener.bind(place)
    listener.listen(8)
    os.write(1, b".")
    while True:
        client, _ = listener.accept()
        if os.fork() > 0:
            client.close()
            with contextlib.suppress(ChildProcessError):
                while os.waitpid(-1, os.WNOHANG)[0] > 0:
                    pass
            continue
        text, files, _, _ = socket.recv_fds(client, 1 << 16, 32)
        numbers, folder, script, *words = text.decode().split("\0")
        child = os.fork()
        if child == 0:
            files = [fcntl.fcntl(file, fcntl.F_DUPFD, 128) for file in files]
            os.closerange(0, 128)
            for number, file in zip(numbers.split(","), files):
                os.dup2(file, int(number))
                os.close(file)
            os.chdir(folder)
            sys.argv = [script, *words]
            sys.path[0] = os.path.dirname(script)
            status = 0
            try:
                runpy.run_path(script, run_name="__main__")
            except SystemExit as end:
                status = end.code if isinstance(end.code, int) else int(end.code is not None)
            except BaseException:  # pylint: disable=broad-except
                traceback.print_exc()
                status = 1
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)  # skips the exit handlers of libraries, which would disturb the parent
        for file in files:
            os.close(file)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        client.send(bytes([status & 255]))
        os._exit(0)


if __name__ == "__main__":
    serve(sys.argv[1])
