/// Finds the region around a brick where all bricks are loaded, once instead of at each reading.
#pragma once

#include <array>
#include <cstdlib>

#include "palpate/engine/types.h"
#include "palpate/samplers/bricks/bricks.h"

namespace palpate::detail {

/// Returns a box around a brick, at most into its neighbours. All points of the box are at least
/// `fade` away from missing bricks. If p is as far from each missing brick along an axis, p is in
/// the box.
/// @param p      A point in the brick [voxels].
/// @param first  The brick's first voxel [voxels].
/// @param fade   Distance to missing bricks, at most half a brick [voxels].
/// @param there  there(std::array<int, 3> off) of a neighbour, by -1 to 1 along each axis.
/// @return       The box includes its lower faces, not its upper ones [voxels].
template <class There>
[[nodiscard]] Box bricksAbout(const Vec3& p, const Vec3& first, double fade,
                              const There& there) noexcept {
  const Vec3 end = first + Vec3::Constant(kBrickSide);
  Box box{first - Vec3::Constant(kBrickSide - fade), end + Vec3::Constant(kBrickSide - fade)};
  for (int touching = 1; touching <= 3; ++touching) {  // faces first, then edges, corners
    for (int n = 0; n < 27; ++n) {
      const std::array<int, 3> off{n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1};
      if (std::abs(off[0]) + std::abs(off[1]) + std::abs(off[2]) != touching) continue;
      // Cut along the axis along which the point is farthest from the brick.
      Eigen::Index axis = 0;
      double farthest = -1.0;
      bool reached = true;
      for (Eigen::Index a = 0; a < 3; ++a) {
        const int side = off[static_cast<std::size_t>(a)];
        if (side == 0) continue;
        reached =
            reached && (side > 0 ? box.upper[a] > end[a] - fade : box.lower[a] < first[a] + fade);
        const double far = side > 0 ? end[a] - p[a] : p[a] - first[a];
        if (far <= farthest) continue;
        farthest = far;
        axis = a;
      }
      if (!reached || there(off)) continue;
      if (off[static_cast<std::size_t>(axis)] > 0) {
        box.upper[axis] = end[axis] - fade;
      } else {
        box.lower[axis] = first[axis] + fade;
      }
    }
  }
  return box;
}

}  // namespace palpate::detail
