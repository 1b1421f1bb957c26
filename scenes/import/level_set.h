/// A surface of a scalar grid as a level set of its own: `--iso`.
#pragma once

#include <string>

#include "palpate/samplers/openvdb_grids.h"
#include "palpate/scenes/import/reader.h"

namespace palpate::importer {

struct LevelSet {
  openvdb::FloatGrid::Ptr grid;
  bool solid_above = true;  ///< Solid is where the values are above the iso-value, else below.
  /// Distance between its surface and the iso-surface of the original's trilinear interpolation,
  /// to first order, where its edges cross it [voxels].
  double rms_error = 0.0;
  double p99_error = 0.0;
  std::uint64_t crossings = 0;
  double lost = 0.0;  ///< Share of the original's surface that is thinner than the voxels.
};

/// The distance to the surface `iso`, three voxels to each side, on cubes of `voxel`, the smallest
/// edge of the grid's if 0. What surrounds the object, the background, is outside. By OpenVDB's
/// surface extraction and its distance from a surface; the signs are those of the values, so that
/// cavities stay hollow. Throws VolumeError if no surface has this value, if all of it is thinner
/// than the voxels, or if these are too many.
/// @param voxel  In the file's unit.
[[nodiscard]] LevelSet levelSetOf(const openvdb::FloatGrid& grid, double iso, double voxel,
                                  const std::string& file, const Progress& progress);

}  // namespace palpate::importer
