/// Grids of .vdb files: what is in them, and loading one so that it can be felt.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "engine/field.h"
#include "engine/types.h"

namespace palpate {

/// What the values of a grid mean, as its metadata say.
enum class GridClass : std::uint8_t { kUnknown, kLevelSet, kFog, kStaggered };

/// One grid of a file, as `palpate info` prints it. "File" means the file's own world space.
struct GridInfo {
  std::string name;  ///< Unique in the file: grids of equal name are density[0], density[1].
  std::string type;  ///< OpenVDB's: float, double, vec3s, vec3d, ...
  GridClass grid_class = GridClass::kUnknown;
  bool vector = false;
  bool half = false;                ///< Stored in 16 bits, read as 32.
  Vec3 voxel = Vec3::Zero();        ///< Edges of a voxel, file.
  std::uint64_t active_voxels = 0;  ///< Active tiles counted by their voxels.
  Box bounds;                       ///< Of the active voxels' centres, file. Empty if none.
  std::uint64_t memory = 0;         ///< [bytes]
  double lowest = 0.0;              ///< Of the active values, magnitudes for a vector grid.
  double highest = 0.0;
  double mean = 0.0;
  double background = 0.0;       ///< Magnitude for a vector grid.
  std::uint64_t non_finite = 0;  ///< NaN, infinite or above 1e100: voxels, tiles, background.
  std::string refusal;           ///< "why: remedy" if it cannot be felt, else empty.
};

/// One grid in memory, const after loading, shared by its placements and by all threads.
class Volume {
 public:
  struct Grid;  ///< OpenVDB's; see samplers/vdb_field.cpp.

  Volume(GridInfo info, std::unique_ptr<const Grid> grid);
  Volume(const Volume&) = delete;
  Volume& operator=(const Volume&) = delete;
  /// Frees the grid: milliseconds. Never let the haptic thread drop the last reference.
  ~Volume();

  [[nodiscard]] const GridInfo& info() const noexcept { return info_; }
  [[nodiscard]] const Grid& grid() const noexcept { return *grid_; }

 private:
  GridInfo info_;
  std::unique_ptr<const Grid> grid_;
};

/// True for a readable file that begins as a .vdb does.
[[nodiscard]] bool isVdb(const std::filesystem::path& file) noexcept;

/// The names of a file's grids, in the file's order. Throws as describeGrids.
[[nodiscard]] std::vector<std::string> gridNames(const std::filesystem::path& file);

/// Reads all grids of a file and describes each. Throws VolumeError for a file that is missing,
/// truncated, damaged or not .vdb. Grids of types that cannot be felt are described by their
/// metadata, their trees are not read. Slow: reads everything else, nothing is delayed.
[[nodiscard]] std::vector<GridInfo> describeGrids(const std::filesystem::path& file);

/// Loads one grid. Throws VolumeError for what describeGrids refuses, for a name that is not there
/// (the nearest is suggested) and for a grid that cannot be felt: points and other types than
/// scalar and vector floats, frustum or singular maps, no active voxel, non-finite values.
/// @param grid  Its name; empty takes the only grid of the file.
[[nodiscard]] std::shared_ptr<const Volume> loadVolume(const std::filesystem::path& file,
                                                       const std::string& grid);

/// "level set", "fog volume", "staggered" or "unknown".
[[nodiscard]] const char* wordFor(GridClass grid_class) noexcept;

}  // namespace palpate
