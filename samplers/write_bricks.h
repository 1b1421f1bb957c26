/// Writes volumes, also those larger than memory, as bricks (samplers/bricks.h).
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
#include "palpate/samplers/bricks.h"
#include "palpate/samplers/crew.h"
#include "palpate/samplers/volume.h"

namespace palpate {

/// Voxels of level 0 that are asked for: a brick with its apron.
struct BrickBox {
  VoxelAt lower{};                 ///< The first of them, in index space.
  std::span<float> values;         ///< kBrickVoxels, as BrickFormat has them; not set.
  std::span<std::uint8_t> active;  ///< kBrickActiveBytes, a bit a voxel; all 0.
};

/// How much of a box was filled in.
enum class BoxFilled : std::uint8_t {
  kEach,      ///< Every voxel by itself.
  kOneValue,  ///< The first alone: all of them are like it.
};

/// A volume, by what fills a box of it.
struct BrickInput {
  std::string name;                            ///< Of the volume.
  GridClass grid_class = GridClass::kUnknown;  ///< Not staggered.
  BrickFormat format;                          ///< Values are rounded to it.
  Mat3 linear = Mat3::Identity();              ///< file = linear * index + origin.
  Vec3 origin = Vec3::Zero();                  ///< Of index (0, 0, 0), file.
  std::array<float, 3> background{};  ///< Also of every voxel beyond the extent, which is inactive.
  VoxelAt lower{};                    ///< First voxel of the extent.
  VoxelAt upper{};                    ///< Last voxel of the extent.
  std::string source;                 ///< As GridInfo.
  std::string metadata = "{}";        ///< A JSON object, docs/bricks.md.
  /// The same text for the same values, and another for others: a checksum of them, or a formula.
  std::string identity;
  /// Called by several threads at a time, for any box, also where it reaches beyond the extent. An
  /// exception from it ends the writing.
  std::function<BoxFilled(const BrickBox& box)> fill;
  /// Of a crew, what `fill` knows here: the bricks between these along the last axis, counted from
  /// that of index 0. Each brick is one rank's. Not set: all of them.
  std::optional<Share> share;
};

/// How bricks are written.
struct BrickOptions {
  int compression = 3;  ///< zstd's level, 1 to 19.
  /// Told how far it is, from 0 to 1, one at a time; an exception from it ends the writing.
  std::function<void(double done)> progress;
  /// Those who write it together, into a folder that all of them see; null: this process alone.
  Crew* crew = nullptr;
};

/// What was written.
struct BrickReport {
  BrickManifest manifest;     ///< As it was written.
  std::uint64_t written = 0;  ///< Objects of bricks.
  std::uint64_t kept = 0;     ///< Those that were there already, from a run that did not end.
};

/// Writes a volume into a folder: level 0 out of `fill`, each further one out of the bricks before,
/// read back; then the manifest, without which nobody reads it. In parallel over bricks. Memory:
/// for each thread some ten times a brick's, and 128 bricks of a level at half its resolution; no
/// more for a larger volume, but for some hundred bytes for each brick that is not the background.
///
/// A run that ends early, however that is, leaves what it has: the same call goes on from there.
/// The bytes do not depend on that, nor on the number of threads or of the crew's ranks. A folder
/// that is finished already is left as it is.
///
/// Of a crew each calls it, with the same input but for `fill` and `share`; what is thrown by one
/// ends it for the others with CrewEnded, by workTogether(). Rank 0 alone holds the folder and
/// writes what is not a brick. All are told of what all have written.
///
/// Level l + 1 at I: the mean of the voxels 2 I and 2 I + 1 of level l. Active where one of the
/// eight is; of a level set also where voxels of both signs are within 3 voxels of it, so that each
/// cell that its surface passes, and the two next to it, have data at every corner on every level.
///
/// Throws Error: the folder holds something else, another input or other options, another run is
/// at it, the disk is full, the ranks' inputs differ; VolumeError: a value that is no number or
/// does not fit the format, an extent, map or class that cannot be.
[[nodiscard]] BrickReport writeBricks(const std::filesystem::path& folder, const BrickInput& input,
                                      const BrickOptions& options = {});

/// A volume in memory, to be written. Doubles are rounded to 32 bits. Throws VolumeError for a
/// vector whose components stand at different places. Slow: looks at every value.
/// @param half  Round to 16 bits.
[[nodiscard]] BrickInput brickInput(const std::shared_ptr<const Volume>& volume, bool half = false);

}  // namespace palpate
