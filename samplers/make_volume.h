/// A grid that a program already has, as a volume that can be felt. The one public header that
/// includes OpenVDB's.
#pragma once

#include <memory>

#include <openvdb/Grid.h>

#include "palpate/samplers/volume.h"
#include "palpate/samplers/write_bricks.h"

namespace palpate {

/// Checked and prepared as a file's (loadVolume), whose world space is the grid's own; for
/// VolumeSpec::volume. The grid is copied and left as it is: another thread may read it meanwhile,
/// none may write to it. Throws VolumeError, by the grid's name, where it cannot be felt. Slow:
/// looks at every value.
[[nodiscard]] std::shared_ptr<const Volume> makeVolume(const openvdb::GridBase& grid,
                                                       const LoadOptions& options = {});

/// One rank's part of a grid that a crew has in parts, to be written in bricks by all of them: what
/// lies in the bricks of its share (BrickInput::share) with two voxels more about them, in leaves,
/// without tiles. May be empty, where another's is not. All of the crew call it; what it gives but
/// for `fill` and `share` is of the whole, and the same as of one grid. The part is not copied:
/// nobody may write to it from here on. Throws VolumeError, by the grid's name, where it cannot be
/// felt. Slow: looks at every value.
[[nodiscard]] BrickInput brickInput(const openvdb::GridBase::Ptr& part, Crew& crew,
                                    const Share& share);

}  // namespace palpate
