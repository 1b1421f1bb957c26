/// Private to engine/balance: the primitives as dimensionless terms of the potential in solver.h.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

#include "palpate/engine/types.h"

namespace palpate::solver {

inline constexpr double kEpsilon = std::numeric_limits<double>::epsilon();

/// The primitives of one balance, without directed forces, as terms sigma |P y - b|. P = alpha I +
/// beta q q^T is the projector on the constrained directions: three for a point, two for a line,
/// one for a plane. Each member is an array over the terms, so that the loops are vectorised.
///
/// b = P a, where a is the anchor: its position along the line or plane has no effect. If the kink
/// is near the origin, b is small, and distances to the kink have small rounding errors.
struct Terms {
  std::size_t count = 0;
  double* sigma;
  double* alpha;             ///< 1 for a point, 1 for a line, 0 for a plane
  double* beta;              ///< 0 for a point, -1 for a line, 1 for a plane
  std::array<double*, 3> q;  ///< unit direction
  std::array<double*, 3> b;
  std::array<double*, 3> z;  ///< multiplier: the force is -sigma z, |z| <= 1, in the range of P
  std::array<double*, 3> u;  ///< working memory of envelopeGradient(), Line and Pivots
  std::size_t* source;       ///< index of the primitive

  /// Sets b to P (scale (b - origin)).
  void placeFeet(const Vec3& origin, double scale) noexcept;
  /// Projects the last tick's multipliers into this tick's range of P. Keeps their length, at most
  /// 1, which states whether the primitive held the proxy.
  void turnMultipliers() noexcept;

  static constexpr std::size_t kFields = 15;
};

template <std::size_t Capacity>
struct Storage {
  // If the size of the arrays were a power of two, all fields would map to the same sets of the
  // cache.
  std::array<std::array<double, Capacity + 8>, Terms::kFields> fields;
  std::array<std::size_t, Capacity> source;

  Terms view() noexcept {
    const auto at = [&](std::size_t i) { return fields[i].data(); };
    return {0,
            at(0),
            at(1),
            at(2),
            {at(3), at(4), at(5)},
            {at(6), at(7), at(8)},
            {at(9), at(10), at(11)},
            {at(12), at(13), at(14)},
            source.data()};
  }
};

inline Vec3 get(const std::array<double*, 3>& field, std::size_t i) noexcept {
  return {field[0][i], field[1][i], field[2][i]};
}

inline void set(const std::array<double*, 3>& field, std::size_t i, const Vec3& v) noexcept {
  for (std::size_t axis = 0; axis < 3; ++axis) field[axis][i] = v[static_cast<Eigen::Index>(axis)];
}

/// Returns the larger value. std::max returns a reference, which prevents vectorisation.
inline double larger(double a, double b) noexcept {
  return a > b ? a : b;
}

/// Solves H x = b for a symmetric H with eigenvalues >= 1, by L D L^T.
inline Vec3 solve3(const Mat3& H, const Vec3& b) noexcept {
  const double i0 = 1.0 / H(0, 0);
  const double l10 = H(1, 0) * i0;
  const double l20 = H(2, 0) * i0;
  const double i1 = 1.0 / (H(1, 1) - l10 * H(1, 0));
  const double m = H(2, 1) - l10 * H(2, 0);
  const double l21 = m * i1;
  const double d2 = H(2, 2) - l20 * H(2, 0) - l21 * m;
  const double y1 = b[1] - l10 * b[0];
  const double y2 = b[2] - l20 * b[0] - l21 * y1;
  Vec3 x;
  x[2] = y2 / d2;
  x[1] = y1 * i1 - l21 * x[2];
  x[0] = b[0] * i0 - l10 * x[1] - l20 * x[2];
  return x;
}

/// Three numbers. In the loops below the compiler keeps a Triple, unlike a Vec3, in vector
/// registers.
struct Triple {
  double x;
  double y;
  double z;
};

/// Returns P (x, y, z) of term i.
inline Triple constrained(const Terms& t, std::size_t i, double x, double y, double z) noexcept {
  const double qx = t.q[0][i];
  const double qy = t.q[1][i];
  const double qz = t.q[2][i];
  const double alpha = t.alpha[i];
  const double along = t.beta[i] * (qx * x + qy * y + qz * z);
  return {alpha * x + along * qx, alpha * y + along * qy, alpha * z + along * qz};
}

inline Vec3 project(const Terms& terms, std::size_t i, const Vec3& v) noexcept {
  const auto [x, y, z] = constrained(terms, i, v.x(), v.y(), v.z());
  return {x, y, z};
}

inline void Terms::placeFeet(const Vec3& origin, double scale) noexcept {
  const double ox = origin.x();
  const double oy = origin.y();
  const double oz = origin.z();
#pragma omp simd
  for (std::size_t i = 0; i < count; ++i) {
    // Projects twice: near the origin, b can be as small as the rounding error outside P's range.
    const auto [ax, ay, az] = constrained(*this, i, scale * (b[0][i] - ox), scale * (b[1][i] - oy),
                                          scale * (b[2][i] - oz));
    const auto [bx, by, bz] = constrained(*this, i, ax, ay, az);
    b[0][i] = bx;
    b[1][i] = by;
    b[2][i] = bz;
  }
}

inline void Terms::turnMultipliers() noexcept {
#pragma omp simd
  for (std::size_t i = 0; i < count; ++i) {
    const double zx = z[0][i];
    const double zy = z[1][i];
    const double zz = z[2][i];
    const auto [ax, ay, az] = constrained(*this, i, zx, zy, zz);
    const auto [bx, by, bz] = constrained(*this, i, ax, ay, az);
    const double length = std::sqrt(zx * zx + zy * zy + zz * zz);
    const double turned = std::sqrt(bx * bx + by * by + bz * bz);
    const double scale = (length < 1.0 ? length : 1.0) / larger(turned, kEpsilon);
    z[0][i] = scale * bx;
    z[1][i] = scale * by;
    z[2][i] = scale * bz;
  }
}

/// The potential to minimise, and the numbers that convert the solution to metres.
struct Problem {
  /// the spring's end, displaced by directed forces, relative to the probe [m]
  Vec3 w = Vec3::Zero();
  double length = 0.0;         ///< T/k [m]
  Vec3 spring = Vec3::Zero();  ///< the spring's end, in units of T/k from the origin
  Terms terms;

  /// Moves the origin to `to`, so that distances near it have small rounding errors.
  void moveOrigin(const Vec3& to) noexcept {
    spring -= to;
    terms.placeFeet(to, 1.0);
  }
  /// Returns a solution as a displacement from the probe [m].
  [[nodiscard]] Vec3 offset(const Vec3& y) const noexcept { return w + length * (y - spring); }
};

/// Returns d = P y - b of term i.
inline Triple displacement(const Terms& t, std::size_t i, double x, double y, double z) noexcept {
  const auto [px, py, pz] = constrained(t, i, x, y, z);
  return {px - t.b[0][i], py - t.b[1][i], pz - t.b[2][i]};
}

}  // namespace palpate::solver
