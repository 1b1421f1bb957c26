/// Describes the grids of .vdb files, and loads them into memory.
#pragma once

#include <cstdint>
#include <exception>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "palpate/engine/field/field.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Standard deviation of the Gaussian that smooths a grid.
struct SmoothWidth {
  /// Standard deviation [voxels, or the file's unit of length], at most kMostSmooth voxels; 0: no
  /// smoothing.
  double sigma = 0.0;
  bool in_file_units = false;  ///< True if `sigma` has the file's unit of length.

  /// Returns true if the widths are equal.
  [[nodiscard]] bool operator==(const SmoothWidth&) const = default;
};

/// Largest standard deviation of a smoothing [voxels].
inline constexpr double kMostSmooth = 32.0;

/// Meaning of inactive voxels in the box of active voxels, as the metadata of the grid state.
enum class Inactive : std::uint8_t {
  /// Inactive voxels have the value of the background, such as zero velocity in the core of a
  /// vortex.
  kBackground,
  /// Inactive voxels have no data: the grid is from a mesh, whose border is between voxels.
  kOutside,
  kMissing,  ///< Inactive voxels have no data: the grid is from an image with missing voxels.
};

/// Meaning of a grid's values, as the metadata of the grid state.
enum class GridClass : std::uint8_t { kUnknown, kLevelSet, kFog, kStaggered };

/// Result of smoothing a grid when it was loaded.
struct Smoothing {
  /// Standard deviation of the Gaussian, along the axis where it is largest [voxels]; 0 if the grid
  /// was not smoothed.
  double sigma = 0.0;
  double rms_change = 0.0;      ///< Root mean square of the changes of active values.
  double largest_change = 0.0;  ///< Largest change of an active value.
  /// Wavelength at which a wave keeps half of its height [voxels]. Shorter waves lose more.
  double half_height_voxels = 0.0;
};

/// A label of a segmentation: a value of the grid that marks one structure, and its name.
struct Label {
  double value = 0.0;          ///< Value of the structure's voxels, a whole number.
  std::string name;            ///< Name of the structure; may be empty.
  std::optional<Vec3> colour;  ///< Red, green and blue, each 0 to 1; unset: not stated.
};

/// Description of a grid, as `palpate info` prints it. [file]: the file's own world space.
struct GridInfo {
  std::string name;  ///< Name, unique in the file. Grids of equal names are density[0], density[1].
  std::string type;  ///< OpenVDB's value type, such as float or vec3s; "3 x float" for three grids.
  /// Class of the grid. It determines which positions have data (makeVdbField).
  GridClass grid_class = GridClass::kUnknown;
  bool vector = false;  ///< True for a vector, in one grid or in three.
  /// True if the file stores 16 bits per number. The load converts them to the grid's type.
  bool half = false;
  Vec3 voxel = Vec3::Zero();  ///< Edges of a voxel [file].
  /// Number of active voxels, including those in tiles; the smallest number of three grids.
  std::uint64_t active_voxels = 0;
  /// Box of the centres of active voxels [file]; empty if no voxel is active or the transform is
  /// unusable. For three grids, the box where all have data. Smoothing does not change this box, so
  /// fitInto() gives the same placement.
  Box bounds;
  std::uint64_t memory = 0;  ///< Memory of the grid [bytes].
  /// Lowest active value; for a vector, the smallest magnitude. NaN for a type that is not read; 0
  /// or NaN if no voxel is active.
  double lowest = 0.0;
  double highest = 0.0;  ///< Highest active value; for a vector, the largest magnitude.
  /// Mean of the active values, tiles included; for a vector, of the magnitudes.
  double mean = 0.0;
  double background = 0.0;  ///< Value of the background; for a vector, its magnitude.
  /// Number of voxels, tiles and backgrounds with a value that is NaN, infinite or above 1e100 in
  /// magnitude.
  std::uint64_t non_finite = 0;
  /// Number of such values, tiles and backgrounds that the load replaced (NonFinite::kFill).
  /// `non_finite` does not count them.
  std::uint64_t filled = 0;
  Smoothing smoothing;  ///< Effect of LoadOptions::smooth.
  /// True if the file stores the vectors in index space. The load converts them.
  bool was_local = false;
  /// Labels that the metadata of the grid state (labels.h), in the order of the file.
  std::vector<Label> labels;
  std::optional<Vec3> colour;  ///< Colour of a mask's surface (makeLabelMask), as in Label.
  std::string source;          ///< File from which the grid was imported, as its metadata state.
  std::string description;     ///< Description of the data, as the grid's metadata state it.
  std::string refusal;         ///< "reason: remedy" if the grid cannot be used, else empty.
};

/// One grid in memory. It is const after loading, and all its placements and all threads share it.
class Volume {
 public:
  struct Grid;  ///< Contains OpenVDB's grid; see samplers/grid/volume_grid.h.

  Volume(GridInfo info, std::unique_ptr<const Grid> grid);
  Volume(const Volume&) = delete;
  Volume& operator=(const Volume&) = delete;
  /// Frees the grid, which is slow. The haptic thread must not drop the last reference.
  ~Volume();

  /// Returns the description of the grid.
  [[nodiscard]] const GridInfo& info() const noexcept { return info_; }
  /// Returns the values of the grid, for use in samplers.
  [[nodiscard]] const Grid& grid() const noexcept { return *grid_; }
  /// Returns the memory of the grid and of its spline coefficients and free maps so far [bytes].
  [[nodiscard]] std::uint64_t memory() const;

