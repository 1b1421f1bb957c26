/// Private to samplers: kernels that interpolate in a cell, from data that load() caches.
///
/// A kernel implements one order of interpolation. At position t in the cell it returns a row: C
/// components of the value, then their derivatives by the first, second and third index. If
/// kBlendsRows, a row is linear in the rows of the cell's corners, and load() rotates these into W.
/// Data are plain arrays: in a large translation unit the compiler does not inline Eigen's
/// expressions, which makes them slow.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>

#include "palpate/engine/types.h"

namespace palpate {

/// The cubic polynomial c0 + c1 s + c2 s^2 + c3 s^3.
using Cubic = std::array<double, 4>;

/// Returns the first s from 0 to 1 at which a cubic falls below zero after a value above zero; 2 if
/// the cubic does not.
/// @param above  In: true if a value before this cubic was above zero. Out: also true if the
///               cubic was above zero.
/// @param first  If true and `above` is false, a cubic that begins at or below zero and falls
///               counts as a fall at s = 0.
inline double firstFall(const Cubic& c, bool first, bool& above) noexcept {
  const auto at = [&c](double s) { return c[0] + s * (c[1] + s * (c[2] + s * c[3])); };
  if (c[0] > 0.0) above = true;
  if (first && !above) {
    const double slope = c[1] != 0.0 ? c[1] : c[2] != 0.0 ? c[2] : c[3];
    if (slope < 0.0) return 0.0;
  }
  // The cubic is monotone between its turning points.
  std::array<double, 4> ends{0.0, 1.0, 1.0, 1.0};
  std::size_t count = 1;
  const double a = 3.0 * c[3];
  const double half = c[2];
  const double root = half * half - a * c[1];
  if (root > 0.0) {
    // Computes the roots of a s^2 + 2 half s + c1 without cancellation.
    const double q = -(half + std::copysign(std::sqrt(root), half));
    const double s1 = a != 0.0 ? q / a : 2.0;
    const double s2 = q != 0.0 ? c[1] / q : 2.0;
    for (const double s : {std::min(s1, s2), std::max(s1, s2)}) {
      if (s > 0.0 && s < 1.0) ends[count++] = s;
    }
  }
  ends[count++] = 1.0;
  for (std::size_t i = 0; i + 1 < count; ++i) {
    const double end = at(ends[i + 1]);
    if (end > 0.0) above = true;
    if (!above || !(end < 0.0)) continue;
    double low = ends[i];
    double high = ends[i + 1];
    for (int n = 0; n < 50; ++n) {
      const double middle = 0.5 * (low + high);
      (at(middle) > 0.0 ? low : high) = middle;
    }
    return low;
  }
  return 2.0;
}

/// A cube of W^3 voxels, given by the addresses of its rows. `first` has the address of the first
/// number of each row (i, j), which runs along the last axis. Components are side by side. Rows at
/// the rim along both axes may be unset if the kernel's kNeedsEdges is false.
template <class Number, int W>
struct Rows {
  static constexpr std::size_t kW = W;
  std::array<const Number*, kW * kW> first;

  [[nodiscard]] const Number* operator()(std::size_t i, std::size_t j) const noexcept {
    return first[i * kW + j];
  }
};

/// Returns the bit of voxel (i, j, k) in the mask of active voxels of a cube.
template <int W>
constexpr int bitOf(int i, int j, int k) noexcept {
  return (i * W + j) * W + k;
}

/// Returns the bits of the cell that has voxel (0, 0, 0) of the cube as its lowest corner.
template <int W>
constexpr std::uint64_t cellBits() noexcept {
  std::uint64_t bits = 0;
  for (int n = 0; n < 8; ++n) bits |= std::uint64_t{1} << bitOf<W>(n >> 2, (n >> 1) & 1, n & 1);
  return bits;
}

/// The polynomial c0 + c1 u + c2 v + c3 w + c4 uv + c5 uw + c6 vw + c7 uvw, for N numbers at once.
template <std::size_t N>
class Trilinear {
 public:
  /// Computes the coefficients from a cell's eight corners. The last index varies fastest.
  void load(const std::array<std::array<double, 8>, N>& at) noexcept {
    for (std::size_t n = 0; n < N; ++n) {
      const std::array<double, 8>& d = at[n];
      c[0][n] = d[0];
      c[1][n] = d[4] - d[0];
      c[2][n] = d[2] - d[0];
      c[3][n] = d[1] - d[0];
      c[4][n] = (d[6] - d[2]) - c[1][n];
      c[5][n] = (d[5] - d[1]) - c[1][n];
      c[6][n] = (d[3] - d[1]) - c[2][n];
      c[7][n] = (d[7] - d[3]) - (d[5] - d[1]) - c[4][n];
    }
  }
  template <std::size_t M>
  [[gnu::always_inline]] void read(const Vec3& t, std::array<double, M>& out) const noexcept {
    const double x = t.x();
    const double y = t.y();
    const double z = t.z();
    for (std::size_t n = 0; n < std::min(M, N); ++n) {
      const double uv = c[4][n] + c[7][n] * z;
      const double u = c[1][n] + c[5][n] * z;
      const double v = c[2][n] + c[6][n] * z;
      out[n] = c[0][n] + c[3][n] * z + v * y + (u + uv * y) * x;
    }
  }

