#include "bench/methods/constraint_approach.h"

#include <cmath>

namespace palpate::methods {

Vec3 constraintProxy(const Vec3& probe, const Vec3& proxy, double stiffness,
                     std::span<const Constraint> constraints) noexcept {
  const Vec3 eta = probe - proxy;  // eq. (1)
  Vec3 moved = proxy;
  for (const Constraint& c : constraints) {
    // Eq. (2) for q and for -q: a constraint holds in both senses of its direction.
    const double along = eta.dot(c.direction);
    const double yielded = std::abs(along) - c.strength / stiffness;
    if (yielded > 0.0) moved += (along > 0.0 ? yielded : -yielded) * c.direction;
  }
  return moved;
}

}  // namespace palpate::methods
