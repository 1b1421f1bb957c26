/// The alternative that Lundin et al. name in section 4.3: "such as the Nelder-Mead Solver".
#pragma once

#include <span>

#include "palpate/bench/methods/method.h"

namespace palpate::methods {

struct NelderMeadParams {
  double size = 0.5;  ///< Edge of the first simplex as a share of S/k.
  /// The search stops when the simplex is smaller than this share of S/k.
  double tolerance = 1e-5;
  int restarts = 1;  ///< Restarts from the best point, each with a tenth of the size before.
  int max_evaluations = 2000;  ///< Limit for all searches together (SimplexParams).
};

/// Minimises the potential of eq. (14), E of engine/balance/solver.h, by downhill simplex
/// (simplex.h). The method does not minimise |f_res|, which has additional minima
/// (smallest_residual.h). First moves `start` to within S/k of the probe, because the balance is
/// there.
///
/// The restart helps if a simplex has collapsed on a kink. palpate_bench_speed_accuracy prints the
/// share of the cases that reach a given accuracy, and the cost.
///
/// @param probe       Hand position [m].
/// @param stiffness   k [N/m], > 0.
/// @param start       Last proxy [m].
[[nodiscard]] Balance nelderMead(const Vec3& probe, double stiffness,
                                 std::span<const Primitive> primitives, const Vec3& start,
                                 const NelderMeadParams& params = {}) noexcept;

}  // namespace palpate::methods
