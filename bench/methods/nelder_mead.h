/// The alternative that Lundin et al. name in section 4.3: "such as the Nelder-Mead Solver".
#pragma once

#include <span>

#include "palpate/bench/methods/method.h"

namespace palpate::methods {

struct NelderMeadParams {
  double size = 0.5;  ///< Edge of the first simplex as a share of S/k.
  /// The search stops when the simplex is smaller than this share of S/k.
  double tolerance = 1e-5;
  int restarts = 1;  ///< Restarts from the best point, with a tenth of `size`.
  int max_evaluations = 2000;
};

/// Minimises the potential of eq. (14), E of engine/balance/solver.h, by downhill simplex
/// (simplex.h). The method does not minimise |f_res|, which has additional minima
/// (smallest_residual.h). First moves `start` to within S/k of the probe, because the balance is
/// there.
///
/// Measured as in euler_adaptive.h, with 200 problems per family (60 with 32 primitives). The share
/// of results within 1e-3 S/k of the answer is 99.8 % with 2 primitives (273 evaluations on
/// average), 99.9 % with 8 (265) and 32 (256). Without the restart the share is 99 % (150
/// evaluations), because a simplex can collapse on a kink.
///
/// @param probe       Hand position [m].
/// @param stiffness   k [N/m], > 0.
/// @param start       Last proxy [m].
[[nodiscard]] Balance nelderMead(const Vec3& probe, double stiffness,
                                 std::span<const Primitive> primitives, const Vec3& start,
                                 const NelderMeadParams& params = {}) noexcept;

}  // namespace palpate::methods
