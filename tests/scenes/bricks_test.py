#!/usr/bin/env python3
"""Tests volumes in bricks through the command line and with other tools: bricks_test.py BIN_DIR VOLUMES_PROGRAM."""
import ctypes
import ctypes.util
import json
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import unittest
import zlib
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import process  # noqa: E402
import suite  # noqa: E402
from program import PALPATE, run  # noqa: E402
from refusals import refusal  # noqa: E402

VOLUMES = sys.argv[2]
ROOT = Path(__file__).resolve().parents[2]


def bytes_in(folder):
    return {str(file.relative_to(folder)): file.read_bytes() if file.is_file() else None
            for file in sorted(folder.rglob("*"))}


def snippet(number):
    """Returns the Python example of docs/bricks.md with this number, from 0."""
    text = (ROOT / "docs/bricks.md").read_text(encoding="utf-8")
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)[number]


class ZarrArray:
    """Reads an array as the Zarr v2 specification requires. Shares no code with palpate."""
    ZSTD = ctypes.CDLL(ctypes.util.find_library("zstd") or "libzstd.so.1")
    ZSTD.ZSTD_decompress.restype = ctypes.c_size_t
    ZSTD.ZSTD_decompress.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_char_p,
                                     ctypes.c_size_t]

    def __init__(self, folder):
        self.folder = folder
        self.meta = json.loads((folder / ".zarray").read_text())
        assert self.meta["zarr_format"] == 2 and self.meta["order"] == "C"
        assert self.meta["compressor"]["id"] == "zstd" and self.meta["filters"] is None
        self.shape = tuple(self.meta["shape"])

    def chunk(self, *at):
        shape, dtype = self.meta["chunks"], np.dtype(self.meta["dtype"])
        name = self.meta["dimension_separator"].join(map(str, (*at, *[0] * (len(shape) - 3))))
        try:
            packed = (self.folder / name).read_bytes()
        except FileNotFoundError:
            return np.full(shape, self.meta["fill_value"], dtype)[0, 0, 0]
        out = ctypes.create_string_buffer(int(np.prod(shape)) * dtype.itemsize)
        got = self.ZSTD.ZSTD_decompress(out, len(out), packed, len(packed))
        assert got == len(out), got
        return np.frombuffer(out, dtype).reshape(shape)[0, 0, 0]

    def chunks(self):
        return np.ndindex(self.shape[:3])


