#pragma once

#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/resample.h"

namespace palpate::importer {

/// Replaces the slices at Piece::depths by slices at 0, 1, 2, ..., by linear interpolation between
/// two slices with data. Without `depths`, returns errors of 0. All slices must be in memory. The
/// values become floats in new memory.
/// @return  Differences between the resampled array and the slices of the file, at up to 200,000
///          points, divided by the range of the values.
ResamplingError evenSlices(Piece& image, Array& array);

}  // namespace palpate::importer
