/// Private to samplers and scenes: input of writeBricks from a grid in a process group.
#pragma once

#include <openvdb/Grid.h>

#include "palpate/samplers/bricks/write_bricks.h"

namespace palpate {

/// Returns one rank's part of a grid as input of writeBricks. All ranks must call this function.
/// The part consists of the bricks in the rank's share (BrickInput::share) and two more voxels
/// around them, as leaves without tiles. A part may be empty if another rank's part is not. Except
/// for `fill` and `share`, the result equals brickInput of the whole grid. The part is not copied:
/// do not write to it afterwards. Throws VolumeError, with the grid's name, if the volume is
/// unusable. Slow: reads every value.
[[nodiscard]] BrickInput brickInput(const openvdb::GridBase::Ptr& part, ProcessGroup& group,
                                    const Share& share);

}  // namespace palpate
