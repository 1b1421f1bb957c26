#!/usr/bin/env python3
"""Tests the program through its command line: cli_test.py BIN_DIR VOLUMES_PROGRAM [--host]. With --host runs the tests
that depend on the scheduler, otherwise all others."""
import csv
import fcntl
import io
import json
import math
import os
import pty
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import termios
import time
import unicodedata
import unittest
from pathlib import Path
from random import Random

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import process  # noqa: E402
import suite  # noqa: E402
from cases import cases  # noqa: E402
from refusals import refusal  # noqa: E402
from terminal import Terminal  # noqa: E402

BIN = Path(sys.argv[1])
VOLUMES = sys.argv[2]
PALPATE = str(BIN / "palpate")


def run(*words, stdin="", status=0, statuses=None):
    done = process.run([PALPATE, *map(str, words)], input=stdin, capture_output=True, text=True,
                          timeout=300)  # for sanitizers on a busy machine
    if done.returncode not in (statuses or (status,)):
        raise AssertionError(f"{words}: status {done.returncode}, not {status}: {done.stderr}")
    return done


class Case(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.holder = tempfile.TemporaryDirectory()
        cls.dir = Path(cls.holder.name)
        process.run([VOLUMES, str(cls.dir)], check=True)

    @classmethod
    def tearDownClass(cls):
        cls.holder.cleanup()

    def refused(self, *words, says, stdin="", status=2):
        """Checks that the command is refused: one line on stderr, nothing on stdout, no file left."""
        _, line = refusal(self, self.dir, lambda: run(*words, stdin=stdin, status=status))
        self.assertIn(says, line)


def explains(test, felt):
    """Runs the explain command of feel's report. Checks that its spring force is that of the strongest tick to within
    2 %. Returns the explanation."""
    most = felt["most"]
    words = shlex.split(most["explain"])
    test.assertEqual(words[:2], ["palpate", "explain"])
    told = json.loads(run(*words[1:], "--json").stdout)
    test.assertAlmostEqual(math.hypot(*told["balance"]["spring"]), most["spring"], delta=0.02 * most["spring"])
    test.assertEqual(most["explained"], most["spring"])
    return told


class Program(Case):
    @suite.smoke
    def test_the_help_of_every_command_has_an_example(self):
        for verb in verbs():
            self.assertIn("Example", run(verb, "--help").stdout, verb)
        self.assertRegex(run("--version").stdout, r"^palpate \d+\.\d+\.\d+( \([0-9a-f]+\+?\))?\n"
                         r"\w+ [\d.]+, \w+; imports with(out)? VTK\n$")

    def test_printed_schemas_equal_the_shipped_ones(self):
        root = Path(__file__).resolve().parents[2]
        for word, file in (("scene", "scenes/scene.schema.json"), ("arm", "devices/hid/hid_profile.schema.json")):
            self.assertEqual(run("schema", word).stdout, (root / file).read_text(encoding="utf-8"))
        self.refused("schema", "hand", says="hand")

    def test_usage_errors_are_one_line(self):
        self.refused(says="usage")
        self.refused("tickle", says="is not a command of palpate")
        self.refused("fel", says='did you mean "feel"?')
        self.refused("feel", says="see palpate feel --help")
        self.refused("info", "a", "--nonsense", says="nonsense")


def verbs():
    """Returns the verbs of palpate --help."""
    told = run("--help").stdout.split("Subcommands:\n")[1].split("\n\n")[0]
    return [line.split()[0] for line in told.splitlines()]


class Help(Case):
    """Tests that all ways to request help print the same text."""
    def test_palpate_help_and_the_option_help_of_a_command_print_the_same_text(self):
        self.assertEqual(run("help").stdout, run("--help").stdout)
        self.assertGreater(len(verbs()), 15)
        for verb in verbs():
            told = run(verb, "--help").stdout
            self.assertEqual(run("help", verb).stdout, told, verb)
            self.assertTrue(told.replace("\n", "").isprintable(), verb)
        self.refused("help", "fel", says='did you mean "feel"?')
        self.refused("help", "feel", "check", says="see palpate help --help")


class Documents(unittest.TestCase):
    ROOT = Path(__file__).resolve().parents[2]

    def test_the_readme_contains_the_smallest_program(self):
        program = (self.ROOT / "scenes" / "apps" / "first_tick.cpp").read_text().strip()
        self.assertIn(program, (self.ROOT / "README.md").read_text())

    def test_every_command_is_documented(self):
        text = (self.ROOT / "docs" / "interfaces.md").read_text()
        for verb in verbs():
            self.assertIn(f"\n## {verb} ", text)


class Info(Case):
    @suite.smoke
    def test_the_command_info_describes_each_grid_of_a_file(self):
        grids = json.loads(run("info", self.dir / "mixed.vdb", "--json").stdout)["grids"]
        by_name = {g["name"]: g for g in grids}
        self.assertEqual(by_name["ball"]["class"], "level set")
        self.assertTrue(by_name["ball"]["can_be_felt"])
        self.assertAlmostEqual(by_name["ball"]["voxel_size"][0], 0.1)
        self.assertFalse(by_name["labels"]["can_be_felt"])
        self.assertIn("feel", run("info", self.dir / "mixed.vdb").stdout)

    @suite.smoke
    def test_the_command_info_refuses_invalid_files(self):
        self.refused("info", self.dir / "none.vdb", says="no such file")
        self.refused("info", self.dir, says="not a file")
        text = self.dir / "text.vdb"
        text.write_text("hello")
        self.refused("info", text, says="not a .vdb file")
        whole = (self.dir / "ball.vdb").read_bytes()
        cut = self.dir / "cut.vdb"
        cut.write_bytes(whole[: len(whole) // 2])
        for verb in ("info", "check", "feel"):
            self.refused(verb, cut, says="truncated")


class Make(Case):
    @suite.smoke
    def test_the_command_make_reports_a_file_that_exceeds_the_limit_of_file_sizes(self):
        out = self.dir / "full.vdb"
        done = process.run(["prlimit", "--fsize=20000", PALPATE, "make", "two-bodies", out],
                              capture_output=True, text=True, timeout=300)
        self.assertEqual(done.returncode, 2)
        self.assertIn(f"{out}: it cannot be written (File too large)", done.stderr)
        self.assertFalse(out.exists())

    def test_the_command_make_refuses_a_pipe_as_output(self):
        os.mkfifo(self.dir / "pipe.vdb")
        done = process.run([PALPATE, "make", "two-bodies", self.dir / "pipe.vdb"],
                              capture_output=True, text=True, timeout=300)
        self.assertEqual(done.returncode, 2)
        self.assertIn("it is a pipe or a device", done.stderr)

    def test_the_command_make_writes_all_grids_of_each_procedural_volume_with_their_source(self):
        for name, grids in (("wind-tunnel", ["velocity", "wing"]),
                            ("fibres", ["direction", "anisotropy"]),
                            ("two-bodies", ["bowl", "cloud"]),
                            ("beating-heart", ["muscle", "u"]), ("breathing", ["ct", "u"])):
            out = self.dir / f"{name}.vdb"
            made = json.loads(run("make", name, out, "--json").stdout)
            self.assertEqual([g["name"] for g in made["grids"]], grids)
            found = {g["name"]: g for g in json.loads(run("info", out, "--json").stdout)["grids"]}
            for grid in made["grids"]:
                for frame in range(grid["frames"]):
                    at = grid["name"] + (f"[{frame}]" if grid["frames"] > 1 else "")
                    self.assertTrue(found[at]["can_be_felt"])
                    self.assertEqual(found[at]["active_voxels"], grid["active_voxels"])
                    self.assertEqual(found[at]["source"], f"palpate make {name}")
            if name == "wind-tunnel":  # the guess finds the tip vortices, which are small
                modes = json.loads(run("scene", out).stdout)["modes"]
                self.assertIn("vortex_tube", [mode["mode"] for mode in modes])
            self.assertIn(name, run("make", "--help").stdout)
            self.assertIn(grids[0], run("make", name, out).stdout)  # again, over the existing file
            os.remove(out)
        self.assertFalse([f for f in os.listdir(self.dir) if "partial" in f])

    def test_a_refused_command_make_leaves_no_files(self):
        out = self.dir / "never.vdb"
        self.refused("make", "wind-tunel", out, says='did you mean "wind-tunnel"?')
        self.refused("make", "teapot", out, says="use one of wind-tunnel, fibres, two-bodies, "
                     "beating-heart, breathing")
        self.refused("make", "fibres", out, "--voxel", 9, says="0.25 to 3 mm")
        self.refused("make", "fibres", out, "--voxel", "nan", says="--voxel")
        self.refused("make", "fibres", "-", says=".vdb")
        self.refused("make", "fibres", self.dir / "never.txt", says=".vdb")
        self.refused("make", "fibres", "/no/such/place/a.vdb", says="cannot be written")
        self.refused("make", "fibres", says="see palpate make --help")


class Parts(Case):
    """Tests of scenes with many instances."""
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        run("make", "two-bodies", cls.dir / "bodies.vdb", "--voxel", 2)

    def strew(self, name, count, room, strength):
        """Writes a scene of `count` clouds in a cube of edge `room` [m]. Each shows one of three volumes in a random
        orientation."""
        random = Random(1)
        volumes = [f"cloud-{i}" for i in range(3)]
        places = [{"scale": 5e-4, "rotation_wxyz": [random.gauss(0, 1) for _ in range(4)],
                   "translate": [random.uniform(-0.5, 0.5) * room for _ in range(3)]} for _ in range(count)]
        scene = self.dir / f"{name}.json"
        scene.write_text(json.dumps({
            "palpate": 1,
            "volumes": {volume: {"file": "bodies.vdb", "grid": "cloud", "instances": places[i::3]}
                        for i, volume in enumerate(volumes)},
            "modes": [{"name": volume, "mode": "isosurface", "of": volume, "value": 0.3, "strength": strength}
                      for volume in volumes]}))
        return scene

    def test_a_scene_of_many_parts_gives_forces_and_reports_its_parts(self):
        scene = self.strew("many", 30, 0.1, 3)
        checked = json.loads(run("check", scene, "--json").stdout)
        self.assertEqual(checked["parts"], 30)
        felt = json.loads(run("feel", scene, "--seconds", 5, "--json").stdout)
        self.assertEqual(felt["parts"]["all"], 30)
        self.assertGreater(felt["parts"]["near_mean"], 0)
        self.assertLessEqual(felt["parts"]["near_most"], 30)
        self.assertEqual(felt["parts"]["crowded_ticks"], 0)
        self.assertEqual(felt["parts"]["missing_max"], 0)
        # The report lists modes by volume, and only those with contact.
        self.assertTrue(felt["felt"])
        for mode in felt["felt"]:
            self.assertIn(mode["mode"], ("cloud-0", "cloud-1", "cloud-2"))
            self.assertGreater(mode["touches"], 0)
        # The load of the parts equals the force on the hand to within the error of the balance: the stiffness, 500 N/m,
        # times the tolerance, 0.01 voxel. In few ticks the error may be larger.
        rows = list(csv.DictReader(io.StringIO(
            run("feel", scene, "--seconds", 5, "--trace", "-").stdout)))
        self.assertEqual([name for name in rows[0] if name.startswith("load_")], ["load_parts"])
        self.assertTrue(any(float(row["load_parts"]) > 0.1 for row in rows))
        apart = [abs(float(row["load_parts"]) - math.hypot(*(float(row[f"force_{a}"]) for a in "xyz")))
                 for row in rows if row["limited"] == "0"]
        self.assertGreater(len(apart), 4900)
        self.assertLess(max(apart), 1.5e-2)
        self.assertGreater(sum(gap < 1e-3 for gap in apart), 4800)
        words = run("feel", scene, "--seconds", 5)
        self.assertIn("of 30 near the hand on average", words.stdout)
        self.assertNotIn("the hand felt no force", words.stderr)
        picture = self.dir / "felt.png"
        drawn = run("feel", scene, "--seconds", 5, "--picture", picture)
        self.assertEqual(picture.read_bytes()[:8], b"\x89PNG\r\n\x1a\n")
        self.assertNotIn("picture:", drawn.stderr)
        os.remove(picture)
        self.assertNotIn("crowded", words.stdout)

    @unittest.skipUnless(os.environ.get("PALPATE_LONG"), "takes 3 GB of memory: only with test.sh --long")
    def test_a_scene_of_a_million_instances_is_checked_in_4_gb_of_memory(self):
        scene = self.dir / "million.json"
        with open(scene, "w", encoding="utf-8") as out:
            out.write('{"palpate": 1, "volumes": {"v": {"file": "bodies.vdb", "grid": "cloud", "instances": [')
            places = ((n % 100 / 1e3, n // 100 % 100 / 1e3, n // 10000 / 1e3) for n in range(10 ** 6))
            out.write(",".join(f'{{"scale": 1e-6, "translate": [{x}, {y}, {z}]}}' for x, y, z in places))
            out.write(']}}, "modes": [{"mode": "isosurface", "of": "v", "value": 0.3, "strength": 1}]}')
        done = process.run(["bash", "-c", 'ulimit -v 4000000; exec "$0" "$@"', PALPATE, "check", str(scene), "--json"],
                           capture_output=True, text=True, timeout=600)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        self.assertEqual(json.loads(done.stdout)["parts"], 10 ** 6)

    def test_too_many_parts_at_one_place_are_reported(self):
        scene = self.strew("heap", 200, 0.01, 0.1)
        done = run("feel", scene, "--seconds", 5, "--json")
        parts = json.loads(done.stdout)["parts"]
        self.assertGreater(parts["crowded_ticks"], 0)
        self.assertGreater(parts["missing_max"], 0)
        words = run("feel", scene, "--seconds", 5).stdout
        self.assertIn("more than 64 parts were near the hand", words)


class Sample(Case):
    def test_sample_prints_values_and_gradients(self):
        done = run("sample", self.dir / "linear.vdb", "--grid", "density", "--points", "-",
                   stdin="x,y,z\n1,2,0.5\n-9,0,0\n")
        rows = list(csv.DictReader(io.StringIO(done.stdout)))
        self.assertEqual(list(rows[0]), ["x", "y", "z", "inside", "value", "gx", "gy", "gz"])
        # value = x + 2 y - z
        self.assertEqual([float(rows[0][k]) for k in ("value", "gx", "gy", "gz")], [4.5, 1, 2, -1])
        self.assertEqual((rows[0]["inside"], rows[1]["inside"]), ("1", "0"))

    @suite.smoke
    def test_sample_prints_curl_divergence_and_jacobian(self):
        done = run("sample", self.dir / "linear.vdb", "--grid", "velocity", "--points", "-",
                   "--derive", "curl,divergence,jacobian", stdin="x,y,z\n1,1,1\n")
        row = next(csv.DictReader(io.StringIO(done.stdout)))
        self.assertEqual(list(row)[:10], ["x", "y", "z", "inside", "vx", "vy", "vz",
                                          "curl_x", "curl_y", "curl_z"])
        # v = (-y, x, 3 z)
        self.assertEqual(float(row["curl_z"]), 2)
        self.assertEqual(float(row["divergence"]), 3)
        self.assertEqual((float(row["j_xy"]), float(row["j_yx"])), (-1, 1))

    @suite.smoke
    def test_sample_prints_vortex_criteria_and_directions(self):
        done = run("sample", self.dir / "linear.vdb", "--grid", "velocity", "--points", "-",
                   "--derive", "q,lambda2,unit,magnitude", stdin="x,y,z\n1,1,1\n2,1.5,0.5\n")
        rows = list(csv.DictReader(io.StringIO(done.stdout)))
        self.assertEqual(list(rows[0])[7:],
                         ["q", "lambda2", "unit_x", "unit_y", "unit_z", "magnitude"])
        for row in rows:
            # v = (-y, x, 3 z): rotation by 1, stretching by 3
            x, y, z = (float(row[k]) for k in "xyz")
            speed = math.sqrt(y * y + x * x + 9 * z * z)
            self.assertAlmostEqual(float(row["q"]), 1 - 4.5, 12)
            self.assertAlmostEqual(float(row["lambda2"]), -1, 12)
            self.assertAlmostEqual(float(row["magnitude"]), speed, 12)
            for k, v in (("unit_x", -y), ("unit_y", x), ("unit_z", 3 * z)):
                self.assertAlmostEqual(float(row[k]), v / speed, 12)
        self.refused("sample", self.dir / "linear.vdb", "--grid", "velocity", "--points", "-",
                     "--derive", "vorticity", says="lambda2", stdin="x,y,z\n")
        self.assertIn("lambda2", run("sample", "--help").stdout)

    @suite.smoke
    def test_sample_refuses_invalid_input_and_all_interpolations_agree_in_a_linear_field(self):
        file = self.dir / "linear.vdb"
        self.refused("sample", file, "--points", "-", says="more than one grid", stdin="x,y,z\n")
        self.refused("sample", file, "--grid", "densty", "--points", "-", says='"density"',
                     stdin="x,y,z\n")
        for text, says in (("", "empty"), ("a,b\n", "header x,y,z"), ("x,y,z\n1,2\n", "line 2"),
                           ("x,y,z\n1,2,nan\n", "finite")):
            self.refused("sample", file, "--grid", "density", "--points", "-", says=says,
                         stdin=text)
        self.refused("sample", file, "--grid", "density", "--points", "-", "--derive", "curl",
                     says="scalar", stdin="x,y,z\n")
        self.refused("sample", file, "--grid", "density", "--points", "-", "--interpolation",
                     "quintic", says="quadratic", stdin="x,y,z\n")
        # The field is linear, so every interpolation gives the voxel's value at its centre.
        values = [run("sample", file, "--grid", "density", "--points", "-", "--interpolation", order,
                      stdin="x,y,z\n1,2,3\n").stdout.splitlines()[1].split(",")[4]
                  for order in ("trilinear", "nearest", "quadratic", "cubic")]
        for value in values:
            self.assertAlmostEqual(float(value), float(values[0]), delta=1e-5)


class Solve(Case):
    PLANE = {"kind": "plane", "position": [0, 0, 0], "direction": [0, 0, 2], "strength": 1.5}

    def solve(self, *lines, status=0):
        text = "\n".join(line if isinstance(line, str) else json.dumps(line) for line in lines)
        return [json.loads(line) for line in run("solve", stdin=text + "\n",
                                                 status=status).stdout.splitlines()]

    def test_the_command_solve_uses_the_closed_form_for_a_single_plane(self):
        [held, yielded] = self.solve(
            {"stiffness": 500, "probe": [0, 0, -0.001], "primitives": [self.PLANE]},
            {"stiffness": 500, "probe": [0, 0, -0.01], "primitives": [self.PLANE]})
        self.assertEqual(held["force"], [0, 0, 0.5])
        self.assertEqual(held["status"], "converged")
        self.assertEqual(held["solver"], "closed-form")
        self.assertAlmostEqual(yielded["force"][2], 1.5)

    @suite.smoke
    def test_the_command_solve_balances_two_primitives_with_the_general_solver(self):
        other = {"kind": "point", "position": [0, 0, 0], "strength": 0.5}
        [answer] = self.solve({"stiffness": 500, "probe": [0.004, 0, -0.001], "start": [0, 0, 0],
                               "primitives": [self.PLANE, other]})
        self.assertEqual(answer["solver"], "general")
        self.assertLess(answer["error_bound"], 1e-8)
        self.assertAlmostEqual(answer["force"][0], -0.5, places=6)

    def test_an_input_that_cannot_be_read_to_its_end_is_refused(self):
        # Reading this file fails, because no memory is mapped at address 0.
        failing = "/proc/self/mem"
        for verb, *words in (("solve",), ("sample", self.dir / "ball.vdb", "--points")):
            self.refused(verb, *words, failing, says="reading failed")
            with open(failing, encoding="utf-8") as stdin:
                done = process.run([PALPATE, verb, *map(str, words), "-"], stdin=stdin,
                                      capture_output=True, text=True, timeout=300)
            self.assertEqual((done.returncode, done.stdout), (2, ""), done.stderr)
            self.assertIn("reading failed", done.stderr)

    def test_the_command_solve_puts_the_proxy_at_the_probe_without_primitives(self):
        [answer] = self.solve({"stiffness": 1, "probe": [1, 2, 3], "primitives": []})
        self.assertEqual((answer["proxy"], answer["force"]), ([1, 2, 3], [0, 0, 0]))

    @suite.smoke
    def test_the_command_solve_reports_invalid_lines_and_solves_the_others(self):
        good = {"stiffness": 500, "probe": [0, 0, -0.001], "primitives": [self.PLANE]}

        def but(**change):
            return {**good, **change}

        def primitive(**change):
            return but(primitives=[{**self.PLANE, **change}])

        bad = ["{", "[]", "1", but(stiffness=0), but(stiffness=-5), but(stiffness="x"),
               but(probe=[0, 0]), but(probe=[0, 0, None]), but(stifness=1),
               primitive(strength=-1), primitive(kind="sphere"), primitive(direction=[0, 0, 0]),
               primitive(position=None), primitive(strenght=1), but(primitives={}),
               '{"stiffness": 1e999, "probe": [0,0,0]}', '{"stiffness": NaN, "probe": [0,0,0]}']
        answers = self.solve(good, *bad, good, status=2)
        self.assertEqual(len(answers), len(bad) + 2)
        self.assertEqual(answers[0], answers[-1])
        for answer in answers[1:-1]:
            self.assertEqual(answer["status"], "bad-input")
            self.assertIsNone(answer["proxy"])
            self.assertIsNone(answer["force"])
            self.assertIsNone(answer["error_bound"])
            self.assertTrue(answer["message"])


class Check(Case):
    @suite.smoke
    def test_the_command_check_prints_the_compiled_graph_of_modes(self):
        out = run("check", self.dir / "mixed.vdb")
        self.assertIn("isosurface of ball", out.stdout)
        self.assertIn("labels", out.stderr)
        data = json.loads(run("check", self.dir / "ball.vdb", "--json").stdout)
        self.assertEqual(data["sampled"][0]["field"], "ball")

    @suite.smoke
    def test_the_command_check_lists_volumes_that_are_computed_at_load(self):
        scene = self.dir / "speed.json"
        scene.write_text(json.dumps({
            "palpate": 1, "volumes": {"flow": {"file": "linear.vdb", "grid": "velocity"}},
            "fields": {"speed": {"magnitude": "flow"}, "way": {"unit": "flow"}},
            "modes": [{"name": "wall", "mode": "isosurface", "of": "speed", "value": 3,
                       "strength": 1}]}))
        lines = run("check", scene).stdout.splitlines()
        line = next(l for l in lines if l.startswith("volume    speed: "))
        self.assertIn('magnitude of flow, computed once at load because mode "wall" needs its '
                      "gradient, float, 729 active voxels, ", line)
        self.assertIn(" MB; ", line)
        self.assertIn("skipped   flow: no mode reads it; at load it was the source of speed", lines)
        self.assertIn("skipped   way: no mode reads it", lines)
        data = json.loads(run("check", scene, "--json").stdout)
        self.assertEqual(data["volumes"]["speed"]["from"], "flow")
        self.assertGreater(data["volumes"]["speed"]["memory_bytes"], 729 * 4)
        self.assertEqual([s["field"] for s in data["sampled"]], ["speed"])
        run("feel", scene, "--seconds", "0.1")
        data = json.loads(scene.read_text())
        data["modes"][0].update(mode="follow", of="way")
        del data["modes"][0]["value"]
        scene.write_text(json.dumps(data))
        self.assertIn("derives   unit of flow", run("check", scene).stdout)

    @suite.smoke
    def test_the_command_check_reports_a_surface_that_leaves_its_data(self):
        scene = self.dir / "edge.json"
        mode = {"name": "tip", "mode": "isosurface", "of": "it", "value": 0, "solid": "below", "strength": 1}
        it = {"file": "ball.vdb", "grid": "ball", "place": {"scale": 0.01, "translate": [1, 0, 0]}}
        text = {"palpate": 1, "volumes": {"it": it}, "modes": [mode]}

        def edge():
            scene.write_text(json.dumps(text))
            told = [l for l in run("check", scene).stdout.splitlines() if l.startswith("edge ")]
            data = json.loads(run("check", scene, "--json").stdout)
            return told, data["modes"][0]["edge"], data["volumes"]["it"]

        told, found, volume = edge()
        self.assertEqual((told, found["open_cells"], found["open_at"]), ([], 0, None))
        self.assertGreater(found["surface_cells"], 1000)
        # The band ends three voxels outside the surface, so a surface at 2.9 voxels reaches the edge of the data.
        mode["value"] = 2.9 * volume["voxel"] / volume["metres_per_unit"]
        (line,), found, _ = edge()
        share = f"{100 * found['open_cells'] / found['surface_cells']:.2g}"
        self.assertRegex(line, r"^edge      tip: in \d+ cells the surface reaches the edge of its data \(" + share +
                               r" % of the surface is not felt\), first at \(.*\) m: there the force drops to zero "
                               r"within one tick: use a wider band or a larger volume$")
        self.assertIn(f" {found['open_cells']} cells", line)
        self.assertGreater(found["open_cells"], 1000)
        # The ball has a radius of 2 units. Its band ends at 2.3.
        self.assertAlmostEqual(math.dist(found["open_at"], [1, 0, 0]), 0.023, delta=0.002)
        it["interpolation"] = "cubic"
        self.assertEqual(edge()[:2], ([], None))
        # The command check examines the edges of isosurfaces only.
        mode.update(mode="surface")
        for key in ("value", "solid"):
            del mode[key]
        scene.write_text(json.dumps(text))
        self.assertNotIn("edge", json.loads(run("check", scene, "--json").stdout)["modes"][0])

    @suite.smoke
    def test_the_command_check_refuses_invalid_scenes(self):
        scene = self.dir / "bad.json"
        scene.write_text('{"palpate": 1, "volumes": {"a": {"file": "gone.vdb"}}, "modes": '
                         '[{"mode": "surface", "of": "a", "strength": 1}]}')
        for verb in ("check", "feel"):
            self.refused(verb, scene, says="/volumes/a")
        scene.write_text("{")
        self.refused("check", scene, says="not valid JSON")
        self.refused("check", self.dir / "gone.json", says="no such file")
        self.refused("check", self.dir / "nan.vdb", says="NaN")
        os.mkfifo(self.dir / "pipe.json")
        os.symlink("round.json", self.dir / "round.json")
        for file in (self.dir / "pipe.json", "/dev/zero"):
            self.refused("check", file, says="it is a folder, a pipe or a device")
        self.refused("check", self.dir / "round.json", says="symbolic links")

    @suite.smoke
    def test_the_command_feel_refuses_a_stiffness_above_the_device_s_limit(self):
        scene = self.dir / "stiff.json"
        scene.write_text('{"palpate": 1, "coupling": {"stiffness": 4000}, "volumes": {"a": {"file":'
                         ' "ball.vdb"}}, "modes": [{"mode": "isosurface", "of": "a", "value": 0, '
                         '"solid": "below", "strength": 1}]}')
        run("check", scene)
        self.refused("feel", scene, says="/coupling/stiffness")


class Room(Case):
    """Tests of the stability margin of a coupling, and of the energy tank."""
    def test_the_two_commands_check_and_feel_report_the_same_stability_margin(self):
        ball = self.dir / "undamped.json"
        ball.write_text('{"palpate": 1, "volumes": {"a": {"file": "ball.vdb"}}, "modes": [{"mode": '
                        '"isosurface", "of": "a", "value": 0, "solid": "below", "strength": 1}]}')
        checked = json.loads(run("check", ball, "--json").stdout)["coupling"]["room"]
        self.assertAlmostEqual(checked["passive"], 1000 / 3, places=6)
        self.assertGreater(checked["stable"], 3000)
        felt = json.loads(run("feel", ball, "--seconds", 2, "--json").stdout)
        self.assertEqual(felt["room"], checked)
        self.assertEqual(felt["tank"]["use"], "observe")
        kept = json.loads(run("feel", ball, "--seconds", 2, "--passive", "--json").stdout)
        self.assertEqual(kept["tank"]["use"], "act")
        self.assertGreaterEqual(kept["tank"]["energy_min"], -1e-9)
        self.assertEqual(kept["tank"]["debt"], 0)

    @suite.smoke
    def test_the_command_check_reports_the_largest_allowed_stiffness_if_the_scene_s_is_above(self):
        scene = self.dir / "stiff.json"
        scene.write_text(json.dumps({
            "palpate": 1, "coupling": {"stiffness": 9000},
            "volumes": {"ball": {"file": "ball.vdb", "place": {"fit": 0.05}}},
            "modes": [{"mode": "isosurface", "of": "ball", "value": 0, "strength": 3, "solid": "below"}]}))
        told = run("check", scene)
        for text in (told.stdout, told.stderr):
            self.assertIn("stiffness 9000 N/m: above the limit of the simulated arm: use at most 1000 N/m\n", text)
        os.remove(scene)

    def room(self, *words):
        """Returns the lines about the stability margin in a command's report."""
        lines = run(*words).stdout.splitlines()
        at, = (i for i, line in enumerate(lines) if line.startswith("stability "))
        return [lines[at]] + [line for line in lines[at + 1:at + 2] if line.startswith(" ")]

    def test_the_stability_margin_is_one_line_and_option_verbose_adds_a_line_of_numbers(self):
        scene = self.dir / "room.json"

        def asked(**coupling):
            scene.write_text(json.dumps({
                "palpate": 1, "coupling": coupling,
                "volumes": {"ball": {"file": "ball.vdb", "place": {"fit": 0.05}}},
                "modes": [{"mode": "isosurface", "of": "ball", "value": 0, "strength": 3,
                           "solid": "below"}]}))
            return scene
        self.assertEqual(self.room("check", asked(stiffness=500, damping=0)), [
            "stability stiffness 500 N/m: stable on the simulated arm while held (limit 3726 N/m; "
            "palpate allows at most 1000 N/m); may oscillate when released (limit 333.3 N/m)"])
        self.assertEqual(self.room("check", asked(stiffness=300, damping=0)), [
            "stability stiffness 300 N/m: stable on the simulated arm, held or released"])
        self.assertIn("; may oscillate when released (at any stiffness)",
                      self.room("check", asked(stiffness=500, damping=0.5))[0])
        for verb in (("check",), ("feel", "--seconds", 1)):
            self.assertEqual(len(self.room(*verb, scene)), 1, verb)
            for more in ("-v", "--verbose"):
                _, numbers = self.room(*verb, scene, more)
                self.assertRegex(numbers, r"^ {10}coupling of 500 N/m and 0.5 N s/m at 1000 Hz: "
                                          r"passive with any hand up to .* oscillations of up to [\d.]+ mm; "
                                          r"it would be passive")
        os.remove(scene)


class Feel(Case):
    HEADER = ("t,probe_x,probe_y,probe_z,proxy_x,proxy_y,proxy_z,force_x,force_y,force_z,"
              "error_bound,iterations,substeps,primitives,tick_ns,status,limited,waiting")

    def path(self, rows):
        file = self.dir / "path.csv"
        file.write_text("t,x,y,z\n" + "".join(",".join(map(str, r)) + "\n" for r in rows))
        return f"path:{file}"

    @suite.smoke
    def test_a_recorded_path_that_presses_a_ball_gives_the_expected_forces(self):
        # A ball of radius 2 units, scaled such that the bounds of its narrow band are 0.1 m.
        low, high = json.loads(run("info", self.dir / "ball.vdb", "--json").stdout)["grids"][0][
            "bounds"]
        radius = 0.1 / (high[0] - low[0]) * 2.0
        device = self.path([(0, 0, 0, 0.06), (0.2, 0, 0, radius - 0.004), (0.3, 0, 0, radius - 0.004)])
        trace = self.dir / "trace.csv"
        done = run("feel", self.dir / "ball.vdb", "--device", device, "--trace", trace,
                   "--summary", "-")
        summary = json.loads(done.stdout)
        text = trace.read_text()
        self.assertTrue(text.startswith(self.HEADER + ",load_"), text.splitlines()[0])
        rows = list(csv.DictReader(io.StringIO(text)))
        self.assertEqual(len(rows), 301)
        self.assertEqual(summary["ticks"], 301)
        first = rows[0]
        self.assertEqual([first["proxy_x"], first["proxy_y"], first["proxy_z"]],
                         [first["probe_x"], first["probe_y"], first["probe_z"]])
        last = rows[-1]
        force = [float(last[f"force_{a}"]) for a in "xyz"]
        self.assertAlmostEqual(force[2], 500 * 0.004, delta=0.03)
        self.assertLess(math.hypot(force[0], force[1]), 0.01)
        self.assertEqual((last["status"], last["limited"]), ("converged", "0"))
        self.assertEqual(summary["status"]["converged"], 301)
        self.assertIn("p99.9", summary["tick_ns"])
        self.assertLessEqual(summary["force_max"], 3.0 + 1e-9)
        self.assertTrue(summary["machine"]["processor"])
        os.remove(trace)

    def trace(self, scene, device, *words):
        """Returns a trace's header and rows."""
        lines = io.StringIO(run("feel", scene, "--device", device, "--trace", "-", *words).stdout)
        table = csv.DictReader(lines)
        return table.fieldnames, list(table)

    def scene_of(self, *modes):
        scene = self.dir / "loads.json"
        scene.write_text(json.dumps({
            "palpate": 1, "coupling": {"stiffness": 500, "damping": 0},
            "volumes": {name: {"file": "linear.vdb", "grid": grid,
                               "place": {"scale": 0.01, "translate": [0, 0, 0]}}
                        for name, grid in (("d", "density"), ("v", "velocity"))},
            "modes": list(modes)}))
        self.addCleanup(os.remove, scene)
        return scene

    def test_the_load_of_a_scene_s_only_mode_equals_the_force(self):
        into = [c / math.sqrt(6) for c in (1, 2, -1)]
        wall = {"name": "wall", "mode": "isosurface", "of": "d", "value": 4, "strength": 3}
        places = [[0.02 + depth * c for c in into] for depth in (-0.002, 0.003, 0.003)]
        device = self.path([(0.2 * i, *place) for i, place in enumerate(places)])
        header, rows = self.trace(self.scene_of(wall), device)
        self.assertEqual(",".join(header), self.HEADER + ",load_wall")
        self.assertEqual(rows[0]["load_wall"], "0")
        self.assertAlmostEqual(float(rows[-1]["load_wall"]), 500 * 0.003, places=9)
        for row in rows:
            force = math.hypot(*(float(row[f"force_{a}"]) for a in "xyz"))
            self.assertAlmostEqual(float(row["load_wall"]), force, places=9)

    def test_the_loads_in_a_trace_equal_those_of_the_command_explain(self):
        wall = {"name": "wall", "mode": "isosurface", "of": "d", "value": 4, "strength": 3,
                "friction": 0.4}
        drag = {"name": "drag", "mode": "viscosity", "of": "d", "strength": 0.3}
        pull = {"name": "pull", "mode": "force", "of": "v", "strength": 0.2}
        scene = self.scene_of(wall, drag, pull)
        at, push = (0.02, 0.02, 0.02), (0.0015, 0.001, -0.002)
        told = json.loads(run("explain", scene, "--at", "0.02,0.02,0.02", "--push",
                              "0.0015,0.001,-0.002", "--json").stdout)
        self.assertEqual(told["rest"]["ticks"], 1)
        device = self.path([(0, *at), (0.001, *(a + p for a, p in zip(at, push)))])
        header, rows = self.trace(scene, device)
        self.assertEqual(header[-3:], ["load_wall", "load_drag", "load_pull"])
        self.assertEqual(len(rows), 2)
        self.assertEqual([mode["name"] for mode in told["modes"]], ["wall", "drag", "pull"])
        for mode in told["modes"]:
            load = math.hypot(*mode["load"])
            self.assertGreater(load, 0.05, mode["name"])
            self.assertAlmostEqual(float(rows[1][f"load_{mode['name']}"]), load, places=9)

    def test_the_load_columns_of_a_trace_have_unique_names(self):
        drag = {"mode": "viscosity", "of": "d", "strength": 0.3}
        names = ["a, b", 'a"', "a\n", "drag", "drag", "größe"]
        scene = self.scene_of(drag, *({"name": name, **drag} for name in names))
        header, rows = self.trace(scene, self.path([(0, 0.02, 0.02, 0.02), (0.1, 0.02, 0.02, 0.03)]))
        self.assertEqual(header[18:], ["load_/modes/0", "load_a_ b", "load_a_", "load_a__2",
                                       "load_drag", "load_drag_2", "load_größe"])
        self.assertEqual(",".join(header[:18]), self.HEADER)
        for name in header[18:]:
            self.assertAlmostEqual(float(rows[-1][name]), 0.3, places=6)

    @suite.smoke
    def test_the_summary_of_a_run_agrees_with_its_trace(self):
        # The scene has a surface and two drags, so a balance on the surface has more than two primitives.
        scene = self.dir / "drag.json"
        scene.write_text('{"palpate": 1, "volumes": {"a": {"file": "ball.vdb"}}, "modes": ['
                         '{"mode": "isosurface", "of": "a", "value": 0, "solid": "below", '
                         '"strength": 3}, {"mode": "viscosity", "of": "a", "strength": 0.2}, '
                         '{"mode": "viscosity", "of": "a", "strength": 0.1}]}')
        device = self.path([(0, 0, 0, 0.06), (0.2, 0, 0, 0.04), (0.4, 0.01, 0, 0.04)])
        trace = self.dir / "trace.csv"
        summary = json.loads(run("feel", scene, "--device", device, "--trace", trace,
                                 "--summary", "-").stdout)
        rows = list(csv.DictReader(io.StringIO(trace.read_text())))
        self.assertEqual(summary["ticks"], len(rows))
        self.assertEqual(summary["limited"], sum(row["limited"] == "1" for row in rows))
        self.assertEqual(sum(summary["solver"].values()), len(rows))
        self.assertGreater(summary["solver"]["general"], 0)
        self.assertLessEqual(summary["solver"]["general"],
                             sum(row["iterations"] != "0" for row in rows))
        self.assertEqual(sum(summary["status"].values()), len(rows))
        os.remove(trace)

    def test_a_hand_out_of_range_cuts_the_force(self):
        device = self.path([(0, 0, 0, 0.03), (0.01, 0, 0, 0.03), (0.02, 1e7, 0, 0)])
        trace = self.dir / "trace.csv"
        done = run("feel", self.dir / "ball.vdb", "--device", device, "--trace", trace,
                   "--summary", "-", status=1)
        self.assertIn("the force was cut", done.stderr)
        rows = list(csv.DictReader(io.StringIO(trace.read_text())))
        faults = [row for row in rows if row["status"] == "fault"]
        self.assertGreater(len(faults), 0)
        for row in faults:
            self.assertEqual([float(row[f"force_{a}"]) for a in "xyz"], [0, 0, 0])
        summary = json.loads(done.stdout)
        self.assertEqual(summary["status"]["fault"], len(faults))
        self.assertEqual(sum(summary["status"].values()), len(rows))
        os.remove(trace)

    def test_two_equal_runs_give_equal_forces(self):
        runs = [run("feel", self.dir / "mixed.vdb", "--seconds", 3, "--trace", "-").stdout
                for _ in range(2)]
        drop = [[r[:14] + r[15:] for r in csv.reader(io.StringIO(text))] for text in runs]
        self.assertEqual(drop[0], drop[1])
        self.assertEqual(len(drop[0]), 3001)

    @suite.smoke
    def test_the_command_feel_accepts_a_folder_of_volumes_as_a_scene(self):
        folder = self.dir / "some"
        folder.mkdir()
        (folder / "ball.vdb").write_bytes((self.dir / "ball.vdb").read_bytes())
        out = run("feel", folder, "--seconds", 2).stdout
        self.assertIn("contact", out)

    @suite.smoke
    def test_a_refused_command_feel_leaves_no_files(self):
        ball = self.dir / "ball.vdb"
        self.refused("feel", ball, "--device", "hid", says="add --realtime")
        self.refused("feel", ball, "--device", "pid", says="is not a device of this version")
        self.refused("feel", ball, "--device", "path:/none.csv", says="/none.csv")
        self.refused("feel", ball, "--device", "path:/dev/zero", says="it is a pipe or a device")
        self.refused("feel", ball, "--device", "path:-", says="empty")
        self.refused("feel", ball, "--rate", 0, says="--rate")
        self.refused("feel", ball, "--trace", ball, says="it is an input")
        self.refused("feel", ball, "--picture", "-", says=".png")
        same = self.dir / "same"
        self.refused("feel", ball, "--trace", same, "--summary", same, says="two outputs")
        same_again = f"{self.dir}/./{Path(same).name}"
        self.refused("feel", ball, "--trace", same, "--summary", same_again, says="two outputs")
        from_here = os.path.relpath(same)
        self.refused("feel", ball, "--trace", from_here, "--summary", same, says="two outputs")
        self.refused("feel", ball, "--trace", from_here, "--summary", f"./{from_here}",
                     says="two outputs")
        self.refused("feel", ball, "--trace", "-", "--json", says="two outputs")
        self.refused("feel", ball, "--rate", "nan", says="--rate")
        self.refused("feel", ball, "--seconds", -1, says="--seconds")
        self.refused("feel", ball, "--trace", "/no/such/place/t.csv", says="cannot be written")
        self.refused("feel", ball, "--picture", "/no/such/place/p.png", says="cannot be written")

    def test_output_that_cannot_be_written_is_an_error(self):
        ball = str(self.dir / "ball.vdb")
        for words in (("--help",), ("--version",), ("help", "feel"), ("feel", "--help"),
                      ("info", ball), ("check", ball), ("feel", ball, "--seconds", "1", "--json"),
                      ("feel", ball, "--seconds", "1", "--trace", "-")):
            with open("/dev/full", "w") as full:
                done = process.run([PALPATE, *words], stdout=full, stderr=subprocess.PIPE,
                                      text=True, timeout=60)
            self.assertIn(done.returncode, (1, 2), words)
            self.assertEqual(len(done.stderr.splitlines()), 1, done.stderr)

    @suite.smoke
    def test_an_output_to_a_symbolic_link_is_written_and_one_to_a_pipe_or_device_is_refused(self):
        ball = str(self.dir / "ball.vdb")
        link = self.dir / "link.csv"
        link.symlink_to(self.dir / "behind.csv")
        run("feel", ball, "--seconds", 1, "--trace", link)
        self.assertTrue(link.is_symlink())
        self.assertTrue((self.dir / "behind.csv").read_text().startswith("t,probe_x"))
        os.remove(link)
        os.remove(self.dir / "behind.csv")
        pipe = self.dir / "pipe"
        os.mkfifo(pipe)
        for place in ("/dev/null", pipe):
            for what in ("--trace", "--summary"):
                self.refused("feel", ball, "--seconds", 1, what, place,
                             says="it is a pipe or a device")
        os.remove(pipe)

    def test_an_output_is_not_written_through_links_at_guesses_of_its_temporary_name(self):
        place = self.dir / "shared"
        place.mkdir()
        precious = self.dir / "precious"
        precious.write_text("precious")
        # An attacker can guess the process id in the name of the temporary file, but not the rest.
        for pid in range(os.getpid(), os.getpid() + 2000):
            (place / f"t.csv.partial-{pid}").symlink_to(precious)
        run("feel", self.dir / "ball.vdb", "--seconds", 1, "--trace", place / "t.csv")
        self.assertEqual(precious.read_text(), "precious")
        self.assertTrue((place / "t.csv").read_text().startswith("t,probe_x"))
        self.assertFalse((place / "t.csv").is_symlink())
        shutil.rmtree(place)
        os.remove(precious)

    def test_a_hand_that_begins_inside_a_solid_is_reported(self):
        path = self.dir / "inside.csv"
        path.write_text("t,x,y,z\n0,0,0,0\n1,0.001,0,0\n", encoding="utf-8")
        said = run("feel", self.dir / "ball.vdb", "--device", f"path:{path}", status=4).stderr
        self.assertIn("it was inside the solid of ", said)

    def test_a_run_whose_arm_is_never_ready_reports_this_and_ends_with_status_4(self):
        done = run("feel", self.dir / "ball.vdb", "--device", "simulated:released@0", "--seconds", 1, "--json",
                   status=4)
        self.assertIn("the hand felt no force: modes acted, but the arm was not ready", done.stderr)
        self.assertFalse(json.loads(done.stdout)["felt_anything"])

    def test_a_hand_that_enters_a_solid_without_strength_is_not_reported_as_beginning_inside(self):
        scene = self.dir / "weak.json"
        scene.write_text(json.dumps({"palpate": 1, "volumes": {"a": {"file": "ball.vdb"}}, "modes": [
            {"mode": "isosurface", "of": "a", "value": 0, "solid": "below", "strength": 0}]}), encoding="utf-8")
        path = self.dir / "into.csv"
        path.write_text("t,x,y,z\n0,0.08,0,0\n1,0,0,0\n", encoding="utf-8")
        said = run("feel", scene, "--device", f"path:{path}", status=4).stderr
        self.assertIn("the hand felt no force: it touched no active mode", said)

    @suite.smoke
    def test_a_run_without_force_is_reported_and_ends_with_status_4(self):
        scene = self.dir / "high.json"
        scene.write_text('{"palpate": 1, "volumes": {"a": {"file": "ball.vdb"}}, "modes": [{"mode":'
                         ' "isosurface", "of": "a", "value": 50, "strength": 1}]}')
        self.assertIn("outside the grid", run("check", scene).stderr)
        done = run("feel", scene, "--seconds", 1, "--json", status=4)
        self.assertIn("the hand felt no force", done.stderr)
        nothing = json.loads(done.stdout)
        self.assertFalse(nothing["felt_anything"])
        self.assertEqual(nothing["felt_share"], 0)
        self.assertIsNone(nothing["most"])
        self.assertIsNone(nothing["felt"][0]["at"])
        self.assertEqual(nothing["search"]["met"], 0)
        trace = self.dir / "nothing.csv"
        felt = run("feel", scene, "--seconds", 1, "--trace", trace, status=4).stdout
        self.assertNotIn("palpate explain", felt)
        self.assertEqual(len(trace.read_text().splitlines()), 1001)
        self.assertIn("4 if the hand felt no force", run("feel", "--help").stdout)
        # If one of two hands felt a force, the status is 0.
        ball = self.dir / "ball.vdb"
        away, near = (self.dir / f"{name}.csv" for name in ("away", "near"))
        away.write_text("t,x,y,z\n0,0.5,0,0\n0.1,0.5,0,0\n")
        near.write_text("t,x,y,z\n0,0.06,0,0\n1,0.04,0,0\n")
        run("feel", ball, "--device", f"path:{away}", status=4)
        run("feel", ball, "--device", f"path:{away}", "--device", f"path:{near}")
        # A fault gives status 1, also if the hand felt no force.
        away.write_text("t,x,y,z\n0,0.5,0,0\n0.01,0.5,0,0\n0.02,1e7,0,0\n")
        run("feel", ball, "--device", f"path:{away}", status=1)

    @suite.smoke
    def test_a_slow_rate_is_reported_once(self):
        ball = self.dir / "ball.vdb"
        at = ("--at", "-0.06,0,0")
        for words in (("feel", ball, "--seconds", 2), ("press", ball, *at, "--along", "0.01,0,0"),
                      ("explain", ball, *at, "--push", "-.001,0,0")):
            said = run(*words, "--rate", 10, statuses=(0, 1, 4)).stderr
            self.assertEqual(said.count(f"palpate: {words[0]}: --rate: at 10 Hz a hand at 0.1 m/s moves 10 mm "
                                        "between two ticks: "), 1, said)
            self.assertNotIn("--rate", run(*words, "--rate", 500, statuses=(0, 4)).stderr)

    @suite.smoke
    def test_the_report_ends_with_a_command_that_explains_the_largest_force(self):
        place = self.dir / "it's a ball.vdb"
        place.write_bytes((self.dir / "ball.vdb").read_bytes())
        felt = json.loads(run("feel", place, "--json").stdout)
        self.assertTrue(felt["felt_anything"])
        self.assertGreater(felt["felt_share"], 0.3)
        self.assertGreater(felt["most"]["force"], 2.0)
        self.assertEqual(felt["most"]["mode"], felt["felt"][0]["mode"])
        self.assertEqual(len(felt["felt"][0]["at"]), 3)
        before, last = run("feel", place).stdout.splitlines()[-2:]
        self.assertRegex(before, r"^strongest [\d.]+ N after [\d.]+ s.*, mainly from .* \(spring [\d.]+ N.*\): "
                         "to explain it, run:$")
        words = shlex.split(last)
        self.assertEqual(words[:3], ["palpate", "explain", str(place)])
        self.assertEqual(last, felt["most"]["explain"])
        explains(self, felt)
        os.remove(place)

    @suite.smoke
    def test_the_command_explain_reproduces_the_force_of_runs_with_other_rates_paths_hands_and_recordings(self):
        ball = self.dir / "ball.vdb"
        path = self.dir / "press.csv"
        path.write_text("t,x,y,z\n0,0.07,0,0\n1,0.04,0.01,0\n2,0.045,-0.02,0.01\n", encoding="utf-8")
        recording = self.dir / "run.rec"
        for words in (("--rate", 250), ("--rate", 3000, "--seconds", 4), ("--passive", "--refill", 0.1),
                      ("--device", f"path:{path}"), ("--device", f"path:{path}", "--device", "simulated"),
                      ("--record", recording), ("--device", f"replay:{recording}@1")):
            with self.subTest(words):
                felt = json.loads(run("feel", ball, *words, "--json").stdout)
                for hand in felt.get("hands", [felt]):
                    told = explains(self, hand)
                    self.assertAlmostEqual(told["force"]["size"], hand["most"]["force"], delta=1e-3)
        felt = json.loads(run("feel", recording, "--device", f"replay:{recording}", "--json").stdout)
        explains(self, felt)
        self.refused("explain", ball, "--device", f"replay:{recording}@1", "--until", 0.5,
                     says="--until: no tick is at this time; the next is at 1 s: give this time")
        os.remove(recording)

    @suite.smoke
    def test_the_command_explain_states_reasons_in_its_second_line_and_refuses_invalid_options(self):
        ball = self.dir / "ball.vdb"
        felt = json.loads(run("feel", ball, "--json").stdout)
        lines = run(*shlex.split(felt["most"]["explain"])[1:]).stdout.splitlines()
        self.assertTrue(lines[1].startswith("because "), lines)
        self.assertIn(f"time      {felt['most']['time']:g} s", lines)
        self.refused("explain", ball, "--until", 11, says="--until: the run ends after")
        self.refused("explain", ball, "--until", 5000, "--seconds", 5000, says="ticks are more than 2000000: give an")
        self.refused("explain", ball, "--until", -1, says="--until: -1 s is not in 0 to 1000000 s")
        self.refused("explain", ball, "--until", 1, "--at", "0,0,0", says="give either --until, or --at and --push")
        self.refused("explain", ball, "--until", 1, "--device", "mouse", says="mouse")
        self.refused("explain", ball, "--at", "0,0,0", "--push", "0,0,0", "--passive", says="add --until SECONDS")

    @suite.smoke
    def test_the_suggested_explain_command_reproduces_the_force_of_a_moving_volume(self):
        turns = [{"time": t, "translate": [0, 0, z], "rotation_wxyz": [1, 0, 0, 0]}
                 for t, z in ((0, 0), (10, 0.02))]
        scene = self.dir / "moving.json"
        scene.write_text(json.dumps({
            "palpate": 1, "volumes": {"a": {"file": "ball.vdb", "place": {
                "fit": 0.06, "keyframes": turns}}},
            "modes": [{"mode": "isosurface", "of": "a", "value": 0, "solid": "below",
                       "strength": 2}]}))
        felt = json.loads(run("feel", scene, "--json").stdout)
        self.assertGreater(felt["felt_share"], 0.3)
        self.assertGreater(felt["most"]["time"], 0.5)
        explains(self, felt)
        os.remove(scene)

    @suite.smoke
    def test_two_hands_in_one_scene_get_the_same_forces_as_each_alone(self):
        ball = self.dir / "ball.vdb"
        for name, side in (("left", -1), ("right", 1)):
            (self.dir / f"{name}.csv").write_text(
                "t,x,y,z\n" + "".join(f"{0.01 * i},{side * (0.06 - 0.0002 * i)},0,0\n"
                                      for i in range(101)))
        left, right = (f"path:{self.dir}/{name}.csv" for name in ("left", "right"))
        alone = []
        for k, hand in enumerate((left, right)):
            run("feel", ball, "--device", hand, "--trace", self.dir / f"alone{k}.csv")
            alone.append((self.dir / f"alone{k}.csv").read_text())
        both = json.loads(run("feel", ball, "--device", left, "--device", right, "--trace",
                              self.dir / "both.csv", "--json").stdout)
        self.assertEqual(len(both["hands"]), 2)
        self.assertGreater(min(hand["force_max"] for hand in both["hands"]), 1.0)

        def felt(text):
            """Returns the rows of a trace without the tick times."""
            return [row.split(",")[:14] + row.split(",")[15:] for row in text.splitlines()]
        for place, text in zip(("both.csv", "both.2.csv"), alone):
            self.assertEqual(felt((self.dir / place).read_text()), felt(text))
            os.remove(self.dir / place)
        self.refused("feel", ball, "--device", left, "--device", right, "--trace", "-",
                     says="would be mixed")
        self.refused("feel", ball, *(["--device", left] * 5), says="give one to four")

    def test_invalid_realtime_options_are_refused(self):
        ball = self.dir / "ball.vdb"
        self.refused("feel", ball, "--realtime", "--rate", 100, says="100 Hz is not in 500 to 20000 Hz")
        self.refused("feel", ball, "--realtime", "--rate", 30000, says="500 to 20000")
        self.refused("feel", ball, "--watch", says="add --realtime")

    @suite.smoke
    def test_the_picture_of_a_run_is_a_png_that_names_the_version(self):
        picture = self.dir / "felt.png"
        run("feel", self.dir / "ball.vdb", "--seconds", 2, "--picture", picture)
        self.assertIn(run("--version").stdout.splitlines()[0].encode(), picture.read_bytes())
        self.assertEqual(picture.read_bytes()[:8], b"\x89PNG\r\n\x1a\n")
        os.remove(picture)


class OnTime(Case):
    """Tests that use a real clock. They do not measure speed."""
    HOST = True

    def until_it_ticks(self, trace):
        """Waits until the trace has rows."""
        end = time.time() + 120
        while time.time() < end:
            if any(f.stat().st_size > 4096 for f in self.dir.glob(trace + ".partial-*")):
                return
            time.sleep(0.01)
        self.fail("the trace got no rows within 120 s")

    def on_time(self, *words):
        """Runs in real time. Returns the summary and the messages. On a busy machine, ticks may be missed and the fault
        "late" may occur."""
        done = process.run([PALPATE, "feel", *map(str, words), "--realtime", "--json",
                            "--reengage", "0"],
                              capture_output=True, text=True, timeout=120)
        self.assertIn(done.returncode, (0, 1), done.stderr)
        summary = json.loads(done.stdout)
        self.assertEqual(done.returncode == 1, summary["faults"] != {})
        return summary, done.stderr

    def test_a_realtime_run_reports_its_timing(self):
        trace = self.dir / "trace.csv"
        summary, _ = self.on_time(self.dir / "ball.vdb", "--seconds", 1.5, "--rate", 2000, "--trace",
                                  trace)
        self.assertEqual(summary["clock"], "real")
        self.assertGreaterEqual(summary["ticks"], 3000)
        self.assertEqual(set(summary["wake_ns"]), {"p50", "p99", "p99.9", "max"})
        self.assertGreater(summary["rate_kept"], 0)
        self.assertGreaterEqual(summary["late_ticks"], 0)
        for key in ("priority", "memory_locked", "cores_awake", "refused", "page_faults",
                    "early_us"):
            self.assertIn(key, summary["realtime"])
        rows = list(csv.DictReader(io.StringIO(trace.read_text())))
        self.assertEqual(len(rows), summary["ticks"] - summary["realtime"]["rows_lost"])
        os.remove(trace)

    WATCHED = ('{"palpate": 1, "volumes": {"a": {"file": "FILE"}}, "modes": [{"name": "%s", '
               '"mode": "isosurface", "of": "a", "value": 0, "solid": "below", "strength": 1}]}')

    def watched(self, scene, text):
        """Starts `palpate feel --watch` with a scene of this text. Returns the process, and a function that waits for
        words in its messages."""
        scene.write_text(text)
        child = subprocess.Popen([PALPATE, "feel", str(scene), "--realtime", "--watch", "--seconds",
                                  "100000", "--json", "--trace", f"{scene}.csv"],
                                 stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

        def until(words):
            """Waits for the words. Skips other lines, such as faults on a busy machine."""
            for line in child.stderr:
                if words in line:
                    return
            self.fail(f"the run ended without the message {words}")

        self.until_it_ticks(f"{scene.name}.csv")
        return child, until

    def felt(self, child):
        """Ends the run. Returns the name of the only mode of each scene of the run."""
        child.send_signal(signal.SIGINT)
        out, _ = child.communicate(timeout=60)
        self.assertEqual(child.returncode, 130)
        felt = [mode["mode"] for mode in json.loads(out)["felt"]]
        self.assertEqual(json.loads(out)["scenes"], len(felt))
        return felt

    def test_a_run_loads_a_changed_scene_but_not_an_invalid_one(self):
        scene = self.dir / "watched.json"
        text = self.WATCHED.replace("FILE", "ball.vdb")
        child, until = self.watched(scene, text % "before")

        def change(content):
            (self.dir / "new.json").write_text(content)
            os.replace(self.dir / "new.json", scene)

        change("{broken")
        until("not valid JSON")
        change(text % "after")
        until("the new scene is active")
        # Edits the scene again, perhaps while the last scene is still being built.
        change(text % "last")
        until("the new scene is active")
        self.assertEqual(self.felt(child), ["before", "after", "last"])

    def test_after_an_edit_the_report_states_the_force_that_its_explain_command_gives(self):
        scene = self.dir / "softer.json"
        text = self.WATCHED.replace("FILE", "ball.vdb") % "skin"
        child, until = self.watched(scene, text)

        def pressed():
            for trace in self.dir.glob(scene.name + ".csv.partial-*"):
                rows = list(csv.reader(io.StringIO(trace.read_text())))[1:-1]
                return any(math.hypot(*map(float, row[7:10])) > 0.5 for row in rows)
        end = time.time() + 120
        while not pressed():
            self.assertLess(time.time(), end)
            time.sleep(0.1)
        scene.write_text(text.replace('"strength": 1', '"strength": 0.01'))
        until("the new scene is active")
        child.send_signal(signal.SIGINT)
        most = json.loads(child.communicate(timeout=60)[0])["most"]
        self.assertGreater(most["force"], 0.5)
        told = json.loads(run(*shlex.split(most["explain"])[1:], "--json").stdout)
        self.assertAlmostEqual(math.hypot(*told["balance"]["spring"]), most["explained"], delta=1e-3)
        self.assertLess(most["explained"], 0.1)

    def test_truncating_a_volume_s_file_does_not_disturb_a_run(self):
        volume = self.dir / "cut.vdb"
        whole = (self.dir / "ball.vdb").read_bytes()
        volume.write_bytes(whole)
        scene = self.dir / "over_cut.json"
        text = self.WATCHED.replace("FILE", "cut.vdb")
        child, until = self.watched(scene, text % "before")
        # Truncates the file in place, as some programs do, instead of replacing it by a renamed file.
        os.truncate(volume, len(whole) // 2)
        scene.write_text(text % "cut")
        until("cut.vdb: it is truncated")
        os.truncate(volume, 0)
        scene.write_text(text % "empty")
        until("cut.vdb: it is not a .vdb file")
        volume.write_bytes(whole)
        scene.write_text(text % "whole")
        until("the new scene is active")
        self.assertEqual(self.felt(child), ["before", "whole"])

    def test_two_hands_can_run_in_real_time(self):
        summary = run("feel", self.dir / "ball.vdb", "--realtime", "--seconds", 1.5, "--device",
                      "simulated", "--device", "simulated", "--json", statuses=(0, 1)).stdout
        hands = json.loads(summary)["hands"]
        self.assertEqual([hand["ticks"] >= 1500 for hand in hands], [True, True])
        self.assertEqual([hand["clock"] for hand in hands], ["real", "real"])

    def test_escape_cuts_the_force_and_enter_clears_the_cut(self):
        main, terminal = pty.openpty()
        child = subprocess.Popen([PALPATE, "feel", str(self.dir / "ball.vdb"), "--realtime",
                                  "--seconds", "100000", "--json"], stdin=terminal,
                                 stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                                 start_new_session=True,
                                 preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0))
        usual = termios.tcgetattr(main)

        def until(words):
            for line in child.stderr:
                if words in line:
                    return
                if words == "on again" and "is cut" in line:
                    os.write(main, b"\r")   # clears a further fault "late"
            self.fail(f"the run ended without the message {words}")

        until("Esc: force off")
        for _ in range(2):
            os.write(main, b"\r\x1b")   # Enter first: it clears a fault "late" of a busy machine
            until("switched off")
            self.assertFalse(termios.tcgetattr(main)[3] & termios.ICANON)
            os.write(main, b"\r")
            until("on again")
        child.send_signal(signal.SIGINT)
        out, _ = child.communicate(timeout=60)
        self.assertEqual(json.loads(out)["faults"]["stopped"], 2)
        self.assertEqual(termios.tcgetattr(main), usual)
        os.close(main)
        os.close(terminal)

    def test_an_interrupted_run_keeps_its_outputs(self):
        summary = self.dir / "interrupted.json"
        # A terminal and a launcher can each send a signal, so several signals can arrive.
        for signals, words in (((signal.SIGINT,), []),
                               ((signal.SIGTERM, signal.SIGINT, signal.SIGTERM), ["--realtime"])):
            child = subprocess.Popen([PALPATE, "feel", str(self.dir / "ball.vdb"), "--seconds",
                                      "100000", "--summary", str(summary), "--trace",
                                      str(self.dir / "interrupted.csv"), *words],
                                     stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
            self.until_it_ticks("interrupted.csv")
            for one in signals:
                child.send_signal(one)
                time.sleep(0.001)
            child.communicate(timeout=60)
            self.assertEqual(child.returncode, 130)
            self.assertGreater(json.loads(summary.read_text())["ticks"], 0)
            self.assertFalse([f for f in os.listdir(self.dir) if "partial" in f])
            os.remove(summary)
            os.remove(self.dir / "interrupted.csv")


class Interrupted(Case):
    """Tests that a command ends within SOON after a signal, and leaves no temporary file."""
    HOST = True
    SOON = 10.0  # [s]; enough for a busy machine

    def setUp(self):
        self.place = Path(tempfile.mkdtemp(dir=self.dir))

    def tearDown(self):
        self.assertEqual(os.listdir(self.place), [])
        self.place.rmdir()

    def wait_for(self, child, there):
        while not there():
            self.assertIsNone(child.poll(), "the command ended before the signal was sent")
            time.sleep(0.01)

    def partial(self):
        return any(".partial-" in name for name in os.listdir(self.place))

    def end(self, how, *words, there=None):
        child = subprocess.Popen([PALPATE, *map(str, words)], cwd=self.place, text=True,
                                 stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        self.wait_for(child, there or self.partial)
        begin = time.monotonic()
        child.send_signal(how)
        _, said = child.communicate(timeout=60)
        self.assertLess(time.monotonic() - begin, self.SOON)
        self.assertEqual(child.returncode, 130, said)
        return said

    def test_an_interrupted_make_writes_no_file(self):
        for how in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            self.assertEqual(self.end(how, "make", "wind-tunnel", "a.vdb", "--voxel", 0.002),
                             "palpate: interrupted: unfinished output was not written\n")

    def test_a_signal_that_was_ignored_at_the_start_stays_ignored(self):
        """nohup makes a run ignore SIGHUP."""
        child = subprocess.Popen(["nohup", PALPATE, "make", "wind-tunnel", "a.vdb", "--voxel", "0.003"],
                                 cwd=self.place, stdout=subprocess.DEVNULL,
                                 stderr=subprocess.DEVNULL)
        self.wait_for(child, self.partial)
        child.send_signal(signal.SIGHUP)
        self.assertEqual(child.wait(120), 0)
        os.remove(self.place / "a.vdb")

    def test_a_run_interrupted_while_it_draws_its_picture_keeps_the_trace(self):
        """The signal comes after the trace was written. The trace must be complete."""
        trace = self.place / "t.csv"
        said = self.end(signal.SIGINT, "feel", self.dir / "ball.vdb", "--seconds", 1, "--trace",
                        "t.csv", "--picture", "p.png", there=trace.exists)
        self.assertIn("the picture was not drawn", said)
        self.assertEqual(len(trace.read_text().splitlines()), 1001)
        os.remove(trace)

    def test_a_terminal_shows_the_progress_until_ctrl_c(self):
        terminal = Terminal([PALPATE, "stability", "--size", 257, "--rate", 20000, "--map",
                             "a.json"], self.place)
        self.assertTrue(terminal.until("mapping: "), terminal.drawn)
        terminal.press(b"\x03")
        status, took = terminal.ended()
        self.assertEqual(status, 130)
        self.assertLess(took, self.SOON)
        # The progress line must be erased.
        self.assertIn("\x1b[K" + "palpate: interrupted", terminal.drawn)

    def test_the_repository_s_scripts_show_their_progress_and_end_on_ctrl_c(self):
        """Tests .ci/watched, with which demo.sh, test.sh and .ci/install run long commands."""
        watched = Path(__file__).resolve().parents[2] / ".ci" / "watched"
        terminal = Terminal(["bash", "-euc", f". '{watched}'; watched building log bash -c "
                             "'trap \"exit 3\" INT; echo [3/9]; while :; do sleep 0.1; done' || exit 1; "
                             "touch on"], self.place)
        # Accepts 1 to 9 s, because a busy machine can skip some of these times.
        self.assertTrue(terminal.until(r"building 0:0[1-9] \[3/9\]"), terminal.drawn)
        terminal.press(b"\x03")
        status, took = terminal.ended()
        self.assertEqual((status, os.listdir(self.place)), (130, ["log"]))
        self.assertLess(took, self.SOON)
        os.remove(self.place / "log")

    def test_a_short_command_shows_no_progress(self):
        terminal = Terminal([PALPATE, "info", self.dir / "ball.vdb"], self.place)
        self.assertEqual(terminal.ended()[0], 0)
        self.assertEqual(terminal.drawn, "")


class Stability(Case):
    def test_the_stability_command_maps_a_set_of_planes_and_a_scene(self):
        # At 250 Hz a map has fewer ticks than at 1 kHz, so it takes less time.
        planes = json.loads(run("stability", "--planes", 20, "--size", 9, "--rate", 250,
                                "--json").stdout)
        self.assertEqual([method["name"] for method in planes["methods"]], ["palpate"])
        solver = planes["methods"][0]
        self.assertEqual([len(row) for row in solver["rows"]], [9] * 9)
        self.assertGreater(solver["rests"], 0.6)

        out = self.dir / "ball"
        ball = ("stability", self.dir / "ball.vdb", "--size", 9, "--rate", 250, "--delay", 0.004,
                "--map")
        words = run(*ball, out).stdout
        self.assertIn("whole tick", words)
        self.assertEqual(Path(f"{out}.png").read_bytes()[:8], b"\x89PNG\r\n\x1a\n")
        self.assertIn("<svg", Path(f"{out}.svg").read_text())
        drawn = json.loads(Path(f"{out}.json").read_text())
        self.assertEqual([method["name"] for method in drawn["methods"]], ["whole tick", "palpate"])
        self.assertAlmostEqual(drawn["boundaries"][0]["passive"], 250 / 3, places=3)
        again = self.dir / "again.json"
        run(*ball, again)
        self.assertEqual(again.read_text(), Path(f"{out}.json").read_text())
        for ending in (".json", ".png", ".svg"):
            os.remove(f"{out}{ending}")
        os.remove(again)

    def test_the_energy_tank_limits_the_force_of_a_moving_volume_unless_it_is_refilled(self):
        """A ball that moves back and forth does work on the hand. The tank limits this work."""
        scene = self.dir / "beating.json"
        place = {"keyframes": [{"time": t, "translate": [0, 0, z], "rotation_wxyz": [1, 0, 0, 0]}
                               for t, z in ((0, 0), (0.1, 0.03), (0.2, 0))],
                 "repeat": True, "fit": 0.1}
        scene.write_text(json.dumps({
            "palpate": 1, "coupling": {"stiffness": 300},
            "volumes": {"ball": {"file": "ball.vdb", "place": place}},
            "modes": [{"mode": "isosurface", "of": "ball", "value": 0, "strength": 3,
                       "solid": "below"}]}))
        felt = {watts: json.loads(run("feel", scene, "--seconds", 5, "--passive", "--refill", watts,
                                      "--json").stdout)["tank"] for watts in (0, 5)}
        self.assertEqual(felt[0]["refilled"], 0.0)
        self.assertGreater(felt[5]["refilled"], 0.0)
        self.assertGreater(felt[0]["force_lost"], 0.02)
        self.assertLess(felt[5]["force_lost"], 0.01)
        self.refused("feel", scene, "--refill", 1, says="add --passive")
        self.refused("feel", scene, "--passive", "--refill", 50, says="0 to 10")
        os.remove(scene)

    @suite.smoke
    def test_a_stability_map_uses_the_values_of_an_arm_s_profile(self):
        """An arm without a self-test needs its mass and its viscous friction as options."""
        self.refused("stability", "--device", "hid:polhem", says="palpate devices --test hid:polhem")
        self.refused("stability", "--device", "simulated", says="does not name a profile")
        self.refused("stability", "--device", "hid:spacemouse", "--mass", 1, "--viscous", 1,
                     says="gives no force")
        map_of = json.loads(run("stability", "--device", "hid:polhem", "--mass", 0.2, "--viscous", 1,
                                "--size", 9, "--rate", 250, "--json").stdout)
        self.assertAlmostEqual(map_of["arm"]["encoder"], 1.2088e-4, places=7)
        self.assertEqual(map_of["arm"]["mass"], 0.2)
        self.assertEqual(map_of["rate"], 250)

    def test_a_stability_map_uses_the_self_test_measurements_of_an_arm(self):
        profile = Path(__file__).resolve().parents[2] / "devices/hid/profiles/polhem.json"
        text = json.dumps(json.loads(profile.read_text()), sort_keys=True, separators=(",", ":"))
        print_of = 14695981039346656037  # FNV-1a hash
        for byte in text.encode():
            print_of = (print_of ^ byte) * 1099511628211 % 2**64
        record = {"profile": f"{print_of:016x}", "scale": [1.0, 1.0, 1.0], "viscous_least": [0.9, 0.8, 1.0],
                  "coulomb_least": [0.05, 0.04, 0.06], "mass": [0.2, 0.15, 0.3],
                  "delay": [0.001, 0.002, 0.001], "delay_error": [0.0, 0.0001, 0.0]}
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "palpate/arms.json"
            file.parent.mkdir()
            env = {**os.environ, "XDG_STATE_HOME": folder}

            def map_of(*words, serials=("S1",)):
                file.write_text(json.dumps({f"polhem@{serial}": record for serial in serials}))
                return process.run([PALPATE, "stability", "--size", "9", "--json", *words],
                                      capture_output=True, text=True, env=env, timeout=300)
            drawn = json.loads(map_of("--device", "hid:polhem", "--rate", "250").stdout)
            self.assertEqual(drawn["device"], "hid:polhem")
            # The delay is the largest mean, plus three standard errors and half a millisecond.
            self.assertAlmostEqual(drawn["arm"].pop("delay"), 0.0028, 9)
            self.assertEqual({k: v for k, v in drawn["arm"].items() if k != "encoder"},
                             {"mass": 0.15, "viscous": 0.8, "coulomb": 0.04})
            other = json.loads(map_of("--device", "hid:polhem@S1", "--rate", "250", "--delay",
                                      "0").stdout)
            self.assertEqual(other["arm"]["delay"], 0)
            two = map_of("--device", "hid:polhem", serials=("S1", "S2"))
            self.assertEqual(two.returncode, 2)
            self.assertIn("several arms with this profile have been tested: name one",
                          two.stderr)

    @suite.smoke
    def test_the_stability_command_refuses_invalid_options(self):
        self.refused("stability", "--rate", 5, says="100 to 20000")
        self.refused("stability", "--size", 20, says="one more than a multiple of 8")
        self.refused("stability", "--planes", 0, says="--planes")
        self.refused("stability", "--planes", 180, says="0.1 to 170")
        self.refused("stability", "--delay", 0.02, "--rate", 20000, says="400 ticks")
        self.refused("feel", self.dir / "ball.vdb", "--rate", 100000, says="use less than 62000 Hz")
        self.refused("devices", "hid", says="does not name a profile")
        self.refused("stability", self.dir / "ball.vdb", "--planes", 20, says="it cannot be combined with a scene")
        self.refused("stability", "--map", "/no/such/place/m", says="cannot be written")


class Devices(Case):
    """Tests without a connected arm. tests/devices/vm tests with emulated arms."""
    @suite.smoke
    def test_profiles_and_known_arms_are_listed_with_their_sources(self):
        words = run("devices").stdout
        for name in ("woodenhaptics-v2015", "woodenhaptics-v2019", "polhem", "teensy-arm", "spacemouse", "Novint Falcon", "HAPI"):
            self.assertIn(name, words)
        listed = json.loads(run("devices", "--json").stdout)
        for profile in listed["profiles"]:
            self.assertTrue(profile["sources"]["/limits"])
            # The firmware must end the force if the program ends.
            if profile["name"] != "spacemouse":  # this device has no motors
                told = json.loads(run("devices", profile["name"], "--json").stdout)["firmware"]
                self.assertRegex(told, "takes? the force off")
                self.assertIn(f"firmware: {told}\n", run("devices", profile["name"]).stdout)
        self.assertGreaterEqual(len(listed["known"]), 8)

    @suite.smoke
    def test_missing_arms_are_refused(self):
        ball = self.dir / "ball.vdb"
        self.refused("feel", ball, "--realtime", "--device", "hid:polhem",
                     says="no plugged-in arm fits this name")
        self.refused("feel", ball, "--realtime", "--device", "hid:polhm",
                     says='did you mean "polhem"?')
        self.refused("feel", ball, "--realtime", "--device", "hid:/nowhere.json",
                     says="it cannot be read")
        self.refused("devices", "--test", "simulated", says="is not the name of an arm")
        self.refused("devices", "--test", "hid:polhem", "--force", 9, says="at most 3")
        self.refused("devices", "--test", "hid:polhem", says="no plugged-in arm fits this name")

    @suite.smoke
    def test_the_self_test_of_the_virtual_arm_passes_and_measures_its_parameters(self):
        told = json.loads(run("devices", "--virtual", "--json").stdout)
        self.assertTrue(told["passed"])
        for axis in told["axes"]:  # the defaults of ArmParams
            self.assertAlmostEqual(axis["mass"], 0.1, delta=0.005)
            self.assertAlmostEqual(axis["viscous"], 0.5, delta=0.1)
            self.assertAlmostEqual(axis["coulomb"], 0.02, delta=0.015)
        self.assertRegex(run("devices", "--virtual").stdout, r"(?m)^passed ")
        self.refused("devices", "--virtual", "--ruler", 0.1, says="no user who moves it")

    def test_the_self_test_of_an_arm_is_refused_if_nobody_presses_enter(self):
        plugins = self.dir / "plugins"
        plugins.mkdir(mode=0o755)
        plugins.chmod(0o755)  # palpate refuses plug-ins in folders that other users can write
        shutil.copy(BIN.parent / "plugins" / "sample.so", plugins)
        (plugins / "sample.so").chmod(0o755)
        for options in ((), ("--ruler", "0")):
            done = process.run([PALPATE, "devices", "--test", "plugin:sample@S2", "--json", *options], text=True,
                               env={**os.environ, "PALPATE_PLUGINS": str(plugins), "HOME": str(self.dir)},
                               stdin=subprocess.DEVNULL, capture_output=True, check=False, timeout=60)
            self.assertEqual((done.returncode, done.stdout), (2, ""), done.stderr)
            self.assertIn("nobody has pressed Enter", done.stderr)

    @suite.smoke
    def test_watching_an_arm_that_is_missing_or_named_twice_is_refused(self):
        for arm in ("hid:polhem", "polhem"):
            self.refused("devices", "--watch", arm, says="no plugged-in arm fits this name")
        self.refused("devices", "--watch", "woodenhaptics", says="woodenhaptics-v2015 or")
        self.refused("devices", "--watch", "hid:polhem", "--json", says="it already names an arm")
        self.refused("devices", "polhem", "--watch", "hid:polhem", says="it already names an arm")

    @suite.smoke
    def test_the_command_devices_checks_the_facts_and_names_of_profiles(self):
        words = run("devices", "polhem").stdout
        self.assertIn("current_b, whose limit is 3", words)
        facts = json.loads(run("devices", "polhem", "--json").stdout)["facts"]
        self.assertEqual(len(facts["motors"]), 3)
        profiles = Path(__file__).resolve().parents[2] / "devices/hid/profiles"
        mine = json.loads((profiles / "teensy-arm.json").read_text())
        for joint in mine["kinematics"]["joints"]:
            joint["torque_constant"] /= 1000
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "mine.json"
            file.write_text(json.dumps(mine))
            self.refused("devices", file, says="correct torque_constant")
            for joint in mine["kinematics"]["joints"]:
                joint["torque_constant"] = 2.59
            file.write_text(json.dumps(mine))
            noted = run("devices", file).stderr
            self.assertEqual(noted.count("\n"), 1, noted)
            self.assertIn("/kinematics/joints/0/torque_constant: 2.59 N m per unit of current_a is above 1", noted)
        self.refused("devices", "polhm", says='did you mean "polhem"?')
        self.refused("devices", "woodenhaptics",
                     says="this name is incomplete, and fits woodenhaptics-v2015 or woodenhaptics-v2019")
        self.refused("devices", "polhem", "--test", "hid", says="--test already names an arm")

    def test_the_documented_output_of_the_command_devices_equals_the_real_output(self):
        """Compares docs/devices.md with the program's output and the shipped profiles."""
        text = (Path(__file__).resolve().parents[2] / "docs/devices.md").read_text(encoding="utf-8")
        blocks = re.findall(r"^    \$ palpate (.*)\n((?:    .*\n)+)", text, flags=re.M)
        self.assertTrue(blocks)
        for command, shown in blocks:
            printed = iter(line.strip() for line in run(*command.split()).stdout.splitlines())
            for line in shown.splitlines():
                if line.strip() != "...":
                    self.assertIn(line.strip(), printed, command)  # in this order
        rows = re.search(r"^\| shipped profile .*\n\|[-|]*\n((?:\|.*\n)+)", text, flags=re.M)[1]
        told = {}
        for row in rows.splitlines():
            name, _, asked, step, _ = (cell.strip() for cell in row.strip("|").split("|"))
            told[name.strip("`")] = (asked, step)
        listed = json.loads(run("devices", "--json").stdout)["profiles"]
        self.assertEqual(sorted(told), sorted(profile["name"] for profile in listed))
        for profile in listed:
            facts = profile["facts"]
            motors = facts["motors"]
            asked = ", ".join(f"{motor['asked']:.4g}" for motor in motors)
            asked = f"{asked} of {motors[0]['most']:g}" if motors else "-"
            step = f"{1e3 * facts['step']:.4g}" if motors else "-"
            self.assertEqual(told[profile["name"]], (asked, step), profile["name"])

    @suite.smoke
    def test_a_broken_profile_of_the_user_is_reported(self):
        with tempfile.TemporaryDirectory() as folder:
            arms = Path(folder) / "palpate/arms"
            arms.mkdir(parents=True)
            (arms / "mine.json").write_text('{"palpate_arm": 1, "name": "mine", "input": []}')
            result = process.run([PALPATE, "devices"], capture_output=True, text=True,
                                    env={**os.environ, "XDG_CONFIG_HOME": folder}, timeout=60)
            self.assertEqual(result.returncode, 0)
            self.assertIn('mine.json: /: "match" is missing: add it', result.stderr)
            result = process.run([PALPATE, "devices", "--test", "hid:mine"], text=True,
                                    capture_output=True, timeout=60,
                                    env={**os.environ, "XDG_CONFIG_HOME": folder})
            self.assertEqual(result.returncode, 2)
            self.assertIn("the profile's file is invalid: correct the error reported above", result.stderr)


class Examples(Case):
    """Tests the examples whose volumes palpate can make. The other examples need external data."""
    SCENES = Path(__file__).resolve().parents[2] / "scenes" / "examples"
    MADE = {"wind_tunnel": ("wind-tunnel", "wind.vdb"), "fibres": ("fibres", "fibres.vdb"),
            "two_bodies": ("two-bodies", "bodies.vdb"), "guides": ("two-bodies", "bodies.vdb"),
            "beating_heart": ("beating-heart", "heart.vdb"), "breathing": ("breathing", "breathing.vdb")}

    def test_every_mode_of_examples_with_procedural_volumes_acts_and_no_force_reaches_6_n(self):
        for scene, (name, volume) in self.MADE.items():
            with self.subTest(scene):
                run("make", name, self.dir / volume)
                place = self.dir / f"{scene}.json"
                shutil.copy(self.SCENES / place.name, place)
                felt = json.loads(run("feel", place, "--seconds", 25, "--json").stdout)
                for mode in felt["felt"]:
                    self.assertGreater(mode["seconds"], 0.05, mode)
                # A tick may not converge if its primitives contradict each other, at an edge of the data or of the
                # wing.
                self.assertGreaterEqual(felt["status"]["converged"], felt["ticks"] - 10)
                self.assertLess(felt["error_bound_max"], 1e-3)
                self.assertEqual(felt["limited"], 0)
                self.assertLess(felt["force_max"], 6.0)
                self.assertGreater(felt["felt_share"], 0.3)
                # A wind pushes and a guide pulls, so they add energy; docs/examples.md states how much.
                self.assertLess(felt["injected_energy"], 0.3)
                explains(self, felt)
                explains(self, json.loads(run("feel", place, "--rate", 250, "--json").stdout))
                explains(self, json.loads(run("feel", self.dir / volume, "--json").stdout))
                os.remove(place)

    def test_the_script_prepare_has_a_function_for_every_example(self):
        text = (self.SCENES / "prepare").read_text()
        for scene in self.SCENES.glob("*.json"):
            self.assertIn(f"make_{scene.stem}()", text)


class Hostile(Case):
    """Tests file and volume names that contain terminal control sequences."""
    NAMES = {
        "bytes": b"\xff\xfe\xc3(\xed\xa0\x80\xc0\xaf\xf4\x90\x80\x80",
        "controls": b"\x1b[2J\x1b]0;x\x07\x7f\npalpate: all is well\r\tb",
        "turned": "\x85\x9b31m\u061c\u2028\u202egpj\u2066\u200f".encode(),
        "long": b"n" * 100_000,
    }
    if cases(len(NAMES), "hostile names") < len(NAMES):
        NAMES = {"all": b"".join(NAMES.values())}
    WORDS = "Stra\u00dfe \u4e2d\u6587 \U0001f9b4"
    LONGEST = 3000  # [characters]; limit of a line, which can have two sentences and two names

    def legible(self, *words, stdin=b"", env=None):
        """Runs a command. Returns its output after checking that it is safe for a terminal."""
        done = process.run([PALPATE, *(w if isinstance(w, bytes) else str(w).encode()
                                          for w in words)],
                              input=stdin, capture_output=True, timeout=300, env=env)
        self.assertIn(done.returncode, (0, 1, 2, 4), done.stderr[:500])
        for text in (done.stdout, done.stderr):
            text = text.decode()  # valid UTF-8
            for line in text.split("\n"):
                hidden = [c for c in line
                          if unicodedata.category(c) in ("Cc", "Cf", "Cs", "Zl", "Zp")]
                self.assertEqual(hidden, [], line[:500])
                if "--json" not in words:
                    self.assertLess(len(line), self.LONGEST)
        if "--json" in words and done.returncode == 0:
            json.loads(done.stdout)
        self.assertFalse(done.stderr and not all(
            line.startswith("palpate: ") for line in done.stderr.decode().splitlines()))
        return done

    def every(self):
        for what, name in self.NAMES.items():
            with self.subTest(what):
                yield name

    def test_hostile_arguments_are_printed_legibly(self):
        ball = str(self.dir / "ball.vdb").encode()
        for name in self.every():
            self.legible(name)
            for verb in ("info", "check", "feel", "solve", "explain", "press", "sample"):
                self.legible(verb, name)
            self.legible("info", ball, b"--" + name)
            self.legible("make", name, self.dir / "never.vdb")
            self.legible("feel", ball, "--device", name)
            self.legible("feel", ball, "--trace", os.fsencode(self.dir) + b"/no/" + name)
            self.legible("explain", ball, "--at", name, "--push", "0,0,1")
            self.legible("sample", ball, "--points", name)
            self.legible("sample", ball, "--grid", name, "--points", "-", stdin=b"x,y,z\n0,0,0\n")
            self.legible("sample", ball, "--points", "-", stdin=name + b"\n0,0,0\n")
            self.legible("sample", ball, "--points", "-", stdin=b"x,y,z\n" + name + b",0,0\n")
            self.legible("stability", "--device", name)
            self.legible("devices", name)
            self.legible("devices", "--test", name)
            self.legible("import", name, self.dir / "never.vdb")
            self.legible("solve", "-", stdin=b'{"' + name + b'":1}\n')

    def test_hostile_file_names_are_printed_legibly(self):
        for what, name in self.NAMES.items():
            with self.subTest(what):
                folder = os.fsencode(self.dir) + b"/" + name[:200]
                os.mkdir(folder)
                shutil.copy(self.dir / "ball.vdb", folder + b"/" + name[:200] + b".vdb")
                file = folder + b"/" + name[:200] + b".vdb"
                for verb in ("info", "check"):
                    self.legible(verb, file)
                    self.legible(verb, file, "--json")
                self.legible("check", folder)
                self.legible("feel", file, "--seconds", "0.1")
                self.legible("explain", file, "--at", "0,0,0", "--push", "0,0,-1")
                self.legible("press", file, "--at", "0,0,0.06", "--along", "0,0,-1")
                shutil.copy(self.dir / "nan.vdb", file)
                for verb in ("info", "check", "feel"):
                    self.legible(verb, file)
                shutil.rmtree(folder)

    def test_unprintable_characters_are_escaped(self):
        points = [c for c in map(chr, range(0x110000))
                  if unicodedata.category(c) in ("Cf", "Zl", "Zp")]
        points += "\u034f\u115f\u1160\u17b4\u17b5\u2065\u3164\uffa0\U000e0100\U000e01ef\U0001fffe"
        self.assertGreater(len(points), 160)
        for i in range(0, len(points), 12):
            name = "a" + "b".join(points[i:i + 12]) + "c"
            shown = "a" + "b".join(f"\\u{ord(c):04x}" if ord(c) < 0x10000 else
                                   f"\\U{ord(c):08x}" for c in points[i:i + 12]) + "c"
            self.assertIn(shown.encode(), self.legible("check", name).stderr)
            file = os.fsencode(self.dir) + b"/" + name.encode() + b".vdb"
            shutil.copy(self.dir / "ball.vdb", file)
            said = self.legible("check", file, "--json").stdout
            self.assertIn(name, json.loads(said)["scene"])
            for c in points[i:i + 12]:
                self.assertNotIn(c.encode(), said)

    def test_hostile_grid_names_are_printed_legibly(self):
        whole = (self.dir / "mixed.vdb").read_bytes()
        for name in (b"\xff\x80\xc3(", "\u202eg".encode(), "\x85\x9b".encode()):
            for old in (b"ball", b"labels"):
                file = self.dir / "patched.vdb"
                file.write_bytes(whole.replace(old, (name * 2)[:len(old)]))
                for verb in ("info", "check"):
                    self.legible(verb, file)
                    self.legible(verb, file, "--json")
                self.legible("feel", file, "--seconds", "0.1")
                self.legible("sample", file, "--grid", "nothing", "--points", "-")

    def test_hostile_names_in_a_scene_are_printed_legibly(self):
        def scene(name, text):
            at = self.dir / "scene.json"
            at.write_bytes(text.replace(b"NAME", name))
            return at
        good = json.dumps({
            "palpate": 1,
            "volumes": {"NAME": {"file": "linear.vdb", "grid": "velocity"},
                        "dNAME": {"file": "linear.vdb", "grid": "density",
                                  "place": {"like": "NAME"}}},
            "fields": {"speed NAME": {"magnitude": "NAME"}, "way NAME": {"unit": "NAME"}},
            "modes": [{"name": "mode NAME", "mode": "isosurface", "of": "speed NAME", "value": 3,
                       "strength": {"piecewise": [[0, 1], [9, 2]], "by": "dNAME"}},
                      {"name": "none NAME", "mode": "follow", "of": "NAME", "strength": 0}]}).encode()
        bad = [json.dumps(text).encode() for text in (
            {"palpate": 1, "NAME": 1},
            {"palpate": 1, "volumes": {"NAME": {"file": "NAME"}}, "modes": []},
            {"palpate": 1, "volumes": {"a": {"file": "ball.vdb", "grid": "NAME"}}, "modes": []},
            {"palpate": 1, "volumes": {"a": {"file": "ball.vdb"}}, "modes": [{"mode": "NAME"}]},
            {"palpate": 1, "volumes": {"NAME": {"file": "ball.vdb", "place": {"fit": "NAME"}}}},
            {"palpate": 1, "volumes": {"NAME": {"file": "ball.vdb"}}, "modes": [
                {"mode": "surface", "of": "XNAME", "strength": 1}]},
            {"palpate": 1, "volumes": {"NAME": {"file": "ball.vdb", "place": {"like": "XNAME"}}},
             "modes": [{"mode": "surface", "of": "NAME", "strength": 1}]},
            "NAME")] + [b"NAME"]
        for what, name in self.NAMES.items():
            # Writes the name with JSON's escapes, then as raw bytes.
            for text in (json.dumps(name.decode("utf-8", "replace"))[1:-1].encode(), name):
                with self.subTest(what):
                    at = scene(text, good)
                    for verb in ("check", "feel"):
                        self.legible(verb, at, *(["--seconds", "0.05"] if verb == "feel" else []))
                        self.legible(verb, at, "--json",
                                     *(["--seconds", "0.05"] if verb == "feel" else []))
                    self.legible("explain", at, "--at", "0,0,0", "--push", "0,0,-1")
                    self.legible("press", at, "--at", "0,0,0", "--along", "1,0,0", "--csv", "-")
                    for wrong in bad:
                        done = self.legible("check", scene(text, wrong))
                        self.assertEqual((done.returncode, done.stderr.count(b"\n")), (2, 1))

    @suite.smoke
    def test_hostile_names_of_an_arm_are_printed_legibly(self):
        profiles = Path(__file__).resolve().parents[2] / "devices/hid/profiles"
        mine = json.loads((profiles / "teensy-arm.json").read_text())
        for what, name in self.NAMES.items():
            with self.subTest(what), tempfile.TemporaryDirectory() as folder:
                arms = Path(folder) / "palpate/arms"
                arms.mkdir(parents=True)
                text = name.decode("utf-8", "replace")
                (arms / "mine.json").write_text(json.dumps(
                    {**mine, "name": "mine", "description": text, "firmware": text}))
                (arms / "bad.json").write_text(json.dumps({**mine, "name": text, text: 1}))
                env = {**os.environ, "XDG_CONFIG_HOME": folder}
                self.legible("devices", env=env)
                self.legible("devices", "mine", env=env)

    @suite.smoke
    def test_hostile_names_in_images_are_printed_legibly(self):
        if not (BIN / "palpate-import").exists():
            self.skipTest("built without VTK")
        for what, name in self.NAMES.items():
            with self.subTest(what), tempfile.TemporaryDirectory() as folder:
                file = os.fsencode(folder) + b"/" + name[:200] + b".vtk"
                Path(os.fsdecode(file)).write_bytes(
                    b"# vtk DataFile Version 3.0\n" + name[:200].replace(b"\n", b"") +
                    b"\nASCII\nDATASET STRUCTURED_POINTS\nDIMENSIONS 3 3 3\nORIGIN 0 0 0\n"
                    b"SPACING 1 1 1\nPOINT_DATA 27\nSCALARS " +
                    name.replace(b" ", b"_").replace(b"\n", b"_") +
                    b" float 1\nLOOKUP_TABLE default\n" + b"1 2 3 4 5 6 7 8 9\n" * 3)
                out = folder + "/out.vdb"
                for words in ((), ("--json",), ("--field", "no"), ("--iso", "3", "--voxel", "9")):
                    self.legible("import", file, out, *words)
                if os.path.exists(out):
                    self.legible("info", out)
                    self.legible("check", out)

    def test_printable_text_is_kept_and_long_text_is_shortened(self):
        self.assertIn(self.WORDS.encode(), self.legible("check", self.WORDS).stderr)
        line = self.legible("info", "a" * 3000 + "z").stderr.decode()
        self.assertIn("aaa...(", line)
        self.assertIn("aaz: it cannot be read (File name too long): check the path", line)
        line = self.legible("check", b"\x1b[2J\n\xff\x7f" + "\u202e".encode()).stderr
        self.assertIn(b"palpate: \\x1b[2J\\n\\xff\\x7f\\u202e: no such file", line)


class Import(Case):
    def setUp(self):
        if not (BIN / "palpate-import").exists():
            self.skipTest("built without VTK")

    def nifti(self, name, size=(6, 5, 4), cut=None):
        """Writes a NIfTI-1 file of floats: value = i + 10 j + 100 k, voxels of 2 mm, origin (-1, -2, -3)."""
        import struct
        header = bytearray(352)
        struct.pack_into("<i", header, 0, 348)
        struct.pack_into("<8h", header, 40, 3, *size, 1, 1, 1, 1)
        struct.pack_into("<hh", header, 70, 16, 32)
        struct.pack_into("<8f", header, 76, 1, 2, 2, 2, 1, 1, 1, 1)
        struct.pack_into("<3f", header, 108, 352, 1, 0)
        struct.pack_into("<hh", header, 252, 0, 1)
        struct.pack_into("<12f", header, 280, 2, 0, 0, -1, 0, 2, 0, -2, 0, 0, 2, -3)
        header[344:348] = b"n+1\0"
        values = [i + 10 * j + 100 * k for k in range(size[2]) for j in range(size[1])
                  for i in range(size[0])]
        data = bytes(header) + struct.pack(f"<{len(values)}f", *values)
        file = self.dir / name
        file.write_bytes(data[:cut] if cut else data)
        return file

    @suite.smoke
    def test_an_import_keeps_values_and_positions_of_an_image(self):
        out = self.dir / "image.vdb"
        run("import", self.nifti("image.nii"), out)
        grid = json.loads(run("info", out, "--json").stdout)["grids"][0]
        self.assertEqual(grid["name"], "density")
        self.assertEqual(grid["voxel_size"], [2, 2, 2])
        done = run("sample", out, "--points", "-", stdin="x,y,z\n3,2,1\n9,6,3\n")
        rows = list(csv.DictReader(io.StringIO(done.stdout)))
        self.assertEqual(float(rows[0]["value"]), 2 + 20 + 200)
        self.assertEqual([float(rows[0][k]) for k in ("gx", "gy", "gz")], [0.5, 5, 50])
        self.assertEqual(float(rows[1]["value"]), 5 + 40 + 300)
        os.remove(out)

    @suite.smoke
    def test_an_import_refuses_invalid_images(self):
        out = self.dir / "never.vdb"
        cut = self.nifti("cut.nii", cut=500)
        self.refused("import", cut, out, says="truncated")
        text = self.dir / "text.nii"
        text.write_text("hello")
        self.refused("import", text, out, says="looks like text")
        self.refused("import", self.dir / "gone.nii", out, says="no such file")
        good = self.nifti("good.nii")
        self.refused("import", good, self.dir / "never.txt", says=".vdb")
        self.refused("import", good, "/no/such/place/a.vdb", says="cannot be written")
        self.refused("import", good, out, "--smooth", -1, says="--smooth")
        self.refused("import", says="usage")


if __name__ == "__main__":
    suite.main(sys.argv[3:])
