/// The "simple Euler solver" of Lundin et al., section 4.3, with a constant step.
#pragma once

#include <span>

#include "palpate/bench/methods/method.h"

namespace palpate::methods {

struct EulerFixedParams {
  /// Length of a step as a share of 1/k. With 1, a step moves the proxy to the place where the
  /// present forces balance the spring.
  double step = 1e-3;
  /// The method stops when |f_res| <= tolerance * S, with S the sum of strengths. The next move
  /// would be shorter than step * tolerance * S/k.
  double tolerance = 1e-4;
  int max_iterations = 20000;
};

/// Iterates x <- x + (step / k) f_res(x), eq. (14) exactly as printed (zero on a kink), from
/// `start`.
///
/// If the balance lies on a kink, f_res does not vanish near the balance. The proxy then chatters
/// about the kink by up to step * s/k, and only the iteration limit stops it. So `step` sets the
/// accuracy, and 1 / step the cost, since the error of a smooth problem falls by the factor 1 -
/// step per iteration. The default reaches 1e-3 S/k; a chart should try others.
///
/// @param probe       Hand position [m].
/// @param stiffness   k [N/m], > 0.
/// @param start       Last proxy [m].
[[nodiscard]] Balance eulerFixed(const Vec3& probe, double stiffness,
                                 std::span<const Primitive> primitives, const Vec3& start,
                                 const EulerFixedParams& params = {}) noexcept;

}  // namespace palpate::methods
