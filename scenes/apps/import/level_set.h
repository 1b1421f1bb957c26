/// Makes a level set from a surface of a scalar grid: `--iso`.
#pragma once

#include <string>

#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

struct LevelSet {
  openvdb::FloatGrid::Ptr grid;
  bool solid_above = true;  ///< Solid is where the values are above the iso-value, else below.
  /// Distance between its surface and the iso-surface of the original's trilinear interpolation, to
  /// first order, at the edges that cross it [voxels].
  double rms_error = 0.0;
  double p99_error = 0.0;
  std::uint64_t crossings = 0;
  double lost = 0.0;  ///< Share of the original's surface that is thinner than the voxels.
};

/// Returns the distance to the surface `iso`, three voxels to each side, on cubes of edge `voxel`.
/// If `voxel` is 0, the edge is the smallest of the grid's. The background, which surrounds the
/// object, is outside. Uses OpenVDB's surface extraction and its distance from a surface. The signs
/// come from the values, so that cavities stay hollow. Throws VolumeError if no surface has this
/// value, if all of it is thinner than the voxels, or if the voxels are too many.
/// @param voxel  Edge of the cubes, in the file's unit, or 0.
[[nodiscard]] LevelSet levelSetOf(const openvdb::FloatGrid& grid, double iso, double voxel,
                                  const std::string& file, const Progress& progress);

}  // namespace palpate::importer
