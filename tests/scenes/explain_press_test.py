#!/usr/bin/env python3
"""Compares `palpate explain` and `palpate press` with numbers computed by hand:
explain_press_test.py BIN_DIR VOLUMES_PROGRAM.

The density of linear.vdb is x + 2 y - z, so its isosurfaces are planes; a unit is a centimetre.
"""
import csv
import io
import json
import math
import os
import shlex
import signal
import subprocess
import sys
import time
import unittest
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent))
from cli_test import PALPATE, Case, run  # noqa: E402

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import process  # noqa: E402
import suite  # noqa: E402

K = 500.0
PLACE = {"scale": 0.01, "translate": [0, 0, 0]}
VOLUMES = {"d": {"file": "linear.vdb", "grid": "density", "place": PLACE},
           "v": {"file": "linear.vdb", "grid": "velocity", "place": PLACE}}
MIDDLE = [0.02, 0.02, 0.02]  # the density here is 4, the velocity (-2, 2, 6)
INTO = [c / math.sqrt(6) for c in (1, 2, -1)]  # unit vector along the density's gradient
ASIDE = [c / math.sqrt(2) for c in (0, 1, 2)]
ASIDE = [c / math.sqrt(5) * math.sqrt(2) for c in ASIDE]  # unit vector perpendicular to INTO
WALL = {"name": "wall", "mode": "isosurface", "of": "d", "value": 4, "strength": 3}


def along(a, x, b=(0, 0, 0), y=0.0, start=(0, 0, 0)):
    return [s + x * p + y * q for s, p, q in zip(start, a, b)]


def words(v):
    return ",".join(repr(c) for c in v)


def size(v):
    return math.sqrt(sum(c * c for c in v))


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


class Touch(Case):
    def scene(self, *modes, volumes=None, **rest):
        file = self.dir / "touch.json"
        file.write_text(json.dumps({"palpate": 1, "volumes": volumes or VOLUMES,
                                    "modes": list(modes), **rest}))
        self.addCleanup(lambda: file.unlink(missing_ok=True))
        return file

    def explain(self, scene, at, push, *options):
        words_ = ("explain", scene, "--at", words(at), "--push", words(push), *options)
        text = run(*words_).stdout
        self.assertNotIn("nan", text.lower())
        out = json.loads(run(*words_, "--json").stdout, parse_constant=self.fail)
        return out, text

    def press(self, scene, at, way, *options):
        words_ = ("press", scene, "--at", words(at), "--along", words(way), *options)
        summary = json.loads(run(*words_, "--json").stdout, parse_constant=self.fail)
        rows = list(csv.DictReader(io.StringIO(run(*words_, "--csv", "-").stdout)))
        # A passive engine gives at most this energy, in any scene.
        self.assertLessEqual(summary["net_energy"], summary["net_energy_bound"] + 1e-12)
        self.assertEqual(summary["ticks"], len(rows))
        self.assertEqual(sum(summary["status"].values()), len(rows))
        return summary, rows

    def near(self, a, b, places=9):
        for x, y in zip(a, b):
            self.assertAlmostEqual(x, y, places)


