#pragma once

#include <string>

#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

struct LevelSet {
  openvdb::FloatGrid::Ptr grid;
  /// True if the material has values above the iso-value; false if below.
  bool solid_above = true;
  /// Distance to the isosurface of the original's trilinear interpolation [voxels], to first order.
  double rms_error = 0.0;
  double p99_error = 0.0;
  std::uint64_t crossings = 0;
  /// Fraction of the original surface in places that are thinner than the voxels.
  double lost = 0.0;
};

/// Returns the level set of the isosurface at `iso`: the signed distance within three voxels on
/// each side. Voxels are cubes with edge `voxel`; 0: the smallest edge of the grid's voxels. The
/// background, which surrounds the object, is outside.
///
/// Takes the signs from the values, so that cavities stay hollow. Throws VolumeError if no surface
/// has this value, if the whole surface is thinner than the voxels, or if there would be too many
/// voxels.
[[nodiscard]] LevelSet levelSetOf(const openvdb::FloatGrid& grid, double iso, double voxel,
                                  const std::string& file, const Progress& progress);

}  // namespace palpate::importer
