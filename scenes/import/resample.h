/// Grids of cubes, and what they are short of of the meshes and images that they were made from.
#pragma once

#include <cstdint>

#include "palpate/scenes/import/grids.h"
#include "palpate/scenes/import/reader.h"

namespace palpate::importer {

/// What resampling changed: at random places anywhere in a mesh, its own interpolation against the
/// trilinear one of the grid, relative to the range of the values; of an image, at its voxels.
struct ResamplingError {
  double rms = 0.0;
  double largest = 0.0;
  std::uint64_t points = 0;  ///< Where all 8 voxels about them have data.
  /// The same beside voxels without data, where the background is read for these: at the edge of
  /// the mesh, in the outermost voxel.
  double edge_rms = 0.0;
  double edge_largest = 0.0;
  std::uint64_t edge_points = 0;
  std::uint64_t lost_points = 0;  ///< In the mesh, and no voxel about them has data.
};

struct Resampled {
  Gridded made;
  ResamplingError error;
};

/// What gridOnCubes changed: at up to 200,000 of the image's own voxels.
[[nodiscard]] ResamplingError errorOf(const Piece& image, const Array& array, const Gridded& made);

}  // namespace palpate::importer
