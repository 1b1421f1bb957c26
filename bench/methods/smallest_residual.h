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

/// Solves eq. (15) "by minimizing the magnitude of the function", with f_res of eq. (14), even if
/// the minimum is not the balance. On its kink, a primitive contributes zero to f_res. |f_res|
/// jumps at every kink, and has other minima between kinks. So downhill simplex searches
/// (simplex.h) start at several points within S/k of the probe, and the smallest result is kept. A
/// search can reach the kinks of planes. It reaches the kinks of lines and points only if it starts
/// at an anchor.
///
/// Measured as in euler_adaptive.h, with 200 problems per family (60 with 32 primitives). The share
/// of results within 1e-3 S/k of the balance is 93 % with 2 primitives (359 evaluations on
/// average), 86 % with 8 (386), 93 % with 32 (377). More searches find smaller |f_res|, but no more
/// balances.
///
/// @param probe       Hand position [m].
/// @param stiffness   k [N/m], > 0.
/// @param start       Last proxy [m].
[[nodiscard]] Balance smallestResidual(const Vec3& probe, double stiffness,
                                       std::span<const Primitive> primitives, const Vec3& start,
                                       const SmallestResidualParams& params = {}) noexcept;

}  // namespace palpate::methods
