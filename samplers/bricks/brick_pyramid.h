/// Private to samplers: makes the bricks of a level from those of the next finer level. Include it
/// in .cpp files only.
#pragma once

#include <cstddef>
#include <cstdint>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <utility>
#include <vector>

#include "palpate/samplers/bricks/bricks.h"

namespace palpate {

/// A brick's own voxels at half the resolution: 32^3 voxels, or their one value.
struct HalvedBrick {
  BrickKind kind = BrickKind::kStored;  ///< kStored: each voxel has its own value.
  std::array<float, 3> value{};         ///< The one value, if not kStored.
  std::vector<float> values;            ///< Means, rounded to the format.
  std::vector<std::uint8_t> active;     ///< One byte a voxel: 1 if one of the eight is active.
};

/// Makes each halved brick of a level once, and caches as many as there is room for. Any thread may
/// use it.
class HalvedBricks {
 public:
  /// @param source  Source of the bricks of `level`, with the level's entries in its manifest.
  HalvedBricks(BrickSource& source, std::int32_t level);

  /// Returns a halved brick. Throws VolumeError if the brick does not arrive.
  [[nodiscard]] std::shared_ptr<const HalvedBrick> of(const VoxelAt& at);

  /// Returns the manifest of the volume.
  [[nodiscard]] const BrickManifest& manifest() const noexcept { return source_.manifest(); }
  [[nodiscard]] std::int32_t level() const noexcept { return level_; }  ///< Their level.

 private:
  /// Largest number of cached bricks.
  static constexpr std::size_t kMost = 128;

  [[nodiscard]] std::shared_ptr<const HalvedBrick> make(const BrickEntry& entry);

  BrickSource& source_;
  std::int32_t level_;
  std::mutex mutex_;
  using Kept = std::list<std::pair<VoxelAt, std::shared_ptr<const HalvedBrick>>>;
  Kept kept_;  ///< The last requested first.
  std::map<VoxelAt, Kept::iterator> by_place_;
};

/// Working memory of one thread for coarserBrick().
struct CoarserSpace {
  std::vector<float> values;         ///< Values of the block around the brick.
  std::vector<std::uint8_t> active;  ///< Active voxels of the block, one byte a voxel.
  std::vector<std::uint8_t> signs;   ///< Near values: 1 if one is below zero, 2 if one is not.
  std::vector<std::uint8_t> other;   ///< Buffer to compute `signs`.
};

/// Makes a brick of the next level, with its apron.
/// @param values  kBrickVoxels values; set on return.
/// @param active  kBrickActiveBytes; set on return.
/// @return        True if all voxels equal the first one; then only the first one is set.
[[nodiscard]] bool coarserBrick(HalvedBricks& finer, const VoxelAt& at, bool level_set,
                                CoarserSpace& space, std::span<float> values,
                                std::span<std::uint8_t> active);

/// Returns the places of the next level where bricks may differ from the background, in an order
/// that keeps neighbours near each other.
[[nodiscard]] std::vector<VoxelAt> coarserPlaces(const BrickManifest& manifest, std::int32_t finer);

}  // namespace palpate
