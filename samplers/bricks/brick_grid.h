/// Private to samplers and scenes: input of writeBricks from a grid whose voxels are made on
/// request.
#pragma once

#include <cstddef>
#include <functional>
#include <vector>

#include <openvdb/Grid.h>

#include "palpate/samplers/bricks/write_bricks.h"

namespace palpate {

/// Makes a grid that has the voxels of a box, as leaves without tiles. Thread-safe.
using GridBox = std::function<openvdb::GridBase::Ptr(const openvdb::CoordBBox& box)>;

/// A grid of leaves without tiles, which are made on request, so that they need not be in memory
/// together.
struct GridParts {
  /// Name, class, type, transform, background and metadata of the grid, without its voxels.
  openvdb::GridBase::Ptr grid;
  openvdb::CoordBBox box;  ///< Box of all voxels.
  /// Consecutive parts of the grid: indices of the bricks along the last axis (BrickInput::share).
  /// In a process group, those of this rank.
  std::vector<Share> shares;
  /// Prepares shares[part]. The result makes boxes in these bricks and two voxels around them. It
  /// is used only until the next call.
  std::function<GridBox(std::size_t part)> open;
};

/// Returns a grid as input of writeBricks. All ranks of the group must call this function. Except
/// for `fill`, `share`, `parts` and `open`, the result equals brickInput of the whole grid in
/// memory. Throws VolumeError, with the grid's name, if the volume is unusable. Slow: makes every
/// voxel. Memory: 24 bytes for each leaf, and in a group again as much.
[[nodiscard]] BrickInput brickInput(const GridParts& parts, ProcessGroup& group);

}  // namespace palpate
