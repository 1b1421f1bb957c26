/// Private to samplers and scenes: the parts of a process group's grid as input of writeBricks.
#pragma once

#include <openvdb/Grid.h>

#include "palpate/samplers/bricks/write_bricks.h"

namespace palpate {

/// Returns one rank's part of a grid as input of writeBricks. A process group (ProcessGroup) holds
/// the grid in parts and writes the bricks together. The part holds the bricks of the rank's share
/// (BrickInput::share) and two more voxels around them, as leaves, without tiles. It may be empty
/// if another rank's part is not. All ranks call this function. The result except `fill` and
/// `share` describes the whole grid and is the same as for one grid. The part is not copied: do not
/// write to it afterwards. Throws VolumeError with the grid's name if the volume cannot be used.
/// Slow: reads every value.
[[nodiscard]] BrickInput brickInput(const openvdb::GridBase::Ptr& part, ProcessGroup& group,
                                    const Share& share);

}  // namespace palpate
