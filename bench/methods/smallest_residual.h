/// The literal interpretation of Lundin et al., section 4.2: the smallest |f_res|.
#pragma once

#include <span>

#include "palpate/bench/methods/method.h"

namespace palpate::methods {

struct SmallestResidualParams {
  double size = 0.5;        ///< Edge of each first simplex as a share of S/k.
  double tolerance = 1e-5;  ///< A search stops when its simplex is smaller than this share of S/k.
  /// Largest number of starting points, at least 1: `start`, the probe, then anchors.
  int searches = 2;
  int max_evaluations = 2000;
};

/// Solves eq. (15) "by minimizing the magnitude of the function", with f_res of eq. (14), even if
/// the minimum is not the balance. On its kink, a primitive contributes zero to f_res. |f_res|
/// jumps at every kink, and has other minima between kinks. So downhill simplex searches
/// (simplex.h) start at several points within S/k of the probe, and the smallest result is kept. A
/// search can reach the kinks of planes. It hits the kinks of lines and points exactly only if it
/// starts on them, as at an anchor. palpate_bench_speed_accuracy prints the share of the cases that
/// reach a given accuracy, and the cost.
///
/// @param probe       Hand position [m].
/// @param stiffness   k [N/m], > 0.
/// @param start       Last proxy [m].
[[nodiscard]] Balance smallestResidual(const Vec3& probe, double stiffness,
                                       std::span<const Primitive> primitives, const Vec3& start,
                                       const SmallestResidualParams& params = {}) noexcept;

}  // namespace palpate::methods
