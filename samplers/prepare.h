/// Private to samplers: from a grid as it was read to one that can be felt. Include it in .cpp
/// files only.
#pragma once

#include <memory>
#include <string>

#include "palpate/samplers/volume_grid.h"

namespace palpate {

/// A grid, what is to be said of it, and what makes up its Volume.
struct Prepared {
  GridInfo info;
  std::unique_ptr<Volume::Grid> grid;
};

/// Reads the leaves that are still on disk, in parallel, and looks at every value on the way; then
/// fills, smooths, turns local vectors into the file's world space and takes staggered ones apart,
/// as `options` and the grid ask. What cannot be felt has a refusal. Throws VolumeError for a
/// filter that does not work on the grid.
[[nodiscard]] Prepared prepare(const std::string& name, const openvdb::GridBase::Ptr& grid,
                               const LoadOptions& options);

/// The same at once to a volume; throws VolumeError with what it refuses. For a grid that is nobody
/// else's.
/// @param called  What it is called in errors.
[[nodiscard]] std::shared_ptr<const Volume> preparedVolume(const std::string& name,
                                                           const openvdb::GridBase::Ptr& grid,
                                                           const std::string& called,
                                                           const LoadOptions& options = {});

/// Three scalars as the x, y and z of a vector.
[[nodiscard]] Prepared join(const std::string& name, std::array<Prepared, 3> components);

}  // namespace palpate
