#!/usr/bin/env python3
"""Compares palpate-import with ITK (and GDCM, ITK's reader of DICOM): oracle_test.py BIN_DIR ITK_ORACLE. The files are
written by ITK or by this test, or are Debian's image of a head. At and between voxels both programs must give the same
values."""
import csv
import io
import sys
import unittest
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import dicom_test  # noqa: E402
import images_test  # noqa: E402

sys.path.append(str(Path(__file__).resolve().parents[2] / "support"))
import process  # noqa: E402
import suite  # noqa: E402

ORACLE = Path(sys.argv[2])
HEAD = Path("/usr/share/mricron/templates/ch2bet.nii.gz")


class BesideItk(images_test.Case):
    def agrees(self, path, *, within=1e-5):
        """Compares palpate's values with ITK's at the points that ITK sampled. `within` is relative to their range."""
        done = process.run([str(ORACLE), "read", str(path)], capture_output=True, text=True,
                              timeout=120)
        self.assertEqual((done.returncode, done.stderr), (0, ""), path)
        theirs = list(csv.DictReader(io.StringIO(done.stdout)))
        places = [tuple(float(row[k]) for k in "xyz") for row in theirs]
        ours = self.sample(self.convert(path), "density", places)
        values = [float(row["value"]) for row in theirs]
        span = max(values) - min(values)
        self.assertGreater(span, 0)
        self.assertEqual(len(ours), len(places))
        for place, value, row in zip(places, values, ours):
            self.assertLessEqual(abs(float(row["value"]) - value), within * span,
                                 (path.name, place))

    def itk_writes(self, name):
        path = self.dir / name
        process.run([str(ORACLE), "write", str(path)], check=True, timeout=120,
                       capture_output=True)  # GDCM reports the values that it fills in
        return path

    def test_files_that_itk_writes_are_read_as_itk_reads_them(self):
        for name in ("a.nrrd", "a.nhdr", "a.mha", "a.mhd", "a.nii", "a.nii.gz", "dicom"):
            with self.subTest(name):
                self.agrees(self.itk_writes(name))

    def test_files_that_this_test_writes_are_read_as_itk_reads_them(self):
        # ITK does not support shear.
        straight = "space directions: (0,3,0) (-2,0,0) (0,0,4)"
        for name, *contents in (
                ("lps.nrrd", images_test.nrrd("space: left-posterior-superior", straight,
                                              images_test.ORIGIN), "\n", images_test.SHORTS),
                ("ras.nrrd", images_test.nrrd("space: right-anterior-superior", straight,
                                              images_test.ORIGIN), "\n", images_test.SHORTS),
                ("a.mha", images_test.meta(*images_test.MetaImage.PLACED,
                                           "AnatomicalOrientation = RAI"), images_test.SHORTS),
                ("unnamed.mha", images_test.meta(*images_test.MetaImage.PLACED), images_test.SHORTS),
                ("q.nii", images_test.nifti(images_test.SIZE, *images_test.SHORT, qfac=-1.0,
                                            pixdim=(1, 2, 3)), images_test.SHORTS),
                ("s.nii", images_test.nifti(
                    images_test.SIZE, *images_test.SHORT, pixdim=(3, 2, 4), slope=0.5, inter=3.0,
                    sform=((0, -2, 0, 10), (3, 0, 0, -20), (0, 0, 4, 30))), images_test.SHORTS)):
            with self.subTest(name):
                self.agrees(self.write(name, *contents))

    def test_dicom_series_that_this_test_writes_are_read_as_itk_reads_them(self):
        turn = dicom_test.turned(0.2, -0.15, 0.1)
        axes = [[sum(turn[a][b] * v[b] for b in range(3)) for a in range(3)]
                for v in ((0, 1, 0), (0, 0, -1))]
        for name, volume in (("axial", dicom_test.Volume()),
                             ("oblique", dicom_test.Volume(row=axes[0], column=axes[1]))):
            with self.subTest(name):
                self.agrees(volume.write(self.dir / name))

    @unittest.skipUnless(HEAD.exists(), "mricron-data is not installed")
    def test_a_head_is_read_as_itk_reads_it(self):
        self.agrees(HEAD)


if __name__ == "__main__":
    suite.main(sys.argv[3:])
