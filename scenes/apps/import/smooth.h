/// Smooths an image's array with a Gaussian, before it becomes a grid.
#pragma once

#include <string>

#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/shared.h"

namespace palpate::importer {

struct Smoothed {
  double rms_change = 0.0;
  double range = 0.0;  ///< Highest minus lowest value; of vectors the longest.
};

/// Replaces the array by its smoothed floats, along i, j and k in turn, to three standard
/// deviations. At the image's edge the part of the Gaussian inside the image is normalised to 1.
/// Takes one copy and a few lines of memory. Throws VolumeError if values are not finite or are
/// hidden: smoothing would spread them.
///
/// In a process group, slices are correct if smoothingReach() more on each side are held. The
/// changes are those of all ranks' own slices together.
/// @param width  Standard deviation, in the file's units.
[[nodiscard]] Smoothed smoothImage(const Piece& image, Array& array, double width,
                                   const std::string& file, const Progress& progress = nullptr);
[[nodiscard]] Smoothed smoothImage(const Piece& image, Array& array, double width,
                                   const std::string& file, const Progress& progress,
                                   const Shared& shared);

/// Returns how many slices the filter reads on each side, for an image with this map and `slices`.
[[nodiscard]] std::size_t smoothingReach(const Affine& file_from_index, int slices, double width);

}  // namespace palpate::importer
