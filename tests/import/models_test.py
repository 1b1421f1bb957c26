#!/usr/bin/env python3
"""Tests imports of files from weather models and flow solvers: models_test.py BIN_DIR."""
import csv
import io
import json
import math
import os
import random
import struct
import sys
import tempfile
import unittest
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import process  # noqa: E402
import suite  # noqa: E402
import cgns  # noqa: E402
import foam  # noqa: E402
import netcdf  # noqa: E402
from cases import cases  # noqa: E402
from refusals import refusal  # noqa: E402

PALPATE = str((Path(sys.argv[1]) / "palpate").resolve())
DEGREE = 6371.0 * math.pi / 180.0


class Case(unittest.TestCase):
    def setUp(self):
        holder = tempfile.TemporaryDirectory()
        self.addCleanup(holder.cleanup)
        self.dir = Path(holder.name)
        self.out = self.dir / "out.vdb"

    def call(self, *words, text=None):
        return process.run([PALPATE, *map(str, words)], capture_output=True, text=True,
                              input=text, timeout=120)

    def imported(self, source, *words):
        """Imports a file. Returns the report, with grids by name."""
        done = self.call("import", source, self.out, "--json", *words)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        report = json.loads(done.stdout)
        report["grid"] = {grid["name"]: grid for grid in report["grids"]}
        report["note"] = "\n".join(report["notes"])
        return report

    def info(self, grid):
        done = self.call("info", self.out, "--json")
        return next(g for g in json.loads(done.stdout)["grids"] if g["name"] == grid)

    def sample(self, grid, points):
        text = "x,y,z\n" + "".join("{!r},{!r},{!r}\n".format(*map(float, p)) for p in points)
        done = self.call("sample", self.out, "--grid", grid, "--points", "-", text=text)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        return list(csv.DictReader(io.StringIO(done.stdout)))

    def holds(self, grid, points, expected, within):
        for p, row in zip(points, self.sample(grid, points)):
            value = expected(*p)
            found = [float(row[k]) for k in ("vx", "vy", "vz")] if isinstance(value, tuple) else [
                float(row["value"])]
            for a, b in zip(value if isinstance(value, tuple) else (value,), found):
                self.assertAlmostEqual(a, b, delta=within, msg=(grid, p, row))

    def scene(self):
        done = self.call("scene", self.out)
        self.assertEqual(done.returncode, 0, done.stderr)
        return json.loads(done.stdout)

    def felt_as(self, flow, *drags):
        """Checks that the scene follows the flow, and that scalars act as drags."""
        modes = [(m["mode"], m["of"]) for m in self.scene()["modes"]]
        self.assertIn(("follow", flow), modes)
        for drag in drags:
            self.assertIn(("viscosity", drag), modes)

    def refused(self, source, says, *words):
        done, line = refusal(self, self.dir,
                             lambda: self.call("import", source, self.out, *words))
        self.assertEqual(done.returncode, 2, line)
        self.assertIn(says, line)

    def survives(self, source, whole, count, name):
        """Checks that damaged copies give one line or a volume, and leave no other file."""
        rng = random.Random(7)
        for case in range(cases(count, f"damaged files of {name}")):
            broken = bytearray(whole)
            if case % 3 == 0:
                del broken[rng.randrange(len(broken)):]
            else:
                for _ in range(rng.choice((1, 1, 5, 50))):
                    at = rng.randrange(min(len(broken), 2000) if rng.random() < 0.7
                                       else len(broken))
                    broken[at] = rng.randrange(256)
            source.write_bytes(broken)
            before = sorted(os.listdir(self.dir))
            done = self.call("import", source, self.out)
            label = f"case {case}: {done.stderr}"
            self.assertIn(done.returncode, (0, 1, 2), label)
            if done.returncode == 0:
                self.assertEqual(done.stderr, "", label)
                self.out.unlink()
            else:
                self.assertEqual(done.stderr.count("\n"), 1, label)
                self.assertTrue(done.stderr.startswith("palpate: "), label)
            self.assertEqual(sorted(os.listdir(self.dir)), before, label)


def clustered(n, beta):
    """Returns n numbers from 0 to 1 that are dense near 0."""
    return [(math.exp(beta * i / (n - 1)) - 1) / (math.exp(beta) - 1) for i in range(n)]


class Sizes(Case):
    SIZE = (25, 31, 9)

    def points(self):
        """Returns points around a cylinder, dense at its surface like a boundary layer's mesh."""
        nt, nr, nz = self.SIZE
        rings = [0.5 + 10 * r for r in clustered(nr, 8)]
        return [(r * math.cos(t), r * math.sin(t), 0.25 * k) for k in range(nz) for r in rings
                for t in (2 * math.pi * i / (nt - 1) for i in range(nt))]

    def test_a_stretched_mesh_is_resampled_to_at_most_16_voxels_per_point(self):
        nt, nr, nz = self.SIZE
        points = self.points()
        body = (f"# vtk DataFile Version 3.0\nx\nASCII\nDATASET STRUCTURED_GRID\n"
                f"DIMENSIONS {nt} {nr} {nz}\nPOINTS {len(points)} double\n"
                + "\n".join("{!r} {!r} {!r}".format(*p) for p in points)
                + f"\nPOINT_DATA {len(points)}\nSCALARS s double 1\nLOOKUP_TABLE default\n"
                + "\n".join(repr(math.exp(-math.hypot(x, y)) + z) for x, y, z in points))
        source = self.dir / "o.vtk"
        source.write_text(body)
        report = self.imported(source)
        s = report["grid"]["s"]
        self.assertGreater(16 * len(points), 33 ** 3)
        self.assertLessEqual(s["active_voxels"], 16 * len(points))
        self.assertGreater(s["active_voxels"], 8 * len(points))
        self.assertLess(s["resampling"]["rms"], 0.005)
        self.assertIn("limits the voxels to 16 per point", report["note"])
        finer = float(report["note"].split("--voxel ")[1].split()[0])
        self.assertLess(finer, s["voxel"][0])
        asked = self.imported(source, "--voxel", 0.9 * s["voxel"][0])
        self.assertGreater(asked["grid"]["s"]["active_voxels"], s["active_voxels"])
        self.assertNotIn("per point", asked["note"])
        self.assertLess(asked["grid"]["s"]["resampling"]["rms"], s["resampling"]["rms"])

    def check_twice_plus_64_mib(self, report, given):
        """Checks that output and additional memory are at most twice the input (`given` bytes) plus 64 MiB."""
        most = 2 * given + (64 << 20)
        self.assertLessEqual(self.out.stat().st_size, most)
        if not os.environ.get("PALPATE_SANITIZE"):
            peak = report["memory"]["peak"] - self.idle()
            self.assertLessEqual(peak, most)
            print(f"{given / 1e6:.1f} MB: {self.out.stat().st_size / 1e6:.1f} MB of .vdb, "
                  f"{peak / 1e6:.0f} MB of memory")

    def idle(self):
        """Returns the peak memory of an import of a tiny file [bytes]."""
        source = self.dir / "small.raw"
        source.write_bytes(bytes(range(27)))
        done = self.call("import", source, self.dir / "small.vdb", "--json", "--raw",
                         '{"size": [3, 3, 3], "type": "uint8"}')
        return json.loads(done.stdout)["memory"]["peak"]

    def test_the_vdb_of_a_ct_of_half_millimetre_voxels_has_at_most_twice_the_size_of_its_source(self):
        n = 256
        rng = random.Random(1)
        plane = struct.pack(f"<{n * n}h", *(rng.randrange(-1024, 2000) for _ in range(n * n)))
        source = self.dir / "ct.nrrd"
        # The values are noise, so no voxel is inactive, and compression finds no equal values.
        with source.open("wb") as file:
            file.write(f"NRRD0004\ntype: short\ndimension: 3\nsizes: {n} {n} {n}\nencoding: raw\n"
                       "endian: little\nspace: right-anterior-superior\nspace directions: "
                       "(0.5,0,0) (0,0.5,0) (0,0,0.5)\nspace origin: (0,0,0)\n\n".encode())
            for k in range(n):
                file.write(plane[2 * k:] + plane[:2 * k])
        report = self.imported(source)
        self.assertGreater(report["grids"][0]["active_voxels"], 0.99 * n ** 3)
        self.assertEqual(report["grids"][0]["voxel"], [0.5, 0.5, 0.5])
        self.assertLessEqual(self.out.stat().st_size, 2 * source.stat().st_size)
        self.check_twice_plus_64_mib(report, source.stat().st_size)

    @suite.smoke
    def test_a_plot3d_boundary_layer_is_imported_with_at_most_16_voxels_per_point(self):
        points = self.points()
        grid, solution = self.dir / "g.xyz", self.dir / "g.q"
        numbers = [p[a] for a in range(3) for p in points]
        grid.write_bytes(struct.pack(f"<3i{len(numbers)}f", *self.SIZE, *numbers))
        states = [(1.0, 1 - 0.25 / (x * x + y * y), 0.1 * y, 0.0, 3.0 + 0.01 * x)
                  for x, y, _ in points]
        numbers = [s[a] for a in range(5) for s in states]
        solution.write_bytes(struct.pack(f"<3i4f{len(numbers)}f", *self.SIZE, 0.5, 0, 1e6, 0,
                                         *numbers))
        report = self.imported(grid, "--solution", solution)
        for one in report["grids"]:
            self.assertLessEqual(one["active_voxels"], 16 * len(points))
        self.check_twice_plus_64_mib(report, grid.stat().st_size + solution.stat().st_size)


