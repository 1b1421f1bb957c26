#pragma once

#include <cstdint>

#include "palpate/scenes/apps/import/grids.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Errors of resampling, divided by the range of the values. They compare trilinear interpolation
/// with the mesh's own, at random places, or with an image's values, at its voxels.
struct ResamplingError {
  double rms = 0.0;
  double largest = 0.0;
  std::uint64_t points = 0;  ///< Number of places where all 8 surrounding voxels have data.
  /// Errors in the outermost voxel of a mesh, where the interpolation also reads the background.
  double edge_rms = 0.0;
  double edge_largest = 0.0;
  std::uint64_t edge_points = 0;
  /// Number of places in the mesh where no surrounding voxel has data.
  std::uint64_t lost_points = 0;
};

struct Resampled {
  Gridded made;
  ResamplingError error;
};

/// Returns the errors of gridOnCubes, at up to 200,000 voxels of the image.
[[nodiscard]] ResamplingError errorOf(const Piece& image, const Array& array, const Gridded& made);

}  // namespace palpate::importer
