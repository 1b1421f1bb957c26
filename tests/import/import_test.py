#!/usr/bin/env python3
"""Tests palpate import through its command line: import_test.py BIN_DIR MAKE_SERIES_PROGRAM."""
import csv
import gzip
import io
import json
import math
import os
import random
import shlex
import signal
import struct
import subprocess
import sys
import tempfile
import time
import unittest
import zlib
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import process  # noqa: E402
import suite  # noqa: E402
from cases import cases  # noqa: E402
from refusals import refusal  # noqa: E402
from terminal import Terminal  # noqa: E402

PALPATE = str((Path(sys.argv[1]) / "palpate").resolve())
MAKE_SERIES = str(Path(sys.argv[2]).resolve())


def call(*words, timeout=120):
    return process.run([PALPATE, *map(str, words)], capture_output=True, text=True,
                          timeout=timeout)


def run(*words, status=0):
    done = call(*words)
    if done.returncode != status:
        raise AssertionError(f"{words}: status {done.returncode}, not {status}: {done.stderr}")
    return done


class Case(unittest.TestCase):
    def setUp(self):
        self.holder = tempfile.TemporaryDirectory()
        self.dir = Path(self.holder.name)

    def tearDown(self):
        self.holder.cleanup()

    def write(self, name, data):
        path = self.dir / name
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
        return path

    def imported(self, source, *words):
        """Imports into out.vdb. Returns the report."""
        done = run("import", source, self.dir / "out.vdb", "--json", *words)
        self.assertEqual(done.stderr, "")
        return json.loads(done.stdout)

    def sample(self, grid, points, *words):
        table = "x,y,z\n" + "".join(f"{x!r},{y!r},{z!r}\n" for x, y, z in points)
        where = self.write("points.csv", table)
        done = run("sample", self.dir / "out.vdb", "--grid", grid, "--points", where, *words)
        return [{k: float(v) for k, v in row.items()}
                for row in csv.DictReader(io.StringIO(done.stdout))]

    def refused(self, *words, says, status=2):
        """Checks that the import is refused: one line on stderr, nothing on stdout, no file left."""
        done, line = refusal(self, self.dir, lambda: call("import", *words))
        self.assertEqual(done.returncode, status, line)
        self.assertIn(says, line)


def grid_report(report, name):
    return next(g for g in report["grids"] if g["name"] == name)


def image_values(nx, ny, nz, function):
    return [function(i, j, k) for k in range(nz) for j in range(ny) for i in range(nx)]


def words_of(values):
    return " ".join(repr(float(v)) for v in values)


def vti(nx, ny, nz, point_arrays, cell_arrays=(), origin=(0, 0, 0), spacing=(1, 1, 1),
        direction=None, start=0):
    """Returns an XML image. Arrays are (name, components, flat values)."""
    def section(kind, arrays):
        text = f"<{kind}>"
        for name, components, values in arrays:
            text += (f'<DataArray type="Float64" Name="{name}" NumberOfComponents="{components}" '
                     f'format="ascii">{words_of(values)}</DataArray>')
        return text + f"</{kind}>"
    extent = f"{start} {start + nx - 1} {start} {start + ny - 1} {start} {start + nz - 1}"
    turned = f'Direction="{words_of(direction)}"' if direction else ""
    return (f'<?xml version="1.0"?><VTKFile type="ImageData" version="1.0">'
            f'<ImageData WholeExtent="{extent}" Origin="{words_of(origin)}" '
            f'Spacing="{words_of(spacing)}" {turned}><Piece Extent="{extent}">'
            f'{section("PointData", point_arrays)}{section("CellData", cell_arrays)}'
            f'</Piece></ImageData></VTKFile>')


def legacy(kind, body, data):
    return f"# vtk DataFile Version 3.0\nmade by a test\nASCII\nDATASET {kind}\n{body}\n{data}\n"


def linear(p):
    return 1.0 + 2.0 * p[0] - 3.0 * p[1] + 0.5 * p[2]


def scalars(name, values):
    return f"SCALARS {name} double 1\nLOOKUP_TABLE default\n{words_of(values)}\n"


def vectors(name, values):
    return f"VECTORS {name} double\n{words_of(c for v in values for c in v)}\n"


def rectilinear(xs, ys, zs, function=linear):
    points = [(x, y, z) for z in zs for y in ys for x in xs]
    body = f"DIMENSIONS {len(xs)} {len(ys)} {len(zs)}\n"
    for name, c in (("X", xs), ("Y", ys), ("Z", zs)):
        body += f"{name}_COORDINATES {len(c)} double\n{words_of(c)}\n"
    data = f"POINT_DATA {len(points)}\n" + scalars("s", map(function, points))
    data += vectors("v", [(function(p), p[0], p[1]) for p in points])
    return legacy("RECTILINEAR_GRID", body, data)


def structured(nx, ny, nz, place, function=linear, extra=""):
    points = [place(i, j, k) for k in range(nz) for j in range(ny) for i in range(nx)]
    body = f"DIMENSIONS {nx} {ny} {nz}\nPOINTS {len(points)} double\n"
    body += words_of(c for p in points for c in p)
    return legacy("STRUCTURED_GRID", body,
                  f"POINT_DATA {len(points)}\n" + scalars("s", map(function, points)) + extra)


def unstructured(points, cells, types, data):
    size = sum(len(c) + 1 for c in cells)
    body = f"POINTS {len(points)} double\n{words_of(c for p in points for c in p)}\n"
    body += f"CELLS {len(cells)} {size}\n"
    body += "\n".join(f"{len(c)} " + " ".join(map(str, c)) for c in cells)
    body += f"\nCELL_TYPES {len(cells)}\n" + " ".join(map(str, types))
    return legacy("UNSTRUCTURED_GRID", body, data)


def box_of_tetrahedra(n, skip=lambda i, j, k: False):
    """Returns points and cells of n^3 unit cubes, each of 6 tetrahedra. Leaves out cubes for which skip(i, j, k) is
    true."""
    def index(i, j, k):
        return (k * (n + 1) + j) * (n + 1) + i
    points = [(float(i), float(j), float(k))
              for k in range(n + 1) for j in range(n + 1) for i in range(n + 1)]
    cells = []
    for k in range(n):
        for j in range(n):
            for i in range(n):
                if skip(i, j, k):
                    continue
                # Kuhn's tetrahedra: one for each order of the axes.
                for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):
                    at = [i, j, k]
                    corners = [index(*at)]
                    for axis in order:
                        at[axis] += 1
                        corners.append(index(*at))
                    cells.append(corners)
    return points, cells


