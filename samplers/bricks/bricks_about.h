/// Finds a region around a brick in which no reading needs to check for missing bricks.
#pragma once

#include <array>
#include <cstdlib>

#include "palpate/engine/types.h"
#include "palpate/samplers/bricks/bricks.h"

namespace palpate::detail {

/// Returns a box around a brick, which may extend into the brick's neighbours. Every point of the
/// box is at least `fade` away from all missing bricks. If p itself is at least `fade` away from
/// each missing brick along one of the axes, the box contains p.
/// @param p      A point in the brick [voxels].
/// @param first  Position of the brick's first voxel [voxels].
/// @param fade   Smallest distance to missing bricks, at most half a brick [voxels].
/// @param there  Called as there(std::array<int, 3> off), where off is -1, 0 or 1 along each axis.
///               Returns true if the neighbour at that offset is loaded.
/// @return       The box [voxels]. It includes its lower faces and excludes its upper faces.
template <class There>
[[nodiscard]] Box bricksAbout(const Vec3& p, const Vec3& first, double fade,
                              const There& there) noexcept {
  const Vec3 end = first + Vec3::Constant(kBrickSide);
  Box box{first - Vec3::Constant(kBrickSide - fade), end + Vec3::Constant(kBrickSide - fade)};
  // Neighbours across faces first, then across edges, then across corners.
  for (int touching = 1; touching <= 3; ++touching) {
    for (int n = 0; n < 27; ++n) {
      const std::array<int, 3> off{n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1};
      if (std::abs(off[0]) + std::abs(off[1]) + std::abs(off[2]) != touching) continue;
      // Cuts the box along the axis along which p is farthest from the missing brick.
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