  std::array<std::array<double, N>, 8> c;  ///< Indexed by coefficient, then by number.
};

/// Kernel for vectors with C components. The value is trilinear. The derivatives are trilinearly
/// interpolated central differences, and continuous.
template <int C>
class TrilinearKernel {
 public:
  /// Width of the block that load() reads [voxels].
  static constexpr int kWidth = 4;
  /// Voxels of the block before the cell, or before the voxel if kNearest.
  static constexpr int kBefore = 1;
  /// True if the block is centred on the nearest voxel, not on the cell.
  static constexpr bool kNearest = false;
  static constexpr bool kBlendsRows = true;
  /// True if the kernel needs the rows at the rim of the block along two axes.
  static constexpr bool kNeedsEdges = false;
  /// True if the derivatives use the reader's slope reach.
  static constexpr bool kDifferences = false;
  static constexpr std::size_t kC = C;
  using Row = std::array<double, 4 * kC>;

  template <class Number, class Turn>
  void load(const Rows<Number, kWidth>& rows, Turn turn) noexcept {
    // Each pass computes two corners, which differ in the last index.
    std::array<std::array<double, 8>, 4 * kC> at;
    for (std::size_t n = 0; n < 8; n += 2) {
      const std::size_t i = 1 + n / 4;
      const std::size_t j = 1 + n / 2 % 2;
      const auto half = [](Number low, Number high) {
        return 0.5 * (static_cast<double>(high) - static_cast<double>(low));
      };
      for (std::size_t c = 0; c < kC; ++c) {
        for (std::size_t k = 0; k < 2; ++k) {
          const std::size_t m = (1 + k) * kC + c;
          at[c][n + k] = static_cast<double>(rows(i, j)[m]);
          at[kC + c][n + k] = half(rows(i - 1, j)[m], rows(i + 1, j)[m]);
          at[2 * kC + c][n + k] = half(rows(i, j - 1)[m], rows(i, j + 1)[m]);
          at[3 * kC + c][n + k] = half(rows(i, j)[m - kC], rows(i, j)[m + kC]);
        }
      }
    }
    turn(at);
    rows_.load(at);
  }

  /// Like load(), but computes differences only between voxels with data, the bits of `known`. The
  /// derivatives at a voxel without data are zero.
  template <class Number, class Turn>
  [[gnu::noinline]] void loadKnown(const Rows<Number, kWidth>& rows, std::uint64_t known,
                                   Turn turn) noexcept {
    using Voxel = std::array<int, 3>;
    const auto is_known = [known](const Voxel& v) {
      return (known >> bitOf<kWidth>(v[0], v[1], v[2]) & 1U) != 0;
    };
    const auto number_at = [&rows](const Voxel& v, std::size_t c) {
      const Number* row = rows(static_cast<std::size_t>(v[0]), static_cast<std::size_t>(v[1]));
      return static_cast<double>(row[static_cast<std::size_t>(v[2]) * kC + c]);
    };
    std::array<std::array<double, 8>, 4 * kC> at;
    for (std::size_t n = 0; n < 8; ++n) {
      const auto bits = static_cast<int>(n);
      const Voxel here{1 + bits / 4, 1 + bits / 2 % 2, 1 + bits % 2};
      for (std::size_t c = 0; c < kC; ++c) at[c][n] = number_at(here, c);
      for (std::size_t a = 0; a < 3; ++a) {
        Voxel low = here;
        Voxel high = here;
        --low[a];
        ++high[a];
        if (!is_known(low)) low = here;
        if (!is_known(high)) high = here;
        const int steps = is_known(here) ? high[a] - low[a] : 0;
        const double scale = steps == 0 ? 0.0 : 1.0 / steps;
        for (std::size_t c = 0; c < kC; ++c) {
          at[(1 + a) * kC + c][n] = scale * (number_at(high, c) - number_at(low, c));
        }
      }
    }
    turn(at);
    rows_.load(at);
  }

