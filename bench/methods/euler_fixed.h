/// The "simple Euler solver" of Lundin et al., section 4.3, with a constant step.
#pragma once

#include <span>

#include "palpate/bench/methods/method.h"

namespace palpate::methods {

struct EulerFixedParams {
  /// Step as a share of 1/k. With 1, the proxy moves to the balance of the present forces.
  double step = 1e-3;
  /// Stops when |f_res| <= tolerance * S, with S the sum of strengths.
  double tolerance = 1e-4;
  int max_iterations = 20000;
};

/// Iterates x <- x + (step / k) f_res(x) from `start`, where f_res is that of eq. (14). On its
/// kink, a primitive contributes zero.
///
/// If the balance lies on a kink, the proxy chatters about the kink, by up to step * s/k, until the
/// iteration limit. So `step` sets the accuracy, and 1 / step the cost: where only the spring's
/// force changes with x, the error falls by the factor 1 - step per iteration.
///
/// @param probe       Hand position [m].
/// @param stiffness   k [N/m], > 0.
/// @param start       Last proxy [m].
[[nodiscard]] Balance eulerFixed(const Vec3& probe, double stiffness,
                                 std::span<const Primitive> primitives, const Vec3& start,
                                 const EulerFixedParams& params = {}) noexcept;

}  // namespace palpate::methods
