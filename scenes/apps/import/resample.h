/// Grids of cubes, and their errors against the meshes and images that they were made from.
#pragma once

#include <cstdint>

#include "palpate/scenes/apps/import/grids.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Errors of resampling, relative to the range of the values. A mesh's own interpolation is
/// compared with the trilinear one of the grid at random places in the mesh; an image at its
/// voxels.
struct ResamplingError {
  double rms = 0.0;
  double largest = 0.0;
  std::uint64_t points = 0;  ///< Places where all 8 voxels around have data.
  /// The same errors beside voxels without data, where the grid gives the background: at the edge
  /// of the mesh, in the outermost voxel.
  double edge_rms = 0.0;
  double edge_largest = 0.0;
  std::uint64_t edge_points = 0;
  std::uint64_t lost_points = 0;  ///< Places in the mesh without data in any voxel around.
};

struct Resampled {
  Gridded made;
  ResamplingError error;
};

/// Returns the errors of gridOnCubes at up to 200,000 of the image's own voxels.
[[nodiscard]] ResamplingError errorOf(const Piece& image, const Array& array, const Gridded& made);

}  // namespace palpate::importer