LONGITUDES = [10 + 0.5 * i for i in range(13)]
LATITUDES = [50 - 0.5 * j for j in range(9)]
LEVELS = [1000, 850, 700, 500, 300]
MIDDLE = 48.0


def height(pressure):
    return 44.330769 * (1 - (pressure / 1013.25) ** (1 / 5.25588))


def wind(x, y, p):
    return (10 + (1000 - p) / 50 + x - 13, 2 * (y - 48) + 1)


def heat(x, y, p):
    return 288 - 0.06 * (1000 - p) + 2 * (y - 48)


def over(levels, function):
    """Returns values in the order of the files: longitude fastest, latitudes descending."""
    return [function(x, y, p) for p in levels for y in LATITUDES for x in LONGITUDES]


def place(longitude, latitude, z):
    return (longitude * DEGREE * math.cos(math.radians(MIDDLE)), latitude * DEGREE, z)


class Netcdf(Case):
    def weather(self, name="a.nc", form=netcdf.CLASSIC, levels=LEVELS, level=None, more=None):
        """Writes a file of two time steps. u is packed, and t has a missing value."""
        t = over(levels, heat)
        t[0] = -999.0
        field = ("time", "lev", "lat", "lon")
        u = [round((v - 5) / 0.01) for v in over(levels, lambda *p: wind(*p)[0])]
        v = over(levels, lambda *p: wind(*p)[1])
        variables = {
            "time": (netcdf.DOUBLE, ("time",), {"units": "hours since 2020-01-01"}, [0, 6]),
            "lev": (netcdf.FLOAT, ("lev",), level or {"units": "hPa"}, levels),
            "lat": (netcdf.FLOAT, ("lat",), {"units": "degrees_north"}, LATITUDES),
            "lon": (netcdf.FLOAT, ("lon",), {"units": "degrees_east"}, LONGITUDES),
            "u": (netcdf.SHORT, field, {
                "units": "m s-1", "scale_factor": (netcdf.DOUBLE, [0.01]),
                "add_offset": (netcdf.DOUBLE, [5.0]), "_FillValue": (netcdf.SHORT, [-32767])},
                u + [w + 100 for w in u]),
            "v": (netcdf.FLOAT, field, {"units": "m s-1"}, v + v),
            "w": (netcdf.FLOAT, field, {"units": "Pa s-1"}, [0.1 * a for a in v + v]),
            "t": (netcdf.DOUBLE, field, {"units": "K", "missing_value": (netcdf.DOUBLE, [-999])},
                  t + t),
            "sp": (netcdf.FLOAT, field[:1] + field[2:], {"units": "Pa"},
                   [1e5] * (2 * len(LATITUDES) * len(LONGITUDES))),
            **(more or {})}
        return netcdf.write(self.dir / name, {
            "time": 2, "lev": len(levels), "lat": len(LATITUDES), "lon": len(LONGITUDES)},
            variables, "made by a test", form, form != netcdf.CLASSIC)

    @suite.smoke
    def test_imports_a_netcdf_file_of_weather_on_pressure_levels(self):
        for form in (netcdf.CLASSIC, netcdf.NETCDF4):
            report = self.imported(self.weather(form=form))
            self.assertEqual(set(report["grid"]), {"wind", "w", "t"})
            self.assertEqual(report["grid"]["wind"]["unit"], "m s-1")
            self.assertEqual(report["grid"]["t"]["unit"], "K")
            for says in ("as at latitude 48", "sp: skipped", "u and v: joined", "standard atmos",
                         "heights are exaggerated 20 times", "the first of 2 steps"):
                self.assertIn(says, report["note"])
            self.assertEqual(report["time"], 0)
            places = [(x, y, p) for x in LONGITUDES[2:9:3] for y in LATITUDES[2:7:2]
                      for p in (850, 700, 500)]
            at = [place(x, y, 20 * height(p)) for x, y, p in places]
            found = iter(places)
            self.holds("wind", at, lambda *_: (*wind(*next(found)), 0.0), 0.05)
            found = iter(places)
            self.holds("t", at, lambda *_: heat(*next(found)), 0.3)
            self.felt_as("wind", "t")
            self.assertIn(b"made by a test, heights times 20", self.out.read_bytes())

    @suite.smoke
    def test_options_select_times_and_fields_of_a_netcdf_file(self):
        source = self.weather()
        report = self.imported(source, "--time", 1, "--field", "u", "--field", "t")
        self.assertEqual((report["time"], set(report["grid"])), (6, {"u", "t"}))
        x, y, p = LONGITUDES[4], LATITUDES[4], 700
        self.holds("u", [place(x, y, 20 * height(p))], lambda *_: wind(x, y, p)[0] + 1, 0.05)
        self.refused(source, 'no array "q"', "--field", "q")
        self.refused(source, "no step", "--time", "2")
        # A scene plays the six hours between the steps in 0.2 s.
        scene = self.dir / "scene.json"
        done = self.call("import", source, self.out, "--time", "all", "--field", "t", "--scene", scene)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        played = json.loads(scene.read_text())
        self.assertEqual((played["volumes"]["t"]["frames"], played["play"]["speed"]), ({"rate": 4.62963e-05}, 110000))
        self.assertEqual(self.call("check", scene).returncode, 0)

    def test_evenly_spaced_heights_are_imported_without_resampling(self):
        levels = [0, 2000, 4000, 6000]
        report = self.imported(self.weather(levels=levels, level={"units": "m", "axis": "Z"}))
        t = report["grid"]["t"]
        self.assertEqual((t["voxels"], t["holes"]), (9 * 13 * 4, 1))
        self.assertNotIn("resampling", t)
        edges = (0.5 * DEGREE * math.cos(math.radians(MIDDLE)), 0.5 * DEGREE, 2 * 20)
        for a, b in zip(t["voxel"], edges):
            self.assertAlmostEqual(a, b, 4)
        points = [(x, y, z) for x in LONGITUDES[1:6] for y in LATITUDES[1:4] for z in levels]
        found = iter(points)
        self.holds("t", [place(x, y, z * 20e-3) for x, y, z in points],
                   lambda *_: heat(*next(found)), 1e-3)
        self.assertIn(b"km", self.out.read_bytes())

    def test_a_vertical_wind_with_the_unit_of_the_horizontal_wind_becomes_the_z_component(self):
        names = ("eastward_wind", "northward_wind", "upward_air_velocity")
        field = ("time", "lev", "lat", "lon")
        more = {n: (netcdf.FLOAT, field, {"units": "m s-1", "standard_name": s}, [c] * 2 * 468)
                for n, s, c in zip("abc", names, (3.0, 4.0, 0.5))}
        more["a"][3][0] = 5.0
        report = self.imported(self.weather(levels=[0, 2000, 4000, 6000],
                                            level={"units": "m", "positive": "up"}, more=more))
        self.assertIn("a, b and c: joined into the vector wind", report["note"])
        at = place(LONGITUDES[4], LATITUDES[4], 40)
        self.holds("wind", [at], lambda *_: (3.0, 4.0, 10.0), 1e-4)

    @suite.smoke
    def test_depths_of_an_ocean_become_negative_heights(self):
        """The longitudes cross the date line, and depths are positive downwards."""
        size = (6, 5, 4)
        lons, lats, depths = [178, 179, 180, -179, -178, -177], [-2, -1, 0, 1, 2], [0, 10, 20, 30]
        values = [100.0 * k + 10 * j + i for k in range(4) for j in range(5) for i in range(6)]
        source = netcdf.write(self.dir / "o.nc", dict(zip(("depth", "lat", "lon"), size[::-1])), {
            "depth": (netcdf.FLOAT, ("depth",), {"units": "m", "positive": "down"}, depths),
            "lat": (netcdf.FLOAT, ("lat",), {"units": "degrees_north"}, lats),
            "lon": (netcdf.FLOAT, ("lon",), {"units": "degrees_east"}, lons),
            "thetao": (netcdf.FLOAT, ("depth", "lat", "lon"), {"units": "degC"}, values)})
        report = self.imported(source)
        self.assertIn("depths became negative heights", report["note"])
        stretch = report["grid"]["thetao"]["voxel"][2] / 0.01
        self.assertEqual(round(stretch), 5000)
        points = [(i, j, k) for i in range(6) for j in range(5) for k in range(4)]
        self.holds("thetao", [((178 + i) * DEGREE, (j - 2) * DEGREE, -0.01 * k * stretch)
                              for i, j, k in points],
                   lambda x, y, z: 100 * round(-z / 50) + 10 * round(y / DEGREE + 2)
                   + round(x / DEGREE - 178), 1e-2)

    def test_a_netcdf_grid_in_metres_is_imported_without_resampling(self):
        """Dimensions are recognised by their axis attributes, not by their order."""
        source = netcdf.write(self.dir / "m.nc", {"x": 4, "y": 5, "z": 6}, {
            **{n: (netcdf.DOUBLE, (n,), {"units": "m", "axis": n.upper()},
                   [0.25 * i + o for i in range(c)])
               for n, c, o in (("x", 4, 1), ("y", 5, 2), ("z", 6, 3))},
            "q": (netcdf.INT, ("x", "y", "z"), {"units": "1"},
                  [100 * k + 10 * j + i + 1 for i in range(4) for j in range(5)
                   for k in range(6)])})
        report = self.imported(source)
        self.assertEqual(report["grid"]["q"]["voxel"], [0.25, 0.25, 0.25])
        self.assertEqual(report["notes"], [])
        points = [(i, j, k) for i in range(4) for j in range(5) for k in range(6)]
        found = iter(points)
        self.holds("q", [(1 + 0.25 * i, 2 + 0.25 * j, 3 + 0.25 * k) for i, j, k in points],
                   lambda *_: (lambda i, j, k: 100 * k + 10 * j + i + 1.0)(*next(found)), 1e-4)

    @suite.smoke
    def test_refuses_netcdf_data_without_a_volume(self):
        place_of = {"units": "degrees_north"}
        source = netcdf.write(self.dir / "c.nc", {"z": 3, "y": 4, "x": 5}, {
            "lat2": (netcdf.FLOAT, ("y", "x"), place_of, [1.0] * 20),
            "lon2": (netcdf.FLOAT, ("y", "x"), {"units": "degrees_east"}, [1.0] * 20),
            "t": (netcdf.FLOAT, ("z", "y", "x"), {"coordinates": "lon2 lat2"},
                  [float(i) for i in range(60)])})
        self.refused(source, "interpolate the variable to a regular grid")
        source = netcdf.write(self.dir / "f.nc", {"cell": 30, "z": 3}, {
            "t": (netcdf.FLOAT, ("z", "cell"), {}, [1.0] * 90)})
        self.refused(source, "no variable of the netCDF file is a volume")

    @suite.smoke
    def test_refuses_netcdf_sizes_out_of_range_and_unordered_positions(self):
        source = netcdf.write(self.dir / "a.nc", {"z": 100000, "y": 100000, "x": 100000}, {
            "t": (netcdf.DOUBLE, ("z", "y", "x"), {}, None)}, form=netcdf.NETCDF4)
        self.refused(source, "more than the file can hold")
        source = netcdf.write(self.dir / "b.nc", {"z": 3, "y": 3, "x": 3}, {
            "x": (netcdf.FLOAT, ("x",), {}, [0, 2, 1]),
            "t": (netcdf.FLOAT, ("z", "y", "x"), {}, [float(i) for i in range(27)])})
        self.refused(source, "neither rise nor fall")
        whole = self.weather().read_bytes()
        source.write_bytes(whole[:-200])
        self.refused(source, "truncated")

    def grid(self, lon=(0, 2, 4, 6), lat=(-2, 0, 2), z=(0, 1, 2), z_is=None, more=None, first="z"):
        """Writes the field "a" over three axes. Its values are the indices of the points."""
        axes = {first: len(z), "lat": len(lat), "lon": len(lon)}
        count = len(z) * len(lat) * len(lon)
        variables = {
            first: (netcdf.DOUBLE, (first,), z_is or {"units": "km"}, z),
            "lat": (netcdf.DOUBLE, ("lat",), {"units": "degrees_north"}, lat),
            "lon": (netcdf.DOUBLE, ("lon",), {"units": "degrees_east"}, lon),
            "a": (netcdf.FLOAT, (first, "lat", "lon"), {}, [float(i) for i in range(count)])}
        for name, (kind, attributes, values) in (more or {}).items():
            variables[name] = (kind, (first, "lat", "lon"), attributes, values or range(count))
        return netcdf.write(self.dir / "g.nc", axes, variables)

    @suite.smoke
    def test_refuses_invalid_netcdf_coordinates(self):
        for lon in ((0, math.inf, 4), (0, 2, 1e300), (0, 1e17, 2e17), (0, math.nan, 4)):
            self.refused(self.grid(lon=lon), "longitude of")
        self.refused(self.grid(lat=(80, 100, 120)), "latitude of 100 degrees")

    def test_the_unit_and_direction_of_levels_decide_the_note_and_the_signs_of_heights(self):
        cases_of = [
            # Each case has z, its attributes, the note, and heights of both ends, of which only the signs count.
            ((1, 2, 3), {"units": "level", "positive": "down"}, "levels have no height",
             (-1, 0)),
            ((0.1, 0.5, 1), {"units": "1", "positive": "down"}, "levels have no height", (-1, 0)),
            ((1, 2, 3), {"units": "furlongs", "axis": "Z"}, '"furlongs" of the levels is unknown', (0, 1)),
            ((0, 1000, 3000), {"units": "ft"}, "heights are", (0, 0.9144)),
            ((0, 1000, 2000), {"units": "Meters"}, "heights are", (0, 2)),
            ((0, 1000, 2000), {"units": "dbar", "positive": "down"}, "depths became negative heights", (-2, 0)),
        ]
        for z, what, said, (low, high) in cases_of:
            report = self.imported(self.grid(z=z, z_is=what))
            self.assertIn(said, report["note"], what)
            bounds = self.info("a")["bounds"]
            found = [bounds[0][2], bounds[1][2]]
            self.out.unlink()
            self.assertEqual(found[0] < -1e-9, low < 0, (what, found))
            self.assertEqual(found[1] > 1e-9, high > 0, (what, found))

    def test_an_ensemble_axis_is_not_a_height(self):
        self.refused(self.grid(first="number", z_is={"standard_name": "realization"}),
                     "fewer than three dimensions of space")

    def test_reads_unsigned_numbers_of_the_classic_netcdf_format(self):
        raw = [(i * 1800) % 65536 for i in range(36)]
        signed = [v - 65536 if v > 32767 else v for v in raw]
        attributes = {"_Unsigned": "true", "scale_factor": (netcdf.DOUBLE, [0.5]),
                      "valid_range": (netcdf.SHORT, [0, -2])}
        self.imported(self.grid(more={"b": (netcdf.SHORT, attributes, signed)}))
        found = self.info("b")
        self.assertEqual(found["active_voxels"], 35)  # all but the voxel with the background value
        self.assertEqual(found["value_range"], [0, 0.5 * max(raw)])

    def test_joins_only_vector_components_of_the_same_unit(self):
        def flow(*units):
            return {name: (netcdf.FLOAT, {"units": unit}, None)
                    for name, unit in zip("uvw", units)}
        apart = self.imported(self.grid(more=flow("m s-1", "knots", "m s-1")))
        self.assertEqual(set(apart["grid"]), {"a", "u", "v", "w"})
        self.out.unlink()
        alike = self.imported(self.grid(more=flow("m s-1", "m/s", "m s**-1")))
        self.assertEqual(set(alike["grid"]), {"a", "wind"})
        self.assertIn("u, v and w: joined", alike["note"])

    def test_a_missing_value_attribute_with_more_digits_than_the_values_still_matches(self):
        values = [float(i) for i in range(36)]
        values[7] = -9999.9
        source = self.grid(more={"b": (netcdf.FLOAT, {"missing_value": (netcdf.DOUBLE, [-9999.9])}, values)})
        self.assertEqual(self.imported(source)["grid"]["b"]["holes"], 1)

    def test_large_whole_numbers_of_a_netcdf_file_are_stored_with_an_offset(self):
        values = [2 ** 30 + i for i in range(36)]
        report = self.imported(self.grid(more={"b": (netcdf.INT, {}, values)}))
        b = report["grid"]["b"]
        self.assertEqual((b["value_offset"], b["lowest"], b["highest"]), (2 ** 30, 0, 35))

    def test_a_value_such_as_minus_9999_is_missing_data_even_without_an_attribute_that_states_it(self):
        """The file's uneven levels are resampled, and no voxel is interpolated from such a value."""
        for sentinel, kind in ((-9999.0, netcdf.FLOAT), (1e20, netcdf.FLOAT), (-1e34, netcdf.DOUBLE)):
            t = over(LEVELS, lambda x, y, p: heat(x, y, p) + 0.1 * x)
            t[0] = t[5] = sentinel
            field = ("lev", "lat", "lon")
            report = self.imported(self.weather(more={"s": (kind, field, {}, t)}))
            s = report["grid"]["s"]
            self.assertIn(f"s: the value {sentinel:.6g} counts as missing data", report["note"])
            self.assertGreater(s["holes"], 0)
            self.assertGreater(s["lowest"], 200)
            self.assertLess(s["highest"], 400)
        # A boundary condition of 1000 is a result, although no other value is near 1000.
        hot = [300.0 + 0.2 * i for i in range(36 * 4)]
        hot[:40] = [1000.0] * 40
        report = self.imported(self.grid(lon=tuple(range(12)), lat=(0, 1, 2, 3),
                                         more={"b": (netcdf.FLOAT, {}, hot)}))
        self.assertEqual(report["grid"]["b"]["holes"], 0)

    def wrf(self, name="wrf.nc", places=True, attributes=True, heights=False, coordinates="XLONG XLAT",
            soil=False):
        """Writes files like those of the model WRF, with wind components on the faces of cells."""
        nx, ny, nz = 9, 7, 5
        full = {"west_east": nx, "south_north": ny, "bottom_top": nz}
        dims = {"Time": 1, **full, **{n + "_stag": c + 1 for n, c in full.items()}}
        mass = ("Time", "bottom_top", "south_north", "west_east")

        def along(axes, function):
            return [function(i, j, k) for k in range(dims[axes[1]]) for j in range(dims[axes[2]])
                    for i in range(dims[axes[3]])]

        def staggered(a):
            return mass[:a] + (mass[a] + "_stag",) + mass[a + 1:]

        kept = {"units": "m s-1", **({"coordinates": coordinates} if coordinates else {})}
        variables = {
            "T": (netcdf.FLOAT, mass, {**kept, "units": "K"}, along(mass, lambda i, j, k: 280 + i + 2 * j - 3 * k)),
            "U": (netcdf.FLOAT, staggered(3), kept, along(staggered(3), lambda i, j, k: i - 0.5 + j)),
            "V": (netcdf.FLOAT, staggered(2), kept, along(staggered(2), lambda i, j, k: 2 * (j - 0.5) + k)),
            "W": (netcdf.FLOAT, staggered(1), kept, along(staggered(1), lambda i, j, k: 0.1 * (k - 0.5)))}
        if heights:
            top = along(staggered(1), lambda i, j, k: 9.81 * (1000.0 * k + (10.0 if i == 0 else 0.0)))
            variables["PH"] = (netcdf.FLOAT, staggered(1), {}, [0.25 * v for v in top])
            variables["PHB"] = (netcdf.FLOAT, staggered(1), {}, [0.75 * v for v in top])
        if places:
            plane = ("Time", "south_north", "west_east")
            variables["XLAT"] = (netcdf.FLOAT, plane, {"units": "degree_north"},
                                 [0.01 * (j - 3) for j in range(ny) for i in range(nx)])
            variables["XLONG"] = (netcdf.FLOAT, plane, {"units": "degree_east"},
                                  [10 + 0.02 * i for j in range(ny) for i in range(nx)])
        if soil:
            dims["soil_layers_stag"] = 4
            layers = ("Time", "soil_layers_stag", *mass[2:])
            variables["TSLB"] = (netcdf.FLOAT, layers, kept, along(layers, lambda i, j, k: 280 + i + k))
        spacing = {"DX": (netcdf.FLOAT, [3000.0]), "DY": (netcdf.FLOAT, [2000.0])} if attributes else {}
        return netcdf.write(self.dir / name, dims, variables, attributes=spacing)

    @suite.smoke
    def test_a_wind_on_the_faces_of_cells_becomes_a_vector_at_their_centres(self):
        for coordinates in ("XLONG XLAT", "XLONG_U XLAT_U XTIME", ""):
            report = self.imported(self.wrf(coordinates=coordinates))
            self.assertEqual(set(report["grid"]), {"wind", "T"})
            self.assertIn("U, V, W: averaged from the cells' faces", report["note"])
            self.assertNotIn("XLAT", report["note"])
            voxel = report["grid"]["wind"]["voxel"]
            self.assertEqual([round(v, 4) for v in voxel[:2]], [3, 2])
            self.assertEqual(voxel, report["grid"]["T"]["voxel"])
            stretch = 1.0
            points = [(i, j, k) for i in (1, 4, 7) for j in (1, 3, 5) for k in (1, 2, 3)]
            at = [(3 * i, 2 * j, voxel[2] * k) for i, j, k in points]
            found = iter(points)
            self.holds("wind", at, lambda *_: (lambda i, j, k: (i + j, 2.0 * j + k, 0.1 * k * stretch))(*next(found)),
                       1e-4)
            found = iter(points)
            self.holds("T", at, lambda *_: (lambda i, j, k: 280.0 + i + 2 * j - 3 * k)(*next(found)), 1e-4)

    def test_the_spacing_of_wrf_is_computed_from_its_positions_if_no_attribute_states_it(self):
        report = self.imported(self.wrf(attributes=False))
        self.assertIn("mean distance between the points at XLAT and XLONG", report["note"])
        for found, degrees in zip(report["grid"]["wind"]["voxel"], (0.02, 0.01)):
            self.assertAlmostEqual(found, degrees * DEGREE, 3)

    def test_skips_wrf_variables_on_levels_of_the_soil(self):
        source = self.wrf(soil=True, heights=True)
        report = self.imported(source)
        self.assertEqual(set(report["grid"]), {"wind", "T", "PHB", "PH"})
        self.assertIn("TSLB: skipped: its levels (soil_layers_stag) have no height", report["note"])
        self.assertEqual(set(self.imported(source, "--field", "TSLB")["grid"]), {"TSLB"})

    def test_the_levels_of_wrf_lie_at_their_mean_heights(self):
        report = self.imported(self.wrf(heights=True))
        self.assertIn("levels lie at their mean heights", report["note"])
        self.assertIn("heights are exaggerated 2 times", report["note"])
        z = report["grid"]["T"]["voxel"][2]
        self.assertAlmostEqual(z, 2.0, 4)
        self.holds("T", [(12, 6, 2 * (0.5 + 10e-3 / 9) + z * k) for k in (1, 2, 3)],
                   lambda x, y, at: 280.0 + 4 + 6 - 3 * round((at - 1) / z), 1e-3)

    def test_refuses_positions_that_depend_on_two_dimensions_and_time(self):
        for coordinates in ({"coordinates": "lon lat"}, {}):
            source = netcdf.write(self.dir / "c.nc", {"time": 1, "z": 3, "y": 4, "x": 5}, {
                "lat": (netcdf.FLOAT, ("time", "y", "x"), {"units": "degrees_north"}, [1.0] * 20),
                "lon": (netcdf.FLOAT, ("time", "y", "x"), {"units": "degrees_east"}, [1.0] * 20),
                "t": (netcdf.FLOAT, ("time", "z", "y", "x"), coordinates, [float(i) for i in range(60)])})
            self.refused(source, "interpolate the variable to a regular grid")

    @suite.smoke
    def test_damaged_netcdf_files_never_crash_the_importer(self):
        for form in (netcdf.CLASSIC, netcdf.NETCDF4):
            source = self.weather(form=form)
            self.survives(source, source.read_bytes(), 24, "netCDF")