class Explain(Touch):
    def mode(self, out, name):
        return next(m for m in out["modes"] if m["name"] == name)

    @suite.smoke
    def test_a_plane_pressed_by_a_millimetre_holds_half_a_newton(self):
        out, text = self.explain(self.scene(WALL), MIDDLE, along(INTO, 0.001))
        wall = self.mode(out, "wall")
        self.assertTrue(wall["active"])
        self.assertEqual((wall["state"], wall["contact"]), ("holds", "outside"))
        self.near(wall["load"], along(INTO, -0.5))
        [plane] = wall["primitives"]
        self.assertEqual((plane["role"], plane["kind"], plane["state"]),
                         ("surface", "plane", "holds"))
        self.assertAlmostEqual(plane["size"], 0.5)
        self.assertAlmostEqual(plane["share"], 0.5 / 3)
        self.near(plane["direction"], along(INTO, -1))
        self.near(out["balance"]["proxy"], MIDDLE)
        self.assertEqual(out["balance"]["solver"], "closed-form")
        self.near(out["force"]["sent"], along(INTO, -0.5))
        self.assertFalse(out["force"]["limiter"]["acted"])
        self.assertEqual(out["because"][0], "wall holds with 0.5 of 3 N along its normal.")
        self.assertIn("because   wall holds with 0.5 of 3 N", text)

    def test_an_explanation_shows_that_a_plane_yields_beyond_its_strength(self):
        out, _ = self.explain(self.scene(WALL), MIDDLE, along(INTO, 0.008))
        wall = self.mode(out, "wall")
        self.assertEqual((wall["state"], wall["contact"]), ("yields", "yielded"))
        self.assertAlmostEqual(size(wall["load"]), 3)
        self.near(out["balance"]["proxy"], along(INTO, 0.002, start=MIDDLE))
        # The limiter lets the force grow by 2 N per tick.
        limiter = out["force"]["limiter"]
        self.assertEqual((limiter["slewed"], limiter["peaked"]), (True, False))
        self.assertAlmostEqual(size(out["force"]["wanted"]), 3)
        self.assertAlmostEqual(out["force"]["size"], 2)
        self.assertIn("grow by 2 N per tick: the device gets 2 N", out["because"][1])

    def test_friction_sticks_below_the_limit_mu_n_and_slips_at_that_limit(self):
        scene = self.scene({**WALL, "friction": 0.3})
        for aside, held, state in ((0.0002, 0.1, "sticks"), (0.001, 0.15, "slips")):
            out, _ = self.explain(scene, MIDDLE, along(INTO, 0.001, ASIDE, aside))
            plane, line = self.mode(out, "wall")["primitives"]
            self.assertEqual((line["role"], line["kind"], line["state"]),
                             ("friction", "line", state))
            self.assertAlmostEqual(plane["size"], 0.5)
            self.assertAlmostEqual(line["strength"], 0.3 * 0.5)
            self.assertEqual(line["coefficient"], 0.3)
            self.near(line["load"], along(ASIDE, -held))
            self.assertEqual(self.mode(out, "wall")["state"], "holds")
        self.assertIn("its friction slips at 0.15 N", out["because"][0])

    def test_the_loads_in_an_explanation_add_up_to_the_spring_s_force(self):
        scene = self.scene(
            {**WALL, "friction": 0.2, "viscosity": 0.1},
            {"name": "stream", "mode": "follow", "of": "v", "strength": 0.7},
            {"name": "drag", "mode": "viscosity", "of": "d", "strength": 0.2},
            {"name": "tube", "mode": "vortex_tube", "of": "v", "strength": 0.3},
            {"name": "wind", "mode": "force", "of": "v", "strength": 0.1},
            coupling={"stiffness": K, "damping": 0.2})
        for x in (-0.002, 0.001, 0.004):
            for y in (-0.001, 0.002):
                push = along(INTO, x, ASIDE, y)
                out, _ = self.explain(scene, MIDDLE, push)
                balance = out["balance"]
                spring = [K * (p - h) for p, h in zip(balance["proxy"], out["hand"])]
                loads = [sum(m["load"][i] for m in out["modes"]) for i in range(3)]
                for mode in out["modes"]:
                    parts = [sum(p["load"][i] for p in mode["primitives"]) for i in range(3)]
                    self.near(parts, mode["load"])
                    for p in mode["primitives"]:
                        self.assertLessEqual(p["size"], p["strength"] * (1 + 1e-9) + 1e-9)
                self.near(loads, balance["loads"])
                self.near(balance["spring"], spring)
                self.near([l + w for l, w in zip(loads, balance["waiting"])], spring, 5)
                self.assertLess(balance["left_over"], 1e-9 + 2 * K * balance["error_bound"])
                self.near([s + d for s, d in zip(spring, out["force"]["damper"])],
                          out["force"]["wanted"])

    @suite.smoke
    def test_an_explanation_states_why_each_inactive_mode_is_inactive(self):
        far = {"file": "ball.vdb", "place": {"scale": 0.001, "translate": [1, 0, 0]}}
        scene = self.scene(
            {"name": "gone", "mode": "isosurface", "of": "far", "value": 0, "solid": "below",
             "strength": 1},
            {"name": "faint", "mode": "follow", "of": "v", "by": "d",
             "strength": {"window": {"level": 100, "width": 1, "max": 2}}},
            {"name": "product", "mode": "follow", "of": "v", "strength": {"product": [
                {"piecewise": [[4, 1], [5, 0]], "by": "d"},
                {"piecewise": [[6, 0], [7, 1]], "by": "speed"}]}},
            {"name": "deep", "mode": "isosurface", "of": "d", "value": 1, "strength": 1},
            {"name": "high", "mode": "isosurface", "of": "d", "value": 9, "strength": 1},
            {"name": "masked", "mode": "follow", "of": "v", "by": "far", "strength": 1},
            {"name": "guide", "mode": "guide", "shape": "point", "at": [0.02, 0.02, 0.05],
             "snap": 0.01, "strength": 1},
            {"name": "null", "mode": "follow", "of": "v", "strength": 0},
            volumes={**VOLUMES, "far": far}, fields={"speed": {"magnitude": "v"},
                                                     "spin": {"curl": "v"}})
        out, text = self.explain(scene, MIDDLE, [0, 0, 0])
        why = {m["name"]: m["because"] for m in out["modes"]}
        self.assertEqual(why["gone"], "the proxy is outside the bounds of far")
        self.assertEqual(why["faint"], "its strength is zero here: a factor is 0 where d is 4")
        self.assertIn("has not reached the surface; the value here is 4, the surface is at 9",
                      why["high"])
        self.assertIn("on the solid side", why["deep"])
        self.assertEqual(why["masked"], "its strength is zero here: far has no data here")
        self.assertEqual(why["guide"], "the proxy is 0.03 m from the guide, farther than the snap of 0.01 m")
        self.assertEqual(out["silent"], ["null"])
        self.assertEqual(out["left_out"], ["spin"])
        fields = {f["field"]: f for f in out["fields"]}
        self.assertEqual((fields["far"]["sampled"], fields["far"]["because"]),
                         (False, "the proxy is outside the bounds of the field"))
        self.assertEqual((fields["d"]["sampled"], fields["d"]["inside"]), (True, True))
        values = {p["property"]: p["value"] for p in out["properties"]}
        self.assertAlmostEqual(values["d"], 4)
        self.near(values["v"], [-2, 2, 6])
        self.near(values["gradient of d"], [1, 2, -1])
        # One mode acts. Its factors are 1 (at the density 4) and the speed sqrt(44) minus 6.
        product = self.mode(out, "product")
        self.assertEqual([m["name"] for m in out["modes"] if m["active"]], ["product"])
        first, second = product["strength"]["factors"]
        self.assertEqual((first["reads"], first["output"]), ("d", 1))
        self.assertEqual(second["reads"], "magnitude of v")
        self.assertAlmostEqual(second["input"], math.sqrt(44))
        self.assertAlmostEqual(product["strength"]["value"], math.sqrt(44) - 6)
        self.assertAlmostEqual(product["primitives"][0]["strength"], math.sqrt(44) - 6)
        self.assertIn("no mode reads it", text)

    def test_an_explanation_reports_missing_data_within_the_bounds_of_a_volume(self):
        # The centre of the ball is inside the bounds, but outside of the narrow band.
        ball = {"b": {"file": "ball.vdb", "place": PLACE}}
        scene = self.scene({"name": "fog", "mode": "viscosity", "of": "b", "strength": 1},
                           volumes=ball)
        out, _ = self.explain(scene, [0, 0, 0], [0.001, 0, 0])
        self.assertEqual(self.mode(out, "fog")["because"], "b has no data here")
        self.assertEqual(out["fields"][0]["because"], "it has no data here")
        self.assertEqual(out["because"][0], "No primitive holds the proxy.")
        self.near(out["balance"]["proxy"], [0.001, 0, 0])

    def test_an_explanation_reports_a_slab_as_one_primitive(self):
        front = {"name": "front", "mode": "front_shape", "of": "v", "strength": 1}
        way = [c / math.sqrt(44) for c in (-2, 2, 6)]
        out, _ = self.explain(self.scene(front), MIDDLE, along(way, 0.001))
        self.assertEqual(out["because"][0], "front holds with 0.5 of 1 N along its normal.")
        out, _ = self.explain(self.scene(front), MIDDLE, along(way, -0.004))
        self.assertEqual(out["because"][0], "front yields at 1 N along its normal.")
        out, _ = self.explain(self.scene(front), MIDDLE, [0, 0, 0])
        self.assertEqual(self.mode(out, "front")["state"], "idle")
        self.assertEqual(self.mode(out, "front")["because"],
                         "the mode placed primitives, but they carry no load")

    def test_a_directed_force_moves_the_resting_proxy(self):
        wind = {"name": "wind", "mode": "force", "of": "v", "strength": 0.3}
        out, _ = self.explain(self.scene(wind), MIDDLE, [0, 0, 0])
        self.assertAlmostEqual(out["rest"]["moved"], 0.3 / K)
        self.assertEqual(self.mode(out, "wind")["state"], "pushes")
        self.assertAlmostEqual(size(out["rest"]["force"]), 0.3)

    def test_an_explanation_waits_until_a_varying_stiffness_has_settled(self):
        scene = self.scene(WALL, coupling={"stiffness": {"piecewise": [[0, 300], [8, 500]],
                                                         "by": "d"}})
        # The wall reaches two voxels. The hand starts outside of this reach.
        out, _ = self.explain(scene, along(INTO, -0.012, start=MIDDLE), along(INTO, 0.013))
        k = 400 - 25 * 1.2 * math.sqrt(6)
        self.assertAlmostEqual(out["balance"]["stiffness"], k, 4)
        self.assertGreater(out["rest"]["ticks"], 5)  # 5 N/m per tick
        self.assertAlmostEqual(size(self.mode(out, "wall")["load"]), 0.001 * k, 6)

    def test_an_explanation_of_a_long_push_uses_several_sub_steps(self):
        # A sub-step is one voxel long, 5 mm.
        drag = {"name": "drag", "mode": "viscosity", "of": "d", "strength": 0.2}
        out, text = self.explain(self.scene(drag), MIDDLE, [0, 0.012, 0])
        self.assertEqual(out["balance"]["substeps"], 3)
        self.near([p[1] for p in out["read_at"]], [0.025, 0.03, 0.032 - 0.2 / K])
        self.assertAlmostEqual(out["balance"]["proxy"][1], 0.032 - 0.2 / K)
        # The first step of the tick uses the remembered planes. Each further step is the balance after a reading.
        steps = out["steps"]
        self.assertEqual([step["foreseen"] for step in steps], [True, False, False, False])
        self.assertEqual([step["at"] for step in steps[1:]], out["read_at"])
        self.assertEqual([step["end"] for step in steps], ["voxel", "voxel", "free", "free"])
        self.assertEqual([step["went"] for step in steps[:3]], out["read_at"])
        self.near(steps[-1]["went"], out["balance"]["proxy"])
        self.assertTrue(all(step["yields"] == ["drag"] for step in steps))
        self.assertEqual(text.count("step      "), 4)
        scene = self.scene(drag, accuracy={"max_substeps": 1})
        out, _ = self.explain(scene, MIDDLE, [0, 0.012, 0])
        self.assertEqual(out["balance"]["status"], "substep-limit")
        self.assertIn("has not arrived", out["because"][-1])

    @suite.smoke
    def test_wrong_options_of_the_command_explain_are_refused(self):
        ball = self.dir / "ball.vdb"
        good = "0,0,0"
        for at in ("0,0", "0,0,0,0", "0,0,x", "", "nan,0,0", "0,0,1e999", "0, 0, 0", "0,,0"):
            self.refused("explain", ball, "--at", at, "--push", good, says="is not x,y,z")
        self.refused("explain", ball, "--at", "1e7,0,0", "--push", good, says="1,000 km")
        self.refused("explain", ball, "--at", "9e5,0,0", "--push", "9e5,0,0", says="--push: a coordinate is 1,000 km or more")
        self.refused("explain", ball, "--at", good, "--push", "1", says="--push: ")
        self.refused("explain", ball, "--at", good, says="--push: it is required without --until")
        self.refused("explain", ball, "--at", good, "--push", good, "--rate", 1, says="--rate")
        self.refused("explain", self.dir / "none.json", "--at", good, "--push", good,
                     says="no such file")
        run("explain", ball, "--at", "-0.06,0,0", "--push", "-.001,0,0")

    def test_output_that_cannot_be_written_is_an_error(self):
        for verb, way in (("explain", "--push"), ("press", "--along")):
            with open("/dev/full", "w") as full:
                done = process.run([PALPATE, verb, str(self.dir / "ball.vdb"), "--at", "0,0,0",
                                       way, "0,0,0.01"], stdout=full, stderr=subprocess.PIPE,
                                      text=True, timeout=60)
            self.assertIn(done.returncode, (1, 2))
            self.assertEqual(len(done.stderr.splitlines()), 1, done.stderr)


