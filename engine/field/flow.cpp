#include "palpate/engine/field/flow.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace palpate {
namespace {

/// Returns the middle eigenvalue of a symmetric matrix M, in closed form except for one step of
/// Halley's method. The eigenvalue farthest from the others is a well-conditioned root of the
/// characteristic polynomial. The other two may be close; they are computed from the matrix
/// deflated by the first. The function avoids acos and cos, which cost more.
double middleEigenvalue(double xx, double yy, double zz, double xy, double xz, double yz) noexcept {
  const double mean = (xx + yy + zz) * (1.0 / 3.0);
  xx -= mean;
  yy -= mean;
  zz -= mean;
  // |M - mean I|^2 = 6 p^2; (M - mean I) / p has eigenvalues 2 cos(a + i 120 deg), cos 3a = h.
  const double p =
      std::sqrt((xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0);
  if (p < 1e-150) return mean;
  const double by = 1.0 / p;
  for (double* entry : {&xx, &yy, &zz, &xy, &xz, &yz}) *entry *= by;
  const double h =
      0.5 * (xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz));

  // Solves x^3 - 3 x = 2 |h| for x in sqrt(3) to 2. A polynomial is accurate to 2e-6, and one step
  // of Halley's method reduces the error to about its cube.
  const double size = std::min(std::abs(h), 1.0);
  double x =
      1.73205212 +
      size * (0.33323771 +
              size * (-0.09505003 + size * (0.04379925 + size * (-0.0179329 + size * 0.0038946))));
  const double value = x * (x * x - 3.0) - 2.0 * size;
  const double slope = 3.0 * x * x - 3.0;
  x -= value * slope / (slope * slope - 3.0 * x * value);
  const double sign = std::copysign(1.0, h);
  const double apart = sign * x;

  // `apart` is the eigenvalue of N = (M - mean I) / p with the largest magnitude. The projector on
  // its eigenvector is adj(N - `apart` I), divided by the trace of this matrix (6 to 9).
  const double ax = xx - apart;
  const double ay = yy - apart;
  const double az = zz - apart;
  double pxx = ay * az - yz * yz;
  double pyy = ax * az - xz * xz;
  double pzz = ax * ay - xy * xy;
  double pxy = xz * yz - xy * az;
  double pxz = xy * yz - xz * ay;
  double pyz = xy * xz - yz * ax;
  const double out = 1.5 * apart / (pxx + pyy + pzz);
  for (double* entry : {&pxx, &pyy, &pzz, &pxy, &pxz, &pyz}) *entry *= out;
  // The deflated matrix has eigenvalues 0, s and -s; the other two of N are -apart / 2 +- s.
  const double dx = xx + 0.5 * apart - pxx;
  const double dy = yy + 0.5 * apart - pyy;
  const double dz = zz + 0.5 * apart - pzz;
  const double dxy = xy - pxy;
  const double dxz = xz - pxz;
  const double dyz = yz - pyz;
  const double s =
      std::sqrt(0.5 * (dx * dx + dy * dy + dz * dz) + dxy * dxy + dxz * dxz + dyz * dyz);
  return mean + p * (-0.5 * apart + sign * s);
}

}  // namespace

double lambda2(const Mat3& J) noexcept {
  // S is the symmetric and O the antisymmetric part of J. S^2 + O^2 is the symmetric part of J J.
  const auto middle = [](const Mat3& A) {
    const double* a = A.data();
    const double xx = a[0] * a[0] + a[3] * a[1] + a[6] * a[2];
    const double yy = a[1] * a[3] + a[4] * a[4] + a[7] * a[5];
    const double zz = a[2] * a[6] + a[5] * a[7] + a[8] * a[8];
    const double xy = 0.5 * ((a[0] + a[4]) * (a[3] + a[1]) + a[6] * a[5] + a[7] * a[2]);
    const double xz = 0.5 * ((a[0] + a[8]) * (a[6] + a[2]) + a[3] * a[7] + a[5] * a[1]);
    const double yz = 0.5 * ((a[4] + a[8]) * (a[7] + a[5]) + a[1] * a[6] + a[2] * a[3]);
    return middleEigenvalue(xx, yy, zz, xy, xz, yz);
  };
  double size = 0.0;
  for (const double* a = J.data(); a != J.data() + 9; ++a) {
    if (!std::isfinite(*a)) return std::numeric_limits<double>::quiet_NaN();
    size = std::max(size, std::abs(*a));
  }
  // In this range, the fourth power of the largest entry neither overflows nor vanishes. Other
  // matrices are scaled.
  if (size > 1e-60 && size < 1e60) return middle(J);
  if (size < 1e-160) return 0.0;
  return middle(J / size) * size * size;
}

}  // namespace palpate
