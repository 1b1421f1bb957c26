/// Copies an OpenVDB grid into a volume. No other public header includes OpenVDB headers.
#pragma once

#include <memory>

#include <openvdb/Grid.h>

#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Name of the boolean metadata of a grid from an image with missing voxels. In such a grid, only
/// the missing voxels in the box of the active voxels are inactive. A place whose value would read
/// an inactive voxel in the box has no data.
inline constexpr const char* kMetaInactiveIsMissing = "inactive_is_missing";

/// Name of the text metadata that states the importer's input for a grid: "image" or "mesh".
/// Inactive voxels of a grid from a mesh have no data.
inline constexpr const char* kMetaImportedFrom = "imported_from";

/// Copies and prepares a grid for VolumeSpec::volume, as loadVolume does. The grid's world space
/// takes the place of the file's. During the call other threads may read the grid but must not
/// write to it. Throws VolumeError, with the grid's name, if the grid is unusable. Slow: reads
/// every value.
[[nodiscard]] std::shared_ptr<const Volume> makeVolume(const openvdb::GridBase& grid,
                                                       const LoadOptions& options = {});

}  // namespace palpate
