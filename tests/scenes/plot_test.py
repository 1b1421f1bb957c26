#!/usr/bin/env python3
"""Tests plots of traces: plot_test.py BIN_DIR VOLUMES_PROGRAM. Compares the numbers that a plot reports (--json) with
numbers that this test computes from the trace."""
import csv
import json
import math
import os
import struct
import sys
import tempfile
import unittest
import xml.etree.ElementTree as ET
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import drawing  # noqa: E402
import process  # noqa: E402
import suite  # noqa: E402
from refusals import refusal  # noqa: E402

BIN = Path(sys.argv[1])
VOLUMES = sys.argv[2]
STRENGTHS = {"soft": 0.5, "stiff": 2.0}  # [N]
PLANES = {"x-y": "xy", "x-z": "xz", "y-z": "yz"}
ODD = "k=$5^{2}$ <b> & 直.csv"
OVER_TIME = {"force": "force [N]", "gap": "|probe - proxy| [mm]", "bound": "error bound [m]",
             "energy": "work on the hand [mJ]"}


def run(*words, status=0, stdin="", programs=BIN):
    done = process.run([str(programs / "palpate"), *map(str, words)], input=stdin, capture_output=True,
                       text=True, timeout=300, check=False)
    if done.returncode != status:
        raise AssertionError(f"{words}: status {done.returncode}, not {status}: {done.stderr}")
    return done


class Numbers:
    """The numbers of a trace, computed from their definitions."""

    def __init__(self, text):
        rows = list(csv.DictReader(text.splitlines()))

        def vectors(what):
            return [[float(row[f"{what}_{a}"]) for a in "xyz"] for row in rows]
        self.t = [float(row["t"]) for row in rows]
        self.probe, self.proxy, forces = vectors("probe"), vectors("proxy"), vectors("force")
        self.force = [math.hypot(*f) for f in forces]
        self.gap = [1e3 * math.dist(*pair) for pair in zip(self.probe, self.proxy)]
        self.bound = [float(row["error_bound"]) for row in rows]
        self.energy = [0.0]  # [mJ]; each tick's force works until the next tick
        for f, a, b in zip(forces, self.probe, self.probe[1:]):
            self.energy.append(self.energy[-1] + 1e3 * sum(n * (y - x) for n, x, y in zip(f, a, b)))
        self.ticks = sorted(int(row["tick_ns"]) for row in rows)
        self.words = [row["status"] for row in rows]
        self.limited = sum(row["limited"] == "1" for row in rows)

    def percentile(self, share):
        """Returns the shortest time that this share of ticks does not exceed [us]."""
        return 1e-3 * self.ticks[math.ceil(share * len(self.ticks)) - 1]