class Press(Touch):
    COLUMNS = ["phase", "depth", "force_along", "force_across", "proxy_depth", "proxy_across",
               "injected", "status", "limited", "contacts"]

    def mode(self, summary, name):
        return next(m for m in summary["modes"] if m["mode"] == name)

    def test_the_force_of_a_pressed_wall_rises_with_slope_k_until_the_wall_yields(self):
        # The press is 12 mm long and begins 4 mm in front of the wall. The wall holds the hand up to 6 mm behind it.
        summary, rows = self.press(self.scene(WALL), along(INTO, -0.004, start=MIDDLE),
                                   along(INTO, 0.012))
        self.assertEqual(list(rows[0]), self.COLUMNS)
        self.assertEqual(len(rows), 2 * 240 + 1)
        for row in rows:
            depth = float(row["depth"])
            force = min(3.0, max(0.0, K * (depth - 0.004)))
            self.assertAlmostEqual(float(row["force_along"]), force, 6)
            self.assertAlmostEqual(float(row["force_across"]), 0, 6)
            self.assertAlmostEqual(float(row["proxy_depth"]), depth - force / K, 9)
            self.assertEqual((row["status"], row["limited"]), ("converged", "0"))
        self.assertEqual([rows[i]["phase"] for i in (0, 240, 241, 480)], ["in", "in", "out", "out"])
        self.assertAlmostEqual(summary["stiffness"], K, 3)
        self.assertAlmostEqual(summary["force_max"]["force"], 3)
        wall = self.mode(summary, "wall")
        self.assertAlmostEqual(wall["touched_at"], 0.00405)
        self.assertAlmostEqual(wall["held_max"], 3)
        self.assertAlmostEqual(wall["yield"]["depth"], 0.010, delta=0.0001)
        self.assertAlmostEqual(wall["yield"]["force"], 3)
        self.assertIsNone(wall["let_go_at"])
        # The work of a spring, then of a constant force. The hand gets all of this work back.
        work = 0.5 * K * 0.006 ** 2 + 3 * 0.002
        self.assertAlmostEqual(summary["work_in"], work, 6)
        self.assertAlmostEqual(summary["work_out"], work, 6)
        self.assertAlmostEqual(summary["hysteresis"], 0, 6)
        contacts = [row["contacts"] for row in rows[:241]]
        self.assertEqual(list(dict.fromkeys(contacts)), ["", "wall=holds", "wall=yields"])

    def test_a_wall_that_releases_the_proxy_dissipates_the_energy_that_the_hand_put_in(self):
        # From a depth of 1 mm, the force fades over one voxel, 5 mm.
        summary, rows = self.press(self.scene({**WALL, "depth": 0.2}), MIDDLE,
                                   along(INTO, 0.014))
        wall = self.mode(summary, "wall")
        self.assertAlmostEqual(wall["yield"]["depth"], 0.006, delta=0.0001)
        self.assertLess(wall["yield"]["depth"], wall["let_go_at"])
        self.assertAlmostEqual(float(rows[-1]["force_along"]), 0)
        self.assertGreater(summary["hysteresis"], 0.5 * K * 0.006 ** 2)
        self.assertAlmostEqual(summary["hysteresis"], summary["work_in"], 6)
        self.assertLess(summary["net_energy"], -0.5 * K * 0.006 ** 2)

    def test_a_wall_that_is_passed_within_a_tick_is_reported_as_yielded(self):
        # The hand moves 14 mm in one tick, to a place where the wall has no strength.
        soft = {"name": "wall", "mode": "surface", "of": "d",
                "strength": {"piecewise": [[6, 1], [6.5, 0]]}}
        summary, rows = self.press(self.scene(soft), MIDDLE, along(INTO, 0.014), "--speed", 14)
        self.assertEqual(rows[1]["contacts"], "")
        wall = self.mode(summary, "wall")
        self.assertAlmostEqual(wall["yield"]["depth"], 0.014)
        self.assertIsNone(wall["yield"]["force"])
        self.assertAlmostEqual(wall["let_go_at"], 0.014)
        said = run("press", self.dir / "touch.json", "--at", words(MIDDLE), "--along",
                   words(along(INTO, 0.014)), "--speed", 14).stdout
        self.assertIn("wall: yielded at 14 mm within one tick, load unknown; released at 14 mm", said)

    def test_a_gap_of_one_tick_in_a_mode_s_load_is_not_reported_as_a_release(self):
        # The strength is 0 in a layer of 0.1 mm, where the proxy moves to the hand: one tick has no load.
        drag = {"name": "drag", "mode": "viscosity", "of": "d", "strength": {
            "piecewise": [[4, 0.5], [4.7, 0.5], [4.71, 0], [4.73, 0], [4.74, 0.5], [6, 0.5], [6.1, 0]]}}
        summary, rows = self.press(self.scene(drag), MIDDLE, along(INTO, 0.014))
        carried = [float(r["force_along"]) > 1e-6 for r in rows if r["phase"] == "in"]
        gap = carried.index(False, carried.index(True))
        self.assertIn(True, carried[gap:gap + 3])
        drag = self.mode(summary, "drag")
        self.assertLess(drag["yield"]["depth"], 1e-3 * 0.05 * gap)
        self.assertAlmostEqual(drag["let_go_at"], 0.01 * 2.1 / math.sqrt(6), delta=0.001)

    def test_a_pressed_mode_yields_and_releases_only_after_its_contact_has_begun(self):
        # For 1 mm the drag is below 1 µN, which does not count as contact.
        drag = {"name": "drag", "mode": "viscosity", "of": "d",
                "strength": {"piecewise": [[4.2, 0], [4.21, 1e-8], [4.45, 1e-8], [4.5, 0.3]]}}
        summary, _ = self.press(self.scene(drag), MIDDLE, along(INTO, 0.01))
        drag = self.mode(summary, "drag")
        self.assertGreater(drag["touched_at"], 0.0018)
        self.assertGreaterEqual(drag["yield"]["depth"], drag["touched_at"])
        self.assertIsNone(drag["let_go_at"])

    def test_a_press_outside_the_bounds_of_a_scene_is_reported(self):
        scene = self.scene(WALL)
        for way, hint in (("0,0,0.01", True), ("-50,-50,-50", False)):  # the second path ends in the scene
            done = run("press", scene, "--at", "50.02,50.02,50.02", "--along", way, "--speed", 100)
            self.assertEqual("press: the hand felt no force: the path is outside the scene's bounds, " in done.stderr,
                             hint)

    def test_a_drag_dissipates_all_work_that_is_put_in(self):
        drag = {"name": "drag", "mode": "viscosity", "of": "d", "strength": 0.5}
        summary, rows = self.press(self.scene(drag), MIDDLE, [0, 0.01, 0])
        # The force rises to 0.5 N over 1 mm. On the way back it reverses over 2 mm.
        self.assertAlmostEqual(summary["work_in"], 0.5 * 0.01 - 0.5 ** 2 / (2 * K), 6)
        self.assertAlmostEqual(summary["work_out"], -0.5 * 0.008, 6)
        self.assertAlmostEqual(summary["hysteresis"], 0.00875, 6)
        self.assertAlmostEqual(summary["net_energy"], -0.00875, delta=3e-4)
        self.assertAlmostEqual(summary["injected_energy"], 0)
        drag = self.mode(summary, "drag")
        self.assertAlmostEqual(drag["yield"]["depth"], 0.001, delta=0.0001)
        self.assertAlmostEqual(drag["yield"]["force"], 0.5)
        self.assertAlmostEqual(float(rows[-1]["force_along"]), -0.5)

    def test_sticking_friction_turns_the_force_of_an_oblique_press_along_its_path(self):
        # The path enters the wall at 45 degrees. With sticking friction, the force is k times the path's length, along
        # the path. Without friction, half of it is along the path and half is perpendicular.
        way = along(INTO, 0.002 / math.sqrt(2), ASIDE, 0.002 / math.sqrt(2))
        summary, rows = self.press(self.scene({**WALL, "friction": 5}), MIDDLE, way)
        last = rows[len(rows) // 2]
        self.assertAlmostEqual(float(last["force_along"]), K * 0.002, 6)
        self.assertAlmostEqual(float(last["force_across"]), 0, 6)
        summary, rows = self.press(self.scene(WALL), MIDDLE, way)
        last = rows[len(rows) // 2]
        self.assertAlmostEqual(float(last["force_along"]), 0.5, 6)
        self.assertAlmostEqual(float(last["force_across"]), 0.5, 6)
        self.assertAlmostEqual(summary["hysteresis"], 0, 6)

    @suite.smoke
    def test_a_pressed_ball_yields_at_its_strength(self):
        [low, high] = json.loads(run("check", self.dir / "ball.vdb", "--json").stdout)[
            "volumes"]["ball"]["bounds"]
        # The guessed isosurface has 3 N and a radius of 2 units of the file.
        scale = json.loads(run("check", self.dir / "ball.vdb", "--json").stdout)[
            "volumes"]["ball"]["metres_per_unit"]
        summary, _ = self.press(self.dir / "ball.vdb", [0, 0, high[2]], [0, 0, -0.016])
        [ball] = summary["modes"]
        touch = high[2] - 2 * scale
        self.assertAlmostEqual(ball["touched_at"], touch, delta=0.0002)
        self.assertAlmostEqual(ball["yield"]["depth"], touch + 3 / K, delta=0.0002)
        self.assertAlmostEqual(ball["yield"]["force"], 3, 6)
        self.assertAlmostEqual(summary["stiffness"], K, delta=2)
        self.assertLess(low[2], high[2])

    def test_pressing_a_scene_of_several_modes_gains_no_energy(self):
        scene = self.scene(
            {**WALL, "name": 'a "wall", of d', "friction": 0.4, "viscosity": 0.2},
            {"name": "stream", "mode": "follow", "of": "v", "strength": 0.7},
            {"name": "front", "mode": "front_shape", "of": "v", "strength": 0.3, "snap_drag": 0.2},
            coupling={"stiffness": K, "damping": 0.2})
        for way in (INTO, ASIDE, (1, 0, 0), (0, 0, 1)):
            summary, rows = self.press(scene, along(INTO, -0.002, start=MIDDLE), along(way, 0.012),
                                       "--speed", 0.2)
            self.assertEqual(len(rows), 121)
            self.assertGreaterEqual(summary["hysteresis"], -1e-9)
            touched = any(r["contacts"].startswith('a "wall", of d=') for r in rows)
            self.assertTrue(touched or way != INTO)

    @suite.smoke
    def test_the_press_command_writes_a_curve_and_a_picture(self):
        curve = self.dir / "curve.csv"
        scene = self.scene(WALL)
        words_ = ("press", scene, "--at", "0.02,0.02,0.02", "--along", "0,0.004,0")
        text = run(*words_, "--csv", curve).stdout
        self.assertIn("energy", text)
        self.assertEqual(curve.read_text(), run(*words_, "--csv", "-").stdout)
        self.assertNotIn("nan", curve.read_text())
        os.remove(curve)
        picture = self.dir / "curve.png"
        run(*words_, "--picture", picture)
        self.assertEqual(picture.read_bytes()[:8], b"\x89PNG\r\n\x1a\n")
        os.remove(picture)

    @suite.smoke
    def test_the_press_command_refuses_invalid_options(self):
        ball = self.dir / "ball.vdb"
        at = ("press", ball, "--at", "0,0,0.06")
        self.refused(*at, "--along", "0,0,0", says="--along: its length is the depth")
        self.refused(*at, "--along", "0,0,1e6", says="--along: a coordinate is 1,000 km or more")
        self.refused(*at, "--along", "0;0;1", says="is not x,y,z")
        self.refused(*at, says="--along is required")
        for speed in (0, -1, "nan", "inf", 1e-9):
            self.refused(*at, "--along", "0,0,-0.1", "--speed", speed, says="--speed")
        self.refused(*at, "--along", "0,0,-0.1", "--rate", 0, says="--rate")
        self.refused(*at, "--along", "0,0,-0.1", "--csv", "-", "--json", says="two outputs")
        picture = self.dir / "p.png"
        again = os.path.relpath(picture)
        self.refused(*at, "--along", "0,0,-0.1", "--csv", again, "--picture", picture,
                     says="two outputs")
        self.assertFalse(picture.exists())
        self.refused(*at, "--along", "0,0,-0.1", "--csv", ball, says="it is an input")
        self.refused(*at, "--along", "0,0,-0.1", "--csv", "/no/such/p.csv", says="cannot be written")
        self.refused(*at, "--along", "0,0,-0.1", "--picture", "p.txt", says=".png")


class NearParts(Touch):
    """A scene of parts is explained as one graph of the parts near the hand."""
    MODES = (
        ("d", "v", {**WALL, "friction": 0.3, "viscosity": 0.1, "by": "d"}),
        ("d", "v", {"mode": "isosurface", "of": "speed", "value": 6.7, "strength": 2}),
        ("d", "v", {"name": "stream", "mode": "follow", "of": "v", "by": "speed",
                    "strength": {"product": [{"piecewise": [[0, 0.2], [9, 0.4]]},
                                             {"piecewise": [[0, 1], [9, 2]], "by": "steep"}]}}),
        ("ball", {"name": "honey", "mode": "viscosity", "of": "ball", "strength": 0.2}),
        ("floor", {"name": "floor", "mode": "guide", "shape": "plane", "at": [2, 2, 2.1],
                   "along": [0, 0, 1], "strength": 1, "in": "ball"}))
    FIELDS = {"speed": ("magnitude", "v"), "slope": ("gradient", "d"),
              "steep": ("magnitude", "slope")}
    STEP = [0.01, 0, 0]  # so small that the first instances overlap

    def place(self, i):
        return {"scale": 0.01, "translate": along(self.STEP, i if i < 3 else 30 * i)}

    def many(self, count):
        """Makes a scene of volumes with `count` instances."""
        volumes = {"d": {"file": "linear.vdb", "grid": "density",
                         "instances": [self.place(i) for i in range(count)]},
                   "v": {"file": "linear.vdb", "grid": "velocity", "place": {"like": "d"}},
                   "ball": {"file": "ball.vdb", "place": PLACE}}
        return self.scene(*(mode[-1] for mode in self.MODES), volumes=volumes,
                          fields={name: {kind: of} for name, (kind, of) in self.FIELDS.items()})

    def few(self, near):
        """Makes the same scene with only these instances, as separate volumes."""
        volumes = {"ball": {"file": "ball.vdb", "place": PLACE}}
        fields = {}
        for i in near:
            volumes[f"d[{i}]"] = {**VOLUMES["d"], "place": self.place(i)}
            volumes[f"v[{i}]"] = {**VOLUMES["v"], "place": {"like": f"d[{i}]"}}
            for name, (kind, of) in self.FIELDS.items():
                fields[f"{name}[{i}]"] = {kind: f"{of}[{i}]"}
        modes = []
        for number, (*reads, mode) in enumerate(self.MODES):
            if "d" not in reads:
                modes.append(mode)
                continue
            for i in near:
                text = json.dumps({"name": f"/modes/{number}", **mode})
                for name in ("d", "v", "speed", "steep"):
                    for key in ("of", "by"):
                        text = text.replace(f'"{key}": "{name}"', f'"{key}": "{name}[{i}]"')
                one = json.loads(text)
                modes.append({**one, "name": f"{one['name']}[{i}]"})
        file = self.dir / "few.json"
        file.write_text(json.dumps({"palpate": 1, "volumes": volumes, "fields": fields,
                                    "modes": modes}))
        self.addCleanup(lambda: file.unlink(missing_ok=True))
        return file

    def told(self, *words_):
        done = run(*words_)
        return done.stdout.replace("few.json", "touch.json"), done.stderr

    def test_parts_near_the_hand_are_explained_as_in_a_scene_of_these_parts_alone(self):
        many = self.many(1000)
        few = self.few((0, 1, 2))
        for push in ([0, 0, 0.001], along(INTO, 0.002), along(INTO, -0.004)):
            words_ = ("--at", words([0.025, 0.022, 0.02]), "--push", words(push))
            for how in ((), ("--json",)):
                a, said = self.told("explain", many, *words_, *how)
                b, nothing = self.told("explain", few, *words_, *how)
                self.assertEqual(a, b)
                self.assertIn("the hand comes near 3 of the scene's 1000 parts", said)
                self.assertNotIn("parts", nothing)
            out = json.loads(a)
            self.assertIn("stream[2]", [mode["name"] for mode in out["modes"]])
            self.assertGreater(sum(mode["active"] for mode in out["modes"]), 3)
        # The explain command of a run in the whole scene gives the same spring force.
        path = self.dir / "into.csv"
        ends = [0.025, 0.022, 0.02], along(INTO, 0.004, start=[0.025, 0.022, 0.02])
        path.write_text("t,x,y,z\n" + "".join(f"{0.1 * i},{words(at)}\n" for i, at in enumerate(ends)))
        most = json.loads(run("feel", many, "--device", f"path:{path}", "--json").stdout)["most"]
        out = json.loads(run(*shlex.split(most["explain"])[1:], "--json").stdout)
        self.assertGreater(most["spring"], 0.1)
        self.assertAlmostEqual(math.hypot(*out["force"]["spring"]), most["spring"], delta=1e-6)
        words_ = ("--at", words([0.025, 0.022, 0.02]), "--along", words(along(INTO, 0.01)))
        for how in (("--json",), ("--csv", "-")):
            a, said = self.told("press", many, *words_, *how)
            b, _ = self.told("press", few, *words_, *how)
            self.assertEqual(a, b)
            self.assertIn("the hand comes near 3 of the scene's 1000 parts", said)
        # At another place, only part 7 is near.
        out, _ = self.explain(many, along(self.STEP, 30 * 7, start=MIDDLE), along(INTO, 0.002))
        self.assertEqual([mode["name"] for mode in out["modes"]],
                         ["wall[7]", "/modes/1[7]", "stream[7]", "honey", "floor"])

    def test_distant_parts_do_not_change_the_report_on_a_part(self):
        balls = {f"b{i}": {"file": "ball.vdb", "place": {"like": f"b{i - 1}"} if i == 5 else
                           {"scale": 0.01, "translate": [0.2 * i, 0, 0]}} for i in range(12)}
        skins = [{"name": f"skin {i}", "mode": "isosurface", "of": f"b{i}", "value": 0,
                  "solid": "below", "strength": 3} for i in range(12)]
        few = [skins[4], skins[5]]
        a, said = self.told("press", self.scene(*skins, volumes=balls), "--at", "0.8,0,0.025",
                            "--along", "0,0,-0.01", "--json")
        b, _ = self.told("press", self.scene(*few, volumes=balls), "--at", "0.8,0,0.025", "--along",
                         "0,0,-0.01", "--json")
        self.assertEqual(a, b)
        self.assertIn("near 2 of the scene's 12 parts", said)
        self.assertAlmostEqual(json.loads(a)["modes"][0]["touched_at"], 0.005, delta=0.0002)
        # Ball 5 is placed like ball 6, which no mode reads and which is loaded only for its placement.
        del balls["b5"]
        balls["b5"] = {"file": "ball.vdb", "place": {"like": "b6"}}
        skins[6]["strength"] = 0
        out, _ = self.explain(self.scene(*skins, volumes=balls), [1.2, 0, 0.0205], [0, 0, -0.002])
        self.assertEqual([mode["name"] for mode in out["modes"]], ["skin 5"])
        self.assertEqual(out["modes"][0]["primitives"][0]["state"], "holds")

    def test_an_explanation_of_a_hand_near_no_part_or_near_too_many_parts_is_refused(self):
        balls = {"b": {"file": "ball.vdb", "instances": [self.place(i) for i in range(5)]}}
        skin = {"mode": "isosurface", "of": "b", "value": 0, "solid": "below", "strength": 3}
        far = self.scene(skin, volumes=balls)
        self.refused("press", far, "--at", "0,5,0", "--along", "0,0,1", says="comes near no part")
        self.refused("explain", far, "--at", "0,5,0", "--push", "0,0,0.001",
                     says="comes near no part")
        balls["b"]["instances"] = [{"scale": 0.01, "translate": [0.05 * i, 0, 0]}
                                   for i in range(70)]
        row = self.scene(skin, volumes=balls)
        self.refused("press", row, "--at", "0,0,0.021", "--along", "3.5,0,0", "--speed", 1,
                     says="near 70 of the scene's 70 parts; a report covers at most 64")
        self.refused("press", row, "--at", "0,0,0.021", "--along", "2,0,0", "--speed", 1,
                     says="a report covers at most 64 volumes")
        self.assertIn("near 4 of the scene's 70", run("press", row, "--at", "0,0,0.021", "--along",
                                              "0.15,0,0", "--speed", 1).stderr)

    @suite.smoke
    def test_an_explanation_of_parts_reports_name_clashes_notes_and_the_limit_of_parts(self):
        ball = {"file": "ball.vdb"}
        skin = {"name": "skin", "mode": "isosurface", "of": "b", "value": 0, "solid": "below",
                "strength": 3}
        way = ("--at", "0,0,0.0205", "--push", "0,0,-0.002", "--json")
        # Another volume has the name that an instance would get.
        volumes = {"b": {**ball, "instances": [self.place(i) for i in range(5)]},
                   "b[0]": {**ball, "place": {"scale": 0.01, "translate": [0, 0, 0.001]}}}
        own = {**skin, "name": "own", "of": "b[0]"}
        self.refused("explain", self.scene(skin, own, volumes=volumes), *way,
                     says='/volumes/b/instances/0: palpate names this instance "b[0]", but')
        # Adds a volume with instances that no mode reads.
        del volumes["b[0]"]
        volumes["unread"] = {**ball, "instances": [self.place(i) for i in range(3)]}
        volumes["b"]["smooth"] = 1.5
        done = run("explain", self.scene(skin, volumes=volumes), *way)
        self.assertEqual([m["name"] for m in json.loads(done.stdout)["modes"]],
                         ["skin[0]", "skin[1]", "skin[2]"])
        # Notes name the scene's own volumes, once.
        self.assertEqual(done.stderr.count("/volumes/b: smoothed"), 1)
        self.assertNotIn("b[0]: smoothed", done.stderr)
        # There are 100 equal parts, more than the limit of 64.
        drag = {"mode": "viscosity", "of": "b", "strength": 0.02}
        del volumes["b"]["smooth"]
        volumes["b"]["instances"] = [self.place(0)] * 100
        done = run("explain", self.scene(drag, volumes=volumes), "--at", "0,0,0.0205", "--push",
                   "0,0,-0.002", "--json")
        self.assertIn("near 64 of the scene's 100 parts", done.stderr)
        self.assertIn("off by at most 0.72 N", done.stderr)
        self.assertAlmostEqual(size(json.loads(done.stdout)["balance"]["spring"]), 1.0)

    def test_an_interrupted_press_or_stability_map_leaves_no_files(self):
        ball = self.dir / "ball.vdb"
        before = sorted(os.listdir(self.dir))
        for words_ in (("press", ball, "--at", "0,0,0.06", "--along", "0,0,-0.1", "--speed", 1e-4,
                        "--csv", self.dir / "x.csv", "--picture", self.dir / "x.png"),
                       ("stability", ball, "--map", self.dir / "x", "--size", 257, "--rate", 4000)):
            for how in (signal.SIGINT, signal.SIGTERM):
                child = subprocess.Popen([PALPATE, *map(str, words_)], stdout=subprocess.DEVNULL,
                                         stderr=subprocess.PIPE, text=True)
                while not any("partial" in name for name in os.listdir(self.dir)):
                    self.assertIsNone(child.poll())
                    time.sleep(0.01)
                time.sleep(0.3)
                child.send_signal(how)
                _, said = child.communicate(timeout=60)
                self.assertEqual(child.returncode, 130)
                self.assertIn("interrupted: unfinished output was not written", said)
                self.assertEqual(sorted(os.listdir(self.dir)), before)

    def test_a_stability_map_does_not_overwrite_its_scene(self):
        skin = {"mode": "isosurface", "of": "b", "value": 0, "solid": "below", "strength": 3}
        scene = self.scene(skin, volumes={"b": {"file": "ball.vdb", "place": PLACE}})
        before = scene.read_text()
        for name in (scene.with_suffix(""), scene):
            self.refused("stability", scene, "--map", name, "--size", 9,
                         says="it is an input of this run")
            self.assertEqual(scene.read_text(), before)

    def test_the_stability_map_of_a_scene_s_parts_equals_that_of_separate_volumes(self):
        balls = {"b": {"file": "ball.vdb",
                       "instances": [{"scale": 0.01, "translate": [0, 0, 0.04 * i]}
                                     for i in range(8)]}}
        skin = {"mode": "isosurface", "of": "b", "value": 0, "solid": "below", "strength": 3}
        done = run("stability", self.scene(skin, volumes=balls), "--size", 9, "--rate", 250, "--json")
        self.assertIn("of the scene's 8 parts", done.stderr)
        tick = json.loads(done.stdout)["methods"][0]
        self.assertEqual(tick["name"], "whole tick")
        # The same balls as separate volumes in one graph.
        balls = {f"b{i}": {"file": "ball.vdb", "place": place}
                 for i, place in enumerate(balls["b"]["instances"])}
        out = self.scene(*({**skin, "of": name} for name in balls), volumes=balls)
        told = json.loads(run("stability", out, "--size", 9, "--rate", 250, "--json").stdout)
        # In unstable cells, rounding decides the class of the oscillation.
        cells = zip("".join(told["methods"][0]["rows"]), "".join(tick["rows"]))
        self.assertLessEqual(sum(a != b for a, b in cells), 1)


if __name__ == "__main__":
    suite.main(sys.argv[3:])
