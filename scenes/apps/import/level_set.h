#pragma once

#include <string>

#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

struct LevelSet {
  openvdb::FloatGrid::Ptr grid;
  /// True if the solid is above the iso-value; false if below.
  bool solid_above = true;
  /// Distance of the level set's surface from the isosurface of the original, trilinearly
  /// interpolated values [voxels], to first order: root mean square, and 99th percentile
  /// (`p99_error`).
  double rms_error = 0.0;
  double p99_error = 0.0;
  std::uint64_t crossings = 0;
  /// Fraction of the original surface that is lost, in parts thinner than a voxel.
  double lost = 0.0;
};

/// Returns the level set of the isosurface at `iso`: the signed distance up to three voxels on each
/// side. Voxels are cubes with edge `voxel`; 0: the smallest edge of the grid's voxels. The side
/// with the background is outside.
///
/// The signs come from the values, so that cavities stay hollow. Throws VolumeError if there is no
/// such surface, if the whole solid is thinner than the voxels, or if the surface needs too many
/// voxels.
/// @param may_be_empty  True: without a surface, returns a level set without active voxels.
[[nodiscard]] LevelSet levelSetOf(const openvdb::FloatGrid& grid, double iso, double voxel,
                                  const std::string& file, const Progress& progress,
                                  bool may_be_empty = false);

}  // namespace palpate::importer
