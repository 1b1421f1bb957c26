#!/usr/bin/env python3
"""Tests volumes in bricks from Ceph, through the command line: rados_test.py BIN_DIR CLASS...

The tests start a cluster of one monitor and one store in memory, on this machine's loopback, with real keys.
"""
import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time
import unittest
import uuid
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import suite  # noqa: E402
from bowl import PATIENCE, Case, Ended, Stored, free_port, run  # noqa: E402

try:
    import rados
except ImportError:
    rados = None


class Cluster:
    """A cluster of one monitor, one store (OSD) and one pool."""

    def __init__(self, home):
        self.programs, self.as_admin = [], None
        try:
            self.begin(home)
        except BaseException:
            self.end()
            raise

    def begin(self, home):
        home.mkdir()
        self.conf = home / "ceph.conf"
        monitor = f"[v2:127.0.0.1:{free_port()}]"
        fsid, store_id = uuid.uuid4(), uuid.uuid4()
        self.conf.write_text(textwrap.dedent(f"""\
            [global]
            fsid = {fsid}
            mon_host = {monitor}
            public_network = 127.0.0.0/8
            keyring = {home}/keyring
            run_dir = {home}
            admin_socket = {home}/$name.asok
            log_file = {home}/$name.log
            osd_pool_default_size = 1
            osd_crush_chooseleaf_type = 0
            mon_allow_pool_size_one = true
            mon_data_avail_crit = 1
            [mon]
            mon_data = {home}/mon
            [osd]
            osd_data = {home}/osd
            keyring = {home}/osd/keyring
            osd_objectstore = memstore
            memstore_device_bytes = 268435456
            [client]
            admin_socket =
            log_file =
            [client.reader]
            keyring = {home}/reader.keyring
            [client.stranger]
            keyring = {home}/stranger.keyring
            """))
        self.do("ceph-authtool", "-C", home / "keyring", "-g", "-n", "mon.", "--cap", "mon", "allow *")
        self.do("ceph-authtool", home / "keyring", "-g", "-n", "client.admin", "--cap", "mon", "allow *", "--cap",
                "osd", "allow *")
        self.do("ceph-authtool", "-C", home / "stranger.keyring", "-g", "-n", "client.stranger")
        self.do("monmaptool", "--create", "--addv", "a", monitor, "--fsid", fsid, home / "monmap")
        self.do("ceph-mon", "--mkfs", "-i", "a", "--monmap", home / "monmap", "--keyring", home / "keyring")
        self.monitor = self.start("ceph-mon", "-f", "-i", "a")
        self.as_admin = rados.Rados(conffile=str(self.conf), conf={"client_mount_timeout": str(PATIENCE)})
        self.as_admin.connect()
        (home / "osd").mkdir()
        self.ask("osd new", uuid=str(store_id))
        key = self.ask("auth get-or-create", entity="osd.0", caps=["mon", "allow profile osd", "osd", "allow *"])
        (home / "osd/keyring").write_text(f"[osd.0]\nkey = {key[0]['key']}\n")
        self.do("ceph-osd", "-i", "0", "--mkfs", "--osd-uuid", store_id)
        key = self.ask("auth get-or-create", entity="client.reader", caps=["mon", "allow r", "osd", "allow r pool=bricks"])
        (home / "reader.keyring").write_text(f"[client.reader]\nkey = {key[0]['key']}\n")
        self.store = self.start("ceph-osd", "-f", "-i", "0")
        self.ask("osd pool create", pool="bricks", pg_num=8)
        self.pool = self.as_admin.open_ioctx("bricks")

    def do(self, *words):
        done = subprocess.run([*map(str, words), "-c", str(self.conf)], capture_output=True, text=True, timeout=PATIENCE)
        if done.returncode != 0:
            raise AssertionError(f"{words}: {done.stderr}")

    def start(self, *words):
        self.programs.append(subprocess.Popen([*words, "-c", str(self.conf)], stdout=subprocess.DEVNULL,
                                              stderr=subprocess.DEVNULL))
        return self.programs[-1]

    def ask(self, prefix, **more):
        status, out, said = self.as_admin.mon_command(json.dumps({"prefix": prefix, "format": "json", **more}), b"")
        if status != 0:
            raise AssertionError(f"{prefix}: {said}")
        return json.loads(out) if out else None

    def copy(self, folder):
        """Copies a folder as docs/servers.md describes, with the manifest last."""
        files = [file for file in folder.rglob("*") if file.is_file()]
        for file in sorted(files, key=lambda file: file.name == "palpate.bricks"):
            self.pool.write_full(str(file.relative_to(folder.parent)), file.read_bytes())

    def end(self):
        for program in self.programs:
            program.kill()
            program.wait()
        # This call must be last, because shutdown() waits for stopped processes.
        if self.as_admin is not None:
            self.as_admin.shutdown()


