/// A grid that a program already has, as a volume that can be felt. The one public header that
/// includes OpenVDB's.
#pragma once

#include <memory>

#include <openvdb/Grid.h>

#include "palpate/samplers/volume.h"

namespace palpate {

/// Checked and prepared as a file's (loadVolume), whose world space is the grid's own; for
/// VolumeSpec::volume. The grid is copied and left as it is: another thread may read it meanwhile,
/// none may write to it. Throws VolumeError, by the grid's name, where it cannot be felt. Slow:
/// looks at every value.
[[nodiscard]] std::shared_ptr<const Volume> makeVolume(const openvdb::GridBase& grid,
                                                       const LoadOptions& options = {});

}  // namespace palpate
