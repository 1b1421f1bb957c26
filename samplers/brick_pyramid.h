/// Private to samplers: bricks of a level out of those of the level before. Include it in .cpp
/// files only.
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

#include "palpate/samplers/bricks.h"

namespace palpate {

/// A brick's own voxels at half the resolution, 32^3 of them, or the one value of all.
struct HalvedBrick {
  BrickKind kind = BrickKind::kStored;  ///< kStored: each voxel by itself.
  std::array<float, 3> value{};         ///< Where it is all of one.
  std::vector<float> values;            ///< Means, rounded to the format.
  std::vector<std::uint8_t> active;     ///< A byte a voxel: 1 where one of the eight is.
};

/// Those of a level, made once and kept as long as there is room. By any thread.
class HalvedBricks {
 public:
  /// @param source  Of that level; the level's entries are known by its manifest.
  HalvedBricks(BrickSource& source, std::int32_t level);

  /// Throws VolumeError where it does not arrive.
  [[nodiscard]] std::shared_ptr<const HalvedBrick> of(const VoxelAt& at);

  /// Of the volume.
  [[nodiscard]] const BrickManifest& manifest() const noexcept { return source_.manifest(); }
  [[nodiscard]] std::int32_t level() const noexcept { return level_; }  ///< Whose they are.

 private:
  /// So many are kept.
  static constexpr std::size_t kMost = 128;

  [[nodiscard]] std::shared_ptr<const HalvedBrick> make(const BrickEntry& entry);

  BrickSource& source_;
  std::int32_t level_;
  std::mutex mutex_;
  using Kept = std::list<std::pair<VoxelAt, std::shared_ptr<const HalvedBrick>>>;
  Kept kept_;  ///< The last asked for first.
  std::map<VoxelAt, Kept::iterator> by_place_;
};

/// Memory for coarserBrick(), a thread's.
struct CoarserSpace {
  std::vector<float> values;         ///< Of the block about the brick.
  std::vector<std::uint8_t> active;  ///< Likewise, a byte a voxel.
  std::vector<std::uint8_t> signs;   ///< Likewise: 1 where one below zero is near, 2 one above.
  std::vector<std::uint8_t> other;   ///< For making these.
};

/// A brick of the next level with its apron.
/// @param values  kBrickVoxels of them, to be set.
/// @param active  kBrickActiveBytes, to be set.
/// @return        True: all are as the first, nothing else is set.
[[nodiscard]] bool coarserBrick(HalvedBricks& finer, const VoxelAt& at, bool level_set,
                                CoarserSpace& space, std::span<float> values,
                                std::span<std::uint8_t> active);

/// The places of the next level whose bricks need not be background, in an order in which
/// neighbours are near each other.
[[nodiscard]] std::vector<VoxelAt> coarserPlaces(const BrickManifest& manifest, std::int32_t finer);

}  // namespace palpate