class Foam(Case):
    FIELDS = {
        "p": ("scalar", "[0 2 -2 0 0 0 0]", lambda x, y, z, t: x + 2 * y + t),
        "U": ("vector", "[0 1 -1 0 0 0 0]", lambda x, y, z, t: (1 + y + t, 0.5 * x, z)),
    }
    INNER = [(0.2, 0.2, 0.2), (0.35, 0.25, 0.15), (0.4, 0.3, 0.25)]

    def case(self, **more):
        return foam.box(self.dir / "case", (6, 5, 4), 0.1, self.FIELDS, **more)

    @suite.smoke
    def test_opens_an_openfoam_case_by_its_folder_or_its_file(self):
        case = self.case()
        (case / "case.foam").touch()
        for source in (case, case / "case.foam"):
            report = self.imported(source)
            self.assertEqual(report["time"], 0.5)
            self.assertEqual((report["grid"]["U"]["unit"], report["grid"]["p"]["unit"]),
                             ("m/s", "m2/s2"))
            self.assertEqual(report["grid"]["U"]["type"], "vec3s")
            self.holds("p", self.INNER, lambda x, y, z: x + 2 * y + 0.5, 1e-3)
            self.holds("U", self.INNER, lambda x, y, z: (1.5 + y, 0.5 * x, z), 1e-3)
            self.felt_as("U", "p")
        self.imported(case, "--time", "1", "--field", "p")
        self.holds("p", self.INNER, lambda x, y, z: x + 2 * y + 1, 1e-3)

    def test_imports_time_0_of_an_openfoam_case_if_it_is_the_only_time(self):
        self.assertEqual(set(self.imported(self.case(times=("0",)))["grid"]), {"U", "p"})
        self.holds("p", self.INNER, lambda x, y, z: x + 2 * y, 1e-3)

    def test_the_curl_of_an_openfoam_flow_is_correct_at_the_boundary(self):
        """The flow is a line vortex along x in the middle of the box. Its curl is 0 outside its core."""
        core = 0.12

        def vortex(x, y, z, t):
            y, z = y - 0.5, z - 0.5
            squared = y * y + z * z
            turn = (1.0 - math.exp(-squared / core ** 2)) / max(squared, 1e-12)
            return 1.0, -turn * z, turn * y

        case = foam.box(self.dir / "case", (6, 20, 20), 0.05,
                        {"U": ("vector", "[0 1 -1 0 0 0 0]", vortex)})
        self.imported(case)
        points = "x,y,z\n0.15,0.6,0.5\n0.15,0.97,0.5\n0.15,0.995,0.5\n0.15,0.5,0.01\n0.3,0.99,0.5\n"
        done = self.call("sample", self.out, "--grid", "U", "--points", "-", "--derive", "curl", text=points)
        curls = [float(row["curl_x"]) for row in csv.DictReader(io.StringIO(done.stdout))]
        for curl in curls[1:]:
            self.assertLess(abs(curl), 0.01 * curls[0], curls)

    def test_a_linear_flow_of_an_openfoam_case_is_correct_at_the_boundary(self):
        self.imported(self.case(), "--voxel", 0.05)
        faces = [(0, 0.25, 0.2), (0.6, 0.1, 0.3), (0.3, 0, 0.1), (0.3, 0.5, 0.4), (0, 0, 0), (0.6, 0.5, 0.4)]
        self.holds("U", faces, lambda x, y, z: (1.5 + y, 0.5 * x, z), 1e-3)
        # A scalar keeps the range of the values at the cells' centres.
        self.holds("p", [(0.3, 0.5, 0.2), (0.3, 0, 0.2)], lambda x, y, z: x + 2 * y + 0.5, 1e-3)
        self.holds("p", [(0.6, 0.5, 0.4)], lambda x, y, z: 0.55 + 2 * 0.45 + 0.5, 1e-3)

    @suite.smoke
    def test_refuses_an_openfoam_case_and_names_its_missing_files(self):
        (self.dir / "a.foam").touch()
        self.refused(self.dir / "a.foam", "system/controlDict is missing")
        case = self.case()
        (case / "constant" / "polyMesh" / "points").unlink()
        self.refused(case, "cannot read")
        (case / "constant" / "polyMesh").rename(case / "constant" / "other")
        (case / "processor0").mkdir()
        self.refused(case, "reconstructPar")

    @suite.smoke
    def test_damaged_openfoam_files_never_crash_the_importer(self):
        for name in ("constant/polyMesh/faces", "constant/polyMesh/owner", "0.5/U"):
            case = self.case()
            source = case / name
            whole = source.read_bytes()
            rng = random.Random(8)
            for n in range(cases(8, "damaged files of OpenFOAM")):
                broken = bytearray(whole)
                if n % 2 == 0:
                    del broken[rng.randrange(len(broken)):]
                else:
                    for _ in range(5):
                        broken[rng.randrange(len(broken))] = rng.randrange(256)
                source.write_bytes(broken)
                before = sorted(os.listdir(self.dir))
                done = self.call("import", case, self.out)
                self.assertIn(done.returncode, (0, 1, 2), done.stderr)
                if done.returncode == 0:
                    self.out.unlink()
                else:
                    self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
                self.assertEqual(sorted(os.listdir(self.dir)), before)
            source.write_bytes(whole)


