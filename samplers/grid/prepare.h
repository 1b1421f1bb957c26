/// Private to samplers: turns a grid as it was read into one that can be felt. Include it in .cpp
/// files only.
#pragma once

#include <memory>
#include <string>

#include "palpate/samplers/grid/volume_grid.h"

namespace palpate {

/// A prepared grid: its description, and the data of its Volume.
struct Prepared {
  GridInfo info;
  std::unique_ptr<Volume::Grid> grid;
};

/// Reads the leaves that are still on disk, in parallel, and checks every value. Then fills,
/// smooths, turns local vectors into the file's world space and splits staggered ones, as `options`
/// and the grid require. A grid that cannot be felt gets a refusal. Throws VolumeError for a filter
/// that does not work on the grid.
[[nodiscard]] Prepared prepare(const std::string& name, const openvdb::GridBase::Ptr& grid,
                               const LoadOptions& options);

/// Prepares a grid and makes a volume of it. Throws VolumeError with the refusal, if any. Only the
/// caller may use the grid.
/// @param called  The grid's name in errors.
[[nodiscard]] std::shared_ptr<const Volume> preparedVolume(const std::string& name,
                                                           const openvdb::GridBase::Ptr& grid,
                                                           const std::string& called,
                                                           const LoadOptions& options = {});

/// Joins three scalars as the x, y and z of a vector.
[[nodiscard]] Prepared join(const std::string& name, std::array<Prepared, 3> components);

}  // namespace palpate
