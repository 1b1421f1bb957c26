#pragma once

#include <string>

#include "palpate/samplers/grid/volume.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/shared.h"

namespace palpate::importer {

struct Smoothed {
  double rms_change = 0.0;
  double range = 0.0;  ///< Highest minus lowest smoothed value; for vectors, largest length.
};

/// Converts the array to floats, and smooths it along i, j and k in turn with a Gaussian that is
/// cut off at three standard deviations. At the image's edges, the weights are scaled to the sum 1.
/// Needs memory for one copy. Throws VolumeError for hidden values, and for values that are not
/// finite.
///
/// In a process group, a rank's slices are correct only if smoothingReach() more slices on each
/// side are in memory. The returned changes are those of all ranks.
/// @param width  Standard deviation. A width in the file's unit is the same length on each axis.
[[nodiscard]] Smoothed smoothImage(const Piece& image, Array& array, const SmoothWidth& width,
                                   const std::string& file, const Progress& progress = nullptr);
[[nodiscard]] Smoothed smoothImage(const Piece& image, Array& array, const SmoothWidth& width,
                                   const std::string& file, const Progress& progress,
                                   const Shared& shared);

/// Returns the number of slices that the filter reads on each side of a slice, for an image with
/// this transform and `slices` slices.
[[nodiscard]] std::size_t smoothingReach(const Affine& file_from_index, int slices,
                                         const SmoothWidth& width);

}  // namespace palpate::importer
