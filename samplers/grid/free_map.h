/// Private to samplers: a coarse map of a grid's empty regions, in which no reading is needed.
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

/// Stores, for each block of voxels, the distance to the nearest block with data.
class FreeMap {
 public:
  /// A box of voxels, from `lower` to `upper`.
  struct Voxels {
    std::array<int, 3> lower;  ///< Least index along each axis.
    std::array<int, 3> upper;  ///< Greatest index along each axis, included.
  };

  /// Makes the map of a grid that has no data.
  FreeMap() = default;
  /// Makes the map of a grid that has data only in these boxes. Needs one byte for each block of
  /// 8^3 voxels within their bounds. If that exceeds 4 MB, doubles the edge of the blocks until the
  /// map fits. Slow, allocates.
  explicit FreeMap(std::span<const Voxels> data);

  /// Returns a lower bound of the Chebyshev distance from p_I to the nearest voxel with data
  /// [voxels]. The Chebyshev distance is the largest distance along an axis. Returns 0 if data may
  /// be next to p_I, or if p_I is NaN; 1e9 if there is no data. RT: no allocation. Cost: one memory
  /// access.
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

  /// Returns the memory for the blocks' distances [bytes]; 0 for a grid without data.
  [[nodiscard]] std::uint64_t memory() const noexcept { return distance_.capacity(); }

 private:
  static constexpr double kFar = 1e9;

  std::array<double, 3> lower_{};      ///< Index of the first voxel of the map along each axis.
  std::array<std::size_t, 3> size_{};  ///< Number of blocks along each axis.
  double edge_ = 8.0;                  ///< Edge of a block [voxels], a power of two.
  double per_edge_ = 0.125;            ///< 1 / edge_.
  /// Chebyshev distance of each block to the nearest block with data [blocks], at most 255.
  std::vector<std::uint8_t> distance_;
};

}  // namespace palpate
