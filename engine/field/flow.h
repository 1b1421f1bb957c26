/// Quantities derived from the Jacobian J(i, j) = d v_i / d x_j of a vector field at a point. The
/// strain is S = (J + J^T) / 2 and the rotation O = (J - J^T) / 2.
#pragma once

#include "palpate/engine/types.h"

namespace palpate {

/// Returns curl v = (dvz/dy - dvy/dz, dvx/dz - dvz/dx, dvy/dx - dvx/dy).
[[nodiscard]] inline Vec3 curl(const Mat3& J) noexcept {
  return {J(2, 1) - J(1, 2), J(0, 2) - J(2, 0), J(1, 0) - J(0, 1)};
}

/// Returns div v, the trace of the Jacobian.
[[nodiscard]] inline double divergence(const Mat3& J) noexcept {
  return J.trace();
}

/// Returns Q = (|O|^2 - |S|^2) / 2 with Frobenius norms (Hunt, Wray and Moin 1988). Q > 0 in a
/// vortex, where rotation prevails. If the flow has divergence, this difference is not equal to the
/// second invariant of J.
[[nodiscard]] inline double qCriterion(const Mat3& J) noexcept {
  // tr(J J) = |S|^2 - |O|^2.
  return -0.5 * (J(0, 0) * J(0, 0) + J(1, 1) * J(1, 1) + J(2, 2) * J(2, 2)) -
         (J(0, 1) * J(1, 0) + J(0, 2) * J(2, 0) + J(1, 2) * J(2, 1));
}

/// Returns the middle eigenvalue of S^2 + O^2 (Jeong and Hussain 1995), < 0 in a vortex. Accurate
/// to a few roundings of |J|^2, even if eigenvalues coincide. The result is 0 if the magnitudes of
/// all entries of J are below 1e-160, NaN if J is not finite, and infinite if the eigenvalue
/// overflows. RT: no allocation.
[[nodiscard]] double lambda2(const Mat3& J) noexcept PALPATE_NONBLOCKING;

/// Least length for which unit() returns a direction, in the data's unit. The reciprocal of a
/// smaller length would exceed the range of volumes (1e100, samplers/grid/prepare_values.h).
inline constexpr double kShortest = 1e-100;

/// Returns v / |v|. Returns zero if |v| is below kShortest, or if |v|^2 overflows or is not finite.
[[nodiscard]] inline Vec3 unit(const Vec3& v) noexcept {
  const double length = v.norm();
  // The comparison is also false for NaN.
  if (!(length >= kShortest) || !(length * 0.0 == 0.0)) return Vec3::Zero();
  return v / length;
}

/// Returns the derivative of v's direction, d(v/|v|)/dx; zero if unit() returns zero or the
/// derivative is not finite.
[[nodiscard]] inline Mat3 turnOf(const Vec3& v, const Mat3& J) noexcept {
  const Vec3 q = unit(v);
  if (q.isZero(0.0)) return Mat3::Zero();
  const Mat3 turn = (J - q * (q.transpose() * J)) / v.norm();
  return turn.allFinite() ? turn : Mat3(Mat3::Zero());
}

}  // namespace palpate
