/// Finds the cells of a level set at which a surface leaves the data.
#pragma once

#include <cstdint>
#include <optional>

#include "palpate/engine/scene/graph.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Result of findOpenCells.
struct OpenCells {
  std::uint64_t count = 0;      ///< Number of open cells.
  Vec3 first_F = Vec3::Zero();  ///< Lowest corner of the first open cell; file space.
};

/// Counts the open cells of the surface V = level. A cell of a level set is open if its corners are
/// on both sides of the level and some corners are inactive. The surface leaves its data there, and
/// the force of a hand on it ends in one tick. Other grids have no open cells.
///
/// The search skips surfaces across faces of active tiles with edges of more than 128 voxels.
/// @return  Empty unless `volume` is a scalar that is read trilinearly.
/// Parallel over leaves: about 15 reads per active voxel.
[[nodiscard]] std::optional<OpenCells> findOpenCells(const Volume& volume, const Sampling& sampling,
                                                     double level, Solid solid);

}  // namespace palpate
