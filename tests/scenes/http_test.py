#!/usr/bin/env python3
"""Tests volumes in bricks from a web server, through the command line: http_test.py BIN_DIR RELAY CLASS...

Apache serves correct answers; a Python server serves wrong ones. All programs run on this machine's loopback, or in
networks of their own with a relay between them.
"""
import base64
import functools
import http.server
import json
import math
import os
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import threading
import time
import unittest
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import suite  # noqa: E402
from bowl import PALPATE, PATIENCE, Case, Ended, Stored, free_port, run  # noqa: E402
from refusals import refusal  # noqa: E402

RELAY = str(Path(sys.argv[2]).resolve())
APACHE = shutil.which("apache2", path=os.environ.get("PATH", "") + ":/usr/sbin")
MODULES = "/usr/lib/apache2/modules"
TRUSTED = "/etc/ssl/certs/ca-certificates.crt"
os.environ["no_proxy"] = "127.0.0.1"


class Bad(http.server.SimpleHTTPRequestHandler):
    """Serves a folder. `wrong(path)` returns a function that sends a wrong answer through this handler, or None."""

    def __init__(self, *args, wrong, **more):
        self.wrong = wrong
        super().__init__(*args, **more)

    def do_GET(self):
        answer = self.wrong(self.path)
        if answer is None:
            super().do_GET()
        else:
            answer(self)

    def log_message(self, format, *args):  # pylint: disable=redefined-builtin
        pass

    def give(self, body, code=200, more=()):
        self.send_response(code)
        for name, value in more:
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


class Kept(Bad):
    """Keeps connections open, because palpate reads the list of trusted certificates for each new connection."""

    protocol_version = "HTTP/1.1"


def apache(home, folder, address):
    """Returns the command that serves a folder in the foreground."""
    home.mkdir()
    user = "User www-data\nGroup www-data" if os.getuid() == 0 else ""
    (home / "conf").write_text(f"""
        LoadModule mpm_event_module {MODULES}/mod_mpm_event.so
        LoadModule authz_core_module {MODULES}/mod_authz_core.so
        ServerRoot {home}
        ServerName palpate
        Listen {address}
        PidFile {home}/pid
        DefaultRuntimeDir {home}
        Mutex file:{home} default
        ErrorLog {home}/error.log
        CustomLog {home}/access.log "%r"
        {user}
        DocumentRoot {folder}
        StartServers 1
        <Directory {folder}>
            Require all granted
        </Directory>""")
    return [APACHE, "-D", "FOREGROUND", "-f", str(home / "conf")]


class Server(Case):
    def setUp(self):
        self.port = free_port()
        self.home = self.dir / f"apache{self.port}"
        self.log = self.home / "access.log"
        self.command = apache(self.home, self.dir, f"127.0.0.1:{self.port}")
        self.serve()
        self.address = f"http://127.0.0.1:{self.port}/bowl"

    def serve(self):
        self.log.write_text("")
        self.server = subprocess.Popen(self.command, start_new_session=True, stderr=subprocess.DEVNULL)
        self.addCleanup(self.server.wait)
        self.addCleanup(self.kill, signal.SIGKILL)
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            with socket.socket() as one:
                if one.connect_ex(("127.0.0.1", self.port)) == 0:
                    return
            time.sleep(0.05)
        self.fail("Apache does not serve: " + (self.home / "error.log").read_text())

    def kill(self, how):
        try:
            os.killpg(self.server.pid, how)
        except ProcessLookupError:
            pass


class Served(Stored, Server):
    @suite.smoke
    def test_a_replay_reports_that_the_volume_at_its_address_has_changed_since_the_recording(self):
        record, bowl, other = (self.dir / name for name in ("served.rec", "bowl", "other"))
        run("feel", self.address, "--device", f"path:{self.dir / 'hand.csv'}", "--record", record)
        again = run("feel", record, "--device", f"replay:{record}")
        self.assertNotIn("since the recording", again.stderr)
        run("brick", self.dir / "bodies.vdb", other, "--grid", "cloud")
        bowl.rename(self.dir / "kept")
        other.rename(bowl)
        try:
            again = run("feel", record, "--device", f"replay:{record}", status=None)
        finally:
            bowl.rename(other)
            (self.dir / "kept").rename(bowl)
        self.assertIn(f"{self.address}: the file has changed since the recording", again.stderr)
        self.kill(signal.SIGKILL)
        self.server.wait()
        again = run("feel", record, "--device", f"replay:{record}", status=2)
        self.assertNotIn("since the recording", again.stderr)


class Killed(Ended, Server):
    HOST = True