 private:
  GridInfo info_;
  std::unique_ptr<const Grid> grid_;
};

/// Returns true if `file` can be read and begins with the signature of .vdb files.
[[nodiscard]] bool isVdb(const std::filesystem::path& file) noexcept;

/// Treatment of values that are NaN, infinite or above 1e100 in magnitude.
enum class NonFinite : std::uint8_t {
  kRefuse,  ///< The grid is rejected.
  /// Unusable values become inactive background. An unusable background becomes zero.
  kFill,
};

/// Options for loading a grid.
struct LoadOptions {
  /// Treatment of values that are NaN, infinite or above 1e100 in magnitude.
  NonFinite non_finite = NonFinite::kRefuse;
  /// Width of a Gaussian that smooths the grid. Every voxel counts, active or not, and so does the
  /// background. A voxel that changes and differs from the background then becomes active, except
  /// in a grid whose inactive voxels have no data (Inactive). The band of a level set is rebuilt.
  /// The faces of tiles of 4096^3 voxels that are not next to a leaf stay sharp. Smoothing needs
  /// memory for one copy of the grid, and for the voxels within three standard deviations of it.
  SmoothWidth smooth;
  /// Receives the progress of reading, from 0 to 1. If it throws an Error, the load ends.
  std::function<void(double done)> progress;
};

/// Returns the names of the grids in a file, in the file's order. Scalars of one type with the
/// names vel.x, vel.y and vel.z appear as one vector, vel. Throws VolumeError for a file that is
/// missing, truncated, damaged or not a .vdb file. Does not check trees of a file with a table of
/// contents.
[[nodiscard]] std::vector<std::string> gridNames(const std::filesystem::path& file);

/// Describes all grids of a file, then each vector that is stored as three grids. Throws
/// VolumeError for a file that is missing, truncated, damaged or not a .vdb file, that has no grid,
/// or that another program waits to change. Slow: reads all values, except those of unsupported
/// types, for which it reads the metadata only.
[[nodiscard]] std::vector<GridInfo> describeGrids(const std::filesystem::path& file);

/// Loads one grid and checks every value, in parallel. Throws VolumeError for a file that is
/// missing, truncated, damaged or not a .vdb file; damage in the tree of another grid does no harm
/// if the file has a table of contents. Throws VolumeError for an unknown name (the error suggests
/// names), for an invalid LoadOptions::smooth, and if another program waits to change the file.
/// Also throws VolumeError for an unusable grid: points, other values than scalar and vector
/// floats, a frustum or singular map, no active voxel, or values that are not finite. During the
/// call, a program that opens the file for writing waits, unless the file was copied
/// (samplers/leased_file.h).
///
/// Each component of a staggered grid keeps its position on a face of its voxel; the split needs
/// twice the grid's memory. Scalars vel.x, vel.y and vel.z of one type can be loaded as "vel".
/// Vectors in index space (isInWorldSpace is false) are converted by the rule of their VecType.
/// @param grid  Name of the grid; if empty, the file must contain one grid, or one vector in three.
[[nodiscard]] std::shared_ptr<const Volume> loadVolume(const std::filesystem::path& file,
                                                       const std::string& grid,
                                                       const LoadOptions& options = {});

/// A volume that loadVolumes() loads.
struct VolumeRequest {
  std::filesystem::path file;                 ///< A .vdb file.
  std::string grid;                           ///< Name of the grid, or empty (loadVolume).
  NonFinite non_finite = NonFinite::kRefuse;  ///< Value for LoadOptions::non_finite.
  SmoothWidth smooth{};                       ///< Value for LoadOptions::smooth.

  /// Returns true if the requests are equal.
  [[nodiscard]] bool operator==(const VolumeRequest&) const = default;
};

/// A volume, or the error of its load.
struct LoadResult {
  std::shared_ptr<const Volume> volume;  ///< The volume; null if it could not be loaded.
  /// The exception of loadVolume, usually a VolumeError; null if the volume was loaded.
  std::exception_ptr error;
};

/// Loads volumes in parallel, and returns the results in the order of the requests. Loads equal
/// requests only once, and opens each file only once to load from it. Calls `progress` with the
/// joint progress, from 0 to 1, from any thread, one call at a time. `progress` must not use TBB.
/// Throws VolumeError, before it loads, if the metadata of large files state that the volumes do
/// not fit into memory.
[[nodiscard]] std::vector<LoadResult> loadVolumes(
    const std::vector<VolumeRequest>& requests,
    const std::function<void(double done)>& progress = nullptr);

/// All grids of one file.
struct FileResult {
  std::vector<std::string> names;   ///< Names of the grids, in the order of gridNames.
  std::vector<LoadResult> volumes;  ///< Results for the grids, in the order of `names`.
  /// Error of the file itself, a VolumeError; null if the file could be read.
  std::exception_ptr error;
};

/// Loads all grids of several files in parallel. For `progress` and memory see loadVolumes.
[[nodiscard]] std::vector<FileResult> loadFiles(
    const std::vector<std::filesystem::path>& files,
    const std::function<void(double done)>& progress = nullptr);

/// Returns the words for a class of grids: "level set", "fog volume", "staggered" or "unknown".
[[nodiscard]] const char* wordFor(GridClass grid_class) noexcept;

}  // namespace palpate
