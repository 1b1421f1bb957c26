/// Private to samplers and scenes: makes the input of writeBricks from a grid that a process group
/// holds in parts.
#pragma once

#include <openvdb/Grid.h>

#include "palpate/samplers/bricks/write_bricks.h"

namespace palpate {

/// Returns one rank's part of a grid as input of writeBricks. A process group (ProcessGroup) holds
/// the grid in parts and writes the bricks together. The part consists of the bricks in the rank's
/// share (BrickInput::share) and of two more voxels around them, as leaves without tiles. It may be
/// empty if the part of another rank is not. All ranks must call this function. Except for `fill`
/// and `share`, the result describes the whole grid, and equals that of brickInput for the whole
/// grid. The function does not copy the part: do not write to the part afterwards. Throws
/// VolumeError with the grid's name if the volume cannot be used. Slow: reads every value.
[[nodiscard]] BrickInput brickInput(const openvdb::GridBase::Ptr& part, ProcessGroup& group,
                                    const Share& share);

}  // namespace palpate
