/// Private to samplers, for .cpp files only: makes bricks from those of the next finer level.
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

/// A brick's own voxels at half the resolution: 32^3 voxels, or a single value.
struct HalvedBrick {
  /// If kStored, each voxel has its own value and state; else all have `value` and one state.
  BrickKind kind = BrickKind::kStored;
  std::array<float, 3> value{};  ///< Value of all voxels, if `kind` is not kStored.
  std::vector<float> values;     ///< Means of eight voxels each, rounded to the format.
  /// One byte for each halved voxel: 1 if one of its eight voxels is active.
  std::vector<std::uint8_t> active;
};

/// Makes the halved bricks of a level on request. Caches the kMost stored bricks that were
/// requested last. Thread-safe.
class HalvedBricks {
 public:
  /// @param source  Source of the bricks of `level`. Its manifest must contain their entries.
  HalvedBricks(BrickSource& source, std::int32_t level);

  /// Returns the brick at index `at` of the level, halved. Throws VolumeError if the brick does not
  /// arrive.
  [[nodiscard]] std::shared_ptr<const HalvedBrick> of(const VoxelAt& at);

  /// Returns the manifest of the volume.
  [[nodiscard]] const BrickManifest& manifest() const noexcept { return source_.manifest(); }
  /// Returns the level of the source's bricks, before they are halved.
  [[nodiscard]] std::int32_t level() const noexcept { return level_; }

 private:
  /// Largest number of cached bricks.
  static constexpr std::size_t kMost = 128;

  [[nodiscard]] std::shared_ptr<const HalvedBrick> make(const BrickEntry& entry);

  BrickSource& source_;
  std::int32_t level_;
  std::mutex mutex_;
  using Kept = std::list<std::pair<VoxelAt, std::shared_ptr<const HalvedBrick>>>;
  Kept kept_;  ///< Cached bricks, the last requested one first.
  std::map<VoxelAt, Kept::iterator> by_place_;
};

/// Working memory of one thread for coarserBrick().
struct CoarserSpace {
  std::vector<float> values;         ///< Values of the block around the brick.
  std::vector<std::uint8_t> active;  ///< Active voxels of the block, one byte for each voxel.
  /// Signs near each voxel: bit 0 for values below zero, bit 1 for other values.
  std::vector<std::uint8_t> signs;
  std::vector<std::uint8_t> other;  ///< Working memory for the computation of `signs`.
};

/// Makes a brick of the next coarser level, with its apron.
/// @param at         Index of the brick to make, in the coarser level.
/// @param level_set  True to activate the voxels that have both signs within three voxels.
/// @param values  Receives kBrickVoxels values.
/// @param active  Receives kBrickActiveBytes bytes of active bits.
/// @return        True if all finer bricks around it have the same single value and state. Then
///                only the first voxel is set.
[[nodiscard]] bool coarserBrick(HalvedBricks& finer, const VoxelAt& at, bool level_set,
                                CoarserSpace& space, std::span<float> values,
                                std::span<std::uint8_t> active);

/// Returns the bricks of the next coarser level that may differ from the background. The order
/// keeps neighbours near each other.
[[nodiscard]] std::vector<VoxelAt> coarserPlaces(const BrickManifest& manifest, std::int32_t finer);

}  // namespace palpate