class Images(Case):
    def test_voxels_keep_exact_values_and_positions_for_any_origin_and_direction(self):
        n = (5, 4, 3)
        rng = random.Random(1)
        values = [rng.uniform(-5, 5) for _ in range(n[0] * n[1] * n[2])]
        flow = [rng.uniform(-1, 1) for _ in range(3 * len(values))]
        c, s = math.cos(0.3), math.sin(0.3)
        turn = (c, -s, 0, s, c, 0, 0, 0, 1)  # rows
        spacing, origin = (0.5, 1.0, 2.0), (10, -20, 3)
        source = self.write("a.vti", vti(*n, [("pressure", 1, values), ("flow", 3, flow)],
                                         origin=origin, spacing=spacing, direction=turn, start=-2))
        report = self.imported(source)
        self.assertEqual([g["name"] for g in report["grids"]], ["pressure", "flow"])
        places = []
        for k in range(n[2]):
            for j in range(n[1]):
                for i in range(n[0]):
                    q = [spacing[a] * (x - 2) for a, x in enumerate((i, j, k))]
                    places.append(tuple(origin[r] + sum(turn[3 * r + a] * q[a] for a in range(3))
                                        for r in range(3)))
        for row, value in zip(self.sample("pressure", places), values):
            self.assertAlmostEqual(row["value"], value, places=5)
        for row, i in zip(self.sample("flow", places), range(len(values))):
            for axis, key in enumerate(("vx", "vy", "vz")):
                self.assertAlmostEqual(row[key], flow[3 * i + axis], places=5)

    @suite.smoke
    def test_cell_data_of_an_image_lie_at_the_cell_centres(self):
        cells = image_values(3, 2, 2, lambda i, j, k: 1 + i + 10 * j + 100 * k)
        points = image_values(4, 3, 3, lambda i, j, k: i * j * k)
        report = self.imported(
            self.write("a.vti", vti(4, 3, 3, [("p", 1, points)], [("c", 1, cells)],
                                    spacing=(2, 2, 2))))
        self.assertTrue(any("c: one value per cell" in note for note in report["notes"]))
        rows = self.sample("c", [(1, 1, 1), (3, 1, 1), (5, 3, 3), (2, 2, 2)])
        self.assertEqual([r["value"] for r in rows[:3]], [1, 2, 113])
        self.assertAlmostEqual(rows[3]["value"], (1 + 2 + 11 + 12 + 101 + 102 + 111 + 112) / 8)

    @suite.smoke
    def test_voxels_with_the_background_value_are_inactive(self):
        def ball(i, j, k):
            return 900.0 if (i - 16) ** 2 + (j - 16) ** 2 + (k - 16) ** 2 < 64 else 7.0
        values = image_values(32, 32, 32, ball)
        report = self.imported(self.write("a.vti", vti(32, 32, 32, [("s", 1, values)])))
        s = grid_report(report, "s")
        self.assertEqual((s["background"], s["tolerance"]), (7.0, 0.0))
        self.assertEqual(s["active_voxels"], sum(v > 100 for v in values))
        rows = self.sample("s", [(0, 0, 0), (16, 16, 16), (-5, 40, 3)])
        self.assertEqual([r["value"] for r in rows], [7, 900, 7])

    def test_the_suggested_tolerance_removes_background_noise(self):
        rng = random.Random(2)
        values = image_values(24, 24, 24, lambda i, j, k: rng.uniform(0, 10)
                              + (1000 if 8 <= min(i, j, k) and max(i, j, k) < 16 else 0))
        source = self.write("a.vti", vti(24, 24, 24, [("s", 1, values)]))
        quieter = grid_report(self.imported(source), "s")["quieter"]
        self.assertLess(quieter["tolerance"], 10)
        s = grid_report(self.imported(source, "--tolerance", 10), "s")
        self.assertEqual(s["active_voxels"], 8 ** 3)
        self.assertLess(quieter["share"] * 24 ** 3, 1.5 * 8 ** 3)

    def test_voxels_with_nan_become_holes_without_data(self):
        values = image_values(6, 6, 6, lambda i, j, k: float("nan") if i == 2 else i + j)
        report = self.imported(self.write("a.vti", vti(6, 6, 6, [("s", 1, values)])))
        self.assertEqual(grid_report(report, "s")["holes"], 36)
        rows = self.sample("s", [(2, 3, 3), (3, 3, 3)])
        self.assertTrue(math.isfinite(rows[0]["value"]))
        self.assertEqual(rows[1]["value"], 6)

    @suite.smoke
    def test_a_grid_with_even_spacing_is_not_resampled(self):
        straight = rectilinear([0, 0.5, 1, 1.5], [2, 3, 4], [0, 0.1, 0.2])
        report = self.imported(self.write("a.vtk", straight))
        self.assertNotIn("resampling", report["grids"][0])
        self.assertEqual(report["grids"][0]["voxel"], [0.5, 1, 0.1])
        sheared = structured(4, 3, 3, lambda i, j, k: (i + 0.5 * j, j, 2 * k + 0.1 * i))
        report = self.imported(self.write("b.vtk", sheared))
        self.assertNotIn("resampling", report["grids"][0])
        row = self.sample("s", [(2 + 0.5, 1, 2 + 0.2)])[0]
        self.assertAlmostEqual(row["value"], linear((2.5, 1, 2.2)), places=5)

    @suite.smoke
    def test_resampling_reports_its_rms_error(self):
        values = image_values(20, 20, 20, lambda i, j, k: math.sin(0.3 * i) * j + k)
        source = self.write("a.vti", vti(20, 20, 20, [("s", 1, values)], spacing=(1, 2, 1)))
        report = self.imported(source, "--voxel", 0.5)
        s = grid_report(report, "s")
        self.assertEqual(s["voxel"], [0.5, 0.5, 0.5])
        self.assertLess(s["resampling"]["rms"], 1e-6)  # 0.5 divides all edges
        coarse = grid_report(self.imported(source, "--voxel", 3), "s")["resampling"]
        self.assertGreater(coarse["rms"], 1e-3)

    @suite.smoke
    def test_smoothing_reports_its_rms_change(self):
        rng = random.Random(3)
        values = image_values(16, 16, 16, lambda i, j, k: rng.uniform(0, 1))
        source = self.write("a.vti", vti(16, 16, 16, [("s", 1, values)]))
        rms = grid_report(self.imported(source, "--smooth", 1), "s")["smoothing_rms"]
        self.assertGreater(rms, 0.1)
        in_voxels = grid_report(self.imported(source, "--smooth", "1.0vx"), "s")["smoothing_rms"]
        self.assertEqual(in_voxels, rms)

    def test_the_written_file_records_its_source_and_resampling_error(self):
        source = self.write("a.vtk", rectilinear([0, 1, 2], [0, 1, 2], [0, 1, 3]))
        self.imported(source, "--voxel", 0.25)
        data = (self.dir / "out.vdb").read_bytes()
        for words in (b"imported_by", b"palpate 0.", b"source", b"a.vtk", b"made by a test",
                      b"resampling_rms"):
            self.assertIn(words, data)


    def test_resampled_voxels_beside_holes_have_no_data(self):
        values = image_values(12, 12, 12, lambda i, j, k: float("nan") if i in (5, 6)
                              else 1000.0 + i + 10 * j * (k % 3))
        source = self.write("a.vti", vti(12, 12, 12, [("s", 1, values)]))
        report = self.imported(source, "--voxel", 0.5)
        s = grid_report(report, "s")
        self.assertEqual(s["voxels"], 23 ** 3)
        self.assertEqual(s["holes"], 5 * 23 ** 2)
        rows = self.sample("s", [(4, 3, 3), (5.5, 3, 3), (6, 3, 3), (7, 3, 4)])
        self.assertEqual([r["inside"] for r in rows], [1, 0, 0, 1])
        self.assertEqual([rows[0]["value"], rows[3]["value"]], [1004, 1037])

    @suite.smoke
    def test_blanked_cells_and_points_of_an_image_have_no_data(self):
        cells = [2 if i == 0 else 0 for i in range(27)]
        ghosts = f'''<CellData><DataArray type="UInt8" Name="vtkGhostType" format="ascii">
{" ".join(str(32 if c else 0) for c in cells)}</DataArray></CellData>'''
        text = vti(4, 4, 4, [("s", 1, [1.0 + i for i in range(64)])])
        report = self.imported(self.write("a.vti", text.replace("<CellData></CellData>", ghosts)))
        self.assertEqual(grid_report(report, "s")["holes"], 1)

    def test_reports_rounding_of_integers(self):
        data = struct.pack("<8i", *(2 ** 24 + 2 ** 24 * i + 1 for i in range(8)))
        report = self.imported(self.write("a.raw", data), "--raw",
                               json.dumps({"size": [2, 2, 2], "type": "int32"}))
        self.assertTrue(any("rounded" in note for note in report["notes"]))

    def test_the_written_file_records_the_length_unit_of_its_source(self):
        source = self.write("a.raw", struct.pack("<8h", *range(8)))
        self.imported(source, "--raw", json.dumps({"size": [2, 2, 2], "type": "int16",
                                                   "unit": "mm"}), "--voxel", 0.3)
        data = (self.dir / "out.vdb").read_bytes()
        for words in (b"length_unit", b"mm", b"resampled_to", b"resampling_rms"):
            self.assertIn(words, data)


