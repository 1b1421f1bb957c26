/// A Gaussian over an image's array, before it becomes a grid.
#pragma once

#include <string>

#include "palpate/scenes/import/reader.h"
#include "palpate/scenes/import/shared.h"

namespace palpate::importer {

struct Smoothed {
  double rms_change = 0.0;
  double range = 0.0;  ///< Highest minus lowest, of a vector its longest.
};

/// Replaces the array by its smoothed floats: along i, j and k in turn, to three standard
/// deviations; at the image's edge the part of the Gaussian that lies within it, as a whole. Takes
/// one copy and a few lines. Throws VolumeError where values are not finite or hidden: they would
/// spread.
///
/// Of an image that others have other slices of: right, as of the whole, in those slices about
/// which smoothingReach() more are held; the changes are told of the crew's own together.
/// @param width  Standard deviation, in the file's units.
[[nodiscard]] Smoothed smoothImage(const Piece& image, Array& array, double width,
                                   const std::string& file, const Progress& progress = nullptr);
[[nodiscard]] Smoothed smoothImage(const Piece& image, Array& array, double width,
                                   const std::string& file, const Progress& progress,
                                   const Shared& shared);

/// How many slices on each side of one it looks at, in an image of that place with so many.
[[nodiscard]] std::size_t smoothingReach(const Affine& file_from_index, int slices, double width);

}  // namespace palpate::importer