class Far(Case):
    """Tests with server and hand in separate networks, with a delay of 5 ms between them."""
    HOST = True

    def felt(self, seed, *relay, delay=5, during=None):
        """Runs a hand that circles in the bowl in real time, and records it in far.rec. Returns the run's summary, and
        the relay's counts of packets."""
        home = self.dir / f"far{seed}"
        rows = [(0, 0.01, 0.01, 0), (1, 0.01, 0.01, -0.02)]
        for i in range(1, 60):
            way = 2 * math.pi * i / 60 + math.pi / 4
            rows.append((1 + i / 10, 0.014 * math.cos(way), 0.014 * math.sin(way), -0.02))
        (self.dir / "round.csv").write_text(
            "t,x,y,z\n" + "".join(",".join(f"{number:.6f}" for number in row) + "\n" for row in rows))
        feel = [PALPATE, "feel", str(self.scene("http://10.77.0.1:8080/bowl")), "--device",
                f"path:{self.dir / 'round.csv'}", "--realtime", "--summary", str(self.dir / "far.json"), "--record",
                str(self.dir / "far.rec")]
        serve = apache(home, self.dir, "10.77.0.1:8080")
        running = subprocess.Popen(
            [RELAY, "--delay-ms", str(delay), "--seed", str(seed), "--seconds", "60", *relay, "--", *serve, "--",
             "sh", "-c", "sleep 1; exec \"$@\"", "sh", *feel], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        self.addCleanup(running.stderr.close)
        self.addCleanup(running.wait)
        self.addCleanup(running.kill)
        if during is not None:
            during(running, home / "access.log")
        said = running.communicate(timeout=2 * PATIENCE)[1]
        if running.returncode == 77:
            self.skipTest(said)
        self.assertTrue((self.dir / "far.json").exists(), said)
        told = json.loads((self.dir / "far.json").read_text())
        (self.dir / "far.json").unlink()
        return told, json.loads(said.splitlines()[-1])

    def test_over_a_network_that_loses_packets_forces_equal_those_of_a_local_folder(self):
        told, way = self.felt(0, "--loss", "0.01")
        self.assertEqual(told["faults"], {})
        self.assertGreater(way["from_one"]["lost"], 10)
        self.assertGreater(told["force_max"], 1)
        self.assertLess(told["coarse_share"], 0.05)
        here = self.dir / "here.rec"
        (self.dir / "far.scene").write_text(self.scene(str(self.dir / "bowl")).read_text())
        run("feel", self.dir / "far.scene", "--device", f"replay:{self.dir / 'far.rec'}", "--record", here)
        # `compare` may report a difference: in the run, some ticks read coarser levels because bricks had not arrived.
        said = run("compare", self.dir / "far.rec", here, status=None).stdout
        self.assertIn("force     differs by at most 0 N, proxy by at most 0 mm", said)

    def test_a_lost_network_cuts_the_force(self):
        def part(running, log):
            end = time.monotonic() + PATIENCE
            while not (log.exists() and log.read_text().count("palpate.bricks") >= 4) and time.monotonic() < end:
                time.sleep(0.05)
            running.send_signal(signal.SIGUSR1)
        told, way = self.felt(10, during=part)
        self.assertEqual(told["faults"], {"volume": 1})
        self.assertGreater(way["from_other"]["lost"], 0)


class Wrong(Case):
    """Tests invalid answers and addresses."""

    @suite.smoke
    def test_an_invalid_http_address_or_answer_is_refused_in_one_line(self):
        self.refused("http://127.0.0.1:1/bowl", "was not received")
        for none in ("http://", "http:///bowl", "http://a:b@127.0.0.1:1/bowl", "http://127.0.0.1:1/bowl?a=b"):
            self.refused(none, "it is not an address")
        self.refused(self.served_badly(lambda path: None).replace("/bowl", "/nothing"), "not a volume in bricks")
        self.refused(self.served_badly(lambda path: lambda of: of.give(b"", 503)), "answers with status 503")
        self.refused(self.served_badly(
            lambda path: lambda of: of.give(b"", 302, [("Location", "file:///etc/passwd")])),
                     "redirects to an address that palpate does not follow, with status 302")
        self.refused(self.served_badly(lambda path: lambda of: of.give(b"x" * 100)), "palpate.bricks")

    @suite.smoke
    def test_https_needs_a_certificate_that_the_machine_trusts(self):
        key, own = self.dir / "key.pem", self.dir / "own.pem"
        subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1",
                        "-nodes", "-days", "2", "-subj", "/CN=palpate", "-addext", "subjectAltName=IP:127.0.0.1",
                        "-keyout", key, "-out", own], check=True, capture_output=True, timeout=PATIENCE)
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(own, key)
        address = self.served_badly(lambda path: None, context)
        self.refused(address, "certificate")
        # Replaces the list of trusted certificates for one program.
        trusting = ["unshare", "--mount", "--map-root-user", "sh", "-c",
                    f'mount --bind "$0" {TRUSTED} && exec "$@"', own]
        if not Path(TRUSTED).exists() or subprocess.run([*trusting, "true"], check=False).returncode:
            self.skipTest("needs a list of trusted certificates that unshare can replace for one program")
        summary = self.dir / "https.json"
        subprocess.run([*trusting, PALPATE, "feel", self.scene(address), "--device",
                        f"path:{self.dir / 'hand.csv'}", "--summary", summary],
                       check=True, capture_output=True, timeout=PATIENCE)
        told = json.loads(summary.read_text())
        self.assertEqual(told["bricks"]["bowl"]["failed"], 0)
        self.assertGreater(told["bricks"]["bowl"]["fetched"], 0)
        self.assertGreater(told["force_max"], 1)

    def keys(self, *lines, mode=0o600):
        """Writes a file of keys, and names it in the environment until the test ends."""
        file = self.dir / "keys"
        file.unlink(missing_ok=True)
        file.touch(mode)
        file.chmod(mode)
        file.write_text("".join(line + "\n" for line in lines))
        os.environ["PALPATE_HTTP_KEYS"] = str(file)
        self.addCleanup(os.environ.pop, "PALPATE_HTTP_KEYS", None)
        return file

    def locked(self, authorization, seen=None):
        """Returns the address of a server that serves only requests with this Authorization header, and answers others
        with 401. Appends the received headers to `seen`."""
        def answer(of):
            got = of.headers.get("Authorization")
            if seen is not None:
                seen.append(got)
            if got == authorization:
                http.server.SimpleHTTPRequestHandler.do_GET(of)
            else:
                of.give(b"who?", 401)
        return self.served_badly(lambda path: answer)

    @suite.smoke
    def test_a_server_gets_its_password_or_token(self):
        basic = "Basic " + base64.b64encode(b"anna:a b:c").decode()
        for authorization, key in ((basic, "basic anna a b:c"), ("Bearer t0k.en", "bearer t0k.en")):
            address = self.locked(authorization)
            origin = address.removesuffix("/bowl")
            os.environ.pop("PALPATE_HTTP_KEYS", None)
            self.refused(address, "the server requires a key in PALPATE_HTTP_KEYS, with status 401")
            self.keys("# keys", "", "https://elsewhere bearer x", f"{origin} {key}")
            _, told, said = self.feel(address)
            self.assertEqual(told["bricks"]["bowl"]["failed"], 0)
            self.assertNotIn("t0k", said)
            self.keys(f"{origin} bearer wrong")
            self.refused(address, "the server rejects the key in PALPATE_HTTP_KEYS, with status 401")

    @suite.smoke
    def test_a_file_of_keys_that_others_can_read_or_that_is_invalid_is_refused(self):
        address = self.served_badly(lambda path: None)
        origin = address.removesuffix("/bowl")
        self.feel(address)
        for mode in (0o640, 0o604, 0o620):
            self.keys(f"{origin} bearer secret", mode=mode)
            self.refused(address, "permissions for it: become its owner (chown), and run chmod 600 on it")
        for line in (origin, f"{origin} bearer", f"{origin} bearer two secrets", f"{origin} basic secret",
                     f"{origin} digest a secret", "ftp://a bearer secret", "https://a:secret@b bearer secret",
                     f"{origin} bearer secret\r", f"{origin} basic a:b secret"):
            self.keys("https://a bearer secret", line)
            _, said = refusal(self, self.dir, lambda: run("feel", address, "--seconds", 1, status=2))
            self.assertIn("line 2 is not a server's address followed by a key", said, line)
            self.assertNotIn("secret", said)
        self.keys("http://10.0.0.9 bearer secret")
        self.refused(address, "line 1 has a key for http, which does not encrypt it")
        self.keys("https://a bearer secret", "https://b bearer x", "HTTPS://A:443 basic name secret")
        self.refused(address, "line 3 has another key for the server of line 1: remove one of these lines")
        self.keys("x" * 70000)
        self.refused(address, "it has more than 64 kB")
        os.environ["PALPATE_HTTP_KEYS"] = str(self.dir / "none")
        self.refused(address, "it cannot be read")
        os.environ["PALPATE_HTTP_KEYS"] = str(self.dir)
        self.refused(address, "it is not a file")

    def moved(self, to, more=b""):
        """Returns an address whose folder has moved to `to`. The body of the redirection ends with `more`."""
        def answer(path):
            if not path.startswith("/bowl"):
                return None
            return lambda of: of.give(b"gone" + more, 302, [("Location", to + path.removeprefix("/bowl"))])
        return self.served_badly(answer)

    @suite.smoke
    def test_one_redirection_to_the_same_host_is_followed(self):
        (self.dir / "new").symlink_to("bowl")
        self.addCleanup((self.dir / "new").unlink)
        here, _, _ = self.feel(str(self.dir / "bowl"))
        there, told, _ = self.feel(self.moved("/new", b"x" * 2_000_000))
        self.assertEqual(here, there)
        self.assertEqual(told["bricks"]["bowl"]["failed"], 0)
        twice = self.moved("/bowl/bowl")
        self.refused(twice, "redirects twice, with status 302")
        for elsewhere in ("http://localhost:1/new", "ftp://127.0.0.1/new", "http://a@127.0.0.1:1/new"):
            self.refused(self.moved(elsewhere), "redirects to an address that palpate does not follow, with status 302")

    def test_a_key_is_not_sent_to_the_target_of_a_redirection_to_another_port(self):
        seen = []
        other = self.locked(None, seen)
        address = self.moved(other)
        self.keys(address.removesuffix("/bowl") + " bearer secret")
        self.feel(address)
        self.assertEqual(set(seen), {None})

    def served_badly(self, wrong, secret=None):
        """Returns the address of a server whose answer to each path is `wrong(path)`, or the correct one if that is
        None."""
        serves = Bad if secret is None else Kept
        server = http.server.ThreadingHTTPServer(
            ("127.0.0.1", 0), functools.partial(serves, directory=str(self.dir), wrong=wrong))
        if secret is not None:
            server.socket = secret.wrap_socket(server.socket, server_side=True)
        server.daemon_threads = True
        server.handle_error = lambda request, address: None  # no traceback if a client has gone
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        self.addCleanup(thread.join)
        self.addCleanup(server.server_close)
        self.addCleanup(server.shutdown)
        scheme = "http" if secret is None else "https"
        return f"{scheme}://127.0.0.1:{server.server_address[1]}/bowl"

    def of_brick(self, answer, says):
        """Serves this answer for every brick of the finest level. Checks that ticks are coarse, and that a message
        states the cause."""
        address = self.served_badly(lambda path: answer if path.startswith("/bowl/0/") else None)
        rows, told, said = self.feel(address)
        self.assertGreater(told["coarse_share"], 0.1)
        self.assertGreater(told["bricks"]["bowl"]["failed"], 0)
        self.assertIn(says, said)
        self.assertGreater(max(float(row["force_z"]) for row in rows), 0.1)

    def test_a_brick_that_is_missing_or_not_received_is_replaced_by_coarser_data(self):
        self.of_brick(lambda of: of.give(b"<html>" * 100_000, 404), "it is missing")
        self.of_brick(lambda of: of.give(b"", 500), "the server answers with status 500")

        def hangs_up(of):
            of.send_response(200)
            of.send_header("Content-Length", str((self.dir / of.path[1:]).stat().st_size))
            of.end_headers()
            of.wfile.write(b"z" * 10)
        self.of_brick(hangs_up, "was not received")

    @suite.smoke
    def test_a_damaged_brick_is_replaced_by_coarser_data(self):
        def changed(of):
            body = bytearray((self.dir / of.path[1:]).read_bytes())
            body[len(body) // 2] ^= 1
            of.give(bytes(body))
        self.of_brick(changed, "checksum")

    def test_a_brick_of_wrong_length_is_replaced_by_coarser_data(self):
        self.of_brick(lambda of: of.give(b"y" * 10), "it has 10 bytes instead of the ")
        self.of_brick(lambda of: of.give(b"y" * 2_000_000), "longer than the manifest states")

    def test_a_brick_that_was_damaged_once_is_loaded_again(self):
        seen = set()

        def once(path):
            if not path.startswith("/bowl/0/") or path in seen:
                return None
            seen.add(path)
            return lambda of: of.give(b"y" * 10)
        (self.dir / "long.csv").write_text("t,x,y,z\n0,0.01,0.01,-0.02\n6,0.01,0.01,-0.02\n")
        summary = self.dir / "again.json"
        run("feel", self.scene(self.served_badly(once)), "--device", f"path:{self.dir / 'long.csv'}",
            "--realtime", "--summary", summary, status=None)
        told = json.loads(summary.read_text())
        self.assertGreater(len(seen), 0)
        self.assertEqual(told["bricks"]["bowl"]["failed"], 0)


if __name__ == "__main__":
    if APACHE is None:
        print("http_test: skipped: needs apache2-bin")
        sys.exit(77)
    suite.main(sys.argv[3:])
