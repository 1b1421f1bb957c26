/// Private to samplers, for .cpp files only: converts a grid as read into one that fields can use.
#pragma once

#include <memory>
#include <string>

#include "palpate/samplers/grid/volume_grid.h"

namespace palpate {

/// Value of GridInfo::refusal for a grid without active voxels.
inline constexpr const char* kNoActiveVoxel =
    "it has no active voxel: write the grid with its values active";

struct Prepared {
  GridInfo info;
  std::unique_ptr<Volume::Grid> grid;
};

/// Reads the leaves that are still on disk, in parallel, and checks every value. Where needed,
/// fills unusable values, smooths, converts local vectors to the file's world space, and splits
/// staggered grids. info.refusal states why a grid is unusable. Throws VolumeError if the grid
/// cannot be smoothed as requested.
[[nodiscard]] Prepared prepare(const std::string& name, const openvdb::GridBase::Ptr& grid,
                               const LoadOptions& options);

/// Prepares a grid and makes a volume from it. Throws VolumeError with GridInfo::refusal if the
/// grid is unusable. The caller must be the only user of the grid.
/// @param called  Name of the grid in error messages.
[[nodiscard]] std::shared_ptr<const Volume> preparedVolume(const std::string& name,
                                                           const openvdb::GridBase::Ptr& grid,
                                                           const std::string& called,
                                                           const LoadOptions& options = {});

/// Combines three scalars as the x, y and z components of a vector.
[[nodiscard]] Prepared join(const std::string& name, std::array<Prepared, 3> components);

}  // namespace palpate
