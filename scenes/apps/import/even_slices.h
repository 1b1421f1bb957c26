#pragma once

#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/resample.h"

namespace palpate::importer {

/// Resamples the slices at Piece::depths to 0, 1, 2, ..., by linear interpolation between two
/// slices. A value is NaN if one of its slices has no data there. All slices must be in memory. The
/// values become floats in new memory. If `depths` is empty, changes nothing and returns errors of
/// 0.
/// @return  Differences between the resampled array and the file's slices, at up to 200,000 points,
///          divided by the range of the values.
ResamplingError evenSlices(Piece& image, Array& array);

}  // namespace palpate::importer
