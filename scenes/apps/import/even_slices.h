/// Resamples images with changing distances between their slices.
#pragma once

#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/resample.h"

namespace palpate::importer {

/// Replaces the slices at Piece::depths by slices at 0, 1, 2, ..., and clears `depths`.
///
/// Values are interpolated linearly between two slices. A value has no data if one of the two has
/// no data. If the image has no `depths`, the function returns errors of 0. All slices must be
/// in memory. The values become floats in new memory.
/// @return  Differences between the resampled array and the slices of the file, at up to 200,000
///          points, divided by the range of the values.
ResamplingError evenSlices(Piece& image, Array& array);

}  // namespace palpate::importer