class Meshes(Case):
    def places(self, lower, upper, count=200):
        rng = random.Random(4)
        return [tuple(rng.uniform(a, b) for a, b in zip(lower, upper)) for _ in range(count)]

    @suite.smoke
    def test_resampling_keeps_a_linear_field_within_rounding(self):
        """Trilinear cells, tetrahedra and voxels represent a linear field exactly."""
        twisted = structured(7, 7, 7, lambda i, j, k: (
            i + 0.2 * math.sin(j + k), j + 0.2 * math.sin(i), k + 0.15 * math.cos(i + j)))
        points, cells = box_of_tetrahedra(6)
        tetrahedra = unstructured(points, cells, [10] * len(cells),
                                  f"POINT_DATA {len(points)}\n" + scalars("s", map(linear, points)))
        uneven = rectilinear([0, 0.5, 2, 3, 6], [0, 1, 4, 6], [0, 2, 2.5, 6])
        for text in (twisted, tetrahedra, uneven):
            report = self.imported(self.write("a.vtk", text), "--voxel", 0.3)
            self.assertLess(report["grids"][0]["resampling"]["largest"], 1e-6)
            for row in self.sample("s", self.places((1, 1, 1), (5, 5, 5))):
                truth = linear((row["x"], row["y"], row["z"]))
                self.assertAlmostEqual(row["value"], truth, delta=2e-5)

    def test_each_voxel_has_the_value_of_the_cell_that_contains_it(self):
        """The points have random values, so only the right cell gives the right value."""
        points, cells = box_of_tetrahedra(4)
        rng = random.Random(8)
        values = [rng.uniform(-1, 1) for _ in points]
        data = f"POINT_DATA {len(points)}\n" + scalars("s", values)
        report = self.imported(self.write("a.vtk", unstructured(points, cells, [10] * len(cells),
                                                                data)), "--voxel", 0.25)
        value_at = dict(zip(points, values))
        places = [tuple(rng.randrange(17) / 4 for _ in range(3)) for _ in range(300)]
        for row in self.sample("s", places):
            # Kuhn's tetrahedron around a point goes from the low corner along the axes, in descending order of the
            # point's fractions.
            p = (row["x"], row["y"], row["z"])
            low = [min(int(x), 3) for x in p]
            rest = sorted(((x - c, a) for a, (x, c) in enumerate(zip(p, low))), reverse=True)
            corner, truth, before = list(low), 0.0, 1.0
            for part, axis in rest:
                truth += (before - part) * value_at[tuple(map(float, corner))]
                corner[axis] += 1
                before = part
            truth += before * value_at[tuple(map(float, corner))]
            self.assertAlmostEqual(row["value"], truth, places=5)
        self.assertGreater(report["grids"][0]["resampling"]["rms"], 0.001)

    def test_each_kind_of_cell_fills_only_its_own_volume(self):
        tetrahedron = ([(0, 0, 0), (4, 0, 0), (0, 4, 0), (0, 0, 4)], [[0, 1, 2, 3]], [10],
                       lambda x, y, z: x + y + z <= 4)
        wedge = ([(0, 0, 0), (0, 4, 0), (4, 0, 0), (0, 0, 4), (0, 4, 4), (4, 0, 4)],
                 [[0, 1, 2, 3, 4, 5]], [13], lambda x, y, z: x + y <= 4)
        pyramid = ([(0, 0, 0), (4, 0, 0), (4, 4, 0), (0, 4, 0), (2, 2, 4)], [[0, 1, 2, 3, 4]],
                   [14], lambda x, y, z: max(abs(x - 2), abs(y - 2)) <= 2 - z / 2)
        prism = ([(0, 0, 0), (2, 0, 0), (4, 2, 0), (2, 4, 0), (0, 4, 0),
                  (0, 0, 4), (2, 0, 4), (4, 2, 4), (2, 4, 4), (0, 4, 4)], [list(range(10))], [15],
                 lambda x, y, z: x - y <= 2 and x + y <= 6)
        for points, cells, types, inside in (tetrahedron, wedge, pyramid, prism):
            data = f"POINT_DATA {len(points)}\n" + scalars("s", [1.0 + sum(p) for p in points])
            report = self.imported(self.write("a.vtk", unstructured(points, cells, types, data)),
                                   "--voxel", 0.5)
            truth = sum(inside(i / 2, j / 2, k / 2)
                        for i in range(9) for j in range(9) for k in range(9))
            self.assertEqual(report["grids"][0]["active_voxels"], truth, types)

    def test_cells_without_volume_are_excluded_from_averages_of_cell_data(self):
        points = [(float(x), float(y), float(z)) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
        data = "CELL_DATA 2\n" + scalars("c", [100.0, 0.0])
        report = self.imported(self.write("a.vtk", unstructured(
            points, [list(range(8)), [0, 1, 2, 3]], [11, 8], data)), "--voxel", 0.25)
        self.assertEqual(report["grids"][0]["lowest"], 100)
        self.assertTrue(any("without volume" in note for note in report["notes"]))

    def test_first_and_last_voxels_lie_on_the_bounds_of_the_mesh(self):
        report = self.imported(self.write("a.vtk", rectilinear([0, 1, 3], [0, 2, 3], [0, 1.5, 3])),
                               "--voxel", 0.5)
        self.assertEqual(report["grids"][0]["active_voxels"], 7 ** 3)

    def test_voxels_outside_the_mesh_have_no_data(self):
        points, cells = box_of_tetrahedra(6, skip=lambda i, j, k: 2 <= min(i, j, k)
                                          and max(i, j, k) < 4)
        data = f"POINT_DATA {len(points)}\n" + scalars("s", [5 + p[0] for p in points])
        self.imported(self.write("a.vtk", unstructured(points, cells, [10] * len(cells), data)),
                      "--voxel", 0.25)
        rows = self.sample("s", [(3, 3, 3), (1, 1, 1), (7, 1, 1)])
        self.assertEqual([r["inside"] for r in rows], [0, 1, 0])

    @suite.smoke
    def test_cell_data_of_a_mesh_are_averaged_to_its_points(self):
        points, cells = box_of_tetrahedra(2)
        data = f"CELL_DATA {len(cells)}\n" + scalars("c", [3.0] * len(cells)) + scalars(
            "d", [float(i) for i in range(len(cells))])
        report = self.imported(self.write("a.vtk", unstructured(points, cells, [10] * len(cells),
                                                                data)), "--voxel", 0.5)
        self.assertTrue(any("averaged to the points" in note for note in report["notes"]))
        self.assertEqual(self.sample("c", [(1, 1, 1)])[0]["value"], 3)

    @suite.smoke
    def test_several_blocks_are_imported_as_one_mesh(self):
        for name, shift in (("left.vtu", 0), ("right.vtu", 1)):
            points = [(shift + x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
            self.write(name, f"""<VTKFile type="UnstructuredGrid" version="1.0"><UnstructuredGrid>
<Piece NumberOfPoints="8" NumberOfCells="1"><PointData>
<DataArray type="Float64" Name="s" format="ascii">{words_of(map(linear, points))}</DataArray>
</PointData><Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">
{words_of(c for p in points for c in p)}</DataArray></Points><Cells>
<DataArray type="Int64" Name="connectivity" format="ascii">0 1 2 3 4 5 6 7</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">8</DataArray>
<DataArray type="UInt8" Name="types" format="ascii">11</DataArray></Cells></Piece>
</UnstructuredGrid></VTKFile>""")
        source = self.write("all.vtm", """<VTKFile type="vtkMultiBlockDataSet" version="1.0">
<vtkMultiBlockDataSet><DataSet index="0" file="left.vtu"/><DataSet index="1" file="right.vtu"/>
</vtkMultiBlockDataSet></VTKFile>""")
        report = self.imported(source, "--voxel", 0.125)
        self.assertIn("2 blocks were joined", report["notes"])
        for row in self.sample("s", [(0.5, 0.5, 0.5), (1.0, 0.3, 0.4), (1.7, 0.5, 0.2)]):
            self.assertAlmostEqual(row["value"], linear((row["x"], row["y"], row["z"])), delta=1e-5)

    def test_a_mesh_gets_more_than_1000_voxels_if_the_user_states_no_size(self):
        report = self.imported(self.write("a.vtk", rectilinear(
            [0, 1, 2, 4, 8, 9, 10], [0, 1, 2, 3, 4, 5.5], [0, 1, 2, 3, 4.1])))
        self.assertGreater(report["grids"][0]["active_voxels"], 1000)

    @suite.smoke
    def test_blanked_points_of_plot3d_have_no_data(self):
        n = 5
        grid, blank, flow = [], [], [[], [], [], [], []]
        points = [(float(i), float(j) * 1.1, float(k) + 0.01 * i * i)
                  for k in range(n) for j in range(n) for i in range(n)]
        for axis in range(3):
            grid += [p[axis] for p in points]
        for i, p in enumerate(points):
            blank.append(0 if i == (2 * n + 2) * n + 2 else 1)
            density, velocity = 2.0, (1.0, 0.1 * p[0], 0.2)
            for q, value in zip(flow, (density, *(density * v for v in velocity), 10.0)):
                q.append(value)
        head = struct.pack("<3i", n, n, n)
        source = self.write("grid.xyz", head + struct.pack(f"<{len(grid)}f", *grid)
                            + struct.pack(f"<{len(blank)}i", *blank))
        self.write("flow.q", head + struct.pack("<4f", 0.1, 0, 1000, 0)
                   + b"".join(struct.pack(f"<{len(q)}f", *q) for q in flow))
        self.refused(source, self.dir / "o.vdb", says="--solution")
        report = self.imported(source, "--solution", self.dir / "flow.q", "--field", "Velocity",
                               "--voxel", 0.2)
        rows = self.sample("Velocity", [(0.6, 0.6, 0.6), (2.0, 2.2, 2.04)])
        self.assertAlmostEqual(rows[0]["vx"], 1.0, places=5)
        self.assertAlmostEqual(rows[0]["vy"], 0.06, places=4)
        self.assertEqual([r["inside"] for r in rows], [1, 0], report)


    def test_skips_the_pressure_of_a_plot3d_solution_without_energy(self):
        n = 5
        points = [(float(i), float(j), float(k)) for k in range(n) for j in range(n)
                  for i in range(n)]
        grid = [p[axis] for axis in range(3) for p in points]
        head = struct.pack("<3i", n, n, n)
        source = self.write("grid.xyz", head + struct.pack(f"<{len(grid)}f", *grid)
                            + struct.pack(f"<{len(points)}i", *[1] * len(points)))
        for energy, derived in ((0.0, False), (9.0, True)):
            q = [[1.0 + 0.01 * p[1] for p in points], [2.0 + p[0] for p in points],
                 [0.1 * p[1] for p in points], [0.2] * len(points), [20 * energy] * len(points)]
            self.write("flow.q", head + struct.pack("<4f", 0.1, 0, 1000, 0)
                       + b"".join(struct.pack(f"<{len(c)}f", *c) for c in q))
            report = self.imported(source, "--solution", self.dir / "flow.q", "--voxel", 0.25)
            names = {grid["name"] for grid in report["grids"]}
            said = [note for note in report["notes"] if "negative at 100 %" in note]
            self.assertEqual(names & {"Pressure", "Temperature"},
                             {"Pressure", "Temperature"} if derived else set())
            self.assertEqual(len(said), 0 if derived else 2, report["notes"])
            self.assertLessEqual({"Density", "Momentum", "Velocity"}, names)

    @suite.smoke
    def test_three_arrays_named_as_components_are_joined_into_a_vector(self):
        n = 6
        at = [(i, j, k) for k in range(n) for j in range(n) for i in range(n)]
        for names, vector in ((("X Velocity", "Y Velocity", "Z Velocity"), "Velocity"),
                              (("u", "v", "w"), "velocity"),
                              (("Momentum_x", "Momentum_y", "Momentum_z"), "Momentum")):
            arrays = [(names[0], 1, [-p[1] for p in at]), (names[1], 1, [p[0] for p in at]),
                      (names[2], 1, [0.5 * p[2] for p in at]),
                      ("p", 1, [p[0] * p[1] for p in at])]
            source = self.write("a.vti", vti(n, n, n, arrays))
            scene = self.dir / "s.json"
            report = self.imported(source, "--scene", scene)
            self.assertEqual({grid["name"] for grid in report["grids"]}, {vector, "p"})
            self.assertIn(f"{names[0]}, {names[1]} and {names[2]}: joined into the vector {vector}",
                          report["notes"])
            row = self.sample(vector, [(3, 2, 4)])[0]
            self.assertEqual([row["vx"], row["vy"], row["vz"]], [-2, 3, 2])
            modes = json.loads(scene.read_text())["modes"]
            self.assertEqual(modes[0]["mode"], "follow")
            # Option --field selects one component or the vector.
            report = self.imported(source, "--field", names[1])
            self.assertEqual([grid["name"] for grid in report["grids"]], [names[1]])
            report = self.imported(source, "--field", vector)
            self.assertEqual([grid["name"] for grid in report["grids"]], [vector])

    def test_an_imported_vdb_gets_the_same_modes_as_the_scene_of_its_import(self):
        n = 12
        at = [(i - 5.5, j - 5.5, k - 5.5) for k in range(n) for j in range(n) for i in range(n)]
        arrays = [("velocity", 3, [c for p in at for c in (-p[1], p[0], 1.0)]),
                  ("density", 1, [1000.0 if math.hypot(*p) < 4 else 0.0 for p in at])]
        source = self.write("a.vti", vti(n, n, n, arrays))
        scene = self.dir / "s.json"
        self.imported(source, "--scene", scene)
        self.assertEqual(json.loads(run("scene", self.dir / "out.vdb").stdout)["modes"],
                         json.loads(scene.read_text())["modes"])


class Series(Case):
    @suite.smoke
    def test_each_time_step_becomes_a_file(self):
        """The Exodus file has the value sin(2 pi t) everywhere, in 10 steps from 0 to 1."""
        source = self.dir / "series.ex2"
        process.run([MAKE_SERIES, source], check=True)
        report = self.imported(source, "--field", "Point Value")
        self.assertTrue(any("first of 10 steps" in note for note in report["notes"]))
        reports = self.imported(source, "--field", "Point Value", "--time", "all")
        self.assertEqual([r["file"] for r in reports],
                         [str(self.dir / f"out_{step:04}.vdb") for step in range(10)])
        for report in reports:
            self.assertAlmostEqual(report["grids"][0]["highest"],
                                   math.sin(2 * math.pi * report["time"]), places=6)
        report = self.imported(source, "--field", "Point Value", "--time", "3")
        self.assertAlmostEqual(report["time"], 1 / 3)
        self.assertAlmostEqual(self.sample("Point Value", [(0.2, 0.2, 0.2)])[0]["value"],
                               math.sin(2 * math.pi / 3), places=6)
        self.refused(source, self.dir / "o.vdb", "--time", "10", says="0 to 9")
        self.refused(source, self.dir / "o.vdb", "--time", "x", says="0 to 9")

    def test_a_file_with_one_step_has_no_time(self):
        source = self.dir / "one.ex2"
        process.run([MAKE_SERIES, source, "one"], check=True)
        report = self.imported(source, "--field", "Point Value", "--voxel", "0.5")
        self.assertNotIn("time", report)

    def test_a_series_is_written_completely_or_not_at_all(self):
        """The third step of a 4-D NIfTI file is constant."""
        def nifti(steps):
            header = bytearray(352)
            struct.pack_into("<i", header, 0, 348)
            struct.pack_into("<8h", header, 40, 4, 4, 4, 4, len(steps), 1, 1, 1)
            struct.pack_into("<2h", header, 70, 4, 16)
            struct.pack_into("<8f", header, 76, 1, 1, 1, 1, 1, 1, 1, 1)
            struct.pack_into("<f", header, 108, 352.0)
            header[344:348] = b"n+1\0"
            return bytes(header) + b"".join(struct.pack("<64h", *s) for s in steps)
        ramp = list(range(64))
        source = self.write("a.nii", nifti([ramp, ramp, [7] * 64, ramp]))
        reports = self.imported(source, "--time", "all")
        self.assertTrue(any("the same value, and all are kept" in note for note in reports[2]["notes"]))
        made = sorted(name for name in os.listdir(self.dir) if name.endswith(".vdb"))
        self.assertEqual(made, [f"out_{n:04d}.vdb" for n in range(4)])
        for name in made:
            (self.dir / name).unlink()
        # If the last step is cut off, no file is written.
        whole = source.read_bytes()
        cut = self.write("cut.nii.gz", gzip.compress(whole[:-100]))
        self.refused(cut, self.dir / "out.vdb", "--time", "all", says="cut.nii.gz")
        # If the last file cannot be written, no file is written.
        (self.dir / "out_0003.vdb").mkdir()
        (self.dir / "out_0003.vdb" / "x").mkdir()
        self.refused(source, self.dir / "out.vdb", "--time", "all", "--scene", self.dir / "s.json",
                     says="out_0003.vdb")

    def test_steps_without_a_surface_are_empty_level_sets_that_a_scene_plays(self):
        def nifti(steps):
            header = bytearray(352)
            struct.pack_into("<i", header, 0, 348)
            struct.pack_into("<8h", header, 40, 4, 8, 8, 8, len(steps), 1, 1, 1)
            struct.pack_into("<2h", header, 70, 4, 16)
            struct.pack_into("<8f", header, 76, 1, 1, 1, 1, 1, 1, 1, 1)
            struct.pack_into("<f", header, 108, 352.0)
            header[344:348] = b"n+1\0"
            return bytes(header) + b"".join(struct.pack("<512h", *s) for s in steps)

        def core(value):
            return image_values(8, 8, 8, lambda *p: value if all(2 <= c < 6 for c in p) else 0)
        # Two steps are constant, and the values of another step do not reach 50.
        source = self.write("a.nii", nifti([[0] * 512, core(100), [7] * 512, core(20), core(100)]))
        scene = self.dir / "s.json"
        reports = self.imported(source, "--time", "all", "--iso", 50, "--scene", scene)
        self.assertEqual([r["file"] for r in reports], [str(self.dir / f"out_{n:04}.vdb") for n in range(5)])
        grids = [r["grids"][0] for r in reports]
        self.assertEqual([g["active_voxels"] > 0 for g in grids], [False, True, False, False, True])
        for grid in grids:
            self.assertEqual([grid[key] for key in ("name", "type", "voxel", "background")],
                             [grids[1]["name"], "float", [1, 1, 1], 3])
        told = [any("no surface has the value of --iso" in note for note in r["notes"]) for r in reports]
        self.assertEqual(told, [True, False, False, False, False])
        played = json.loads(scene.read_text())
        (volume,) = played["volumes"].values()
        self.assertEqual((volume["file"], volume["frames"]), ("out_%04d.vdb", {"rate": 1}))
        (volume,) = json.loads(run("check", scene, "--json").stdout)["volumes"].values()
        self.assertEqual(volume["frames"]["count"], 5)
        for name in os.listdir(self.dir):
            if name.endswith(".vdb"):
                (self.dir / name).unlink()
        self.refused(source, self.dir / "out.vdb", "--time", "all", "--iso", 500, says="no step has a surface")

    def test_three_volumes_of_unit_vectors_are_a_vector_and_not_a_series(self):
        """The three volumes of a 4-D NIfTI file are unit vectors, vectors by the intent code, or time steps."""
        def nifti(volumes, intent=0):
            header = bytearray(352)
            struct.pack_into("<i", header, 0, 348)
            struct.pack_into("<8h", header, 40, 4, 4, 4, 4, 3, 1, 1, 1)
            struct.pack_into("<h", header, 68, intent)
            struct.pack_into("<2h", header, 70, 16, 32)
            struct.pack_into("<8f", header, 76, 1, 1, 1, 1, 1, 1, 1, 1)
            struct.pack_into("<f", header, 108, 352.0)
            header[344:348] = b"n+1\0"
            return bytes(header) + b"".join(struct.pack("<64f", *v) for v in volumes)
        angles = [0.1 * i for i in range(64)]
        unit = [[math.cos(a) for a in angles], [math.sin(a) for a in angles], [0.0] * 64]
        scene = self.dir / "s.json"
        report = self.imported(self.write("a.nii", nifti(unit)), "--scene", scene)
        self.assertTrue(any("not as time steps" in note for note in report["notes"]))
        self.assertFalse(any("the first of" in note for note in report["notes"]))
        written = json.loads(scene.read_text())
        self.assertEqual([mode["mode"] for mode in written["modes"]], ["follow"])
        self.assertTrue(written["volumes"]["vector"]["axial"])
        # The voxel axes are right-handed, so FSL mirrors x.
        row = self.sample("vector", [(1, 0, 0)])[0]
        self.assertAlmostEqual(row["vx"], -math.cos(0.1), places=6)
        self.assertAlmostEqual(row["vy"], math.sin(0.1), places=6)

        twice = [[2 * v for v in volume] for volume in unit]
        report = self.imported(self.write("a.nii", nifti(twice, 1007)))
        row = self.sample("vector", [(1, 0, 0)])[0]
        self.assertAlmostEqual(row["vx"], 2 * math.cos(0.1), places=6)
        report = self.imported(self.write("a.nii", nifti(twice)))
        self.assertTrue(any("first of 3 steps" in note for note in report["notes"]))

    def test_a_file_with_a_single_time_step_gets_a_single_report(self):
        source = self.write("a.vti", vti(3, 3, 3, [("s", 1, range(27))]))
        self.assertEqual(len(self.imported(source, "--time", "all")), 1)


class Raw(Case):
    LAYOUT = {"size": [4, 3, 2], "type": "int16", "spacing": [1, 2, 3]}

    def layout(self, **changes):
        layout = {**self.LAYOUT, **changes}
        return json.dumps({k: v for k, v in layout.items() if v is not None})

    @suite.smoke
    def test_reads_raw_files_of_every_number_type_and_byte_order(self):
        values = [i - 3 if i > 2 else i for i in range(24)]
        for name, code in (("int8", "b"), ("uint8", "B"), ("int16", "h"), ("uint16", "H"),
                           ("int32", "i"), ("uint32", "I"), ("int64", "q"), ("uint64", "Q"),
                           ("float32", "f"), ("float64", "d")):
            for endian, mark in (("little", "<"), ("big", ">")):
                source = self.write("a.raw", struct.pack(f"{mark}24{code}", *values))
                self.imported(source, "--raw", self.layout(type=name, endian=endian))
                row = self.sample("density", [(3, 2, 0), (1, 4, 3)])
                self.assertEqual([r["value"] for r in row], [values[7], values[21]], name)

    def test_reads_raw_files_with_skipped_bytes_and_axes_of_any_direction(self):
        values = list(range(24))
        data = struct.pack("<24h", *values)
        for skip, content in ((5, b"12345" + data), (-1, b"any header" + data),
                              ({"after": "end\n"}, b"header\nend\n" + data)):
            self.imported(self.write("a.raw", content), "--raw", self.layout(skip=skip))
            self.assertEqual(self.sample("density", [(3, 4, 3)])[0]["value"], 23)
        layout = self.layout(spacing=None, axes=[[0, 2, 0], [0, 0, 1], [3, 0, 0]],
                             origin=[1, 1, 1], name="here")
        self.imported(self.write("a.raw", data), "--raw", self.write("layout.json", layout))
        self.assertEqual(self.sample("here", [(1 + 3, 1 + 6, 1 + 2)])[0]["value"], 23)

    def test_reads_interleaved_and_planar_vectors_of_raw_files(self):
        flow = [(i, 2 * i, -i) for i in range(24)]
        inter = struct.pack("<72f", *(c for v in flow for c in v))
        planar = struct.pack("<72f", *(v[a] for a in range(3) for v in flow))
        for order, data in (("interleaved", inter), ("planar", planar)):
            self.imported(self.write("a.raw", data), "--raw",
                          self.layout(type="float32", components=3, order=order, name="v"))
            row = self.sample("v", [(1, 2, 0)])[0]
            self.assertEqual((row["vx"], row["vy"], row["vz"]), (5, 10, -5))

    def test_refuses_a_raw_layout_that_is_not_a_regular_json_file(self):
        source = self.write("a.raw", struct.pack("<24h", *range(24)))
        os.mkfifo(self.dir / "pipe")
        os.symlink("round", self.dir / "round")
        kinds = "it is a folder, a pipe or a device"
        for raw, says in ((self.dir / "pipe", kinds), ("/dev/zero", kinds), (self.dir, kinds),
                          (self.dir / "round", "symbolic links"),
                          (self.write("empty", b""), "not JSON")):
            self.refused(source, self.dir / "o.vdb", "--raw", raw, says=says)

    @suite.smoke
    def test_refuses_an_invalid_raw_layout_and_names_its_error(self):
        source = self.write("a.raw", struct.pack("<24h", *range(24)))
        out = self.dir / "o.vdb"
        for changes, says in (({"size": [4, 3]}, "/size"), ({"size": [4, 3, 0]}, "/size"),
                              ({"size": None}, '"size" is missing'), ({"type": "half"}, "/type"),
                              ({"endian": "middle"}, "/endian"), ({"components": 2}, "/components"),
                              ({"spacing": [1, 1, "x"]}, "/spacing"), ({"skip": -2}, "/skip"),
                              ({"axes": [[1, 0, 0]]}, "/spacing"), ({"sizes": 1}, "/sizes"),
                              ({"spacing": [0, 1, 1]}, "no volume"),
                              ({"size": [40, 3, 2]}, "needs 480 bytes"),
                              ({"size": [999987, 999964, 768652], "components": 3}, "more than the limit"),
                              ({"skip": 2**64 - 1}, "/skip"),
                              ({"skip": {"after": "never"}}, "first megabyte")):
            self.refused(source, out, "--raw", self.layout(**changes), says=says)
        self.refused(source, out, "--raw", "{nonsense", says="not JSON")
        self.refused(source, out, "--raw", self.dir / "none.json", says="cannot be read")


class LevelSets(Case):
    def ball(self, spacing, cavity=0.0, name="a.vti", inside=1000.0, outside=0.0):
        """Writes a ball of radius 10 with an edge that is blurred over a length of 4."""
        n = [int(30 / s) + 1 for s in spacing]
        def value(i, j, k):
            r = math.dist((i * spacing[0], j * spacing[1], k * spacing[2]), (15, 15, 15))
            level = min(1.0, max(0.0, 0.5 + 0.25 * (10 - r)))
            if cavity:
                level = min(level, min(1.0, max(0.0, 0.5 + 0.25 * (r - cavity))))
            return outside + (inside - outside) * level
        return self.write(name, vti(*n, [("s", 1, image_values(*n, value))], spacing=spacing))

    @suite.smoke
    def test_the_surface_of_an_imported_level_set_lies_at_the_iso_value(self):
        for spacing in ((1, 1, 1), (1, 1, 2)):
            report = self.imported(self.ball(spacing), "--iso", 500)
            s = grid_report(report, "s")
            self.assertEqual(s["level_set"]["solid"], "above")
            self.assertLess(s["level_set"]["rms_voxels"], 0.15)
            self.assertEqual(s["voxel"], [1, 1, 1])
            for x in (9, 10, 11):
                self.assertAlmostEqual(self.sample("s", [(15 + x, 15, 15)])[0]["value"], x - 10,
                                       delta=0.25)

    def test_a_level_set_of_a_mask_is_solid_where_the_mask_has_the_given_value(self):
        values = image_values(12, 12, 12, lambda i, j, k: float(3 <= min(i, j, k)
                                                                 and max(i, j, k) < 9))
        self.imported(self.write("a.vti", vti(12, 12, 12, [("s", 1, values)])), "--iso", 1)
        self.assertLess(self.sample("s", [(6, 6, 6)])[0]["value"], 0)

    @suite.smoke
    def test_refuses_level_sets_with_voxels_that_are_too_large_or_too_small(self):
        values = image_values(40, 40, 40, lambda i, j, k: 100.0 * (k == 20))
        source = self.write("a.vti", vti(40, 40, 40, [("s", 1, values)]))
        self.refused(source, self.dir / "o.vdb", "--iso", 50, "--voxel", 17, says="thinner")
        self.refused(source, self.dir / "o.vdb", "--iso", 50, "--voxel", 1e-3, says="too many")

    def test_an_import_of_level_sets_skips_vectors_with_a_note(self):
        source = self.write("a.vti", vti(9, 9, 9, [("s", 1, range(729)), ("v", 3, range(3 * 729))]))
        report = self.imported(source, "--iso", 300)
        self.assertTrue(any("v: skipped" in note for note in report["notes"]))

    def test_a_cavity_of_a_solid_stays_hollow_in_a_level_set(self):
        self.imported(self.ball((1, 1, 1), cavity=5), "--iso", 500)
        values = [r["value"] for r in self.sample("s", [(15, 15, 15 + r) for r in (3, 7.5, 12)])]
        self.assertGreater(values[0], 0)
        self.assertLess(values[1], 0)
        self.assertGreater(values[2], 0)

    def test_a_dark_object_in_bright_surroundings_becomes_a_solid_level_set(self):
        report = self.imported(self.ball((1, 1, 1), inside=0, outside=1000), "--iso", 500)
        self.assertEqual(grid_report(report, "s")["level_set"]["solid"], "below")
        self.assertLess(self.sample("s", [(15, 15, 23)])[0]["value"], 0)

    def test_a_level_set_can_be_felt_without_a_scene(self):
        self.imported(self.ball((1, 1, 1)), "--iso", 500)
        summary = json.loads(run("feel", self.dir / "out.vdb", "--seconds", 3, "--json").stdout)
        self.assertGreater(summary["force_max"], 0.05)

    def test_refuses_an_iso_value_outside_the_range_of_the_data(self):
        self.refused(self.ball((1, 1, 1)), self.dir / "o.vdb", "--iso", 5000, says="has the value")
        two = self.write("b.vti", vti(3, 3, 3, [("a", 1, range(27)), ("b", 1, range(27))]))
        self.refused(two, self.dir / "o.vdb", "--iso", 5, says="--field")


class Scenes(Case):
    @suite.smoke
    def test_the_scene_that_an_import_writes_gives_a_force(self):
        def ball(i, j, k):
            return 900.0 / (1 + math.exp(2 * (math.dist((i, j, k), (16, 16, 16)) - 9)))
        values = image_values(33, 33, 33, ball)
        source = self.write("a.vti", vti(33, 33, 33, [("s", 1, values)]))
        (self.dir / "scenes").mkdir()
        scene = self.dir / "scenes" / "first.json"
        self.imported(source, "--scene", scene)
        text = json.loads(scene.read_text())
        self.assertEqual(text["volumes"]["s"]["file"], "../out.vdb")
        self.assertAlmostEqual(text["modes"][0]["value"], 450, delta=50)
        self.assertTrue(all(mode["description"] for mode in text["modes"]))
        summary = json.loads(run("feel", scene, "--seconds", 3, "--json").stdout)
        self.assertGreater(summary["force_max"], 0.05)

    def test_an_import_prints_its_result_and_the_next_command(self):
        values = image_values(33, 33, 33, lambda i, j, k: 900.0 / (
            1 + math.exp(2 * (math.dist((i, j, k), (16, 16, 16)) - 9))))
        source = self.write("a.vti", vti(33, 33, 33, [("s", 1, values)]))
        out, scene = self.dir / "out.vdb", self.dir / "it's one.json"
        *_, last = run("import", source, out).stdout.splitlines()
        self.assertEqual(last, f"next: palpate feel {out} --seconds 10")
        *_, made, last = run("import", source, out, "--scene", scene).stdout.splitlines()
        modes = json.loads(scene.read_text())["modes"]
        self.assertTrue(made.startswith(f"{scene}: a scene of {len(modes)} mode"), made)
        self.assertTrue(made.endswith(": " + ", ".join(f"{m['name']} ({m['mode']})" for m in modes)))
        self.assertTrue(last.startswith("next: palpate feel '"), last)
        words = shlex.split(last.removeprefix("next: palpate "))
        self.assertEqual(words, ["feel", str(scene), "--seconds", "10"])
        run(*words)
        # With --scene - or --json, stdout has data only.
        json.loads(run("import", source, out, "--scene", "-").stdout)
        json.loads(run("import", source, out, "--scene", scene, "--json").stdout)
        # If no scene can be guessed, the output does not suggest `palpate feel`.
        flat = self.write("b.vti", vti(8, 8, 8, [("s", 1, image_values(
            8, 8, 8, lambda i, j, k: float(k == 4)))]))
        *_, last = run("import", flat, out, "--scene", self.dir / "none.json").stdout.splitlines()
        self.assertEqual(last, f"next: palpate info {out}")

    def test_a_written_scene_finds_its_volume_from_any_working_folder(self):
        source = self.write("a.vti", vti(3, 3, 3, [("s", 1, range(27))]))
        (self.dir / "a").mkdir()
        (self.dir / "b").mkdir()
        done = process.run([PALPATE, "import", "../a.vti", "o.vdb", "--scene", "../b/s.json"],
                              cwd=self.dir / "a", capture_output=True, text=True, timeout=60)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        run("check", self.dir / "b" / "s.json")
        printed = run("import", source, self.dir / "out.vdb", "--scene", "-").stdout
        self.assertEqual(json.loads(printed)["palpate"], 1)

    def test_an_import_writes_its_volume_and_either_a_scene_or_a_note_that_it_has_none(self):
        values = image_values(8, 8, 8, lambda i, j, k: float(k == 4))
        report = self.imported(self.write("a.vti", vti(8, 8, 8, [("s", 1, values)])), "--scene",
                               self.dir / "s.json")
        self.assertEqual((self.dir / "s.json").exists(),
                         not any("no scene" in note for note in report["notes"]))

    def test_a_vector_array_named_direction_is_not_axial(self):
        v = [c for i in range(64) for c in (1.0 + i % 4, 0.5, 0.25 * (i % 3))]
        source = self.write("a.vti", vti(4, 4, 4, [("wind_direction", 3, v)]))
        self.imported(source, "--scene", self.dir / "s.json")
        self.assertNotIn("axial", (self.dir / "s.json").read_text())

    def test_writes_no_volume_if_the_scene_cannot_be_written(self):
        source = self.write("a.vti", vti(3, 3, 3, [("s", 1, range(27))]))
        self.refused(source, self.dir / "o.vdb", "--scene", self.dir / "nowhere" / "s.json",
                     says="cannot be written")


class Refusals(Case):
    @suite.smoke
    def test_refuses_an_unsupported_file_and_names_its_kind(self):
        out = self.dir / "o.vdb"
        for data, says in ((b"\x89PNG\r\n\x1a\n" + bytes(50), "PNG"), (b"PK\3\4" + bytes(50), "zip"),
                           (b"%PDF-1.4" + bytes(50), "PDF"), (b"solid x\nfacet", "surface"),
                           (b"II*\0" + bytes(50), "TIFF"), (b"some words of text\n", "text"),
                           (bytes(range(256)), "damaged"), (b"", "empty"),
                           (b" BDV" + bytes(50), "OpenVDB"),
                           (b"object 3 class gridpositions counts 2 2 2\n", "--raw")):
            self.refused(self.write("a.dat", data), out, says=says)
        self.refused(self.dir / "none.nii", out, says="no such file")
        self.refused(self.dir, out, says="folder")

    def test_the_error_for_an_unknown_array_lists_the_available_arrays(self):
        source = self.write("a.vtk", rectilinear([0, 1, 2], [0, 1], [0, 1]))
        self.refused(source, self.dir / "o.vdb", "--field", "w", says="choose from s, v")
        report = self.imported(source, "--field", "v")
        self.assertEqual([g["name"] for g in report["grids"]], ["v"])

    def test_refuses_files_without_a_volume(self):
        out = self.dir / "o.vdb"
        self.refused(self.write("flat.vtk", rectilinear([0, 1, 2], [0, 1], [5])), out,
                     says="no cells with volume")
        self.refused(self.write("flat.vti", vti(4, 4, 1, [("s", 1, range(16))])), out, says="flat")
        self.refused(self.write("surface.vtk", legacy(
            "POLYDATA", "POINTS 3 float\n0 0 0 1 0 0 0 1 0\nPOLYGONS 1 4\n3 0 1 2", "")), out,
            says="no cells with volume")
        self.refused(self.write("bare.vtk", legacy(
            "STRUCTURED_POINTS", "DIMENSIONS 3 3 3\nORIGIN 0 0 0\nSPACING 1 1 1", "")), out,
            says="no array")
        self.refused(self.write("constant.vti", vti(3, 3, 3, [("s", 1, [4] * 27)])), out,
                     says="the same value")

    def test_refuses_invalid_options(self):
        source = self.write("a.vti", vti(3, 3, 3, [("s", 1, range(27))]))
        mesh = self.write("b.vtk", rectilinear([0, 1, 3], [0, 1, 2], [0, 1, 2]))
        out = self.dir / "o.vdb"
        self.refused(source, self.dir / "o.txt", says="does not end in .vdb")
        self.refused(source, self.dir / "nowhere" / "o.vdb", says="cannot be written")
        self.refused(source, out, "--smooth", -1, says="--smooth")
        self.refused(source, out, "--smooth", "-1vx", says="--smooth")
        self.refused(source, out, "--smooth", "1 mm", says="usage: Could not convert: --smooth = 1 mm")
        self.refused(source, out, "--voxel", "nan", says="--voxel")
        self.refused(source, out, "--iso", "nan", says="--iso")
        self.refused(source, out, "--time", 3, says="--time")
        self.refused(mesh, out, "--smooth", 1, says="mesh")
        self.refused(mesh, out, "--voxel", 1e-5, says="too many")
        self.refused(mesh, out, "--voxel", 50, says="larger than the volume")
        self.refused(mesh, out, "--tolerance", 1, says="mesh")
        for tolerance in ("nan", "-5"):
            self.refused(source, out, "--tolerance", tolerance, says="--tolerance")
        self.refused(source, out, "--as", "banana", says="--as")
        self.refused(source, out, "--as", "vector", says="does not use this option")
        self.refused(source, out, "--series", "2", says="does not use this option")
        self.refused(source, out, "--solution", mesh, says="does not use this option")
        self.refused(source, out, "--scene", out, says="the same path")
        self.refused(source, out, "--scene", source, says="the same path")
        self.refused(source, self.dir, says="folder")
        self.refused(source, out, "--nonsense", says="usage")
        self.refused(source, says="usage")

    @suite.smoke
    def test_refuses_truncated_or_inconsistent_files(self):
        out = self.dir / "o.vdb"
        text = rectilinear([0, 1, 2.5], [0, 1, 2], [0, 1, 3])
        for part in (0.4, 0.6, 0.8, 0.95):
            self.refused(self.write("a.vtk", text[:int(part * len(text))]), out, says="a.vtk")
        image = legacy("STRUCTURED_POINTS", "DIMENSIONS 4 4 4\nORIGIN 0 0 0\nSPACING 1 1 1", "")
        binary = image.replace("ASCII", "BINARY").encode() + (
            b"POINT_DATA 64\nSCALARS s float\nLOOKUP_TABLE default\n"
            + struct.pack(">64f", *range(64)))
        self.imported(self.write("b.vtk", binary))
        (self.dir / "out.vdb").unlink()
        self.refused(self.write("b.vtk", binary[:-9]), out, says="b.vtk")
        short = legacy("STRUCTURED_POINTS", "DIMENSIONS 4 4 4\nORIGIN 0 0 0\nSPACING 1 1 1",
                       "POINT_DATA 64\nFIELD f 1\ns 1 10 float\n" + words_of(range(10)))
        self.refused(self.write("c.vtk", short), out, says="10 values for 64")
        points, cells = box_of_tetrahedra(1)
        cells[0][0] = 77
        self.refused(self.write("d.vtk", unstructured(
            points, cells, [10] * 6, "POINT_DATA 8\n" + scalars("s", range(8)))), out,
            says="refer to points")
        piece = vti(4, 4, 8, [("s", 1, range(128))]).replace(
            'WholeExtent="0.0 3.0 0.0 3.0 0.0 7.0"', "").replace('Piece Extent="0 3 0 3 0 7"',
                                                                 'Piece Extent="0 3 0 3 0 3"')
        self.refused(self.write("e.vti", piece), out, says="pieces cover")
        whole = (self.dir / "series.ex2")
        process.run([MAKE_SERIES, whole], check=True)
        data = whole.read_bytes()
        for part in (0.5, 0.9, 0.999):
            self.refused(self.write("f.ex2", data[:int(part * len(data))]), out, says="truncated")
        self.refused(self.write("tiny.vti", vti(3, 3, 3, [("s", 1, range(27))],
                                                spacing=(1e-5, 1e-5, 1e-5))), out, says="too small")
        os.mkfifo(self.dir / "pipe")
        self.refused(self.dir / "pipe", out, says="neither a file nor a folder")

    def test_a_failed_import_keeps_the_old_file(self):
        old = self.write("o.vdb", "old")
        self.refused(self.write("a.dat", "text"), old, says="text")
        self.assertEqual(old.read_bytes(), b"old")


class Damage(Case):
    @suite.smoke
    def test_damaged_files_never_crash_the_importer(self):
        rng = random.Random(int(os.environ.get("PALPATE_SEED", "5")))
        points, cells = box_of_tetrahedra(2)
        data = f"POINT_DATA {len(points)}\n" + scalars("s", map(linear, points))
        sources = [
            ("a.vtk", rectilinear([0, 1, 2.5], [0, 1, 2], [0, 1, 3]).encode()),
            ("b.vtk", unstructured(points, cells, [10] * len(cells), data).encode()),
            ("c.vti", vti(4, 4, 4, [("s", 1, range(64))]).encode()),
        ]
        if "PALPATE_DATA" in os.environ:
            folder = Path(os.environ["PALPATE_DATA"])
            for name in ("cfd_disk_out_ref/disk_out_ref.ex2", "flow_carotid/carotid.vtk"):
                sources.append((Path(name).name, (folder / name).read_bytes()))
        crashes = 0
        count = cases(60, "damaged files of VTK's formats")
        for case in range(count):
            name, whole = sources[case % len(sources)]
            broken = bytearray(whole)
            if rng.random() < 0.4:
                del broken[rng.randrange(len(broken)):]
            else:
                for _ in range(rng.choice((1, 1, 5, 50))):
                    # Most damage is in the part that has the file's structure.
                    at = rng.randrange(min(len(broken), 4000) if rng.random() < 0.7 else len(broken))
                    broken[at] = rng.randrange(256)
            source = self.write(name, bytes(broken))
            before = sorted(os.listdir(self.dir))
            done = call("import", source, self.dir / "out.vdb", timeout=120)
            label = f"case {case} of {name}: {done.stderr}"
            self.assertIn(done.returncode, (0, 1, 2), label)
            if done.returncode == 0:
                self.assertEqual(done.stderr, "", label)
                (self.dir / "out.vdb").unlink()
            else:
                self.assertEqual(len(done.stderr.splitlines()), 1, label)
                self.assertTrue(done.stderr.startswith("palpate: "), label)
                crashes += "the reader crashed" in done.stderr
            self.assertEqual(sorted(os.listdir(self.dir)), before, label)
        print(f"damaged: {count} cases, {crashes} of them crashes of the reader that were contained")


class Extremes(Case):
    """Imports of valid sources with extreme sizes, positions and values."""
    NUMBERS = (0.0, 1.0, -1.0, 1e-3, 1e-5, 1e-12, 1e-30, 1e-160, 1e-310, 1e5, 1e9, 1e15, 1e25, 1e31,
               1e38, 1e39, 1e100, 1e101, 1e160, 1e300, -1e31, math.nan, math.inf)
    NAMES = ("s", "", "v.x", "a[0]", "density", "\x1b[2J", "\u202e", "n" * 5000, "caf\u00e9" * 60)

    def number(self, usual):
        return usual if self.rng.random() < 0.6 else self.rng.choice(self.NUMBERS)

    def values(self, count):
        kind = self.rng.randrange(5)
        if kind == 0:
            return [self.number(2.0)] * count
        if kind == 1:
            return [float(i) for i in range(count)]
        scale = self.number(1.0)
        if kind == 2:
            return [scale * i for i in range(count)]
        if kind == 3:
            return [self.number(float(i)) for i in range(count)]
        return [self.number(1.0) if i == count // 2 else 0.0 for i in range(count)]

    def source(self):
        """Returns a file, its layout, and more options."""
        rng = self.rng
        words = []
        if rng.random() < 0.3:
            words += ["--voxel", repr(self.number(0.5))]
        if rng.random() < 0.2:
            words += ["--iso", repr(self.number(1.0))]
        if rng.random() < 0.1:
            words += ["--smooth", repr(self.number(1.0))]
        size = [rng.choice((1, 2, 2, 3, 5)) for _ in range(3)]
        count = size[0] * size[1] * size[2]
        name = rng.choice(self.NAMES)
        kind = rng.randrange(4)
        if kind == 0:
            plain = name if name.isprintable() and name else "s"
            return self.write("a.vti", vti(
                *size, [(plain, 1, self.values(count)), ("w", 3, self.values(3 * count))],
                origin=[self.number(0.0) for _ in range(3)],
                spacing=[self.number(1.0) for _ in range(3)])), words
        if kind == 1:
            lines = [[self.number(0.0)] for _ in range(3)]
            for a in range(3):
                step = self.number(1.0)
                lines[a] = [lines[a][0] + step * i + (0.3 * step if i == 1 else 0)
                            for i in range(size[a])]
            return self.write("a.vtk", rectilinear(*lines, lambda p: self.number(p[0]))), words
        if kind == 2:
            points, cells = box_of_tetrahedra(rng.choice((1, 1, 2)))
            scale, shift = self.number(1.0), self.number(0.0)
            points = [tuple(scale * c + shift for c in p) for p in points]
            cells = cells[:rng.choice((1, 6, len(cells)))]
            data = f"POINT_DATA {len(points)}\n" + scalars(name.replace(" ", "_") or "s",
                                                          self.values(len(points)))
            return self.write("a.vtk", unstructured(points, cells, [10] * len(cells), data)), words
        layout = {"size": size, "type": "float64", "name": name,
                  "spacing": [self.number(1.0) for _ in range(3)],
                  "origin": [self.number(0.0) for _ in range(3)]}
        source = self.write("a.raw", struct.pack(f"<{count}d", *self.values(count)))
        return source, [*words, "--raw", json.dumps(layout).replace("Infinity", "1e999")]

    def test_every_volume_written_from_extreme_numbers_can_be_felt(self):
        seed = int(os.environ.get("PALPATE_SEED", "7"))
        written = 0
        count = cases(60, "sources of extreme numbers")
        for case in range(count):
            self.rng = random.Random(1000003 * seed + case)
            out = self.dir / "out.vdb"
            source, words = self.source()
            before = sorted(os.listdir(self.dir))
            label = f"case {case} of seed {seed}: {words} {source.read_bytes()[:1500]}"
            try:
                done = call("import", source, out, *words, timeout=100)
            except subprocess.TimeoutExpired:
                self.fail("too slow: " + label)
            if done.returncode == 0:
                written += 1
                self.assertEqual(done.stderr, "", label)
                info = call("info", out, "--json")
                self.assertEqual((info.returncode, info.stderr), (0, ""), label)
                for grid in json.loads(info.stdout)["grids"]:
                    if not grid["type"].startswith("3 x"):
                        self.assertTrue(grid["can_be_felt"], (grid, label))
                out.unlink()
            else:
                self.assertIn(done.returncode, (1, 2), (done.stderr, label))
                self.assertEqual(len(done.stderr.splitlines()), 1, (done.stderr, label))
                self.assertEqual(done.stdout, "", label)
            self.assertEqual(sorted(os.listdir(self.dir)), before, label)
        print(f"extremes: {written} of {count} written")


class Running(Case):
    def test_an_import_fails_if_its_standard_output_cannot_be_written(self):
        source = self.write("a.raw", bytes(range(64)))
        for words in ([], ["--json"]):
            words += ["--raw", '{"size":[4,4,4],"type":"uint8"}']
            with open("/dev/full", "w") as full:
                done = process.run([PALPATE, "import", source, self.dir / "out.vdb", *words], stdout=full,
                                   stderr=subprocess.PIPE, text=True, timeout=60)
            self.assertEqual(done.returncode, 2)
            self.assertEqual(done.stderr, "palpate: standard output: it cannot be written: check the disk or the pipe\n")

    def big(self, n=160):
        rng = random.Random(6)
        return self.write("big.raw", rng.randbytes(n ** 3)), json.dumps(
            {"size": [n, n, n], "type": "uint8"})

    def test_an_interrupted_import_leaves_no_files(self):
        # With this many voxels the import would take minutes.
        source = self.write("a.vtk", rectilinear([0, 1, 3], [0, 2, 3], [0, 1.5, 3]))
        before = sorted(os.listdir(self.dir))
        for pause in (0.05, 0.3, 5.0):
            importer = subprocess.Popen([PALPATE, "import", source, self.dir / "o.vdb", "--voxel",
                                        "0.0025"], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                       text=True)
            time.sleep(pause)
            importer.send_signal(signal.SIGINT)
            out, err = importer.communicate(timeout=60)
            # The status is -SIGINT if the signal came before the program handled it.
            self.assertIn(importer.returncode, (130, -signal.SIGINT) if pause < 5 else (130,))
            self.assertEqual((out, err), ("", ""))
            self.assertEqual(sorted(os.listdir(self.dir)), before)

    def at_a_terminal(self, shows, *words):
        """Imports until the terminal shows progress, then presses Ctrl-C."""
        before = sorted(os.listdir(self.dir))
        terminal = Terminal([PALPATE, "import", *words], self.dir)
        self.assertTrue(terminal.until(shows), terminal.drawn)
        terminal.press(b"\x03")
        status, took = terminal.ended()
        self.assertEqual(status, 130)
        self.assertLess(took, 10.0)  # [s]; enough on a busy machine
        self.assertTrue(terminal.drawn.endswith("\r\x1b[K"), terminal.drawn)
        self.assertEqual(sorted(os.listdir(self.dir)), before)

    def test_prints_progress_at_a_terminal_until_ctrl_c(self):
        source = self.write("a.vtk", rectilinear([0, 1, 3], [0, 2, 3], [0, 1.5, 3]))
        self.at_a_terminal("resampling: ", source, "o.vdb", "--voxel", "0.0025", "--scene", "s.json")
        source, layout = self.big(224)
        self.at_a_terminal("smoothing density: ", source, "o.vdb", "--raw", layout, "--smooth", "80")

    def test_an_import_interrupted_while_writing_leaves_no_files(self):
        """The import writes the scene first. Writing the volume takes longer."""
        source, layout = self.big(224)
        before = sorted(os.listdir(self.dir))
        for how in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            importer = subprocess.Popen([PALPATE, "import", source, "o.vdb", "--raw", layout,
                                        "--scene", "s.json"], cwd=self.dir, text=True,
                                       stdout=subprocess.PIPE, stderr=subprocess.PIPE)
            while not any(name.startswith("o.vdb.partial") for name in os.listdir(self.dir)):
                self.assertIsNone(importer.poll())
                time.sleep(0.001)
            begin = time.monotonic()
            importer.send_signal(how)
            out, err = importer.communicate(timeout=60)
            self.assertLess(time.monotonic() - begin, 10.0)
            self.assertEqual((importer.returncode, out, err), (130, "", ""))
            self.assertEqual(sorted(os.listdir(self.dir)), before)

    @unittest.skipIf(os.environ.get("PALPATE_SANITIZE"), "sanitizers take memory of their own")
    def test_an_import_needs_memory_of_at_most_three_times_its_grids(self):
        small = self.imported(self.write("a.vti", vti(3, 3, 3, [("s", 1, range(27))])))["memory"]
        rng = random.Random(6)
        n = 160
        for kind, width in (("uint8", 1), ("float32", 4), ("float64", 8)):
            data = rng.randbytes(n ** 3) if width == 1 else b"".join(
                struct.pack(f"<{n * n}{'f' if width == 4 else 'd'}",
                            *(rng.random() for _ in range(n * n))) for _ in range(n))
            source = self.write("big.raw", data)
            layout = json.dumps({"size": [n, n, n], "type": kind})
            for words in ((), ("--smooth", "1")):
                memory = self.imported(source, "--raw", layout, *words)["memory"]
                times = (memory["peak"] - small["peak"]) / memory["grids"]
                self.assertLess(times, 3, (kind, words))
                print(f"memory {kind} {words}: {times:.2f}")


if __name__ == "__main__":
    suite.main(sys.argv[3:])