class Case(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        holder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(holder.cleanup)
        cls.dir = Path(holder.name)
        process.run([VOLUMES, str(cls.dir)], check=True)
        run("make", "two-bodies", cls.dir / "bodies.vdb", "--voxel", 0.5)

    def refused(self, *words, says, status=2, **more):
        _, line = refusal(self, self.dir, lambda: run(*words, status=status, **more))
        self.assertIn(says, line)
        return line

    def brick(self, name, file, *words):
        out = self.dir / name
        return out, json.loads(run("brick", self.dir / file, out, "--json", *words).stdout)


class Others(Case):
    """Tests that read bricks only by the Zarr specification and docs/bricks.md."""

    def test_values_in_bricks_have_the_documented_positions(self):
        # "density" = x + 2 y - z and "velocity" = (-y, x, 3 z), 9^3 voxels of 0.5 from 0.
        for half, tolerance in (((), 0), (("--half",), 2e-3)):
            for grid in ("density", "velocity"):
                out, _ = self.brick(f"{grid}{len(half)}", "linear.vdb", "--grid", grid, *half)
                facts = json.loads((out / ".zattrs").read_text())["palpate"]
                level = facts["levels"][0]
                array = ZarrArray(out / "0")
                self.assertEqual(array.shape[:3], (1, 1, 1))
                chunk = array.chunk(0, 0, 0)
                values = chunk[:68].astype(float)
                bits = np.unpackbits(chunk[68:].reshape(-1).view(np.uint8), bitorder="little")
                active = bits[:68 ** 3].reshape(68, 68, 68).astype(bool)
                self.assertEqual(int(active.sum()), 9 ** 3)
                at = np.argwhere(active)
                index = at - 2 + 64 * np.array(level["first"])
                x, y, z = (index @ np.array(level["linear"]).T + level["origin"]).T
                self.assertEqual((x.min(), x.max()), (0, 4))
                found = values[tuple(at.T)]
                is_to_be = x + 2 * y - z if grid == "density" else np.stack([-y, x, 3 * z], 1)
                self.assertLessEqual(float(np.abs(found - is_to_be).max()), tolerance)

    @suite.smoke
    def test_the_manifest_of_bricks_has_the_documented_format(self):
        out, said = self.brick("manifest", "bodies.vdb", "--grid", "bowl")
        names = {"folder": str(out)}
        exec(snippet(1), names)  # pylint: disable=exec-used
        facts, tables = names["facts"], names["tables"]
        self.assertEqual(facts, json.loads((out / ".zattrs").read_text())["palpate"])
        stored = 0
        for level, table in enumerate(tables):
            array = ZarrArray(out / str(level))
            rows = {tuple(row["at"]): row for row in table}
            for at in array.chunks():
                row = rows.get(at)
                file = out / str(level) / (".".join(map(str, at)) + ".0.0.0")
                self.assertEqual(file.exists(), row is not None and row["kind"] == 2)
                if not file.exists():
                    continue
                stored += 1
                packed = file.read_bytes()
                self.assertEqual((len(packed), zlib.crc32(packed)), (row["bytes"], row["crc"]))
        self.assertEqual(stored, said["stored"])
        self.assertEqual(sum(len(t) for t in tables), stored + sum(
            level["constant"] for level in said["levels"]))

    def test_aprons_repeat_the_neighbour_s_voxels_and_coarse_voxels_are_means_of_fine_ones(self):
        out, _ = self.brick("rims", "bodies.vdb", "--grid", "cloud")
        fine, coarse = ZarrArray(out / "0"), ZarrArray(out / "1")
        for i, j, k in fine.chunks():
            if i + 1 < fine.shape[0]:
                here, there = fine.chunk(i, j, k)[:68], fine.chunk(i + 1, j, k)[:68]
                np.testing.assert_array_equal(here[-4:], there[:4])
        facts = json.loads((out / ".zattrs").read_text())["palpate"]
        first = [np.array(level["first"]) for level in facts["levels"]]
        whole = np.zeros([64 * n for n in fine.shape[:3]])
        for i, j, k in fine.chunks():
            whole[64 * i:64 * i + 64, 64 * j:64 * j + 64, 64 * k:64 * k + 64] = \
                fine.chunk(i, j, k)[2:66, 2:66, 2:66]
        for at in coarse.chunks():
            corner = 2 * (first[1] + at) - first[0]
            if (corner < 0).any() or (corner + 2 > fine.shape[:3]).any():
                continue
            i, j, k = 64 * corner
            means = whole[i:i + 128, j:j + 128, k:k + 128].reshape(64, 2, 64, 2, 64, 2).mean(
                axis=(1, 3, 5))
            np.testing.assert_array_equal(coarse.chunk(*at)[2:66, 2:66, 2:66],
                                          means.astype(np.float32))

    def test_the_zarr_library_reads_a_volume_in_bricks(self):
        try:
            import zarr  # noqa: F401 pylint: disable=import-outside-toplevel,unused-import
        except ImportError:
            self.skipTest("there is no python3-zarr")
        out, _ = self.brick("zarr", "bodies.vdb", "--grid", "cloud")
        names = {}
        exec(snippet(0).replace("head.bricks", str(out)), names)  # pylint: disable=exec-used
        volume = names["volume"]
        array = ZarrArray(out / "0")
        self.assertEqual(volume.shape, tuple(64 * n for n in array.shape[:3]))
        for i, j, k in array.chunks():
            np.testing.assert_array_equal(
                volume[64 * i:64 * i + 64, 64 * j:64 * j + 64, 64 * k:64 * k + 64],
                array.chunk(i, j, k)[2:66, 2:66, 2:66])


class Broken(Case):
    def test_a_killed_export_of_bricks_resumes_to_the_same_bytes_as_one_run(self):
        """Kills exports at random points; in the end, the bytes must equal those of one run."""
        run("make", "two-bodies", self.dir / "fine.vdb", "--voxel", 0.3)
        words = ["brick", self.dir / "fine.vdb", "--grid", "bowl", "--compression", 12]
        run(*words, self.dir / "whole")
        expected = bytes_in(self.dir / "whole")
        stored = sum(name.endswith(".0.0.0") for name in expected)
        dice = random.Random(4)
        killed = 0
        for attempt in range(4):
            out = self.dir / f"killed{attempt}"
            for count in sorted(dice.sample(range(stored), 3)):
                child = subprocess.Popen([PALPATE, *map(str, words), str(out)],
                                         stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
                # Kills the export after `count` bricks, at a random point of the next one.
                while child.poll() is None and len(list(out.glob("*/*.0.0.0"))) < count:
                    time.sleep(0.001)
                time.sleep(dice.uniform(0, 0.005))
                child.kill()
                child.wait()
                if (out / ".zattrs").exists() and not (out / "palpate.bricks").exists():
                    killed += 1
                    self.refused("info", out, says="it is unfinished")
            run(*words, out)
            self.assertEqual(bytes_in(out), expected)
            shutil.rmtree(out)
        self.assertGreater(killed, 6)

    def test_an_interrupted_export_of_bricks_prints_how_to_resume(self):
        run("make", "two-bodies", self.dir / "slow.vdb", "--voxel", 0.25)
        words = ["brick", self.dir / "slow.vdb", self.dir / "slow", "--grid", "bowl",
                 "--compression", 12]
        child = subprocess.Popen([PALPATE, *map(str, words)], stdout=subprocess.PIPE,
                                 stderr=subprocess.PIPE, text=True)
        while not list(self.dir.glob("slow/0/*.0")):
            self.assertIsNone(child.poll())
            time.sleep(0.01)
        child.send_signal(signal.SIGINT)
        out, said = child.communicate(timeout=60)
        self.assertEqual((child.returncode, out), (130, ""))
        self.assertEqual(said, "palpate: interrupted: run the same command again to resume\n")
        told = run(*words).stdout
        self.assertRegex(told, r"note +\d+ of these bricks were already written by an interrupted run")
        self.assertIn("all bricks were already written", run(*words).stdout)

    def test_an_export_of_bricks_that_reaches_the_limit_of_file_sizes_can_be_resumed(self):
        out = self.dir / "full"

        def small():
            resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

        done = run("brick", self.dir / "bodies.vdb", out, "--grid", "cloud", status=2,
                   preexec_fn=small)
        self.assertRegex(done.stderr, r"^palpate: \S+: it cannot be written \(File too large\): raise "
                         r"the limit of file sizes \(ulimit -f\), and run the same command again: it "
                         r"continues where it stopped\n$")
        self.assertFalse((out / "palpate.bricks").exists())
        run("brick", self.dir / "bodies.vdb", out, "--grid", "cloud")
        self.assertTrue((out / "palpate.bricks").exists())


class Verbs(Case):
    @suite.smoke
    def test_the_command_info_prints_the_facts_of_a_file_also_for_its_bricks(self):
        out, made = self.brick("told", "bodies.vdb", "--grid", "bowl")
        grids = json.loads(run("info", self.dir / "bodies.vdb", "--json").stdout)["grids"]
        file = next(grid for grid in grids if grid["name"] == "bowl")
        bricks = json.loads(run("info", out, "--json").stdout)["grids"][0]
        told = bricks.pop("bricks")
        del file["description"]  # bricks do not store it
        self.assertEqual(list(bricks), list(file))
        for key in file:
            if key == "mean":
                self.assertAlmostEqual(bricks[key], file[key], places=6)
            elif key == "source":
                self.assertEqual(bricks[key], file[key])
            elif key != "memory_bytes":
                np.testing.assert_allclose(np.array(bricks[key], dtype=object) == file[key], True)
        for key, value in told.items():
            self.assertEqual(made[key], value)
        self.assertEqual(made["written"], told["stored"])
        self.assertEqual(made["kept"], 0)
        for level in told["levels"]:
            self.assertEqual(level["stored"] + level["constant"] + level["background"],
                             int(np.prod(level["count"])))
        self.assertLessEqual(int(np.prod(told["levels"][-1]["count"])), 8)
        text = run("info", out).stdout
        self.assertIn("level set", text)
        self.assertRegex(text, r"level 0 +\d+ x \d+ x \d+ bricks: \d+ stored in \S+ MB")
        again = json.loads(run("brick", self.dir / "bodies.vdb", out, "--grid", "bowl",
                               "--json").stdout)
        self.assertEqual(again["written"], 0)

    @suite.smoke
    def test_half_precision_bricks_are_smaller_and_info_marks_them(self):
        whole, made = self.brick("single", "bodies.vdb", "--grid", "cloud")
        half, less = self.brick("halved", "bodies.vdb", "--grid", "cloud", "--half")
        self.assertLess(less["bytes"], 0.8 * made["bytes"])
        self.assertNotEqual(less["identity"], made["identity"])
        self.assertTrue(json.loads(run("info", half, "--json").stdout)["grids"][0]["half"])
        self.assertFalse(json.loads(run("info", whole, "--json").stdout)["grids"][0]["half"])

    @suite.smoke
    def test_invalid_outputs_and_damaged_bricks_are_refused(self):
        ball = self.dir / "ball.vdb"
        out, _ = self.brick("there", "ball.vdb")
        self.refused("brick", ball, out, "--half", says="it contains bricks of another input, of other "
                     "options, or of another version of palpate or zstd: remove the folder, or name another one")
        self.refused("brick", self.dir / "linear.vdb", self.dir / "n", says="more than one grid")
        self.refused("brick", self.dir / "nan.vdb", self.dir / "n", says="NaN")
        self.refused("brick", ball, ball, says="it exists already and is not a folder")
        self.refused("brick", ball, "/no/such/place", says="the folder cannot be created")
        self.refused("brick", ball, self.dir, says="it exists already and contains")
        self.refused("brick", ball, self.dir / "n", "--compression", 20, says="give 1 to 19")
        self.refused("brick", ball, self.dir / "n", "--compression", "x", says="--compression")
        self.refused("brick", self.dir / "none.vdb", self.dir / "n", says="no such file")
        self.refused("brick", self.dir / "labels.vdb", self.dir / "n", says="convert it")
        # Damages the manifest as other programs could.
        manifest = out / "palpate.bricks"
        whole = manifest.read_bytes()
        manifest.write_bytes(whole[:-5])
        self.refused("info", out, says="it is cut off or damaged: copy or write it again")
        manifest.write_bytes(whole.replace(b'"components":1', b'"components":9'))
        self.refused("info", out, says="it is cut off or damaged")
        manifest.unlink()
        self.refused("info", out, says="it is unfinished: it has no manifest: repeat the command "
                     "that wrote the folder")
        (out / ".zattrs").unlink()
        self.refused("info", out, says="it is not a file")


class Felt(Case):
    """Tests of a hand on the skin of a rod, with a window of 60 MB."""

    def skin(self):
        i, j, k = np.mgrid[0:300, 0:160, 0:160]
        depth = 70 - np.hypot(np.hypot(np.maximum(0, np.abs(i - 150) - 70), j - 80), k - 80)
        (depth * 8 + i % 3).astype("<i2").transpose(2, 1, 0).tofile(self.dir / "rod.raw")
        layout = json.dumps({"size": [300, 160, 160], "type": "int16", "unit": "mm"})
        bricks = self.dir / "rod"
        run("import", self.dir / "rod.raw", bricks, "--bricks", "--raw", layout)
        run("import", self.dir / "rod.raw", self.dir / "rod.vdb", "--raw", layout)
        scene = {"palpate": 1, "coupling": {"stiffness": 500},
                 "volumes": {"rod": {"file": "rod", "place": {"unit": "mm"}, "window": {"budget_mb": 60}}},
                 "modes": [{"mode": "isosurface", "of": "rod", "value": 0, "solid": "above",
                            "strength": 5, "friction": 0.2}]}
        (self.dir / "bricks.json").write_text(json.dumps(scene))
        del scene["volumes"]["rod"]["window"]
        scene["volumes"]["rod"]["file"] = "rod.vdb"
        (self.dir / "whole.json").write_text(json.dumps(scene))
        t = np.arange(3000) * 1e-3
        rows = np.stack([t, -0.13 + 0.09 * t, 0 * t, 0.075 - 0.009 * np.minimum(1, t)], 1)
        np.savetxt(self.dir / "way.csv", rows, "%.9g", ",", header="t,x,y,z", comments="")
        return bricks

    def feel(self, scene, trace, *words):
        out = run("feel", self.dir / scene, "--device", f"path:{self.dir / 'way.csv'}", "--trace",
                  self.dir / trace, "--summary", self.dir / "summary.json", *words)
        return out, json.loads((self.dir / "summary.json").read_text())

    def test_an_import_as_bricks_has_the_bytes_of_its_vdb_in_bricks(self):
        i, j, k = np.mgrid[0:70, 0:66, 0:140]
        tube = np.where(np.hypot(i - 35, j - 33) < 25, 1.0 + (7 * i + 11 * j + 13 * k) % 31, 0.0)
        tube.astype("<f4").transpose(2, 1, 0).tofile(self.dir / "tube.raw")
        layout = json.dumps({"size": list(tube.shape), "type": "float32", "spacing": [1, 1, 0.75], "unit": "mm"})
        source = [self.dir / "tube.raw", "--raw", layout]
        # Only --voxel 1.5 makes a new grid, which the import then copies.
        for name, *words in (("plain",), ("smooth", "--smooth", 1.5), ("coarse", "--voxel", 1.5)):
            with self.subTest(words=words):
                run("import", *source, self.dir / f"tube_{name}", "--bricks", *words)
                run("import", *source, self.dir / f"tube_{name}.vdb", *words)
                again, _ = self.brick(f"tube_{name}_again", f"tube_{name}.vdb")
                self.assertEqual(bytes_in(again), bytes_in(self.dir / f"tube_{name}"))

    def test_bricks_give_the_forces_of_the_volume_in_memory(self):
        bricks = self.skin()
        self.feel("whole.json", "whole.csv")
        out, summary = self.feel("bricks.json", "bricks.csv")
        self.assertRegex(out.stdout, r"bricks    rod: \d+ loaded, \d+ in memory, in a window of \d+ bricks "
                                     r"\([\d.]+ MB\)\n")
        self.assertEqual(summary["coarse_share"], 0)
        self.assertGreater(summary["felt_share"], 0.5)
        self.assertEqual(summary["bricks"]["rod"]["failed"], 0)
        felt = [[row.split(",") for row in (self.dir / name).read_text().splitlines()]
                for name in ("whole.csv", "bricks.csv")]
        # On a free path, a tick reads a volume in bricks, but not one in memory. So the columns of work differ.
        work = ("tick_ns", "substeps")
        columns = [i for i, name in enumerate(felt[0][0]) if name not in work]
        whole, streamed = ([[row[i] for i in columns] for row in rows] for rows in felt)
        self.assertEqual(whole, streamed)
        # Bricks work without a scene, with a trailing slash, and with `check`.
        self.assertIn(f'"file": "{bricks}"', run("scene", bricks).stdout)
        self.assertIn("in bricks", run("check", self.dir / "bricks.json").stdout)
        run("feel", f"{bricks}/", "--seconds", 1, status=None)

    @suite.smoke
    def test_missing_bricks_are_reported_and_replaced_by_coarser_data(self):
        bricks = self.skin()
        (bricks / "0/2.1.1.0.0.0").unlink()
        (bricks / "0/2.1.2.0.0.0").write_bytes(b"no brick")
        out, summary = self.feel("bricks.json", "bricks.csv")
        lines = [line for line in out.stderr.splitlines() if "rod/0/" in line]
        self.assertEqual(len(lines), 2, out.stderr)
        self.assertTrue(any("2.1.1" in line and "missing" in line for line in lines), out.stderr)
        self.assertGreater(summary["coarse_share"], 0.02)
        self.assertLess(summary["coarse_share"], 0.9)
        self.assertEqual(summary["bricks"]["rod"]["failed"], 2)
        self.assertEqual(summary["faults"], {})
        self.assertRegex(out.stdout, r"coarse    coarser data replaced missing data")

    def test_a_recording_of_a_scene_in_bricks_replays_identically(self):
        self.skin()
        self.feel("bricks.json", "bricks.csv", "--record", self.dir / "felt.rec")
        again = run("feel", self.dir / "felt.rec", "--device", f"replay:{self.dir / 'felt.rec'}",
                    "--record", self.dir / "again.rec")
        self.assertIn("data that came too late during the recording", again.stderr)
        said = json.loads(run("compare", self.dir / "felt.rec", self.dir / "again.rec", "--json").stdout)
        self.assertTrue(said["identical"], said)


class Import(Case):
    def raw(self):
        i, j, k = np.mgrid[0:70, 0:80, 0:90]
        values = np.where((i - 35) ** 2 + (j - 40) ** 2 + (k - 45) ** 2 < 900, i + j + k, 0)
        file = self.dir / "cube.raw"
        values.astype("<i2").transpose(2, 1, 0).tofile(file)
        return file, json.dumps({"size": [70, 80, 90], "type": "int16", "unit": "mm"})

    def test_imported_bricks_equal_those_of_the_imported_vdb(self):
        file, layout = self.raw()
        run("import", file, self.dir / "cube.vdb", "--raw", layout)
        direct, between = self.dir / "direct", self.dir / "between"
        text = run("import", file, direct, "--bricks", "--raw", layout).stdout
        self.assertIn(f"next: palpate info {direct}", text)
        run("brick", self.dir / "cube.vdb", between)
        self.assertEqual(bytes_in(direct), bytes_in(between))
        facts = json.loads((direct / ".zattrs").read_text())["palpate"]
        self.assertEqual(facts["metadata"]["length_unit"], {"string": "mm"})
        self.assertEqual(facts["source"], "cube.raw")

    @suite.smoke
    def test_an_import_into_bricks_refuses_invalid_outputs(self):
        file, layout = self.raw()
        words = ["import", file, "--raw", layout, "--bricks"]
        self.refused(*words, self.dir / "a.vdb", says="omit .vdb in the name")
        self.refused(*words, self.dir / "a", "--scene", "s.json", says="run palpate scene on the folder of bricks")
        self.refused("import", file, self.dir / "a", "--raw", layout, says="add .vdb to the name")
        self.refused(*words, self.dir, says="it exists already and contains")


if __name__ == "__main__":
    suite.main(sys.argv[3:])
