/// Finds the cells of a level set in which missing data interrupt the surface.
#pragma once

#include <cstdint>
#include <optional>

#include "palpate/engine/scene/graph.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Result of findOpenCells.
struct OpenCells {
  std::uint64_t count = 0;  ///< Number of open cells.
  /// Number of cells that contain the level. Cells without an active corner count only if open.
  std::uint64_t surface = 0;
  /// Lowest corner of the first open cell, in the file's world space; zero if `count` is 0.
  Vec3 first_F = Vec3::Zero();
};

/// Counts the open cells of the surface V = level of a level set. A cell is open under three
/// conditions. Its corners are on both sides of the level. makeVdbField has no data there
/// (ScalarSample::inside). The cell has an active corner, or shares a corner with a surface cell
/// that has data and both active and inactive corners. In an open cell, modes add no primitives.
/// Grids of other classes have no open cells.
///
/// Does not search the faces of active tiles with edges of more than 128 voxels. Parallel over
/// leaves. Cost: about 15 reads per active voxel.
/// @param solid  Side of the level that is solid.
/// @return       std::nullopt unless `volume` is a scalar that is read trilinearly.
[[nodiscard]] std::optional<OpenCells> findOpenCells(const Volume& volume, const Sampling& sampling,
                                                     double level, Solid solid);

}  // namespace palpate
