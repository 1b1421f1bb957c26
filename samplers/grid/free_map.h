/// Private to samplers: a coarse map of where a grid is empty, so that free space costs one
/// look-up.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "palpate/engine/types.h"

namespace palpate {

/// Stores, block by block, the distance to the nearest voxel with data.
class FreeMap {
 public:
  /// A box of voxels from `lower` to `upper`, both included.
  struct Voxels {
    std::array<int, 3> lower;  ///< Least index along each axis.
    std::array<int, 3> upper;  ///< Greatest index along each axis, included.
  };

  /// Makes the map of a grid without data.
  FreeMap() = default;
  /// Makes a map in which only these boxes have data. Takes a byte for every leaf of 8^3 in the box
  /// around them. If that is more than 4 MB, it takes a byte for every 16^3, and so on. Slow,
  /// allocates.
  explicit FreeMap(std::span<const Voxels> data);

  /// Returns a lower bound of the distance to voxels with data, along the axis where they are
  /// farthest [voxels]. Returns 0 if they may be next to p_I, or if p_I is NaN. RT: no
  /// allocation. Cost: a few ns, and the memory access.
  [[nodiscard]] double around(const Vec3& p_I) const noexcept {
    double outside = 0.0;
    bool within = true;
    std::size_t at = 0;
    for (std::size_t a = 0; a < 3; ++a) {
      const double u = p_I[static_cast<Eigen::Index>(a)] - lower_[a];
      const double length = edge_ * static_cast<double>(size_[a]);
      if (u >= 0.0 && u < length) {
        at = at * size_[a] + static_cast<std::size_t>(u * per_edge_);
      } else {
        if (std::isnan(u)) return 0.0;
        within = false;
        outside = std::max(outside, u < 0.0 ? -u : u - (length - 1.0));
      }
    }
    if (distance_.empty()) return kFar;
    if (!within) return outside;
    const int blocks = distance_[at];
    return blocks == 0 ? 0.0 : edge_ * (blocks - 1);
  }

  /// Size of the blocks' distances, one byte each [bytes]; 0 for a grid without data.
  [[nodiscard]] std::uint64_t memory() const noexcept { return distance_.capacity(); }

 private:
  static constexpr double kFar = 1e9;

  std::array<double, 3> lower_{};       ///< First voxel.
  std::array<std::size_t, 3> size_{};   ///< Number of blocks along each axis.
  double edge_ = 8.0;                   ///< Edge of a block [voxels], a power of two.
  double per_edge_ = 0.125;             ///< 1 / edge_.
  std::vector<std::uint8_t> distance_;  ///< Distance to the nearest block with data, along the axis
                                        ///< where it is farthest; at most 255 [blocks].
};

}  // namespace palpate
