/// The literal interpretation of Lundin et al., section 4.2: the smallest |f_res|.
#pragma once

#include <span>

#include "palpate/bench/methods/method.h"

namespace palpate::methods {

struct SmallestResidualParams {
  double size = 0.5;        ///< Edge of each first simplex as a share of S/k.
  double tolerance = 1e-5;  ///< A search stops when its simplex is smaller than this share of S/k.
  /// Largest number of starting points: `start`, the probe, then anchors.
  int searches = 2;
  int max_evaluations = 2000;
};

/// Solves eq. (15) "by minimizing the magnitude of the function", with eq. (14) exactly as printed
/// (zero on a kink), even if the minimum is not the balance. The paper does not say how to
/// minimise. |f_res| jumps at every kink, and has a minimum of its own in many of the cells between
/// kinks. So we search by downhill simplex (simplex.h), which needs no gradient. The searches start
/// at several points, each moved to within S/k of the probe, and the smallest result is kept.
///
/// The kinks of planes bound cells, and a search reaches the cells' edges. The force of a line or a
/// point is zero only on a set without volume, which floating-point numbers can meet at most at an
/// anchor.
///
/// Measured as in euler_adaptive.h, 200 problems per family (60 with 32 primitives): within 1e-3
/// S/k of the balance in 93 % with 2 primitives (359 evaluations on average), 86 % with 8 (386), 93
/// % with 32 (377). Additional searches from every anchor find a smaller |f_res|, but no more
/// balances (93 instead of 95 %, 84 and 84, 95 and 95 on 40, 40 and 15 problems per family), at 2,
/// 4 and 12 times the cost. With 8 planes, in 8 of 100 problems another place had a smaller |f_res|
/// than every place that was found about the balance.
///
/// @param probe       Hand position [m].
/// @param stiffness   k [N/m], > 0.
/// @param start       Last proxy [m].
[[nodiscard]] Balance smallestResidual(const Vec3& probe, double stiffness,
                                       std::span<const Primitive> primitives, const Vec3& start,
                                       const SmallestResidualParams& params = {}) noexcept;

}  // namespace palpate::methods
