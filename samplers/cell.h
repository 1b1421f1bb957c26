/// Private to samplers: what is kept of the last cell of a grid, and how it is read.
///
/// A kernel is one order of interpolation. It keeps what it needs of the voxels about a cell and
/// answers, at a position t in it, with one row: C components of the value, then their derivatives
/// by the first, second and third index. Where rows blend linearly (kBlendsRows), load() turns the
/// rows of the cell's corners into W, and what is read is turned already. All in plain arrays: in a
/// unit as large as OpenVDB's the compiler no longer inlines Eigen's expressions, at three times
/// the cost.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>

#include "palpate/engine/types.h"

namespace palpate {

/// c0 + c1 s + c2 s^2 + c3 s^3.
using Cubic = std::array<double, 4>;

/// Where a cubic first falls below zero for s from 0 to 1, or 2 where it does not. `above`: it was
/// above zero before, and says afterwards whether it has been. `first`: where it begins at or below
/// zero and falls, that counts.
inline double firstFall(const Cubic& c, bool first, bool& above) noexcept {
  const auto at = [&c](double s) { return c[0] + s * (c[1] + s * (c[2] + s * c[3])); };
  if (c[0] > 0.0) above = true;
  if (first && !above) {
    const double slope = c[1] != 0.0 ? c[1] : c[2] != 0.0 ? c[2] : c[3];
    if (slope < 0.0) return 0.0;
  }
  // Between its turning points it is monotone.
  std::array<double, 4> ends{0.0, 1.0, 1.0, 1.0};
  std::size_t count = 1;
  const double a = 3.0 * c[3];
  const double half = c[2];
  const double root = half * half - a * c[1];
  if (root > 0.0) {
    // The roots of a s^2 + 2 half s + c1 without cancellation.
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

/// A cube of W^3 voxels, wherever they lie: of row (i, j), along the last axis, the first number;
/// the components of a voxel side by side.
template <class Number, int W>
struct Rows {
  static constexpr std::size_t kW = W;
  std::array<const Number*, kW * kW> first;

  [[nodiscard]] const Number* operator()(std::size_t i, std::size_t j) const noexcept {
    return first[i * kW + j];
  }
};

/// The bit of voxel (i, j, k) in a cube's mask.
template <int W>
constexpr int bitOf(int i, int j, int k) noexcept {
  return (i * W + j) * W + k;
}

/// The bits of a cell's eight voxels in a cube's mask, the cell's lower corner at (0, 0, 0).
template <int W>
constexpr std::uint64_t cellBits() noexcept {
  std::uint64_t bits = 0;
  for (int n = 0; n < 8; ++n) bits |= std::uint64_t{1} << bitOf<W>(n >> 2, (n >> 1) & 1, n & 1);
  return bits;
}

/// Trilinear value; derivatives are trilinearly interpolated central differences, continuous. Kept
/// as the polynomial c0 + c1 u + c2 v + c3 w + c4 uv + c5 uw + c6 vw + c7 uvw of each number.
template <int C>
class TrilinearKernel {
 public:
  static constexpr int kWidth = 4;         ///< Voxels along an edge of the block it is made of.
  static constexpr int kBefore = 1;        ///< Of these, before the cell or the nearest voxel.
  static constexpr bool kNearest = false;  ///< Centred on the nearest voxel, not on the cell.
  static constexpr bool kBlendsRows = true;
  static constexpr bool kNeedsEdges = false;  ///< Voxels at the rim of two axes of the block.
  static constexpr std::size_t kC = C;
  using Row = std::array<double, 4 * kC>;

  template <class Number, class Turn>
  void load(const Rows<Number, kWidth>& rows, Turn turn) noexcept {
    // Number by number, the eight corners side by side: two along the last axis at a time.
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
    for (std::size_t n = 0; n < 4 * kC; ++n) {
      const std::array<double, 8>& d = at[n];
      c_[0][n] = d[0];
      c_[1][n] = d[4] - d[0];
      c_[2][n] = d[2] - d[0];
      c_[3][n] = d[1] - d[0];
      c_[4][n] = (d[6] - d[2]) - c_[1][n];
      c_[5][n] = (d[5] - d[1]) - c_[1][n];
      c_[6][n] = (d[3] - d[1]) - c_[2][n];
      c_[7][n] = (d[7] - d[3]) - (d[5] - d[1]) - c_[4][n];
    }
  }

  [[gnu::always_inline]] void read(const Vec3& t, Row& row) const noexcept {
    const double x = t.x();
    const double y = t.y();
    const double z = t.z();
    for (std::size_t n = 0; n < 4 * kC; ++n) {
      const double uv = c_[4][n] + c_[7][n] * z;
      const double u = c_[1][n] + c_[5][n] * z;
      const double v = c_[2][n] + c_[6][n] * z;
      row[n] = c_[0][n] + c_[3][n] * z + v * y + (u + uv * y) * x;
    }
  }

  /// How the gradient's rows (of the first component) change by the index, [row][index].
  [[nodiscard]] std::array<std::array<double, 3>, 3> turning(const Vec3& t) const noexcept {
    const double x = t.x();
    const double y = t.y();
    const double z = t.z();
    std::array<std::array<double, 3>, 3> by;
    for (std::size_t r = 0; r < 3; ++r) {
      const std::size_t n = (r + 1) * kC;
      const double uv = c_[4][n] + c_[7][n] * z;
      by[r] = {c_[1][n] + c_[5][n] * z + uv * y, c_[2][n] + c_[6][n] * z + uv * x,
               c_[3][n] + c_[5][n] * x + (c_[6][n] + c_[7][n] * x) * y};
    }
    return by;
  }

  /// The value alone.
  [[gnu::always_inline]] void value(const Vec3& t, std::array<double, kC>& v) const noexcept {
    const double x = t.x();
    const double y = t.y();
    const double z = t.z();
    for (std::size_t n = 0; n < kC; ++n) {
      const double uv = c_[4][n] + c_[7][n] * z;
      const double u = c_[1][n] + c_[5][n] * z;
      const double w = c_[2][n] + c_[6][n] * z;
      v[n] = c_[0][n] + c_[3][n] * z + w * y + (u + uv * y) * x;
    }
  }
  /// Least and largest value of the cell's corners (first component), and so of the cell.
  [[nodiscard]] std::pair<double, double> range() const noexcept {
    const double x = c_[1][0];
    const double y = c_[2][0];
    const double z = c_[3][0];
    const double xy = x + y + c_[4][0];
    const double xz = x + z + c_[5][0];
    const double yz = y + z + c_[6][0];
    const double all = xy + z + c_[5][0] + c_[6][0] + c_[7][0];
    const auto [least, most] = std::minmax({0.0, x, y, z, xy, xz, yz, all});
    return {c_[0][0] + least, c_[0][0] + most};
  }
  /// The value (its first component) along t + s d: a cubic in s.
  [[nodiscard]] Cubic along(const Vec3& t, const Vec3& d) const noexcept {
    std::array<double, kC> at;
    value(t, at);
    const Vec3 by = slope(t);
    const double uvw = c_[7][0];
    const double uv = c_[4][0] + uvw * t.z();
    const double uw = c_[5][0] + uvw * t.y();
    const double vw = c_[6][0] + uvw * t.x();
    return {at[0], by.x() * d.x() + by.y() * d.y() + by.z() * d.z(),
            uv * d.x() * d.y() + uw * d.x() * d.z() + vw * d.y() * d.z(),
            uvw * d.x() * d.y() * d.z()};
  }

  /// Gradient by the index of the value's own polynomial (its first component's).
  [[nodiscard]] Vec3 slope(const Vec3& t) const noexcept {
    const double uv = c_[4][0] + c_[7][0] * t.z();
    return Vec3(c_[1][0] + c_[5][0] * t.z() + uv * t.y(), c_[2][0] + c_[6][0] * t.z() + uv * t.x(),
                c_[3][0] + c_[5][0] * t.x() + (c_[6][0] + c_[7][0] * t.x()) * t.y());
  }

 private:
  std::array<Row, 8> c_;
};

/// p(t) = c0 + c1 t + ... and its derivative, by Horner's rule.
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

/// B-spline of degree 2 or 3 whose coefficients the block holds: value, and its own derivative.
/// Kept as the polynomial of the piece, a sum over c_ijk u^i v^j w^k.
template <int C, int Degree>
class SplineKernel {
 public:
  static constexpr int kWidth = Degree + 1;
  static constexpr int kBefore = 1;
  static constexpr bool kNearest = Degree == 2;  ///< t from -1/2 to 1/2, else from 0 to 1.
  static constexpr bool kBlendsRows = false;
  static constexpr bool kNeedsEdges = true;
  static constexpr std::size_t kC = C;
  using Row = std::array<double, 4 * kC>;

  template <class Number, class Turn>
  void load(const Rows<Number, kWidth>& rows, Turn /*turn*/) noexcept {
    for (std::size_t n = 0; n < kSide * kSide; ++n) {
      std::copy_n(rows.first[n], kSide * kC, c_.data() + n * kLine);
    }
    // From spline to polynomial, axis by axis.
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
    // Along x: all of a plane at once; then y, a line at once; then z.
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

  /// How the gradient's rows (of the first component) change by the index, [row][index]: central
  /// differences of the piece's polynomial, exact for degree 2 and to 1e-6 for 3.
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
  /// Coefficients of the splines about a piece, a stride apart, to those of its polynomial.
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

  /// Lines of an even length: in pairs from end to end, what is stored is loaded again as it was.
  static constexpr std::size_t kSide = kWidth;
  static constexpr std::size_t kLine = (kSide * kC + 1) / 2 * 2;
  static constexpr std::size_t kPlane = kSide * kLine;
  std::array<double, kSide * kPlane> c_{};
};

/// The nearest voxel's value, derivatives zero: for labels.
template <int C>
class NearestKernel {
 public:
  static constexpr int kWidth = 1;
  static constexpr int kBefore = 0;
  static constexpr bool kNearest = true;
  static constexpr bool kBlendsRows = true;
  static constexpr bool kNeedsEdges = true;
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