  [[gnu::always_inline]] void read(const Vec3& t, Row& row) const noexcept { rows_.read(t, row); }
  [[gnu::always_inline]] void value(const Vec3& t, std::array<double, kC>& v) const noexcept {
    rows_.read(t, v);
  }

 private:
  Trilinear<4 * kC> rows_;
};

/// Kernel for scalars. The value V is trilinear. The derivative along axis a is the difference
///
///     g_a(t) = (V(t + r e_a) - V(t - r e_a)) / 2r,     r: the reach, above 0 and at most 1 voxel,
///
/// which is continuous, and exact for quadratics if r is 1/2 or 1. g_a is a weighted mean of the
/// slopes of the cell and of the cells before and after it. Up to r = 1/2, at most one of these two
/// neighbours contributes.
template <>
class TrilinearKernel<1> {
 public:
  static constexpr int kWidth = 4;
  static constexpr int kBefore = 1;
  static constexpr bool kNearest = false;
  static constexpr bool kBlendsRows = false;
  static constexpr bool kNeedsEdges = false;
  static constexpr bool kDifferences = true;
  static constexpr std::size_t kC = 1;
  using Row = std::array<double, 4>;

  template <class Number, class Turn>
  void load(const Rows<Number, kWidth>& rows, Turn /*turn*/) noexcept {
    const auto at = [&](std::size_t i, std::size_t j, std::size_t k) {
      return static_cast<double>(rows(i, j)[k]);
    };
    face_ = bilinear(at(1, 1, 1), at(1, 1, 2), at(1, 2, 1), at(1, 2, 2));
    for (std::size_t m = 0; m < 3; ++m) {
      // Slopes along each axis, at the four edges of cell m that are parallel to the axis: at (0,
      // 0), (0, 1), (1, 0) and (1, 1) of the other two axes.
      std::array<std::array<double, 4>, 3> d;
      for (std::size_t n = 0; n < 4; ++n) {
        const std::size_t p = 1 + n / 2;
        const std::size_t q = 1 + n % 2;
        d[0][n] = at(m + 1, p, q) - at(m, p, q);
        d[1][n] = at(p, m + 1, q) - at(p, m, q);
        d[2][n] = at(p, q, m + 1) - at(p, q, m);
      }
      for (std::size_t a = 0; a < 3; ++a) {
        const Bilinear c = bilinear(d[a][0], d[a][1], d[a][2], d[a][3]);
        for (std::size_t n = 0; n < 4; ++n) slopes_[a][n][m] = c[n];
      }
    }
  }

  [[gnu::always_inline]] void read(const Vec3& t, double reach, Row& row) const noexcept {
    row[0] = valueAt(t);
    for (std::size_t a = 0; a < 3; ++a) {
      const double at = t[static_cast<Eigen::Index>(a)];
      const auto [P, Q] = kAside[a];
      if (reach == 0.5) {
        const std::size_t first = at < 0.5 ? 0 : 1;  // first of the two cells that t +- 1/2 spans
        const std::array<double, 2> s = slopesAlong<2>(a, first, t[P], t[Q]);
        const double second = at + 0.5 - static_cast<double>(first);
        row[a + 1] = (1.0 - second) * s[0] + second * s[1];
      } else {
        const Cells s = slopesAlong<3>(a, 0, t[P], t[Q]);
        const Cells w = weights(at, reach);
        row[a + 1] = w[0] * s[0] + w[1] * s[1] + w[2] * s[2];
      }
    }
  }

  /// Returns the derivatives of the gradient by the index, as [component of the gradient][index].
  [[nodiscard]] std::array<std::array<double, 3>, 3> turning(const Vec3& t,
                                                             double reach) const noexcept {
    return reach <= 0.5 ? turningOver<2>(t, reach) : turningOver<3>(t, reach);
  }

