/// An axial CT image as the header of a DICOM file, for tests of series.
#pragma once

#include "palpate/scenes/apps/import/dicom_header.h"

namespace palpate::test {

/// Returns a CT file with one image of 4 x 3 pixels of 0.5 x 0.8 mm, at z = 2 k mm. Path, series
/// and times are not set.
inline importer::File axialImage(int k) {
  importer::File file;
  file.is_image = true;
  file.modality = "CT";
  importer::Slice slice;
  slice.format = {3, 4, 16, 12, 1};
  slice.placed = true;
  slice.position = {10.0, 20.0, 2.0 * k};
  slice.row = Vec3::UnitX();
  slice.column = Vec3::UnitY();
  slice.across = 0.5;
  slice.down = 0.8;
  slice.times.fill(importer::kUnsaid);
  file.slices = {slice};
  return file;
}

}  // namespace palpate::test
