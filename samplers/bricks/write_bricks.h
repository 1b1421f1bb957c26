/// Writes volumes as bricks (samplers/bricks/bricks.h). The volumes may be larger than memory.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "palpate/engine/types.h"
#include "palpate/samplers/bricks/bricks.h"
#include "palpate/samplers/grid/volume.h"
#include "palpate/samplers/process_group.h"

namespace palpate {

/// A brick of level 0 to fill in, with its apron.
struct BrickBox {
  VoxelAt lower{};  ///< Index of the first voxel of the apron.
  /// Values to set, kBrickVoxels in the layout of BrickFormat. Not initialised.
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
  /// Text that identifies the values, such as a checksum or a formula. Different values must have
  /// different texts.
  std::string identity;
  /// Fills in a box. Several threads call it at the same time, for any box, which may extend beyond
  /// the extent. An exception from it ends the writing.
  std::function<BoxFilled(const BrickBox& box)> fill;
  /// Range of the bricks that `fill` can provide on this rank, along the last axis, for a process
  /// group. Brick 0 begins at index 0. Each brick belongs to exactly one rank. If not set, `fill`
  /// can provide all bricks.
  std::optional<Share> share;
};

/// Options of writeBricks.
struct BrickOptions {
  int compression = 3;  ///< Level of compression by zstd, 1 to 19.
  /// Receives the progress from 0 to 1. One thread calls it at a time. An exception from it ends
  /// the writing.
  std::function<void(double done)> progress;
  /// Process group whose ranks write together into one folder that all of them see. If null, this
  /// process writes alone.
  ProcessGroup* group = nullptr;
};

/// The result of writing.
struct BrickReport {
  BrickManifest manifest;     ///< The written manifest.
  std::uint64_t written = 0;  ///< Number of objects that this run has written.
  std::uint64_t kept = 0;     ///< Number of objects that were kept from an interrupted run.
};

/// Writes a volume into a folder. Level 0 comes from `fill`. Each further level is made from the
/// bricks of the level before, which are read back. The manifest is written last, and readers
/// reject a folder without a manifest. Bricks are written in parallel. Each thread needs about ten
/// times the memory of a brick. All threads share 128 bricks of a level at half its resolution, and
/// about a hundred bytes for each brick that is not the background.
///
/// If a run ends early for any reason, the same call resumes it. The written bytes do not depend on
/// interruptions, on the number of threads or on the number of ranks. The function does not change
/// a finished folder.
///
/// In a process group, all ranks must call the function with the same input, except for `fill` and
/// `share`. If a rank throws, all other ranks end with GroupEnded (see workTogether()). Rank 0
/// alone locks the folder and writes the files that are not bricks. Each rank gets the report about
/// all ranks.
///
/// Voxel I of level l + 1 is the mean of the voxels 2 I and 2 I + 1, along each axis, of level l.
/// It is active if one of these eight voxels is active. In a level set it is also active if both
/// signs occur within 3 voxels of it. So on every level, each cell that the surface crosses has
/// data at every corner, and so have the two cells next to it.
///
/// Throws Error in these cases: the folder contains other files, or bricks of another input or of
/// other options; another run writes into the folder; the disk is full; the ranks' inputs differ.
/// Throws VolumeError if a value is not finite or does not fit the format, or if the extent,
/// transform or class is invalid.
[[nodiscard]] BrickReport writeBricks(const std::filesystem::path& folder, const BrickInput& input,
                                      const BrickOptions& options = {});

/// Returns a volume in memory as input of writeBricks. Doubles are rounded to 32 bits. Throws
/// VolumeError for a vector whose components have different positions. Slow: reads every value.
/// @param half  True to round values to 16 bits.
[[nodiscard]] BrickInput brickInput(const std::shared_ptr<const Volume>& volume, bool half = false);

}  // namespace palpate
