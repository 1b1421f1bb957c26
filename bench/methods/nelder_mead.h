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
/// (simplex.h).
///
/// Minimising the potential, not |f_res|, is the fair interpretation of the method, because |f_res|
/// has other minima (smallest_residual.h). `start` is first moved to within S/k of the probe, where
/// the balance must lie. Otherwise the search would go the whole way in steps of the simplex's
/// size.
///
/// Measured as in euler_adaptive.h, 200 problems per family (60 with 32 primitives): within 1e-3
/// S/k of the answer in 99.8 % with 2 primitives (273 evaluations on average), 99.9 % with 8 (265)
/// and 32 (256). Without the restart 99 % in 150; with tolerance 1e-4 99 % in 210; with both
/// changes 97 % in 120 (60, 40 and 15 problems per family). The restart helps because a simplex can
/// collapse on a kink before it has arrived.
///
/// @param probe       Hand position [m].
/// @param stiffness   k [N/m], > 0.
/// @param start       Last proxy [m].
[[nodiscard]] Balance nelderMead(const Vec3& probe, double stiffness,
                                 std::span<const Primitive> primitives, const Vec3& start,
                                 const NelderMeadParams& params = {}) noexcept;

}  // namespace palpate::methods
