/// Writes volumes, also those larger than memory, as bricks (samplers/bricks/bricks.h).
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

/// Voxels of level 0 to fill in: a brick with its apron.
struct BrickBox {
  VoxelAt lower{};                 ///< First voxel, in index space.
  std::span<float> values;         ///< kBrickVoxels, laid out as in BrickFormat; not set.
  std::span<std::uint8_t> active;  ///< kBrickActiveBytes, one bit a voxel; all 0.
};

/// How a box was filled in.
enum class BoxFilled : std::uint8_t {
  kEach,      ///< Every voxel by itself.
  kOneValue,  ///< Only the first voxel: all voxels equal it.
};

/// A volume, with the function that fills a box of it.
struct BrickInput {
  std::string name;                            ///< Name of the volume.
  GridClass grid_class = GridClass::kUnknown;  ///< Class of the grid; must not be staggered.
  BrickFormat format;                          ///< Values are rounded to it.
  Mat3 linear = Mat3::Identity();              ///< file = linear * index + origin.
  Vec3 origin = Vec3::Zero();                  ///< Position of index (0, 0, 0), file.
  std::array<float, 3> background{};  ///< Value beyond the extent, where each voxel is inactive.
  VoxelAt lower{};                    ///< First voxel of the extent.
  VoxelAt upper{};                    ///< Last voxel of the extent.
  std::string source;                 ///< See GridInfo.
  std::string metadata = "{}";        ///< A JSON object, docs/bricks.md.
  /// Identifies the values, for example by a checksum or a formula. Different values must have
  /// different texts.
  std::string identity;
  /// Called by several threads at a time, for any box, also one that reaches beyond the extent. An
  /// exception from it ends the writing.
  std::function<BoxFilled(const BrickBox& box)> fill;
  /// In a process group: the bricks that `fill` knows on this rank, by their range along the last
  /// axis. Brick 0 begins at index 0. Each brick belongs to one rank. Not set: all bricks.
  std::optional<Share> share;
};

/// Options for writing bricks.
struct BrickOptions {
  int compression = 3;  ///< Level of zstd, 1 to 19.
  /// Called with the progress from 0 to 1, by one thread at a time. An exception from it ends the
  /// writing.
  std::function<void(double done)> progress;
  /// The process group that writes together, into a folder that all ranks see; null: this process
  /// alone.
  ProcessGroup* group = nullptr;
};

/// The result of writing.
struct BrickReport {
  BrickManifest manifest;     ///< The written manifest.
  std::uint64_t written = 0;  ///< Objects of bricks.
  std::uint64_t kept = 0;     ///< Objects that an interrupted run had already written.
};

/// Writes a volume into a folder: level 0 by `fill`, each further level from the bricks of the
/// level before, which are read back. The manifest comes last; readers reject a folder without it.
/// Writes bricks in parallel. Memory for each thread: about ten times a brick's. Shared: 128 bricks
/// of a level at half its resolution, and about a hundred bytes for each brick that is not the
/// background.
///
/// If a run ends early for any reason, the same call resumes it. The bytes written do not depend on
/// interruptions, on the number of threads or on the number of ranks. A finished folder is not
/// changed.
///
/// In a process group, each rank calls it with the same input except for `fill` and `share`. An
/// exception on one rank ends the others with GroupEnded, by workTogether(). Rank 0 alone locks the
/// folder and writes the files that are not bricks. Each rank gets the report of all ranks.
///
/// Voxel I of level l + 1 is the mean of the voxels 2 I and 2 I + 1 of level l. It is active if one
/// of the eight is. In a level set it is also active if voxels of both signs are within 3 voxels of
/// it. So each cell that the surface passes, and the two next to it, have data at every corner on
/// every level.
///
/// Throws Error if the folder has other content, another input or other options, if another run is
/// writing into it, if the disk is full, or if the ranks' inputs differ. Throws VolumeError if a
/// value is not finite or does not fit the format, or if the extent, transform or class is invalid.
[[nodiscard]] BrickReport writeBricks(const std::filesystem::path& folder, const BrickInput& input,
                                      const BrickOptions& options = {});

/// Returns a volume in memory as input of writeBricks. Rounds doubles to 32 bits. Throws
/// VolumeError for a vector with components at different positions. Slow: reads every value.
/// @param half  Round to 16 bits.
[[nodiscard]] BrickInput brickInput(const std::shared_ptr<const Volume>& volume, bool half = false);

}  // namespace palpate
