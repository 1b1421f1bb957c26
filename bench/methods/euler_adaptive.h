/// The paper's own solver: Lundin et al., section 4.3, Euler with an adaptive step length.
#pragma once

#include <span>

#include "palpate/bench/methods/method.h"

namespace palpate::methods {

struct EulerAdaptiveParams {
  double grow = 1.002;   ///< Factor by which the step grows if |f_res| fell.
  double shrink = 0.75;  ///< Factor by which the step shrinks if |f_res| did not fall.
  /// Stops when a move is at most tolerance * S/k, with S the sum of strengths. The steps become
  /// small early, so an error of 1e-3 S/k needs this much smaller tolerance.
  double tolerance = 3e-5;
  int max_iterations = 1000;
};

/// Iterates x <- x + (h / k) f_res(x) from `start` with h = 1, where f_res is that of eq. (14).
/// Every step is accepted. After a step, h grows (up to 1) if |f_res| fell; otherwise h shrinks.
///
/// The paper gives no rule for the step. This rule reached the balance most often among the rules
/// that we compared. palpate_bench_speed_accuracy prints its share of the cases that reach a given
/// accuracy, its cost, and those of two variants. A rule that rejects steps which increase E or
/// |f_res| is worse: near a kink every step along f_res increases them. A faster growth of h makes
/// the proxy chatter.
///
/// The method often reaches its iteration limit if a kink holds the proxy at almost s/k or almost
/// zero distance from the probe, as at the beginning of a contact. On one side of the kink f_res is
/// small and falls, so h grows. Then one step by the large force on the opposite side undoes many
/// steps.
///
/// @param probe       Hand position [m].
/// @param stiffness   k [N/m], > 0.
/// @param start       Last proxy [m].
[[nodiscard]] Balance eulerAdaptive(const Vec3& probe, double stiffness,
                                    std::span<const Primitive> primitives, const Vec3& start,
                                    const EulerAdaptiveParams& params = {}) noexcept;

}  // namespace palpate::methods
