/// How far about a brick all is there, found at once instead of at each reading.
#pragma once

#include <array>
#include <cstdlib>

#include "palpate/engine/types.h"
#include "palpate/samplers/bricks.h"

namespace palpate::detail {

/// A box about a brick and within those about it, with nothing nearer than `fade` to one that is
/// not there. A place that is as far from these, along an axis each, is in it.
/// @param p      In the brick [voxels].
/// @param first  The brick's first voxel [voxels].
/// @param fade   At most half a brick [voxels].
/// @param there  there(std::array<int, 3> off) of a brick about it, by -1 to 1 along each axis.
/// @return       Its lower face is within, its upper one is not [voxels].
template <class There>
[[nodiscard]] Box bricksAbout(const Vec3& p, const Vec3& first, double fade,
                              const There& there) noexcept {
  const Vec3 end = first + Vec3::Constant(kBrickSide);
  Box box{first - Vec3::Constant(kBrickSide - fade), end + Vec3::Constant(kBrickSide - fade)};
  for (int touching = 1; touching <= 3; ++touching) {  // by faces first, then edges, corners
    for (int n = 0; n < 27; ++n) {
      const std::array<int, 3> off{n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1};
      if (std::abs(off[0]) + std::abs(off[1]) + std::abs(off[2]) != touching) continue;
      // Of the axes to cut along, the one along which the place is farthest from it.
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