  [[gnu::always_inline]] void value(const Vec3& t, std::array<double, 1>& v) const noexcept {
    v[0] = valueAt(t);
  }
  /// Returns the bounds of the trilinear value in the cell: its extreme corner values.
  [[nodiscard]] std::pair<double, double> range() const noexcept {
    const Polynomial c = polynomial();
    const double xy = c.u + c.v + c.uv;
    const double xz = c.u + c.w + c.uw;
    const double yz = c.v + c.w + c.vw;
    const double all = xy + c.w + c.uw + c.vw + c.uvw;
    const auto [least, most] = std::minmax({0.0, c.u, c.v, c.w, xy, xz, yz, all});
    return {c.one + least, c.one + most};
  }
  /// Returns the value at t + s d as a cubic in s.
  [[nodiscard]] Cubic along(const Vec3& t, const Vec3& d) const noexcept {
    const Polynomial c = polynomial();
    const Vec3 by = slope(t);
    const double uv = c.uv + c.uvw * t.z();
    const double uw = c.uw + c.uvw * t.y();
    const double vw = c.vw + c.uvw * t.x();
    return {valueAt(t), by.x() * d.x() + by.y() * d.y() + by.z() * d.z(),
            uv * d.x() * d.y() + uw * d.x() * d.z() + vw * d.y() * d.z(),
            c.uvw * d.x() * d.y() * d.z()};
  }
  /// Returns the gradient by index of the cell's polynomial. It jumps at the cell's faces.
  [[nodiscard]] Vec3 slope(const Vec3& t) const noexcept {
    const Polynomial c = polynomial();
    const double uv = c.uv + c.uvw * t.z();
    return Vec3(c.u + c.uw * t.z() + uv * t.y(), c.v + c.vw * t.z() + uv * t.x(),
                c.w + c.uw * t.x() + (c.vw + c.uvw * t.x()) * t.y());
  }

 private:
  /// Numbers for the cell before the present cell, the present cell, and the cell after it.
  using Cells = std::array<double, 3>;
  /// The polynomial c0 + c1 p + c2 q + c3 pq.
  using Bilinear = std::array<double, 4>;
  /// The value in the cell: one + u x + v y + w z + uv xy + uw xz + vw yz + uvw xyz.
  struct Polynomial {
    double one, u, v, w, uv, uw, vw, uvw;
  };
  /// For each axis, the other two axes.
  static constexpr std::array<std::array<Eigen::Index, 2>, 3> kAside{{{1, 2}, {0, 2}, {0, 1}}};

  /// Makes a bilinear polynomial from the numbers at (0, 0), (0, 1), (1, 0) and (1, 1).
  static Bilinear bilinear(double d00, double d01, double d10, double d11) noexcept {
    return {d00, d10 - d00, d01 - d00, (d11 - d01) - (d10 - d00)};
  }
  /// Returns the slopes along axis a of N cells from `first` on, at (p, q) on the other two axes.
  template <std::size_t N>
  [[nodiscard, gnu::always_inline]] std::array<double, N> slopesAlong(std::size_t a,
                                                                      std::size_t first, double p,
                                                                      double q) const noexcept {
    const auto& c = slopes_[a];
    std::array<double, N> s;
    for (std::size_t m = 0; m < N; ++m) {
      const std::size_t cell = first + m;
      s[m] = c[0][cell] + c[1][cell] * p + (c[2][cell] + c[3][cell] * p) * q;
    }
    return s;
  }
  /// turning(), with the N cells that the span t +- reach can meet: 2 up to a reach of 1/2, else 3.
  template <std::size_t N>
  [[nodiscard, gnu::always_inline]] std::array<std::array<double, 3>, 3> turningOver(
      const Vec3& t, double reach) const noexcept {
    std::array<std::array<double, 3>, 3> by;
    for (std::size_t a = 0; a < 3; ++a) {
      const auto [P, Q] = kAside[a];
      const double p = t[P];
      const double q = t[Q];
      const double at = t[static_cast<Eigen::Index>(a)];
      const std::size_t first = N == 3 || at < 0.5 ? 0 : 1;
      const std::array<double, N> s = slopesAlong<N>(a, first, p, q);
      const Cells w = weights(at, reach);
      const auto& c = slopes_[a];
      double by_p = 0.0;
      double by_q = 0.0;
      for (std::size_t n = 0; n < N; ++n) {
        const std::size_t m = first + n;
        by_p += w[m] * (c[1][m] + c[3][m] * q);
        by_q += w[m] * (c[2][m] + c[3][m] * p);
      }
      by[a][static_cast<std::size_t>(P)] = by_p;
      by[a][static_cast<std::size_t>(Q)] = by_q;
      // If t grows, the span gains the slope just above t + reach and loses that just above t -
      // reach.
      // Without sums, which round: at + 1/2 can be 1 for `at` below 1/2.
      const double enters = s[(at >= 1.0 - reach ? 2 : 1) - first];
      const double leaves = s[(at < reach ? 0 : 1) - first];
      by[a][a] = (enters - leaves) / (2.0 * reach);
    }
    return by;
  }
  /// Returns the shares of the span t +- reach in the three cells; t is from 0 to 1.
  [[nodiscard]] static Cells weights(double t, double reach) noexcept {
    const double scale = 0.5 / reach;
    const double before = std::max(0.0, (reach - t) * scale);
    const double after = std::max(0.0, (t + reach - 1.0) * scale);
    return {before, 1.0 - before - after, after};
  }
  [[nodiscard, gnu::always_inline]] double valueAt(const Vec3& t) const noexcept {
    const auto& c = slopes_[0];
    const double q = t.z();
    return face_[0] + face_[2] * q + (face_[1] + face_[3] * q) * t.y() +
           (c[0][1] + c[2][1] * q + (c[1][1] + c[3][1] * q) * t.y()) * t.x();
  }
  [[nodiscard]] Polynomial polynomial() const noexcept {
    const auto& c = slopes_[0];
    return {face_[0], c[0][1], face_[1], face_[2], c[1][1], c[2][1], face_[3], c[3][1]};
  }

