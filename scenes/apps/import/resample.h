#pragma once

#include <cstdint>

#include "palpate/scenes/apps/import/grids.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Errors of trilinear interpolation after resampling, divided by the range of the values. The
/// reference is the mesh's own interpolation at random points, or the values of the image's voxels.
struct ResamplingError {
  double rms = 0.0;
  double largest = 0.0;
  std::uint64_t points = 0;  ///< Number of compared points; for a mesh, those whose 8 surrounding
                             ///< voxels all have data.
  /// Errors at points of a mesh at which only some of the 8 surrounding voxels have data. These
  /// errors depend on the background too.
  double edge_rms = 0.0;
  double edge_largest = 0.0;
  std::uint64_t edge_points = 0;
  /// Number of points in the mesh whose surrounding voxels all lack data.
  std::uint64_t lost_points = 0;
};

struct Resampled {
  Gridded made;
  ResamplingError error;
};

/// Returns the errors of gridOnCubes, at up to 200,000 voxels of the image.
[[nodiscard]] ResamplingError errorOf(const Piece& image, const Array& array, const Gridded& made);

}  // namespace palpate::importer
