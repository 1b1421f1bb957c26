/// Copies an OpenVDB grid in memory into a volume that a hand can feel. No other public header
/// includes OpenVDB headers.
#pragma once

#include <memory>

#include <openvdb/Grid.h>

#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Checks and prepares a grid for VolumeSpec::volume, as loadVolume does for a grid of a file. The
/// grid's own world space takes the place of the file's world space. The function copies the grid
/// and does not change it. During the call other threads may read the grid but must not write to
/// it. Throws VolumeError, with the grid's name, if the grid is not usable as a volume. Slow: reads
/// every value.
[[nodiscard]] std::shared_ptr<const Volume> makeVolume(const openvdb::GridBase& grid,
                                                       const LoadOptions& options = {});

}  // namespace palpate