  Bilinear face_;  ///< The value on the cell's lower face along the first axis.
  /// Slopes along each axis in each cell, as [axis][coefficient][cell].
  std::array<std::array<Cells, 4>, 3> slopes_;
};

/// Evaluates p(t) = c0 + c1 t + ... + c_n t^n and its derivative, by Horner's rule.
template <int Degree>
[[gnu::always_inline]] inline void horner(const double* c, std::size_t stride, double t, double& p,
                                          double& slope) noexcept {
  p = c[Degree * stride];
  slope = 0.0;
  for (std::size_t i = Degree; i-- > 0;) {
    slope = i == Degree - 1 ? p : slope * t + p;
    p = p * t + c[i * stride];
  }
}
template <int Degree>
[[gnu::always_inline]] inline double horner(const double* c, std::size_t stride,
                                            double t) noexcept {
  double p = c[Degree * stride];
  for (std::size_t i = Degree; i-- > 0;) p = p * t + c[i * stride];
  return p;
}

/// Kernel for B-splines of degree 2 or 3. The block contains spline coefficients, which load()
/// converts to the polynomial sum of c_ijk u^i v^j w^k.
template <int C, int Degree>
class SplineKernel {
 public:
  static constexpr int kWidth = Degree + 1;
  static constexpr int kBefore = 1;
  /// If true, t is from -1/2 to 1/2 along each axis, else from 0 to 1.
  static constexpr bool kNearest = Degree == 2;
  static constexpr bool kBlendsRows = false;
  static constexpr bool kNeedsEdges = true;
  static constexpr bool kDifferences = false;
  static constexpr std::size_t kC = C;
  using Row = std::array<double, 4 * kC>;

  template <class Number, class Turn>
  void load(const Rows<Number, kWidth>& rows, Turn /*turn*/) noexcept {
    for (std::size_t n = 0; n < kSide * kSide; ++n) {
      std::copy_n(rows.first[n], kSide * kC, c_.data() + n * kLine);
    }
    for (std::size_t n = 0; n < kPlane; ++n) toPolynomial(c_.data() + n, kPlane);
    for (std::size_t i = 0; i < kSide; ++i) {
      double* plane = c_.data() + i * kPlane;
      for (std::size_t n = 0; n < kLine; ++n) toPolynomial(plane + n, kLine);
    }
    for (std::size_t i = 0; i < kSide * kSide; ++i) {
      double* line = c_.data() + i * kLine;
      for (std::size_t n = 0; n < kC; ++n) toPolynomial(line + n, kC);
    }
  }