class Server(Case):
    address = "rados://bricks/bowl"
    cluster = None

    @classmethod
    def tearDownClass(cls):
        if cls.cluster is not None:
            cls.cluster.end()

    def setUp(self):
        self.serve()

    def serve(self):
        if self.cluster is not None and self.cluster.store.poll() is None:
            return
        if self.cluster is not None:
            self.cluster.end()
        type(self).cluster = Cluster(self.dir / f"ceph{time.monotonic_ns()}")
        os.environ["CEPH_CONF"] = str(self.cluster.conf)
        self.cluster.copy(self.dir / "bowl")

    def kill(self, how):
        self.cluster.store.send_signal(how)


class Killed(Ended, Server):
    HOST = True


def load_tests(_loader, tests, _pattern):
    """Runs the test that kills the cluster last, so that no other test needs a new cluster."""
    return unittest.TestSuite(sorted(suite.cases_of(tests), key=lambda test: "is_killed" in test.id()))


class Served(Stored, Server):
    def test_a_ceph_user_with_read_access_alone_can_load_bricks(self):
        run("feel", "rados://reader@bricks/bowl/", "--seconds", 0.2)

    def test_an_unusable_rados_address_is_refused_in_one_line(self):
        for none in ("rados://", "rados:///bowl", "rados://bricks", "rados://bricks/", "rados://a@b@bricks/bowl",
                     "rados://@bricks/bowl"):
            self.refused(none, "it is not an address")
        self.refused("rados://bricks/nothing", "not a volume in bricks")
        self.refused("rados://pond/bowl", 'Ceph does not have the pool "pond"')
        self.refused("rados://stranger@bricks/bowl", 'Ceph rejects the user "stranger"')
        self.refused("rados://nobody@bricks/bowl", 'Ceph rejects the user "nobody"')
        conf = os.environ["CEPH_CONF"]
        self.addCleanup(os.environ.__setitem__, "CEPH_CONF", conf)
        os.environ["CEPH_CONF"] = str(self.dir / "none.conf")
        self.refused(self.address, "the configuration of Ceph cannot be read")
        silent = Path(conf).with_name("silent.conf")
        silent.write_text(Path(conf).read_text().replace("mon_host = [v2:127.0.0.1:", "mon_host = [v2:127.0.0.2:"))
        os.environ["CEPH_CONF"] = str(silent)
        begin = time.monotonic()
        self.refused(self.address, "no monitor of Ceph answers")
        self.assertLess(time.monotonic() - begin, 10)

    def test_a_damaged_brick_is_replaced_by_coarser_data(self):
        bricks = [file.relative_to(self.dir) for file in (self.dir / "bowl/0").rglob("*") if file.is_file()]

        def of_bricks(body_of, says):
            for brick in bricks:
                body = body_of((self.dir / brick).read_bytes())
                if body is None:
                    self.cluster.pool.remove_object(str(brick))
                else:
                    self.cluster.pool.write_full(str(brick), body)
            rows, told, said = self.feel(self.address)
            self.assertGreater(told["coarse_share"], 0.1)
            self.assertGreater(told["bricks"]["bowl"]["failed"], 0)
            self.assertIn(says, said)
            self.assertGreater(max(float(row["force_z"]) for row in rows), 0.1)
        self.addCleanup(self.cluster.copy, self.dir / "bowl")
        of_bricks(lambda body: body[:100], "it has 100 bytes instead of the ")
        of_bricks(lambda body: body + b"y", "longer than the manifest states")
        of_bricks(lambda body: body[:50] + bytes([body[50] ^ 1]) + body[51:], "checksum")
        of_bricks(lambda body: None, "it is missing")


if __name__ == "__main__":
    if rados is None or shutil.which("ceph-osd") is None or shutil.which("ceph-mon") is None:
        print("rados_test: skipped: needs ceph-mon, ceph-osd and python3-rados")
        sys.exit(77)
    suite.main(sys.argv[2:])
