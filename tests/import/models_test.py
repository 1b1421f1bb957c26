#!/usr/bin/env python3
"""What models of weather and solvers of flows write, and what it becomes: models_test.py BIN_DIR."""
import json
import math
import os
import random
import struct
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path


PALPATE = str((Path(sys.argv[1]) / "palpate").resolve())


class Case(unittest.TestCase):
    def setUp(self):
        holder = tempfile.TemporaryDirectory()
        self.addCleanup(holder.cleanup)
        self.dir = Path(holder.name)
        self.out = self.dir / "out.vdb"

    def call(self, *words):
        return subprocess.run([PALPATE, *map(str, words)], capture_output=True, text=True,
                              timeout=120)

    def imported(self, source, *words):
        """The report, its grids by name."""
        done = self.call("import", source, self.out, "--json", *words)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        report = json.loads(done.stdout)
        report["grid"] = {grid["name"]: grid for grid in report["grids"]}
        report["note"] = "\n".join(report["notes"])
        return report


def clustered(n, beta):
    """n numbers from 0 to 1, most of them near 0."""
    return [(math.exp(beta * i / (n - 1)) - 1) / (math.exp(beta) - 1) for i in range(n)]


class Sizes(Case):
    SIZE = (25, 31, 9)

    def points(self):
        """About a cylinder, as close to it as a boundary layer has it."""
        nt, nr, nz = self.SIZE
        rings = [0.5 + 10 * r for r in clustered(nr, 8)]
        return [(r * math.cos(t), r * math.sin(t), 0.25 * k) for k in range(nz) for r in rings
                for t in (2 * math.pi * i / (nt - 1) for i in range(nt))]

    def test_a_stretched_mesh_has_no_more_voxels_than_its_points_are_worth(self):
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
        self.assertIn("at most 16 a point", report["note"])
        finer = float(report["note"].split("--voxel ")[1].split()[0])
        self.assertLess(finer, s["voxel"][0])
        asked = self.imported(source, "--voxel", 0.9 * s["voxel"][0])
        self.assertGreater(asked["grid"]["s"]["active_voxels"], s["active_voxels"])
        self.assertNotIn("a point", asked["note"])
        self.assertLess(asked["grid"]["s"]["resampling"]["rms"], s["resampling"]["rms"])

    def of_at_most_twice(self, report, given):
        """Output and memory: twice the input and 64 MB."""
        most = 2 * given + (64 << 20)
        self.assertLessEqual(self.out.stat().st_size, most)
        if not os.environ.get("PALPATE_SANITIZE"):
            peak = report["memory"]["peak"] - self.idle()
            self.assertLessEqual(peak, most)
            print(f"{given / 1e6:.1f} MB: {self.out.stat().st_size / 1e6:.1f} MB of .vdb, "
                  f"{peak / 1e6:.0f} MB of memory")

    def idle(self):
        """What the program takes with next to nothing to do."""
        source = self.dir / "small.raw"
        source.write_bytes(bytes(range(27)))
        done = self.call("import", source, self.dir / "small.vdb", "--json", "--raw",
                         '{"size": [3, 3, 3], "type": "uint8"}')
        return json.loads(done.stdout)["memory"]["peak"]

    def test_a_ct_of_half_a_millimetre(self):
        n = 256
        rng = random.Random(1)
        plane = struct.pack(f"<{n * n}h", *(rng.randrange(-1024, 2000) for _ in range(n * n)))
        source = self.dir / "ct.nrrd"
        # Noise everywhere: nothing of it is left out, and no packing helps.
        with source.open("wb") as file:
            file.write(f"NRRD0004\ntype: short\ndimension: 3\nsizes: {n} {n} {n}\nencoding: raw\n"
                       "endian: little\nspace: right-anterior-superior\nspace directions: "
                       "(0.5,0,0) (0,0.5,0) (0,0,0.5)\nspace origin: (0,0,0)\n\n".encode())
            for k in range(n):
                file.write(plane[2 * k:] + plane[:2 * k])
        report = self.imported(source)
        self.assertGreater(report["grids"][0]["active_voxels"], 0.99 * n ** 3)
        self.assertEqual(report["grids"][0]["voxel"], [0.5, 0.5, 0.5])
        self.of_at_most_twice(report, source.stat().st_size)

    def test_a_plot3d_grid_with_a_boundary_layer(self):
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
        self.of_at_most_twice(report, grid.stat().st_size + solution.stat().st_size)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1] + sys.argv[2:], verbosity=1)