class Plot(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.holder = tempfile.TemporaryDirectory()
        cls.dir = Path(cls.holder.name)
        cls.fork = drawing.Fork(cls.addClassCleanup, BIN)
        cls.shared = {}  # drawings that tests share
        process.run([VOLUMES, str(cls.dir)], check=True)
        cls.traces, cls.numbers, cls.felt = [], [], []
        for name, strength in STRENGTHS.items():
            scene = {"palpate": 1, "coupling": {"stiffness": 500, "damping": 0.5},
                     "volumes": {"ball": {"file": "ball.vdb", "grid": "ball", "place": {"fit": 0.1}}},
                     "modes": [{"name": "ball", "mode": "isosurface", "of": "ball", "value": 0,
                                "solid": "below", "strength": strength}]}
            (cls.dir / f"{name}.json").write_text(json.dumps(scene))
            trace = cls.dir / f"{name}.csv"
            felt = run("feel", cls.dir / f"{name}.json", "--seconds", 4, "--trace", trace, "--json")
            cls.traces.append(trace)
            cls.numbers.append(Numbers(trace.read_text()))
            cls.felt.append(json.loads(felt.stdout))

    @classmethod
    def tearDownClass(cls):
        cls.holder.cleanup()

    def drawn(self, *traces, out="runs.png", stdin=""):
        """Returns the reported content and the picture. Removes the picture's file."""
        place = self.dir / out
        done = run("plot", *traces, "--out", place, "--json", stdin=stdin, programs=self.fork.folder)
        self.assertEqual(done.stderr, "")
        picture = place.read_bytes()
        os.remove(place)
        self.assertFalse([f for f in os.listdir(self.dir) if "partial" in f])
        return json.loads(done.stdout), picture

    def drawn_once(self, name, draw):
        """Returns the result of the first call with this name."""
        if name not in self.shared:
            self.shared[name] = draw()
        return self.shared[name]

    def both(self):
        return self.drawn_once("both", lambda: self.drawn(*self.traces))

    def both_printed(self):
        """Draws both traces in a new process without --json. Returns the printed lines and the picture."""
        def draw():
            place = self.dir / "words.png"
            said = run("plot", *self.traces, "--out", place).stdout.splitlines()
            picture = place.read_bytes()
            os.remove(place)
            return said, picture
        return self.drawn_once("printed", draw)

    def six(self):
        """Draws six traces: the first trace under four names, with other columns, and from a pipe."""
        def draw():
            text = self.traces[0].read_text()
            rows = list(csv.DictReader(text.splitlines()))
            names = ["remark", *reversed(rows[0])]
            turned = "\ufeff" + "\r\n".join([",".join(names), "", *(
                ",".join(r.get(n, "as seen") for n in names) for r in rows)])
            (self.dir / "other").mkdir()
            twins = [self.written(name, text) for name in ("other/soft.csv", ODD, "a" * 90 + ".csv")]
            other = self.written("other.csv", turned)
            return self.drawn(self.traces[0], *twins, other, "-", out="names.svg", stdin=text)
        return self.drawn_once("six", draw)

    def written(self, name, text):
        place = self.dir / name
        place.write_text(text, encoding="utf-8", newline="")
        self.addCleanup(place.unlink, missing_ok=True)
        return place

    def near(self, a, b):
        self.assertAlmostEqual(a, b, delta=1e-9 * max(1.0, abs(b)))

    @suite.smoke
    def test_the_numbers_printed_by_the_command_plot_equal_those_of_the_traces(self):
        told, _ = self.both()
        self.assertEqual([r["name"] for r in told["runs"]], list(STRENGTHS))
        for shown, own, felt in zip(told["runs"], self.numbers, self.felt):
            self.assertEqual(shown["ticks"], len(own.t))
            self.assertEqual(shown["ticks"], felt["ticks"])
            self.near(shown["seconds"], own.t[-1] - own.t[0])
            self.assertGreater(max(own.force), 0.3)
            self.near(shown["force_max"], max(own.force))
            self.near(shown["force_max"], felt["force_max"])
            self.near(shown["gap_max_mm"], max(own.gap))
            self.assertEqual(shown["error_bound_max"], max(own.bound))
            self.assertEqual(shown["error_bound_zero"], own.bound.count(0.0))
            self.assertNotEqual(own.energy[-1], 0.0)
            self.near(shown["energy_mJ"], own.energy[-1])
            self.near(shown["energy_mJ"], 1e3 * felt["net_energy"])
            for word, share in (("p50", 0.5), ("p99", 0.99), ("p99.9", 0.999), ("max", 1.0)):
                self.near(shown["tick_us"][word], own.percentile(share))
                if 1e3 * shown["tick_us"][word] < 65000:  # larger times are coarser in the summary
                    self.near(shown["tick_us"][word], 1e-3 * felt["tick_ns"][word])
            self.assertEqual(shown["status"], {w: own.words.count(w) for w in set(own.words)})
            self.assertEqual(shown["limited"], own.limited)
            self.assertEqual(shown["limited"], felt["limited"])

    def test_the_panels_of_a_plot_have_units_and_the_range_of_all_runs(self):
        told, _ = self.both()
        panels = {(p["run"], p["panel"]): p for p in told["panels"]}
        self.assertEqual(set(panels), {(r, p) for r in STRENGTHS
                                       for p in (*PLANES, *OVER_TIME, "status", "times")})
        for name, own in zip(STRENGTHS, self.numbers):
            lines = {"force": own.force, "gap": own.gap, "bound": own.bound, "energy": own.energy}
            for panel, label in OVER_TIME.items():
                shown = panels[name, panel]
                self.assertEqual((shown["x"]["label"], shown["y"]["label"]), ("time [s]", label))
                self.assertEqual(shown["y"]["scale"], "log" if panel == "bound" else "linear")
                self.assertLessEqual(shown["x"]["limits"][0], own.t[0])
                self.assertGreaterEqual(shown["x"]["limits"][1], own.t[-1])
                # The line has fewer points than the run has ticks, but contains the smallest and the largest value. An
                # error of zero is drawn at the bottom.
                least, most, count = shown["line"]
                self.assertLessEqual(count, 2002)
                self.near(most, max(lines[panel]))
                if panel != "bound":
                    self.near(least, min(lines[panel]))
                low, high = shown["y"]["limits"]
                self.assertTrue(low <= least <= most <= high, shown)
            for panel, (a, b) in PLANES.items():
                shown = panels[name, panel]
                self.assertEqual((shown["x"]["label"], shown["y"]["label"]), (f"{a} [mm]", f"{b} [mm]"))
                for axis, key in ((a, "x"), (b, "y")):
                    at = [1e3 * p["xyz".index(axis)] for p in own.probe + own.proxy]
                    self.assertLessEqual(shown[key]["limits"][0], min(at))
                    self.assertGreaterEqual(shown[key]["limits"][1], max(at))
            times = panels[name, "times"]
            self.assertEqual((times["x"]["label"], times["y"]["label"]), ("time of a tick [µs]", "ticks [%]"))
            self.assertLessEqual(times["x"]["limits"][0], 1e-3 * own.ticks[0])
            self.assertGreaterEqual(times["x"]["limits"][1], 1e-3 * own.ticks[-1])
            self.assertEqual(times["legend"], [f"{w}  {own.percentile(s):.3g} µs" for w, s in
                                               (("p50", 0.5), ("p99", 0.99), ("p99.9", 0.999))])
            lanes = told["lanes"]
            for word in ("converged", "substep-limit", "fault", "limited"):
                self.assertIn(word, lanes)
            counts = [own.limited if w == "limited" else own.words.count(w) for w in lanes]
            self.assertEqual(panels[name, "status"]["texts"], [str(c) for c in counts])
            self.assertEqual(panels[name, "force"]["legend"][0], "sent")
            self.assertIn(f"limited ({own.limited} tick", panels[name, "force"]["legend"][1])
        # A panel has the same range for all runs, so that they can be compared.
        for panel in (*PLANES, *OVER_TIME, "status", "times"):
            ranges = {json.dumps(panels[name, panel]["y"]["limits"]) for name in STRENGTHS}
            self.assertEqual(len(ranges), 1, panel)

    def test_a_plot_is_written_in_every_format(self):
        for kind in ("png", "pdf", "svg"):
            traces = self.traces[:1] if kind == "pdf" else self.traces
            told, picture = self.both() if kind == "png" else self.drawn(*traces, out=f"runs.{kind}")
            self.assertEqual((told["format"], told["dpi"]), (kind, 300))
            again = self.both_printed() if kind == "png" else self.drawn(*traces, out=f"runs.{kind}")
            self.assertEqual(again[1], picture)  # equal, because a picture has no date
            self.assertNotIn(str(self.dir).encode(), picture)
            self.assertLess(len(picture), 3e6)
            if kind == "png":
                self.assertEqual(picture[:8], b"\x89PNG\r\n\x1a\n")
                self.assertIn(run("--version").stdout.splitlines()[0].encode(), picture)
                at = picture.index(b"pHYs") + 4
                self.assertEqual(struct.unpack(">IIB", picture[at:at + 9]), (11811, 11811, 1))  # 300 dpi
                size = struct.unpack(">II", picture[16:24])
                for pixels, inches in zip(size, told["inches"]):
                    self.assertAlmostEqual(pixels, 300 * inches, delta=1)
            elif kind == "pdf":
                self.assertEqual(picture[:5], b"%PDF-")
                self.assertIn(b"/FontFile2", picture)  # fonts that journals accept
                self.assertNotIn(b"/Type3", picture)
            else:
                words = " ".join(" ".join(text.itertext()) for text in ET.fromstring(picture).iter(
                    "{http://www.w3.org/2000/svg}text"))
                for word in (*STRENGTHS, "x [mm]", "y [mm]", "z [mm]", "time [s]", "force [N]",
                             "hand [mJ]", "time of a tick [µs]", "ticks [%]", "converged", "fault",
                             f"{self.numbers[0].percentile(0.999):.3g} µs"):
                    self.assertIn(word, words)

    def test_a_plot_of_many_rows_is_small_and_keeps_a_spike(self):
        head, row = self.traces[0].read_text().splitlines()[:2]
        fields = dict(zip(head.split(","), row.split(",")))
        lines = [head]
        for i in range(300000):
            fields["t"] = repr(i / 1000)
            fields["force_x"] = "7.5" if i == 123457 else "0"
            fields["force_y"] = fields["force_z"] = "0"
            fields["limited"] = str(int(i == 200001))
            fields["status"] = "fault" if i == 250003 else "hairpin" if i % 2 else "converged"
            lines.append(",".join(fields.values()))
        many = self.written("many.csv", "\n".join(lines) + "\n")
        told, picture = self.drawn(many, out="many.svg")
        self.assertLess(len(picture), 2e6)
        panels = {p["panel"]: p for p in told["panels"]}
        self.assertEqual(panels["force"]["line"][:2], [0.0, 7.5])
        self.assertEqual(told["runs"][0]["status"], {"converged": 150000, "hairpin": 149999, "fault": 1})
        self.assertEqual(dict(zip(told["lanes"], panels["status"]["texts"])),
                         {"converged": "150000", "hairpin": "149999", "substep-limit": "0", "fault": "1",
                          "limited": "1"})
        self.assertEqual(panels["force"]["legend"], ["sent", "limited (1 tick)"])
        # All marks are drawn: intervals of the two statuses, one fault, one limited force.
        self.assertEqual(panels["status"]["marks"], 4)

    def test_a_plot_reads_traces_with_more_columns_in_another_order(self):
        """One of the traces comes from a pipe."""
        told, _ = self.six()
        _, usual, *_, other, piped = [  # skips the first run, which alone has a legend of the paths
            ({**run, "name": ""}, [{**panel, "run": ""} for panel in told["panels"] if panel["run"] == run["name"]])
            for run in told["runs"]]
        self.assertEqual([run["name"] for run in told["runs"][4:]], ["other", "stdin"])
        self.assertEqual(len(usual[1]), len(PLANES) + len(OVER_TIME) + 2)
        self.assertEqual(other, usual)
        self.assertEqual(piped, usual)

    def test_missing_numbers_of_a_tick_are_skipped(self):
        head, *rows = self.traces[0].read_text().splitlines()
        bound = head.split(",").index("error_bound")
        fields = rows[100].split(",")
        fields[bound] = ""
        fields[bound - 1] = ""
        fields[bound - 2] = ""
        cut = self.written("cut.csv", "\n".join([head, *rows[:100], ",".join(fields), *rows[101:]]))
        told, _ = self.drawn(cut)
        self.assertEqual(told["runs"][0]["ticks"], len(rows))
        self.assertTrue(math.isfinite(told["runs"][0]["force_max"]))

    def test_traces_of_few_ticks_or_without_motion_are_drawn(self):
        head, row = self.traces[0].read_text().splitlines()[:2]
        for count in (1, 2):
            lines = [row.replace("0,", f"{i},", 1) for i in range(count)]
            told, _ = self.drawn(self.written("short.csv", "\n".join([head, *lines])))
            self.assertEqual(told["runs"][0]["ticks"], count)
        nothing = ["0" if name != "status" else "fault" for name in head.split(",")]
        told, _ = self.drawn(self.written("still.csv", "\n".join([head, ",".join(nothing)])))
        self.assertEqual(told["runs"][0]["force_max"], 0.0)

    def test_runs_in_a_plot_are_named_by_their_file_names_without_extension(self):
        told, picture = self.six()
        names = [r["name"] for r in told["runs"]]
        self.assertEqual(names[:3], ["soft", "soft (2)", Path(ODD).stem])
        self.assertLessEqual(len(names[3]), 40)
        titles = "".join("".join(t.itertext()) for t in ET.fromstring(picture).iter(
            "{http://www.w3.org/2000/svg}text"))
        self.assertIn(Path(ODD).stem, titles)

    def test_the_plot_command_prints_one_line_for_each_trace(self):
        said, _ = self.both_printed()
        self.assertEqual(len(said), 2)
        for line, name, own in zip(said, STRENGTHS, self.numbers):
            self.assertRegex(line, rf"^{name}: {len(own.t)} ticks in [\d.]+ s; at most [\d.]+ N, ")

    @suite.smoke
    def test_a_refused_command_plot_leaves_no_files(self):
        good = self.traces[0]
        out = self.dir / "out.png"
        text = good.read_text()
        head, first, second = text.splitlines()[:3]

        def refused(*words, says, programs=BIN):
            _, line = refusal(self, self.dir, lambda: run("plot", *words, status=2, programs=programs))
            self.assertIn(says, line)

        def bad(text, says):
            refused(good, self.written("bad.csv", text), "--out", out, says=says, programs=self.fork.folder)
        refused(self.dir / "none.csv", "--out", out, says="none.csv: it cannot be read (No such file")
        refused(self.dir, "--out", out, says="it is a folder")
        refused("--out", out, says="see palpate plot --help")
        refused(good, says="see palpate plot --help")
        for name in ("out.jpg", "out", "png", "-", "out.PNG"):
            refused(good, "--out", name, says="it is not named .png, .pdf or .svg")
        refused(*[good] * 7, "--out", out, says="7 traces do not fit side by side: give at most 6")
        refused(good, "--out", "/no/such/place/p.png", says="cannot be written")
        refused(self.dir / "ball.vdb", "--out", out, says="it is not a trace: the column \"t\" is missing")
        for name in ("t", "probe_y", "error_bound", "tick_ns", "status", "limited"):
            bad(",".join(n for n in head.split(",") if n != name), says=f'the column "{name}" is missing')
        bad("", says='the column "t" is missing')
        bad(head + "\n", says="it has no rows")
        bad("\n".join([head, first, second[:20]]), says="bad.csv line 3: it has ")
        bad("\n".join([head, "x" + first]), says="is not a finite number")
        bad("\n".join([head, first.replace("0,", "inf,", 1)]), says='t: "inf" is not a finite number')
        bad("\n".join([head, first.replace("0,", ",", 1)]), says='t: "" is not a finite number')
        undefined = ",".join(["0", "nan", *first.split(",")[2:]])
        bad("\n".join([head, undefined]), says='probe_x: "nan" is not a finite number')
        bad("\n".join([head, first.replace("converged", "fine")]), says='"fine" is not a status')
        bad("\n".join([head, second, first]), says="bad.csv line 3: its time is earlier")
        bad(head + "\n" + "1," * 40000, says="bad.csv line 2: it is longer than")
        # Existing files are kept: an input and the previous picture.
        trace = self.written("trace.png", text)
        refused(trace, "--out", trace, says="it is an input of this run")
        link = self.dir / "link.svg"
        link.symlink_to("trace.png")
        self.addCleanup(link.unlink)
        refused(trace, "--out", link, says="it is an input of this run")
        self.assertEqual(trace.read_text(), text)
        before = self.written("before.png", "a picture")
        refused(good, self.written("bad.csv", head), "--out", before, says="it has no rows")
        self.assertEqual(before.read_text(), "a picture")


if __name__ == "__main__":
    suite.main(sys.argv[3:])
