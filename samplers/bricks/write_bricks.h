/// Writes volumes as bricks (samplers/bricks/bricks.h). The volumes may be larger than memory.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "palpate/engine/types.h"
#include "palpate/samplers/bricks/bricks.h"
#include "palpate/samplers/grid/volume.h"
#include "palpate/samplers/process_group.h"

namespace palpate {

/// A brick of level 0 to fill in, with its apron.
struct BrickBox {
  VoxelAt lower{};  ///< Index of the first voxel of the apron.
  /// Values to set, kBrickVoxels in the order of BrickFormat, as floats also if BrickFormat::half
  /// is true. Not initialised.
  std::span<float> values;
  std::span<std::uint8_t> active;  ///< Active bits to set, kBrickActiveBytes. All are 0 initially.
};

/// States which voxels of a box were set.
enum class BoxFilled : std::uint8_t {
  kEach,      ///< All voxels were set.
  kOneValue,  ///< Only the first voxel was set. All voxels have its value and state.
};

/// Description of a volume, with the function that provides its voxels.
struct BrickInput {
  std::string name;                            ///< Name of the volume.
  GridClass grid_class = GridClass::kUnknown;  ///< Class of the grid; must not be kStaggered.
  BrickFormat format;              ///< Format of the bricks, to which values are rounded.
  Mat3 linear = Mat3::Identity();  ///< file = linear * index + origin.
  Vec3 origin = Vec3::Zero();      ///< Position of index (0, 0, 0) in the file's world space.
  /// Value outside of the extent, where all voxels are inactive.
  std::array<float, 3> background{};
  VoxelAt lower{};              ///< First voxel of the extent.
  VoxelAt upper{};              ///< Last voxel of the extent.
  std::string source;           ///< File from which the volume was imported (GridInfo::source).
  std::string metadata = "{}";  ///< Further metadata, a JSON object as described in docs/bricks.md.
  /// Identifies the values, such as a checksum. Different values must have different texts.
  std::string identity;
  /// Fills in a box, which may extend beyond the extent. Several threads call it at the same time.
  /// An exception ends the writing.
  std::function<BoxFilled(const BrickBox& box)> fill;
  /// Indices of the bricks along the last axis that `fill` can provide on this rank of a group.
  /// Brick 0 begins at index 0. Each brick belongs to exactly one rank. If not set: all bricks.
  std::optional<Share> share;
  /// Consecutive parts of `share`, if `fill` can provide only one part at a time. Empty: `fill` can
  /// provide all bricks at any time.
  std::vector<Share> parts;
  /// Prepares `fill` for parts[part]. The writer calls it for each part in turn, except for parts
  /// outside of the extent.
  std::function<void(std::size_t part)> open;
};

/// Options of writeBricks.
struct BrickOptions {
  int compression = 3;  ///< Compression level of zstd: 1 is the fastest, 19 the smallest.
  /// Receives the progress from 0 to 1, from any thread, one call at a time. An exception ends the
  /// writing.
  std::function<void(double done)> progress;
  /// Process group that writes together into one shared folder; null for a single process.
  ProcessGroup* group = nullptr;
};

/// The result of writing.
struct BrickReport {
  BrickManifest manifest;     ///< The written manifest.
  std::uint64_t written = 0;  ///< Number of objects that this run has written.
  std::uint64_t kept = 0;     ///< Number of objects that were kept from an interrupted run.
};

/// Writes a volume into a folder. Level 0 comes from `fill`, each further level from the bricks of
/// the level before. The manifest is written last, and readers reject a folder without one.
/// Parallel. Memory: about ten bricks for each thread, 128 bricks at half their resolution, and
/// about a hundred bytes for each brick that is not the background.
///
/// The same call resumes an interrupted run. The written bytes do not depend on interruptions,
/// threads or ranks. A finished folder stays unchanged.
///
/// In a process group, all ranks must call this function with the same input, except for `fill`,
/// `share`, `parts` and `open`. If a rank throws, the others end with GroupEnded (workTogether()).
/// Rank 0 alone locks the folder and writes the files that are not bricks. Each rank gets the
/// report about all ranks.
///
/// Voxel I of level l + 1 is the mean of voxels 2 I and 2 I + 1, along each axis, of level l. It is
/// active if one of these eight voxels is active; in a level set, also if both signs occur within 3
/// voxels. So on levels above 0, all corners of cells that the surface crosses, and of the two
/// cells on each side of them, are active.
///
/// Throws Error if the folder cannot be made, contains other files, or contains bricks of another
/// input, other options or another version of zstd. Also throws Error if another run writes into
/// the folder, a file cannot be written, or the ranks' inputs differ. Throws VolumeError for values
/// that are not finite or exceed the range of the format, and for an invalid extent, transform,
/// class, background or compression level. Also throws it if a written file cannot be read back.
[[nodiscard]] BrickReport writeBricks(const std::filesystem::path& folder, const BrickInput& input,
                                      const BrickOptions& options = {});

/// Returns a volume in memory as input of writeBricks. Rounds doubles to 32 bits. Throws
/// VolumeError if a vector is staggered or has its components in separate grids. Slow: reads every
/// value.
/// @param half  True to round values to 16 bits. Otherwise GridInfo::half decides.
[[nodiscard]] BrickInput brickInput(const std::shared_ptr<const Volume>& volume, bool half = false);

}  // namespace palpate
