/// Grids of .vdb files: describes them, and loads one so that it can be felt.
#pragma once

#include <cstdint>
#include <exception>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "palpate/engine/field/field.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Meaning of a grid's values, as its metadata say.
enum class GridClass : std::uint8_t { kUnknown, kLevelSet, kFog, kStaggered };

/// Effect of smoothing at load.
struct Smoothing {
  int width = 0;                    ///< Reach of the filter's boxes, voxels to each side; 0: none.
  double rms_change = 0.0;          ///< RMS change of the active values.
  double largest_change = 0.0;      ///< Largest change of the active values.
  double half_height_voxels = 0.0;  ///< Waves of this length keep half of their height, shorter
                                    ///< waves less.
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
  std::uint64_t active_voxels = 0;             ///< A tile counts by its voxels.
  Box bounds;                    ///< Box of the active voxels' centres, file; empty without them.
  std::uint64_t memory = 0;      ///< [bytes]
  double lowest = 0.0;           ///< Lowest active value; a magnitude for a vector grid.
  double highest = 0.0;          ///< Highest active value; a magnitude for a vector grid.
  double mean = 0.0;             ///< Mean active value; a tile counts by its voxels.
  double background = 0.0;       ///< Magnitude for a vector grid.
  std::uint64_t non_finite = 0;  ///< NaN, infinite or above 1e100: voxels, tiles, background.
  std::uint64_t filled = 0;      ///< Values made the background and inactive at load.
  Smoothing smoothing;           ///< Effect of LoadOptions::smooth.
  bool was_local = false;        ///< Vectors stored in the grid's own index space, turned at load.
  std::string source;            ///< File that it was imported from, as its metadata say.
  std::string refusal;           ///< "why: remedy" if it cannot be felt, else empty.
};

/// One grid in memory: const after loading, shared by its placements and by all threads.
class Volume {
 public:
  struct Grid;  ///< OpenVDB's grid; see samplers/grid/volume_grid.h.

  Volume(GridInfo info, std::unique_ptr<const Grid> grid);
  Volume(const Volume&) = delete;
  Volume& operator=(const Volume&) = delete;
  /// Frees the grid, which takes milliseconds. The haptic thread must never drop the last
  /// reference.
  ~Volume();

  [[nodiscard]] const GridInfo& info() const noexcept { return info_; }  ///< Set at load.
  [[nodiscard]] const Grid& grid() const noexcept { return *grid_; }     ///< Values, for samplers.
  /// Returns the memory of the grid, and of the B-spline coefficients and free maps made so far
  /// [bytes].
  [[nodiscard]] std::uint64_t memory() const;

 private:
  GridInfo info_;
  std::unique_ptr<const Grid> grid_;
};

/// Returns whether `file` can be read and begins with the signature of a .vdb file.
[[nodiscard]] bool isVdb(const std::filesystem::path& file) noexcept;

/// Treatment of values that are not numbers.
enum class NonFinite : std::uint8_t {
  kRefuse,  ///< The grid cannot be felt.
  kFill,    ///< The values become the background and inactive: no data. A background that is not a
            ///< number becomes zero.
};

/// Options for loading a grid, and the receiver of progress.
struct LoadOptions {
  NonFinite non_finite = NonFinite::kRefuse;  ///< For NaN, infinite and above 1e100.
  /// Width of OpenVDB's Gaussian at load: four box filters of so many voxels to each side; 0 for
  /// no filter. Uses LevelSetFilter for a level set, else Filter; changes active voxels only.
  /// During the call it needs twice the grid's memory in addition.
  int smooth = 0;
  /// Receives the progress of reading, from 0 to 1. An Error that it throws ends the load.
  std::function<void(double done)> progress;
};

/// Returns the names of the grids in a file, in its order. vel.x, vel.y and vel.z, scalars of one
/// type, are listed together as vel. Throws as describeGrids.
[[nodiscard]] std::vector<std::string> gridNames(const std::filesystem::path& file);

/// Reads all grids of a file and describes each, then each vector that is kept by component. Throws
/// VolumeError for a file that is missing, truncated, damaged or not .vdb. Grids of unsupported
/// types are described by their metadata; their trees are not read. Slow: reads everything else,
/// without delayed loading.
[[nodiscard]] std::vector<GridInfo> describeGrids(const std::filesystem::path& file);

/// Loads one grid, its compressed leaves in parallel, and checks every value. Throws VolumeError
/// for a file that describeGrids rejects, for an unknown name (the error suggests the nearest one)
/// and for a grid that cannot be felt: points and other types than scalar and vector floats,
/// frustum or singular maps, no active voxel, values that are not numbers. A program that wants to
/// change the file waits until it has been read, or changes a file other than the one read
/// (samplers/leased_file.h).
///
/// Vectors: a staggered grid is split, and each component keeps its place on the face of its voxel
/// (twice the grid's memory for a moment). vel.x, vel.y and vel.z, three scalars of one type, are
/// read as "vel". Vectors stored in the file's own index space (isInWorldSpace) are turned into
/// world space by the rule of their VecType.
/// @param grid  Its name; empty takes the only grid of the file.
[[nodiscard]] std::shared_ptr<const Volume> loadVolume(const std::filesystem::path& file,
                                                       const std::string& grid,
                                                       const LoadOptions& options = {});

/// A request for one of several volumes to load together.
struct VolumeRequest {
  std::filesystem::path file;                 ///< A .vdb.
  std::string grid;                           ///< Its name; empty: the only grid of the file.
  NonFinite non_finite = NonFinite::kRefuse;  ///< See LoadOptions.
  int smooth = 0;                             ///< See LoadOptions [voxels].

  [[nodiscard]] bool operator==(const VolumeRequest&) const = default;  ///< True for the same load.
};

/// The volume, or the error that loadVolume threw.
struct LoadResult {
  std::shared_ptr<const Volume> volume;  ///< Null if it could not be loaded.
  std::exception_ptr error;              ///< The reason, as a rule a VolumeError; else null.
};

/// Loads volumes in parallel. Loads equal requests once and opens each file once. `progress`
/// receives the progress of all together, from any thread but one at a time; it must not use TBB.
[[nodiscard]] std::vector<LoadResult> loadVolumes(
    const std::vector<VolumeRequest>& requests,
    const std::function<void(double done)>& progress = nullptr);

/// All grids of a file.
struct FileResult {
  std::vector<std::string> names;   ///< See gridNames.
  std::vector<LoadResult> volumes;  ///< One for each name.
  std::exception_ptr error;         ///< Error of the file itself, a VolumeError; else null.
};

/// Loads all grids of files in parallel; opens each file once. `progress` as in loadVolumes.
[[nodiscard]] std::vector<FileResult> loadFiles(
    const std::vector<std::filesystem::path>& files,
    const std::function<void(double done)>& progress = nullptr);

/// Returns "level set", "fog volume", "staggered" or "unknown".
[[nodiscard]] const char* wordFor(GridClass grid_class) noexcept;

}  // namespace palpate
