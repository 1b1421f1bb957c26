/// Curvilinear and unstructured meshes become grids of cubes: voxels outside the mesh stay
/// inactive.
#pragma once

#include <string>
#include <vector>

#include "palpate/scenes/import/grids.h"
#include "palpate/scenes/import/pieces.h"

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

/// Half the edge of the median cell: the cube of as much volume. Not more than 512 voxels along the
/// longest side of the mesh, and not less than 32; a 64th of that side where no cell has volume. In
/// the file's unit.
[[nodiscard]] double suggestVoxel(const Piece& mesh);

/// All arrays of a mesh at once, on the same voxels: the first at the lowest corner of its bounds,
/// each with the interpolation of the mesh's own cell that holds it (VTK's). Works leaf by leaf in
/// parallel; besides the mesh it takes VTK's cell locator and the grids. Throws VolumeError for a
/// voxel that would make too many of them.
[[nodiscard]] std::vector<Resampled> resampleMesh(const Piece& mesh, double voxel,
                                                  const std::string& file,
                                                  const Progress& progress);

/// What gridOnCubes changed: at up to 200,000 of the image's own voxels.
[[nodiscard]] ResamplingError errorOf(const Piece& image, const Array& array, const Gridded& made);

}  // namespace palpate::importer
