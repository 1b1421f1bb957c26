/// Private to engine/balance: an upper bound on the distance from a guess to the balance.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include "palpate/engine/balance/terms.h"

namespace palpate::solver {

/// A multiplier z counts as parallel to its displacement d if z.d is above this share of |d|.
inline constexpr double kAlong = 1.0 - 1e-4;

/// Returns an upper bound on |y - y*|, the distance from the place `at` to the balance y*. The
/// duality gap is a sum of terms >= 0, so no cancellation amplifies the rounding errors. The
/// function computes the gap for two dual points and returns the smaller bound. The first consists
/// of the multipliers. In the second, d/|d| replaces each multiplier that is parallel to d = P y -
/// b. Sets `by_multipliers` to true if the second bound is not smaller, else to false.
inline double certify(const Problem& problem, const Vec3& at, bool& by_multipliers) noexcept {
  constexpr double kLastDigits = 4.0 * kEpsilon;
  const Terms& t = problem.terms;
  const double x = at.x();
  const double y = at.y();
  const double z = at.z();
  double gap = 0.0;
  double mx = 0.0;
  double my = 0.0;
  double mz = 0.0;
  double off_gap = 0.0;
  double ox = 0.0;
  double oy = 0.0;
  double oz = 0.0;
#pragma omp simd reduction(+ : gap, mx, my, mz, off_gap, ox, oy, oz)
  for (std::size_t i = 0; i < t.count; ++i) {
    const auto [dx, dy, dz] = displacement(t, i, x, y, z);
    const double zx = t.z[0][i];
    const double zy = t.z[1][i];
    const double zz = t.z[2][i];
    const double sigma = t.sigma[i];
    const double distance = std::sqrt(dx * dx + dy * dy + dz * dz);
    const double held = zx * dx + zy * dy + zz * dz;
    // The second summand covers the rounding of `distance - held`.
    const double loss = sigma * (larger(distance - held, 0.0) + kLastDigits * distance);
    const bool off = held > kAlong * distance;
    const double per = 1.0 / larger(distance, std::numeric_limits<double>::min());
    gap += loss;
    mx += sigma * zx;
    my += sigma * zy;
    mz += sigma * zz;
    off_gap += off ? 0.0 : loss;
    ox += sigma * (off ? per * dx : zx);
    oy += sigma * (off ? per * dy : zy);
    oz += sigma * (off ? per * dz : zz);
  }
  const Vec3 stretch = at - problem.spring;
  const double by_z = 2.0 * gap + (stretch + Vec3(mx, my, mz)).squaredNorm();
  const double by_d = 2.0 * off_gap + (stretch + Vec3(ox, oy, oz)).squaredNorm();
  by_multipliers = by_z <= by_d;
  return std::sqrt(std::min(by_z, by_d));
}

/// Replaces the multipliers by the second dual point of certify().
inline void turnAlongDisplacements(Problem& problem, const Vec3& at) noexcept {
  const Terms& t = problem.terms;
  for (std::size_t i = 0; i < t.count; ++i) {
    const auto [x, y, z] = displacement(t, i, at.x(), at.y(), at.z());
    const Vec3 d(x, y, z);
    const double distance = d.norm();
    if (get(t.z, i).dot(d) > kAlong * distance) set(t.z, i, d / distance);
  }
}

}  // namespace palpate::solver