class Cgns(Case):
    def zone(self):
        return cgns.structured(
            self.dir / "a.cgns", (6, 5, 7), lambda i, j, k: (0.1 * i * (i + 1), 0.2 * j, 0.3 * k),
            {"Pressure": lambda x, y, z: x + 2 * y, "VelocityX": lambda x, y, z: 1 + y,
             "VelocityY": lambda x, y, z: z, "VelocityZ": lambda x, y, z: x})

    @suite.smoke
    def test_a_structured_cgns_zone_keeps_its_values(self):
        report = self.imported(self.zone())
        self.assertEqual({n: g["type"] for n, g in report["grid"].items()},
                         {"Pressure": "float", "Velocity": "vec3s"})
        points = [(0.7, 0.3, 0.9), (1.9, 0.6, 0.4), (2.6, 0.5, 1.5)]
        self.holds("Pressure", points, lambda x, y, z: x + 2 * y, 1e-3)
        self.holds("Velocity", points, lambda x, y, z: (1 + y, z, x), 1e-3)
        self.felt_as("Velocity", "Pressure")

    @suite.smoke
    def test_damaged_cgns_files_never_crash_the_importer(self):
        source = self.zone()
        whole = source.read_bytes()
        source.write_bytes(whole[:len(whole) // 2])
        self.refused(source, "")
        self.survives(source, whole, 30, "CGNS")


def image(path, value, size=(5, 4, 3), at=0.0, name="T"):
    """Writes an image in VTK's XML format, with a spacing of 1."""
    extent = " ".join(f"0 {n - 1}" for n in size)
    numbers = " ".join(str(float(value(i, j, k))) for k in range(size[2]) for j in range(size[1])
                       for i in range(size[0]))
    path.write_text(f"""<?xml version="1.0"?><VTKFile type="ImageData" version="1.0">
<ImageData WholeExtent="{extent}" Origin="{at} 0 0" Spacing="1 1 1"><Piece Extent="{extent}"><PointData>
<DataArray type="Float64" Name="{name}" format="ascii">{numbers}</DataArray>
</PointData></Piece></ImageData></VTKFile>""")
    return path


class Collections(Case):
    """ParaView's lists of files with times (.pvd)."""

    def collection(self, rows):
        source = self.dir / "run.pvd"
        source.write_text('<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1"><Collection>'
                          + "".join(f"<DataSet {row}/>" for row in rows) + "</Collection></VTKFile>")
        return source

    @suite.smoke
    def test_each_time_in_a_collection_becomes_a_time_step(self):
        (self.dir / "run").mkdir()
        for n in range(3):
            image(self.dir / f"run/{n}.vti", lambda i, j, k, n=n: 10 * n + i + j * k)
        # The times, not the rows, determine the order of the steps.
        source = self.collection(f'timestep="{0.5 * n}" part="0" file="run/{n}.vti"' for n in (2, 0, 1))
        for n in range(3):
            report = self.imported(source, "--time", n)
            self.assertEqual(report["time"], 0.5 * n)
            self.holds("T", [(3, 2, 1)], lambda *_, n=n: 10.0 * n + 5, 1e-5)
        self.assertIn("the first of 3 steps", self.imported(source)["note"])

    def test_files_of_the_same_time_in_a_collection_become_one_time_step(self):
        image(self.dir / "a.vti", lambda i, j, k: i)
        image(self.dir / "b.vti", lambda i, j, k: 4 + i, at=4.0)
        report = self.imported(self.collection(f'timestep="1" part="{p}" file="{n}.vti"'
                                               for p, n in enumerate("ab")))
        self.assertEqual(set(report["grid"]), {"T", "T_2"})
        self.holds("T_2", [(6, 1, 1)], lambda *_: 6.0, 1e-5)

    def test_refuses_a_collection_of_files_that_are_missing_or_in_other_folders(self):
        outside = tempfile.TemporaryDirectory()
        self.addCleanup(outside.cleanup)
        elsewhere = image(Path(outside.name) / "a.vti", lambda i, j, k: i)
        source = self.collection([f'timestep="0" file="{elsewhere}"'])
        self.refused(source, "a data file in another folder")
        self.imported(source, "--follow")
        self.out.unlink()
        self.refused(self.collection(['timestep="0" file="gone.vti"']), "gone.vti cannot be read")
        self.refused(self.collection(['timestep="soon" file="gone.vti"']), "time of gone.vti is not a number")
        self.refused(self.collection([]), "the collection has no data set")
        source.write_text('<VTKFile type="Collection"><Collection>')
        self.refused(source, "not valid XML")


class FileSeries(Case):
    """ParaView's JSON lists of files with times (.vtu.series)."""

    def series(self, rows, name="run.vti.series"):
        source = self.dir / name
        source.write_text(json.dumps({"file-series-version": "1.0", "files": rows}))
        return source

    @suite.smoke
    def test_each_file_of_a_file_series_becomes_a_time_step(self):
        (self.dir / "run").mkdir()
        rows = []
        for n in (2, 0, 1):
            image(self.dir / f"run/{n}.vti", lambda i, j, k, n=n: 10 * n + i + j * k)
            rows.append({"name": f"run/{n}.vti", "time": 0.5 * n})
        # The times, not the rows, determine the order of the steps.
        source = self.series(rows)
        for n in range(3):
            report = self.imported(source, "--time", n)
            self.assertEqual(report["time"], 0.5 * n)
            self.holds("T", [(3, 2, 1)], lambda *_, n=n: 10.0 * n + 5, 1e-5)
        self.assertIn("the first of 3 steps", self.imported(source)["note"])
        # Some programs write the version last, after a long list.
        source.write_text(json.dumps({"files": rows, "x": "x" * 5000, "file-series-version": "1.0"}))
        self.assertEqual(self.imported(source, "--time", 2)["time"], 1)

    def test_a_file_series_may_list_meshes_in_legacy_files(self):
        points = [(x, y, z) for z in range(4) for y in range(4) for x in range(4)]
        rows = []
        for n in range(2):
            values = " ".join(str(10.0 * n + x + y * z) for x, y, z in points)
            (self.dir / f"{n}.vtk").write_text(
                "# vtk DataFile Version 3.0\na\nASCII\nDATASET STRUCTURED_GRID\nDIMENSIONS 4 4 4\nPOINTS 64 double\n"
                + " ".join(f"{x} {y} {z}" for x, y, z in points)
                + f"\nPOINT_DATA 64\nSCALARS T double 1\nLOOKUP_TABLE default\n{values}\n")
            rows.append({"name": f"{n}.vtk", "time": n})
        source = self.series(rows, "run.vtk.series")
        for n in range(2):
            self.assertEqual(self.imported(source, "--time", n)["time"], n)
            self.holds("T", [(2, 2, 1)], lambda *_, n=n: 10.0 * n + 4, 1e-3)

    def test_refuses_a_damaged_file_series_and_names_missing_files(self):
        image(self.dir / "a.vti", lambda i, j, k: i)
        image(self.dir / "b.vti", lambda i, j, k: i)
        self.refused(self.series([{"name": "gone.vti", "time": 0}]), "gone.vti cannot be read")
        self.refused(self.series([{"name": "../a.vti", "time": 0}]), "a data file in another folder")
        self.refused(self.series([{"name": "a.vti", "time": "soon"}]),
                     "the time of a.vti is missing, or is not a number")
        self.refused(self.series([{"name": "a.vti"}]),
                     "the time of a.vti is missing, or is not a number")
        self.refused(self.series([{"name": "a.vti", "time": 1}, {"name": "b.vti", "time": 1}]),
                     "b.vti has the time 1 of another file")
        for row in {"time": 0}, {"name": "", "time": 0}, {"name": 3, "time": 0}, "a.vti":
            self.refused(self.series([row]), "an entry of the series names no file")
        self.refused(self.series([]), "the list \"files\" of the series is empty")
        source = self.dir / "run.vtu.series"
        for text, says in (('{"file-series-version": "1.0", "files": [', "not valid JSON (byte "),
                           ("soon", "not valid JSON (byte "), ("[]", 'no list "files"'),
                           ('{"file-series-version": "1.0", "files": {}}', 'no list "files"'),
                           ('{"files": [{"name": "a.vti", "time": 1e999}]}', "too large for a double")):
            source.write_text(text)
            self.refused(source, says)
        whole = self.series([{"name": "a.vti", "time": 0}, {"name": "b.vti", "time": 1}])
        self.survives(whole, whole.read_bytes(), 30, "a ParaView series")


class VtkHdf(Case):
    """VTK's format based on HDF5 (.vtkhdf)."""

    def image(self, version):
        import h5py  # pylint: disable=import-outside-toplevel
        path = self.dir / "a.vtkhdf"
        with h5py.File(path, "w") as file:
            group = file.create_group("VTKHDF")
            group.attrs.create("Version", version, dtype="i8")
            group.attrs.create("Type", b"ImageData", dtype=h5py.string_dtype("ascii", 9))
            group.attrs.create("WholeExtent", (0, 4, 0, 3, 0, 2), dtype="i8")
            for key, numbers in (("Origin", (0, 0, 0)), ("Spacing", (1, 2, 3)),
                                 ("Direction", (1, 0, 0, 0, 1, 0, 0, 0, 1))):
                group.attrs.create(key, numbers, dtype="f8")
            values = [[[100.0 * k + 10 * j + i for i in range(5)] for j in range(4)] for k in range(3)]
            group.create_group("PointData").create_dataset("T", data=values)
        return path

    @suite.smoke
    def test_reads_an_image_from_a_vtkhdf_file(self):
        report = self.imported(self.image((1, 0)))
        self.assertEqual(report["grid"]["T"]["voxel"], [1, 2, 3])
        self.holds("T", [(3, 4, 3)], lambda *_: 123.0, 1e-5)

    def test_refuses_a_vtkhdf_file_of_an_unsupported_type_and_names_the_type(self):
        import h5py  # pylint: disable=import-outside-toplevel
        # VTK 9.3 knows the type OverlappingAMR, and reports the first attribute that is missing.
        for name, says in ((b"PolyData", "the file is PolyData in VTK's HDF5 format"), (b"OverlappingAMR", "VTK")):
            path = self.dir / "a.vtkhdf"
            with h5py.File(path, "w") as file:
                group = file.create_group("VTKHDF")
                group.attrs.create("Version", (2, 0), dtype="i8")
                group.attrs.create("Type", name, dtype=h5py.string_dtype("ascii", len(name)))
            self.refused(path, says)

    def test_refuses_a_vtkhdf_file_of_a_version_that_vtk_cannot_read(self):
        self.refused(self.image((9, 0)), "higher than this reader supports")


class Sentinels(Case):
    """Numbers with which solvers mark cells and points without data."""

    def mesh(self, values, section):
        """Writes cells that are not cubes, so that the import resamples them."""
        xs = [0, 1, 2.5, 4, 6, 7, 9, 10, 12]
        lines = "".join(f"{a}_COORDINATES {len(xs)} double\n{' '.join(map(str, xs))}\n" for a in "XYZ")
        path = self.dir / "a.vtk"
        path.write_text(f"# vtk DataFile Version 3.0\na\nASCII\nDATASET RECTILINEAR_GRID\n"
                        f"DIMENSIONS {len(xs)} {len(xs)} {len(xs)}\n{lines}{section} {len(values)}\n"
                        f"SCALARS s double 1\nLOOKUP_TABLE default\n{' '.join(map(repr, values))}\n")
        return path

    def test_values_that_mark_missing_data_are_never_interpolated(self):
        for section, count in (("POINT_DATA", 9 ** 3), ("CELL_DATA", 8 ** 3)):
            for sentinel in (-9999.0, 1e30, -1e34):
                values = [20.0 + 0.01 * (i * 37 % count) for i in range(count)]
                values[count // 2] = values[count // 3] = sentinel
                report = self.imported(self.mesh(values, section), "--voxel", 0.5)
                s = report["grid"]["s"]
                self.assertIn(f"s: the value {sentinel:.6g} counts as missing data", report["note"])
                self.assertGreater(s["holes"], 0)
                self.assertGreaterEqual(s["lowest"], 20.0)
                self.assertLess(s["highest"], 28.0)
                # Places without data in the file count neither as errors nor as lost.
                self.assertTrue(all(math.isfinite(e) for e in s["resampling"].values()), s)

    def test_results_and_labels_that_resemble_fill_values_are_kept_as_data(self):
        count = 9 ** 3
        labels = [(-999.0, 7.0)[i % 2] for i in range(count)]
        peak = [20.0 + 0.01 * (i * 37 % count) for i in range(count)]
        peak[5] = 500.0  # at one point
        jump = [1e11 * (1 + i % 3) if i % 2 else 0.01 * i for i in range(count)]
        for values in (labels, peak, jump):
            self.assertEqual(self.imported(self.mesh(values, "POINT_DATA"))["grid"]["s"]["holes"], 0)


class Minc(Case):
    """MINC 1 files: images in classic netCDF."""

    SIZES = {"xspace": 5, "yspace": 4, "zspace": 3}
    COSINES = {"xspace": (0.8, 0.6, 0.0), "yspace": (-0.6, 0.8, 0.0), "zspace": (0.0, 0.0, 1.0)}
    STEPS = {"xspace": -2.0, "yspace": 1.5, "zspace": 3.0}
    STARTS = {"xspace": 7.0, "yspace": -8.0, "zspace": 9.0}

    def write(self, order=("zspace", "yspace", "xspace"), kind=netcdf.SHORT, image=None, scale=1,
              values=None, more=None, sizes=None):
        """Writes an image. `scale` is the number of dimensions of image-min and image-max."""
        sizes = sizes or self.SIZES
        variables = {}
        for name in order:
            if name in self.STEPS:
                variables[name] = (netcdf.INT, (), {
                    "step": (netcdf.DOUBLE, [self.STEPS[name]]), "units": "mm",
                    "start": (netcdf.DOUBLE, [self.STARTS[name]]), "spacing": "regular__",
                    "direction_cosines": (netcdf.DOUBLE, self.COSINES[name])}, [0])
        along = order[:scale]
        count = math.prod(sizes[d] for d in along)
        variables["image-min"] = (netcdf.DOUBLE, along, {}, [-float(n) for n in range(count)])
        variables["image-max"] = (netcdf.DOUBLE, along, {}, [10.0 + 2 * n for n in range(count)])
        values = values or [i * 37 % 1001 for i in range(math.prod(sizes[d] for d in order))]
        variables["image"] = (kind, order, image or {
            "signtype": "signed__", "valid_range": (netcdf.DOUBLE, [0.0, 1000.0])}, values)
        variables.update(more or {})
        return netcdf.write(self.dir / "a.mnc", {d: sizes[d] for d in order}, variables)

    def place(self, order, index):
        """Returns the position of an index along the file's dimensions."""
        return tuple(sum(self.COSINES[d][a] * (self.STARTS[d] + self.STEPS[d] * n)
                         for d, n in zip(order, index)) for a in range(3))

    def agrees(self, order, value):
        """Checks that the grid has value(n, slice, row) at the position of the n-th value."""
        sizes = [self.SIZES[d] for d in order]
        indices = [(k, j, i) for k in range(sizes[0]) for j in range(sizes[1]) for i in range(sizes[2])]
        rows = self.sample("image", [self.place(order, index) for index in indices])
        for n, (index, row) in enumerate(zip(indices, rows)):
            self.assertAlmostEqual(float(row["value"]), value(n, index[0], index[0] * sizes[1] + index[1]),
                                   delta=1e-4, msg=(order, index))

    @suite.smoke
    def test_each_slice_of_a_minc_image_has_its_documented_position_and_scale(self):
        for order in (("zspace", "yspace", "xspace"), ("xspace", "zspace", "yspace"),
                      ("yspace", "xspace", "zspace")):
            for scale in 0, 1, 2:
                report = self.imported(self.write(order, scale=scale))
                self.assertEqual(report["grid"]["image"]["holes"], 0)
                self.agrees(order, lambda n, k, j, s=scale: (lambda at: -at + (n * 37 % 1001) / 1000 * (
                    10 + 3 * at))((0, k, j)[s]))
        self.assertIn(b"RAS", self.out.read_bytes())

    def test_reads_signed_unsigned_and_floating_point_values_of_a_minc_image(self):
        order = ("zspace", "yspace", "xspace")
        self.imported(self.write(kind=netcdf.BYTE, scale=0, image={"signtype": "unsigned"},
                                 values=[(i * 5 + 100) % 256 - 256 * ((i * 5 + 100) % 256 > 127)
                                         for i in range(60)]))
        self.agrees(order, lambda n, k, j: (n * 5 + 100) % 256 / 255 * 10)
        self.imported(self.write(kind=netcdf.SHORT, scale=0, image={"signtype": "signed__"},
                                 values=[i * 1000 - 30000 for i in range(60)]))
        self.agrees(order, lambda n, k, j: (n * 1000 - 30000 + 32768) / 65535 * 10)
        self.imported(self.write(kind=netcdf.FLOAT, values=[0.5 * i for i in range(60)]))
        self.agrees(order, lambda n, k, j: 0.5 * n)

    def test_values_of_a_minc_image_outside_the_valid_range_have_no_data(self):
        values = [i * 37 % 1001 for i in range(60)]
        values[7], values[30] = -1, 1001
        self.assertEqual(self.imported(self.write(values=values))["grid"]["image"]["holes"], 2)

    def test_refuses_minc_images_with_a_time_dimension_or_irregular_spacing(self):
        more = dict(self.SIZES, time=2)
        self.refused(self.write(("time", "zspace", "yspace", "xspace"), sizes=more), "has 4 dimensions")
        path = self.write()
        data = path.read_bytes().replace(b"regular__", b"irregular")
        path.write_bytes(data)
        self.refused(path, "the distances along")

    def test_damaged_minc_files_never_crash_the_importer(self):
        source = self.write()
        self.survives(source, source.read_bytes(), 24, "MINC")


class WholeNumbers(Case):
    """Whole numbers that floats cannot represent keep their differences on meshes, too."""

    def test_large_whole_numbers_of_points_and_cells_of_a_mesh_are_stored_with_an_offset(self):
        xs = [0, 1, 2.5, 4, 6, 7, 9, 10, 12]
        lines = "".join(f"{a}_COORDINATES {len(xs)} double\n{' '.join(map(str, xs))}\n" for a in "XYZ")
        for base in 2 ** 53, 2 ** 60:
            values = [base + i % 9 for i in range(9 ** 3)]
            path = self.dir / "a.vtk"
            path.write_text(f"# vtk DataFile Version 3.0\na\nASCII\nDATASET RECTILINEAR_GRID\n"
                            f"DIMENSIONS 9 9 9\n{lines}POINT_DATA 729\nSCALARS s vtktypeint64 1\n"
                            f"LOOKUP_TABLE default\n{' '.join(map(str, values))}\n"
                            f"CELL_DATA 512\nSCALARS c vtktypeint64 1\nLOOKUP_TABLE default\n"
                            f"{' '.join(str(base + 4 * (i % 8)) for i in range(512))}\n")
            report = self.imported(path, "--voxel", 0.5)
            for name in "s", "c":
                self.assertEqual(report["grid"][name]["value_offset"], base)
                self.assertEqual(report["note"].count(f"{name}: a float cannot hold these whole numbers exactly"), 1)
            points = [(x, 4, 7) for x in xs]
            for n, row in enumerate(self.sample("s", points)):
                self.assertAlmostEqual(float(row["value"]), n, delta=1e-4)
            for n, row in enumerate(self.sample("c", points[1:-1])):
                self.assertAlmostEqual(float(row["value"]), 4 * n + 2, delta=1e-4)


class Others(Case):
    @suite.smoke
    def test_refuses_a_file_in_the_format_slc(self):
        source = self.dir / "a.slc"
        source.write_bytes(b"11111\n10 10 10 8\n" + bytes(100))
        self.refused(source, "SLC")

    @suite.smoke
    def test_a_grib_file_is_refused_with_the_command_that_converts_it(self):
        for name, begin in (("a.bin", b"GRIB"), ("a.grib", b"\1"), ("a.GRIB2", b"\1"), ("a.grb", b"\1"),
                            ("a.grb2", b"\1")):
            source = self.dir / name
            source.write_bytes(begin + bytes(100))
            self.refused(source, "convert it to netCDF, for example with ecCodes' grib_to_netcdf or cdo -f nc copy")

    def test_the_message_that_refuses_a_medical_image_as_a_scene_states_the_import_command(self):
        source = self.dir / "head.nii.gz"
        source.write_bytes(b"\x1f\x8b\x08" + bytes(100))
        for verb in (("feel",), ("info",), ("scene",), ("check",)):
            done, line = refusal(self, self.dir, lambda v=verb: self.call(*v, source))
            self.assertEqual(done.returncode, 2, line)
            self.assertIn(f"import it first: palpate import {source} head.vdb", line)


if __name__ == "__main__":
    suite.main(sys.argv[2:])
