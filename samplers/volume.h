/// Grids of .vdb files: what is in them, and loading one so that it can be felt.
#pragma once

#include <cstdint>
#include <exception>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "palpate/engine/field.h"
#include "palpate/engine/types.h"

namespace palpate {

/// What the values of a grid mean, as its metadata say.
enum class GridClass : std::uint8_t { kUnknown, kLevelSet, kFog, kStaggered };

/// What smoothing at load took away.
struct Smoothing {
  int width = 0;                    ///< Of the filter's boxes, voxels to each side; 0: none.
  double rms_change = 0.0;          ///< Of the active values.
  double largest_change = 0.0;      ///< Of the active values.
  double half_height_voxels = 0.0;  ///< Waves of this length keep half of their height, shorter
                                    ///< ones less.
};

/// One grid of a file, as `palpate info` prints it. "File" means the file's own world space.
struct GridInfo {
  std::string name;  ///< Unique in the file: grids of equal name are density[0], density[1].
  std::string
      type;  ///< OpenVDB's: float, double, vec3s, ...; "3 x float" for a vector by component.
  GridClass grid_class = GridClass::kUnknown;  ///< Decides where there are data (makeVdbField).
  bool vector = false;                         ///< Vectors of floats, in one grid or by component.
  bool half = false;                           ///< Stored in 16 bits, read as 32.
  Vec3 voxel = Vec3::Zero();                   ///< Edges of a voxel, file.
  std::uint64_t active_voxels = 0;             ///< Active tiles counted by their voxels.
  Box bounds;                    ///< Of the active voxels' centres, file. Empty if none.
  std::uint64_t memory = 0;      ///< [bytes]
  double lowest = 0.0;           ///< Of the active values, magnitudes for a vector grid.
  double highest = 0.0;          ///< Of the active values, likewise.
  double mean = 0.0;             ///< Likewise, tiles counted by their voxels.
  double background = 0.0;       ///< Magnitude for a vector grid.
  std::uint64_t non_finite = 0;  ///< NaN, infinite or above 1e100: voxels, tiles, background.
  std::uint64_t filled = 0;      ///< Of these, made the background and inactive at load.
  Smoothing smoothing;           ///< By LoadOptions::smooth.
  bool was_local = false;        ///< Vectors stored in the grid's own index space, turned at load.
  std::string source;            ///< The file that it was imported from, as its metadata say.
  std::string refusal;           ///< "why: remedy" if it cannot be felt, else empty.
};

/// One grid in memory, const after loading, shared by its placements and by all threads.
class Volume {
 public:
  struct Grid;  ///< OpenVDB's; see samplers/volume_grid.h.

  Volume(GridInfo info, std::unique_ptr<const Grid> grid);
  Volume(const Volume&) = delete;
  Volume& operator=(const Volume&) = delete;
  /// Frees the grid: milliseconds. Never let the haptic thread drop the last reference.
  ~Volume();

  [[nodiscard]] const GridInfo& info() const noexcept { return info_; }  ///< As found at load.
  [[nodiscard]] const Grid& grid() const noexcept { return *grid_; }  ///< Its values, for samplers.
  /// Of the grid, and of the B-spline coefficients and maps of free space made so far [bytes].
  [[nodiscard]] std::uint64_t memory() const;

 private:
  GridInfo info_;
  std::unique_ptr<const Grid> grid_;
};

/// True for a readable file that begins as a .vdb does.
[[nodiscard]] bool isVdb(const std::filesystem::path& file) noexcept;

/// What to do with values that are no numbers.
enum class NonFinite : std::uint8_t {
  kRefuse,  ///< The grid cannot be felt.
  kFill,    ///< They become the background and inactive: no data. A background that is none
            ///< becomes zero.
};

/// What is done to a grid at load before it is looked at, and who is told how far it is.
struct LoadOptions {
  NonFinite non_finite = NonFinite::kRefuse;  ///< Of NaN, infinite and above 1e100.
  /// OpenVDB's Gaussian at load: four box filters of so many voxels to each side; 0 for none. For a
  /// level set its LevelSetFilter, else its Filter; active voxels only. Takes twice the grid's
  /// memory more while it works.
  int smooth = 0;
  /// Told how far reading is, from 0 to 1; an Error from it ends the load.
  std::function<void(double done)> progress;
};

/// The names of what a file holds, in its order: vel.x, vel.y and vel.z, scalars of one type,
/// together are vel. Throws as describeGrids.
[[nodiscard]] std::vector<std::string> gridNames(const std::filesystem::path& file);

/// Reads all grids of a file and describes each, then each vector that is kept by component. Throws
/// VolumeError for a file that is missing, truncated, damaged or not .vdb. Grids of types that
/// cannot be felt are described by their metadata, their trees are not read. Slow: reads everything
/// else, nothing is delayed.
[[nodiscard]] std::vector<GridInfo> describeGrids(const std::filesystem::path& file);

/// Loads one grid, compressed leaves in parallel, and looks at every value. Throws VolumeError for
/// what describeGrids refuses, for a name that is not there (the nearest is suggested) and for a
/// grid that cannot be felt: points and other types than scalar and vector floats, frustum or
/// singular maps, no active voxel, values that are no numbers. Who wants to change the file waits
/// until it has been read, or changes another than is read (samplers/steady_file.h).
///
/// Vectors: a staggered grid is taken apart, each component keeps its place on the face of its
/// voxel (twice the grid's memory for a moment); vel.x, vel.y and vel.z, three scalars of one type,
/// are read as "vel"; vectors that the file has in its own index space (isInWorldSpace) are turned
/// into world space by the rule of their VecType.
/// @param grid  Its name; empty takes the only grid of the file.
[[nodiscard]] std::shared_ptr<const Volume> loadVolume(const std::filesystem::path& file,
                                                       const std::string& grid,
                                                       const LoadOptions& options = {});

/// One of several volumes to be loaded together.
struct VolumeRequest {
  std::filesystem::path file;                 ///< A .vdb.
  std::string grid;                           ///< Its name; empty: the only grid of the file.
  NonFinite non_finite = NonFinite::kRefuse;  ///< As LoadOptions.
  int smooth = 0;                             ///< As LoadOptions, voxels.

  [[nodiscard]] bool operator==(const VolumeRequest&) const = default;  ///< For the same load.
};

/// The volume, or what loadVolume threw.
struct LoadResult {
  std::shared_ptr<const Volume> volume;  ///< Null where it could not be loaded.
  std::exception_ptr error;              ///< Why, as a rule a VolumeError; null where it could.
};

/// Loads in parallel, equal requests once; opens each file once. `progress` is told of all
/// together, from any thread but one at a time; it may not use TBB.
[[nodiscard]] std::vector<LoadResult> loadVolumes(
    const std::vector<VolumeRequest>& requests,
    const std::function<void(double done)>& progress = nullptr);

/// All that is in a file.
struct FileResult {
  std::vector<std::string> names;   ///< As gridNames.
  std::vector<LoadResult> volumes;  ///< Of each.
  std::exception_ptr error;         ///< Of the file itself, a VolumeError; else null.
};

/// Loads all grids of files in parallel, opens each file once. `progress` as of loadVolumes.
[[nodiscard]] std::vector<FileResult> loadFiles(
    const std::vector<std::filesystem::path>& files,
    const std::function<void(double done)>& progress = nullptr);

/// "level set", "fog volume", "staggered" or "unknown".
[[nodiscard]] const char* wordFor(GridClass grid_class) noexcept;

}  // namespace palpate