  [[gnu::always_inline]] void read(const Vec3& t, Row& row) const noexcept {
    const double x = t.x();
    const double y = t.y();
    const double z = t.z();
    // Evaluates along x for a plane of coefficients, then along y for a line, then along z.
    std::array<double, kPlane> plane;
    std::array<double, kPlane> plane_x;
    for (std::size_t n = 0; n < kPlane; ++n) {
      horner<Degree>(c_.data() + n, kPlane, x, plane[n], plane_x[n]);
    }
    std::array<double, kLine> line;
    std::array<double, kLine> line_x;
    std::array<double, kLine> line_y;
    for (std::size_t n = 0; n < kLine; ++n) {
      horner<Degree>(plane.data() + n, kLine, y, line[n], line_y[n]);
      line_x[n] = horner<Degree>(plane_x.data() + n, kLine, y);
    }
    for (std::size_t n = 0; n < kC; ++n) {
      horner<Degree>(line.data() + n, kC, z, row[n], row[3 * kC + n]);
      row[kC + n] = horner<Degree>(line_x.data() + n, kC, z);
      row[2 * kC + n] = horner<Degree>(line_y.data() + n, kC, z);
    }
  }

  /// Returns the derivatives of the first component's gradient as [component of the
  /// gradient][index]. Central differences: exact up to rounding for degree 2. For degree 3, the
  /// error is 1e-6 times the cubic coefficient along the axis.
  [[nodiscard]] std::array<std::array<double, 3>, 3> turning(const Vec3& t) const noexcept {
    constexpr double kAside = 1e-3;
    std::array<std::array<double, 3>, 3> by;
    for (std::size_t a = 0; a < 3; ++a) {
      Row ahead;
      Row back;
      const Vec3 aside = kAside * Vec3::Unit(static_cast<Eigen::Index>(a));
      read(t + aside, ahead);
      read(t - aside, back);
      for (std::size_t r = 0; r < 3; ++r) {
        const std::size_t n = (r + 1) * kC;
        by[r][a] = (ahead[n] - back[n]) / (2.0 * kAside);
      }
    }
    return by;
  }

 private:
  /// Converts coefficients along one axis, `stride` numbers apart, from spline to polynomial.
  static void toPolynomial(double* c, std::size_t stride) noexcept {
    const double c0 = c[0];
    const double c1 = c[stride];
    const double c2 = c[2 * stride];
    if constexpr (Degree == 2) {
      c[0] = 0.125 * (c0 + c2) + 0.75 * c1;
      c[stride] = 0.5 * (c2 - c0);
      c[2 * stride] = 0.5 * (c0 + c2) - c1;
    } else {
      const double c3 = c[3 * stride];
      c[0] = (c0 + 4.0 * c1 + c2) * (1.0 / 6.0);
      c[stride] = 0.5 * (c2 - c0);
      c[2 * stride] = 0.5 * (c0 + c2) - c1;
      c[3 * stride] = 0.5 * (c1 - c2) + (c3 - c0) * (1.0 / 6.0);
    }
  }

  static constexpr std::size_t kSide = kWidth;
  /// Even, so that a load of two numbers matches an earlier store (store forwarding).
  static constexpr std::size_t kLine = (kSide * kC + 1) / 2 * 2;
  static constexpr std::size_t kPlane = kSide * kLine;
  std::array<double, kSide * kPlane> c_{};
};

/// Kernel for labels: the value of the nearest voxel, with zero derivatives.
template <int C>
class NearestKernel {
 public:
  static constexpr int kWidth = 1;
  static constexpr int kBefore = 0;
  static constexpr bool kNearest = true;
  static constexpr bool kBlendsRows = true;
  static constexpr bool kNeedsEdges = true;
  static constexpr bool kDifferences = false;
  static constexpr std::size_t kC = C;
  using Row = std::array<double, 4 * kC>;

  template <class Number, class Turn>
  void load(const Rows<Number, kWidth>& rows, Turn turn) noexcept {
    std::array<std::array<double, 1>, 4 * kC> at{};
    for (std::size_t c = 0; c < kC; ++c) at[c][0] = static_cast<double>(rows(0, 0)[c]);
    turn(at);
    for (std::size_t c = 0; c < 4 * kC; ++c) row_[c] = at[c][0];
  }
  [[gnu::always_inline]] void read(const Vec3& /*t*/, Row& row) const noexcept { row = row_; }
  [[nodiscard]] static std::array<std::array<double, 3>, 3> turning(const Vec3& /*t*/) noexcept {
    return {};
  }

 private:
  Row row_;
};

}  // namespace palpate
