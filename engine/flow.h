/// What a vector field does at a point, from its Jacobian J(i, j) = d v_i / d x_j, its strain S =
/// (J + J^T) / 2 and its rotation O = (J - J^T) / 2.
#pragma once

#include "palpate/engine/types.h"

namespace palpate {

/// curl v = (dvz/dy - dvy/dz, dvx/dz - dvz/dx, dvy/dx - dvx/dy).
[[nodiscard]] inline Vec3 curl(const Mat3& J) noexcept {
  return {J(2, 1) - J(1, 2), J(0, 2) - J(2, 0), J(1, 0) - J(0, 1)};
}

/// div v, the trace of the Jacobian.
[[nodiscard]] inline double divergence(const Mat3& J) noexcept {
  return J.trace();
}

/// Q = (|O|^2 - |S|^2) / 2, Hunt, Wray and Moin 1988, Frobenius norms: > 0 where rotation prevails,
/// in a vortex. Departure: where the flow is not free of divergence Q is still this difference, not
/// the second invariant of J.
[[nodiscard]] inline double qCriterion(const Mat3& J) noexcept {
  // tr(J J) = |S|^2 - |O|^2.
  return -0.5 * (J(0, 0) * J(0, 0) + J(1, 1) * J(1, 1) + J(2, 2) * J(2, 2)) -
         (J(0, 1) * J(1, 0) + J(0, 2) * J(2, 0) + J(1, 2) * J(2, 1));
}

/// The middle eigenvalue of S^2 + O^2, Jeong and Hussain 1995: < 0 in a vortex.
///
/// Right to a few roundings of |J|^2, also where eigenvalues coincide. 0 where |J| < 1e-160; NaN
/// where J is not finite; infinite where the square overflows.
///
/// RT: no allocation. Cost: some 60 ns.
[[nodiscard]] double lambda2(const Mat3& J) noexcept PALPATE_NONBLOCKING;

/// Least length of a vector that has a direction, in the data's unit: the reciprocal of a shorter
/// one would be beyond what volumes may hold (samplers/prepare_values.h, 1e100).
inline constexpr double kShortest = 1e-100;

/// v / |v|; zero where |v| < kShortest (in the data's unit) or is not finite.
[[nodiscard]] inline Vec3 unit(const Vec3& v) noexcept {
  const double length = v.norm();
  // False for NaN as well.
  if (!(length >= kShortest) || !(length * 0.0 == 0.0)) return Vec3::Zero();
  return v / length;
}

/// How the direction of v turns, d(v/|v|)/dx, from v's Jacobian; zero where v has no direction.
[[nodiscard]] inline Mat3 turnOf(const Vec3& v, const Mat3& J) noexcept {
  const Vec3 q = unit(v);
  if (q.isZero(0.0)) return Mat3::Zero();
  const Mat3 turn = (J - q * (q.transpose() * J)) / v.norm();
  return turn.allFinite() ? turn : Mat3(Mat3::Zero());
}

}  // namespace palpate
