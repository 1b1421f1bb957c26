/// Private to samplers: fields over OpenVDB's grids, for each type and interpolation. Include it in
/// .cpp files only.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <mutex>
#include <new>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

#include <Eigen/Eigenvalues>
#include <openvdb/tree/ValueAccessor.h>

#include "palpate/engine/trace_cells.h"
#include "palpate/samplers/cell.h"
#include "palpate/samplers/openvdb_grids.h"
#include "palpate/samplers/spline.h"
#include "palpate/samplers/vdb_field.h"
#include "palpate/samplers/volume_grid.h"

namespace palpate::detail {

using openvdb::Coord;

inline constexpr int kNoCell = std::numeric_limits<int>::max();

template <class Value>
double componentOf(const Value& value, int c) noexcept {
  if constexpr (std::is_arithmetic_v<Value>) {
    return static_cast<double>(value);
  } else {
    return static_cast<double>(value[c]);
  }
}

/// A leaf or a tile: rows of eight voxels along the last axis. A tile has one for all.
template <class Value>
class LeafOrTile {
 public:
  /// The one that a voxel is in.
  template <class Accessor>
  [[gnu::always_inline]] void find(Accessor& accessor, const Coord& voxel) noexcept {
    if (const auto* leaf = accessor.probeConstLeaf(voxel)) {
      values_ = &leaf->buffer()[0];
      active_ = reinterpret_cast<const unsigned char*>(&leaf->valueMask());
      last_row_ = 63;
    } else {
      Value value;
      tile_active_ = accessor.probeValue(voxel, value) ? 0xff : 0;
      tile_.fill(value);
      values_ = tile_.data();
      active_ = &tile_active_;
      last_row_ = 0;
    }
  }
  [[nodiscard]] const Value* row(std::size_t n) const noexcept {
    return values_ + (n & last_row_) * 8;
  }
  /// Which voxels of the row are active, a bit each.
  [[nodiscard]] std::uint64_t active(std::size_t n) const noexcept {
    return active_[n & last_row_];
  }

 private:
  const Value* values_;
  const unsigned char* active_;
  std::size_t last_row_;
  std::array<Value, 8> tile_;
  unsigned char tile_active_;
};

/// A block of W^3 voxels, read where they lie. Without Edges it has no rows at the rim of two axes.
///
/// Along each axis it lies in one leaf or in two. Where it does decides hardly a branch, since none
/// of these would be foreseen, and little is done between finding the leaves and reading them, so
/// that out of a cold cache all rows come together.
template <class Value, int W, bool Edges>
class Block {
 public:
  using Number = typename openvdb::VecTraits<Value>::ElementType;

  /// The one whose lowest corner is `low`.
  template <class Accessor>
  [[gnu::always_inline]] Block(Accessor& accessor, const Coord& low) noexcept
      : x_(low[0] & 7), y_(low[1] & 7), z_(low[2] & 7), two_((z_ + kW - 1) / 8) {
    // The leaves: a bit for each axis, set for the second along it.
    const std::size_t last = (x_ + kW - 1) / 8 * 4 + (y_ + kW - 1) / 8 * 2 + two_;
    for (std::size_t n = last;; n = (n - 1) & last) {
      const auto end = [n](std::size_t axis) { return (n & axis) != 0 ? W - 1 : 0; };
      leaves_[n].find(accessor, low.offsetBy(end(4), end(2), end(1)));
      if (n == 0) break;
    }
    forRows([&](std::size_t i, std::size_t j) __attribute__((always_inline)) {
      if (!Edges && atRim(i) && atRim(j)) return;
      const std::size_t n = leafOf(i, j);
      const Value* row = leaves_[n].row(rowOf(i, j)) + z_;
      if (two_ != 0) {
        // The end of a row and the beginning of the next, side by side.
        Value* joined = joined_[i * kW + j].data();
        std::copy_n(row - z_ + 8 - kW, kW, joined);
        std::copy_n(leaves_[n + 1].row(rowOf(i, j)), kW, joined + kW);
        row = joined + z_ - (8 - kW);
      }
      rows_.first[i * kW + j] = reinterpret_cast<const Number*>(row);
    });
  }
  Block(const Block&) = delete;  // rows may lie in here
  Block& operator=(const Block&) = delete;

  [[nodiscard]] const Rows<Number, W>& rows() const noexcept { return rows_; }

  /// Which voxels are active, of those that can be a cell's corners: of four rows, the inner two.
  [[nodiscard, gnu::always_inline]] std::uint64_t active() const noexcept {
    std::uint64_t bits = 0;
    forRows([&](std::size_t i, std::size_t j) __attribute__((always_inline)) {
      if (W == 4 && (atRim(i) || atRim(j))) return;
      const std::size_t n = leafOf(i, j);
      const std::size_t row = rowOf(i, j);
      const std::uint64_t here = leaves_[n].active(row) | leaves_[n + two_].active(row) << 8;
      bits |= (here >> z_ & ((1U << W) - 1)) << (i * kW + j) * kW;
    });
    return bits;
  }

 private:
  static constexpr std::size_t kW = W;
  /// Calls f(i, j) row by row, written out: the compiler would keep a loop, at a tenth more time.
  template <class F>
  [[gnu::always_inline]] static void forRows(F f) noexcept {
    [&]<std::size_t... N>(std::index_sequence<N...> /*rows*/) __attribute__((always_inline)) {
      (f(N / kW, N % kW), ...);
    }
    (std::make_index_sequence<kW * kW>());
  }
  static constexpr bool atRim(std::size_t i) noexcept { return W > 1 && i * (kW - 1 - i) == 0; }
  /// Where row (i, j) is: the first leaf, and which row of it.
  [[nodiscard]] std::size_t leafOf(std::size_t i, std::size_t j) const noexcept {
    return (x_ + i) / 8 * 4 + (y_ + j) / 8 * 2;
  }
  [[nodiscard]] std::size_t rowOf(std::size_t i, std::size_t j) const noexcept {
    return (x_ + i) % 8 * 8 + (y_ + j) % 8;
  }

  std::size_t x_;  ///< The lowest corner, in its leaf.
  std::size_t y_;
  std::size_t z_;
  std::size_t two_;  ///< 1 where rows lie in two leaves.
  std::array<LeafOrTile<Value>, 8> leaves_;
  std::array<std::array<Value, 2 * kW>, kW * kW> joined_;
  Rows<Number, W> rows_;
};

/// A copy of vectors without a sign, in which all point along the main axis of the cell's eight.
class Aligned {
 public:
  template <class Number>
  explicit Aligned(const Rows<Number, 4>& from) noexcept {
    const auto at = [&from](std::size_t i, std::size_t j, std::size_t k) {
      const Number* v = from(i, j) + 3 * k;
      return Vec3(v[0], v[1], v[2]);
    };
    Mat3 spread = Mat3::Zero();
    for (std::size_t n = 0; n < 8; ++n) {
      const Vec3 v = at(1 + n / 4, 1 + n / 2 % 2, 1 + n % 2);
      spread += v * v.transpose();
    }
    Eigen::SelfAdjointEigenSolver<Mat3> axes;
    axes.computeDirect(spread);
    const Vec3 axis = axes.eigenvectors().col(2);
    for (std::size_t n = 0; n < 16; ++n) {
      const std::size_t i = n / 4;
      const std::size_t j = n % 4;
      if (i % 3 == 0 && j % 3 == 0) continue;  // an edge
      for (std::size_t k = 0; k < 4; ++k) {
        const Vec3 v = at(i, j, k);
        Eigen::Map<Vec3>(values_[n].data() + 3 * k) = v.dot(axis) < 0.0 ? Vec3(-v) : v;
      }
      rows_.first[n] = values_[n].data();
    }
  }
  Aligned(const Aligned&) = delete;
  Aligned& operator=(const Aligned&) = delete;

  [[nodiscard]] const Rows<double, 4>& rows() const noexcept { return rows_; }

 private:
  std::array<std::array<double, 12>, 16> values_;
  Rows<double, 4> rows_;
};

/// M v, written out: see cell.h.
[[gnu::always_inline]] inline Vec3 times(const Mat3& M, const Vec3& v) noexcept {
  const double* m = M.data();
  return {m[0] * v.x() + m[3] * v.y() + m[6] * v.z(), m[1] * v.x() + m[4] * v.y() + m[7] * v.z(),
          m[2] * v.x() + m[5] * v.y() + m[8] * v.z()};
}
/// (x, y, z) = M (x, y, z), at N places.
template <std::size_t N>
[[gnu::always_inline]] inline void combine(const Mat3& M, std::array<double, N>& x,
                                           std::array<double, N>& y,
                                           std::array<double, N>& z) noexcept {
  const double* m = M.data();
  for (std::size_t n = 0; n < N; ++n) {
    const double a = x[n];
    const double b = y[n];
    const double c = z[n];
    x[n] = m[0] * a + m[3] * b + m[6] * c;
    y[n] = m[1] * a + m[4] * b + m[7] * c;
    z[n] = m[2] * a + m[5] * b + m[8] * c;
  }
}

/// The map between W and a grid's index space, and what follows from it.
struct IndexMap {
  Mat3 index_from_world;  ///< p_I = index_from_world p_W + origin_I
  Mat3 world_from_index;
  Vec3 origin_I;
  Mat3 rotation;             ///< file to W
  Mat3 gradient_from_index;  ///< g_W = gradient_from_index g_I, per unit of the file
  bool straight;             ///< Index axes are W's: the maps are diagonal.

  IndexMap(const Volume::Grid::Part& part, const Placement& placement) {
    const Mat3 index_from_file = part.linear.inverse();
    index_from_world = index_from_file * placement.rotation.transpose() / placement.scale;
    world_from_index = placement.scale * placement.rotation * part.linear;
    origin_I = -index_from_world * placement.translate - index_from_file * part.origin;
    gradient_from_index = placement.rotation * index_from_file.transpose();
    rotation = placement.rotation;
    straight = index_from_world.isDiagonal(0.0);
  }

  /// p_I. Most volumes stand straight: that a branch knows costs less than the products.
  [[gnu::always_inline]] Vec3 operator()(const Vec3& p_W) const noexcept {
    if (straight) {
      const double* m = index_from_world.data();
      return {m[0] * p_W.x() + origin_I.x(), m[4] * p_W.y() + origin_I.y(),
              m[8] * p_W.z() + origin_I.z()};
    }
    const Vec3 p = times(index_from_world, p_W);
    return {p.x() + origin_I.x(), p.y() + origin_I.y(), p.z() + origin_I.z()};
  }
};

/// That of a volume that is placed.
FieldFrame frameOf(const Volume& volume, const Placement& placement);

/// That of a part of a volume, as a kind of interpolation reads it; made once.
std::shared_ptr<const FreeMap> freeMapOf(const Volume& volume, std::size_t part,
                                         Interpolation interpolation, const GridData& data);

/// Reads one grid through a kernel: finds the cell that a position is in, and loads it if it is not
/// the last one. Const; what changes is in a Cache.
template <class GridT, class Kernel>
class GridReader {
  static constexpr int kComponents = static_cast<int>(std::tuple_size_v<typename Kernel::Row>) / 4;
  static constexpr int kWidth = Kernel::kWidth;

 public:
  using Row = typename Kernel::Row;

  /// What a reader keeps of a grid: the accessor and the last cell.
  struct Cache {
    alignas(64) Kernel kernel;
    std::uint64_t active = 0;
    std::array<int, 3> cell{kNoCell, kNoCell, kNoCell};
    openvdb::tree::ValueAccessor<const typename GridT::TreeType, false> accessor;

    explicit Cache(const GridT& grid) : accessor(grid.tree()) {}
  };

  GridReader(const Volume& volume, std::size_t part, const Placement& placement,
             const Sampling& sampling)
      : grid_(std::get<typename GridT::ConstPtr>(gridFor(volume, part, sampling.interpolation))),
        map_(volume.grid().parts[part], placement),
        free_(freeMapOf(volume, part, sampling.interpolation, grid_)),
        voxel_(1.0 / map_.index_from_world.rowwise().norm().maxCoeff()),
        // For `inside`: a level set means something only within its band.
        all_corners_(volume.info().grid_class == GridClass::kLevelSet),
        axial_(sampling.axial) {
    background_.fill(0.0);
    for (std::size_t c = 0; c < kComponents; ++c) {
      background_[c] = componentOf(grid_->background(), static_cast<int>(c));
    }
    turn(background_);
  }

  /// The row at p_W, turned into W, and whether there is data; the background where p_W is no place
  /// in a grid.
  [[gnu::always_inline]] bool read(const Vec3& p_W, Cache& cache, Row& row) const noexcept {
    Vec3 t;
    if (!locate(p_W, cache, t)) {
      row = background_;
      return false;
    }
    cache.kernel.read(t, row);
    if constexpr (!Kernel::kBlendsRows) turn(row);
    return insideAt(t, cache.active);
  }

  /// As ScalarField::freeWithin.
  [[nodiscard]] double freeWithin(const Vec3& p_W) const noexcept {
    constexpr double kKernel = 2.0;  // a value depends on voxels no farther away, along each axis
    return std::max(0.0, voxel_ * (free_->around(map_(p_W)) - kKernel));
  }

  /// As ScalarField::value. Trilinear scalars only.
  [[nodiscard]] double value(const Vec3& p_W, Cache& cache) const noexcept {
    Vec3 t;
    if (!locate(p_W, cache, t)) return background_[0];
    std::array<double, 1> v;
    cache.kernel.value(t, v);
    return v[0];
  }

  /// Gradient of the cell's own polynomial, turned into W. Trilinear scalars only.
  [[nodiscard]] Vec3 slope(const Vec3& p_W, Cache& cache) const noexcept {
    Vec3 t;
    if (!locate(p_W, cache, t)) return {0.0, 0.0, 0.0};
    return times(map_.gradient_from_index, cache.kernel.slope(t));
  }

  /// As ScalarField::gradientJacobian.
  [[nodiscard]] Mat3 turning(const Vec3& p_W, Cache& cache) const noexcept {
    Mat3 by = Mat3::Zero();
    Vec3 t;
    if (!locate(p_W, cache, t)) return by;
    const auto rows = cache.kernel.turning(t);
    for (Eigen::Index a = 0; a < 3; ++a) {
      const auto n = static_cast<std::size_t>(a);
      const Vec3 column(rows[0][n], rows[1][n], rows[2][n]);
      by.col(a) = Kernel::kBlendsRows ? column : times(map_.gradient_from_index, column);
    }
    return by * map_.index_from_world;
  }

  /// As ScalarField::firstFall, exact: walks the cells on the way. One whose corners are all on the
  /// free side cannot hold the level; in the others the value is a cubic. Trilinear scalars only.
  [[nodiscard]] Crossing firstFall(const Vec3& a_W, const Vec3& b_W, double level, double sign,
                                   Cache& cache) const noexcept {
    constexpr int kMostCells = 256;
    Crossing out;
    const Vec3 from = map_(a_W);
    const Vec3 to = map_(b_W);
    std::array<int, 3> cell{};
    if (!floorOf(from, cell) || !isPlace(to)) {
      out.share = 0.0;
      return out;
    }
    const Vec3 way(to.x() - from.x(), to.y() - from.y(), to.z() - from.z());
    bool above = false;
    double share = 0.0;
    while (out.cells < kMostCells) {
      // To the next face.
      double next = 1.0;
      std::size_t axis = 3;
      for (std::size_t a = 0; a < 3; ++a) {
        const double d = way[static_cast<Eigen::Index>(a)];
        if (d == 0.0) continue;
        const double face = cell[a] + (d > 0.0 ? 1.0 : 0.0);
        const double s = (face - from[static_cast<Eigen::Index>(a)]) / d;
        if (s < next) {
          next = s;
          axis = a;
        }
      }
      next = std::max(next, share);
      ++out.cells;
      if (cell != cache.cell) load(cell[0], cell[1], cell[2], cache);
      auto [least, most] = cache.kernel.range();
      least = sign * (least - level);
      most = sign * (most - level);
      if (least > most) std::swap(least, most);
      const bool data = hasData(cache.active);
      if (least >= 0.0 || !data) {
        // Nothing to fall through; without data there is no side.
        above = above || (data && most > 0.0) || !data;
        out.behind = false;
      } else if (next > share || share == 0.0) {
        const double length = next - share;
        const Vec3 t(from.x() + share * way.x() - cell[0], from.y() + share * way.y() - cell[1],
                     from.z() + share * way.z() - cell[2]);
        const Vec3 d(length * way.x(), length * way.y(), length * way.z());
        Cubic cubic = cache.kernel.along(t, d);
        cubic[0] -= level;
        for (double& c : cubic) c *= sign;
        const double fall = palpate::firstFall(cubic, share == 0.0, above);
        if (fall <= 1.0) {
          out.found = true;
          out.share = std::min(share + fall * length, 1.0);
          out.behind = false;
          return out;
        }
        out.behind = !above && cubic[0] + cubic[1] + cubic[2] + cubic[3] < 0.0;
      }
      if (axis == 3) return out;
      share = next;
      cell[axis] += way[static_cast<Eigen::Index>(axis)] > 0.0 ? 1 : -1;
    }
    out.share = share;
    return out;
  }

  /// As VectorField::trace, cell by cell. Trilinear vectors in one grid only.
  [[nodiscard]] Trace trace(const Vec3& p_W, const TraceOrder& order, double voxel,
                            Cache& cache) const noexcept {
    Flow flow{*this, cache, {}, voxel};
    TraceOrder scaled = order;
    scaled.length = order.length / voxel;
    scaled.hand = order.hand / voxel;
    Trace out = traceCells(flow, map_(p_W), scaled);
    out.position = times(map_.world_from_index, out.position - map_.origin_I);
    out.length *= voxel;
    return out;
  }

  [[nodiscard]] const GridT& grid() const noexcept { return *grid_; }

 private:
  /// The cells as trace_cells.h walks them, in index space.
  struct Flow {
    static constexpr bool kCells = true;
    const GridReader& reader;
    Cache& cache;
    std::array<int, 3> cell;
    double voxel;

    bool enter(const Vec3& u, const Vec3& direction) noexcept {
      if (!floorOf(u, cell)) return false;
      for (std::size_t a = 0; a < 3; ++a) {
        const auto n = static_cast<Eigen::Index>(a);
        if (u[n] == cell[a] && direction[n] < 0.0) --cell[a];
      }
      return here();
    }
    bool pass(int axis, int side) noexcept {
      cell[static_cast<std::size_t>(axis)] += side;
      return here();
    }
    bool here() noexcept {
      if (cell != cache.cell) reader.load(cell[0], cell[1], cell[2], cache);
      return reader.hasData(cache.active);
    }
    [[nodiscard]] Vec3 lower() const noexcept { return Vec3(cell[0], cell[1], cell[2]); }
    [[nodiscard]] Vec3 value(const Vec3& u) const noexcept {
      std::array<double, 3> v;
      cache.kernel.value(Vec3(u.x() - cell[0], u.y() - cell[1], u.z() - cell[2]), v);
      return {v[0], v[1], v[2]};
    }
    [[nodiscard]] Vec3 rate(const Vec3& v) const noexcept {
      return times(reader.map_.index_from_world, Vec3(voxel * v.x(), voxel * v.y(), voxel * v.z()));
    }
  };

  static const GridData& gridFor(const Volume& volume, std::size_t part,
                                 Interpolation interpolation) {
    if (interpolation == Interpolation::kQuadratic) return splineCoefficients(volume, 2)[part];
    if (interpolation == Interpolation::kCubic) return splineCoefficients(volume, 3)[part];
    return volume.grid().parts[part].data;
  }

  /// From components of the file and derivatives by index to both in W, per unit of the file, for N
  /// places at once: rows[r][n]. A lone component has no direction.
  template <std::size_t N>
  [[gnu::always_inline]] void turn(
      std::array<std::array<double, N>, std::tuple_size_v<Row>>& rows) const noexcept {
    if constexpr (kComponents == 1) {
      combine(map_.gradient_from_index, rows[1], rows[2], rows[3]);
    } else {
      // The value, and d v_F / d index axis by axis; then the axes, component by component.
      for (std::size_t r = 0; r < 12; r += 3) {
        combine(map_.rotation, rows[r], rows[r + 1], rows[r + 2]);
      }
      for (std::size_t c = 0; c < 3; ++c) {
        combine(map_.gradient_from_index, rows[3 + c], rows[6 + c], rows[9 + c]);
      }
    }
  }
  [[gnu::always_inline]] void turn(Row& row) const noexcept {
    if constexpr (kComponents == 1) {
      if (map_.straight) {
        const double* m = map_.gradient_from_index.data();
        row = {row[0], m[0] * row[1], m[4] * row[2], m[8] * row[3]};
        return;
      }
    }
    auto rows = std::bit_cast<std::array<std::array<double, 1>, std::tuple_size_v<Row>>>(row);
    turn(rows);
    row = std::bit_cast<Row>(rows);
  }

  /// False for NaN as well.
  [[gnu::always_inline]] static bool isPlace(const Vec3& p_I) noexcept {
    return std::abs(p_I.x()) < 1e9 && std::abs(p_I.y()) < 1e9 && std::abs(p_I.z()) < 1e9;
  }
  static bool floorOf(const Vec3& p_I, std::array<int, 3>& cell) noexcept {
    if (!isPlace(p_I)) return false;
    for (std::size_t a = 0; a < 3; ++a) {
      cell[a] = static_cast<int>(std::floor(p_I[static_cast<Eigen::Index>(a)]));
    }
    return true;
  }
  /// Whether the cell has data; see insideAt.
  [[nodiscard]] bool hasData(std::uint64_t active) const noexcept {
    return insideAt(Vec3(0.0, 0.0, 0.0), active);
  }

  /// Loads the cell about p_W, and gives the position in it; false where it is no place in a grid.
  [[gnu::always_inline]] bool locate(const Vec3& p_W, Cache& cache, Vec3& t) const noexcept {
    const Vec3 p_I = map_(p_W);
    if (!isPlace(p_I)) return false;
    std::array<int, 3> cell{};
    for (int a = 0; a < 3; ++a) {
      const double from = Kernel::kNearest ? p_I[a] + 0.5 : p_I[a];
      // The floor, without a call: truncated, less one if that went up.
      int floor = static_cast<int>(from);
      floor -= static_cast<int>(from < floor);
      cell[static_cast<std::size_t>(a)] = floor;
      t[a] = p_I[a] - floor;
    }
    // One by one: comparing what was just stored as wider words would wait for the stores.
    const bool same =
        cell[0] == cache.cell[0] && cell[1] == cache.cell[1] && cell[2] == cache.cell[2];
    if (!same) load(cell[0], cell[1], cell[2], cache);
    return true;
  }

  /// By its numbers: to read an array that was just stored by wider words is to wait for the
  /// stores.
  [[gnu::noinline]] void load(int i, int j, int k, Cache& cache) const noexcept {
    constexpr int kBefore = Kernel::kBefore;
    const Block<typename GridT::ValueType, kWidth, Kernel::kNeedsEdges> block(
        cache.accessor, Coord(i - kBefore, j - kBefore, k - kBefore));
    const auto take = [&](const auto& rows) __attribute__((always_inline)) {
      cache.kernel.load(
          rows, [&](auto& corners) __attribute__((always_inline)) { turn(corners); });
    };
    if (!axial_) {
      take(block.rows());
    } else if constexpr (std::is_same_v<Kernel, TrilinearKernel<3>>) {
      take(Aligned(block.rows()).rows());  // no other kernel is axial
    }
    cache.active = block.active();
    cache.cell = {i, j, k};
  }

  /// Whether the cell at t has data: all eight voxels of a level set's, else at least one.
  [[nodiscard, gnu::always_inline]] bool insideAt(const Vec3& t,
                                                  std::uint64_t active) const noexcept {
    if constexpr (kWidth == 1) {
      return active != 0;
    } else {
      std::uint64_t cell = cellBits<kWidth>();
      if constexpr (Kernel::kNearest) {
        // Of the block about the nearest voxel, the octant that t is in.
        cell <<= bitOf<kWidth>(static_cast<int>(t.x() >= 0.0), static_cast<int>(t.y() >= 0.0),
                               static_cast<int>(t.z() >= 0.0));
      } else {
        cell <<= bitOf<kWidth>(1, 1, 1);
      }
      return all_corners_ ? (active & cell) == cell : (active & cell) != 0;
    }
  }

  typename GridT::ConstPtr grid_;
  IndexMap map_;
  std::shared_ptr<const FreeMap> free_;
  double voxel_;  ///< A shorter way is less than one along every axis of the index [m].
  Row background_;
  bool all_corners_;
  bool axial_;
};

/// A field over N grids of a volume: what scalars and vectors share.
template <class Base, class GridT, class Kernel, std::size_t N>
class GridField : public Base {
  using Reader = GridReader<GridT, Kernel>;
  using Caches = std::array<typename Reader::Cache, N>;
  static_assert(sizeof(Caches) <= sizeof(FieldCache::bytes));

 public:
  GridField(std::shared_ptr<const Volume> volume, const Placement& placement,
            const Sampling& sampling)
      : GridField(std::move(volume), placement, sampling, std::make_index_sequence<N>()) {}

  [[nodiscard]] double freeWithin(const Vec3& p_W) const noexcept final {
    return std::apply([&](const auto&... reader) { return std::min({reader.freeWithin(p_W)...}); },
                      readers_);
  }

  void reset(FieldCache& memory) const noexcept final {
    std::apply(
        [&](const auto&... reader) {
          ::new (memory.bytes.data()) Caches{typename Reader::Cache(reader.grid())...};
        },
        readers_);
  }

 protected:
  using Row = typename Reader::Row;

  /// As a field lays them into its memory.
  static Caches& cachesIn(FieldCache& memory) noexcept {
    return *std::launder(reinterpret_cast<Caches*>(memory.bytes.data()));
  }
  [[nodiscard]] const std::array<Reader, N>& readers() const noexcept { return readers_; }

 private:
  template <std::size_t... Part>
  GridField(std::shared_ptr<const Volume> volume, const Placement& placement,
            const Sampling& sampling, std::index_sequence<Part...> /*parts*/)
      : Base(frameOf(*volume, placement)),
        volume_(std::move(volume)),
        readers_{Reader(*volume_, Part, placement, sampling)...} {}

  std::shared_ptr<const Volume> volume_;
  std::array<Reader, N> readers_;
};

template <class GridT, class Kernel>
class VdbScalarField final : public GridField<ScalarField, GridT, Kernel, 1> {
  using Base = GridField<ScalarField, GridT, Kernel, 1>;

 public:
  using Base::Base;

  [[nodiscard]] ScalarSample sample(const Vec3& p_W, FieldCache& memory) const noexcept override {
    typename Base::Row row;
    const bool inside = this->readers()[0].read(p_W, Base::cachesIn(memory)[0], row);
    return {row[0], Vec3(row[1], row[2], row[3]), inside};
  }

  [[nodiscard]] double value(const Vec3& p_W, FieldCache& memory) const noexcept override {
    if constexpr (std::is_same_v<Kernel, TrilinearKernel<1>>) {
      return this->readers()[0].value(p_W, Base::cachesIn(memory)[0]);
    } else {
      return sample(p_W, memory).value;
    }
  }

  [[nodiscard]] Vec3 cellGradient(const Vec3& p_W, FieldCache& memory) const noexcept override {
    if constexpr (std::is_same_v<Kernel, TrilinearKernel<1>>) {
      return this->readers()[0].slope(p_W, Base::cachesIn(memory)[0]);
    } else {
      return sample(p_W, memory).gradient;
    }
  }

  [[nodiscard]] Mat3 gradientJacobian(const Vec3& p_W, FieldCache& memory) const noexcept override {
    return this->readers()[0].turning(p_W, Base::cachesIn(memory)[0]);
  }

  [[nodiscard]] Crossing firstFall(const Vec3& a_W, const Vec3& b_W, double level, double sign,
                                   FieldCache& memory) const noexcept override {
    if constexpr (std::is_same_v<Kernel, TrilinearKernel<1>>) {
      return this->readers()[0].firstFall(a_W, b_W, level, sign, Base::cachesIn(memory)[0]);
    } else {
      return ScalarField::firstFall(a_W, b_W, level, sign, memory);
    }
  }
};

template <class GridT, class Kernel>
class VdbVectorField final : public GridField<VectorField, GridT, Kernel, 1> {
  using Base = GridField<VectorField, GridT, Kernel, 1>;

 public:
  using Base::Base;

  [[nodiscard]] VectorSample sample(const Vec3& p_W, FieldCache& memory) const noexcept override {
    VectorSample out;
    typename Base::Row row;
    out.inside = this->readers()[0].read(p_W, Base::cachesIn(memory)[0], row);
    out.value = Vec3(row[0], row[1], row[2]);
    std::copy_n(row.begin() + 3, 9, out.jacobian.data());
    return out;
  }

  [[nodiscard]] Trace trace(const Vec3& p_W, const TraceOrder& order,
                            FieldCache& memory) const noexcept override {
    if constexpr (std::is_same_v<Kernel, TrilinearKernel<3>>) {
      return this->readers()[0].trace(p_W, order, this->frame().voxel, Base::cachesIn(memory)[0]);
    } else {
      return VectorField::trace(p_W, order, memory);
    }
  }
};

/// A vector whose components are grids of their own, each at its own place.
template <class GridT, class Kernel>
class ComponentField final : public GridField<VectorField, GridT, Kernel, 3> {
  using Base = GridField<VectorField, GridT, Kernel, 3>;

 public:
  ComponentField(std::shared_ptr<const Volume> volume, const Placement& placement,
                 const Sampling& sampling)
      : Base(std::move(volume), placement, sampling), rotation_(placement.rotation) {}

  [[nodiscard]] VectorSample sample(const Vec3& p_W, FieldCache& memory) const noexcept override {
    auto& caches = Base::cachesIn(memory);
    VectorSample out;
    out.inside = true;
    Vec3 v;
    Mat3 J;
    for (std::size_t c = 0; c < 3; ++c) {
      typename Base::Row row;
      const bool inside = this->readers()[c].read(p_W, caches[c], row);
      const auto r = static_cast<Eigen::Index>(c);
      v[r] = row[0];
      for (Eigen::Index a = 0; a < 3; ++a) J(r, a) = row[static_cast<std::size_t>(a) + 1];
      out.inside = out.inside && inside;
    }
    out.value = times(rotation_, v);
    for (Eigen::Index a = 0; a < 3; ++a) out.jacobian.col(a) = times(rotation_, Vec3(J.col(a)));
    return out;
  }

 private:
  Mat3 rotation_;
};

template <class GridT, template <class, class> class Field, int C>
auto withKernel(const std::shared_ptr<const Volume>& volume, const Placement& placement,
                const Sampling& sampling)
    -> std::conditional_t<std::is_base_of_v<ScalarField, Field<GridT, TrilinearKernel<C>>>,
                          std::shared_ptr<const ScalarField>, std::shared_ptr<const VectorField>> {
  switch (sampling.interpolation) {
    case Interpolation::kTrilinear:
      break;
    case Interpolation::kNearest:
      return std::make_shared<const Field<GridT, NearestKernel<C>>>(volume, placement, sampling);
    case Interpolation::kQuadratic:
      return std::make_shared<const Field<GridT, SplineKernel<C, 2>>>(volume, placement, sampling);
    case Interpolation::kCubic:
      return std::make_shared<const Field<GridT, SplineKernel<C, 3>>>(volume, placement, sampling);
  }
  return std::make_shared<const Field<GridT, TrilinearKernel<C>>>(volume, placement, sampling);
}

/// A field over a volume whose first part is of type GridT.
template <class GridT>
FieldPtr makeField(const std::shared_ptr<const Volume>& volume, const Placement& placement,
                   const Sampling& sampling) {
  if constexpr (std::is_arithmetic_v<typename GridT::ValueType>) {
    if (volume->grid().parts.size() == 3) {
      return withKernel<GridT, ComponentField, 1>(volume, placement, sampling);
    }
    return withKernel<GridT, VdbScalarField, 1>(volume, placement, sampling);
  } else {
    return withKernel<GridT, VdbVectorField, 3>(volume, placement, sampling);
  }
}

// In field_float.cpp and the like.
extern template FieldPtr makeField<openvdb::FloatGrid>(const std::shared_ptr<const Volume>&,
                                                       const Placement&, const Sampling&);
extern template FieldPtr makeField<openvdb::DoubleGrid>(const std::shared_ptr<const Volume>&,
                                                        const Placement&, const Sampling&);
extern template FieldPtr makeField<openvdb::Vec3SGrid>(const std::shared_ptr<const Volume>&,
                                                       const Placement&, const Sampling&);
extern template FieldPtr makeField<openvdb::Vec3DGrid>(const std::shared_ptr<const Volume>&,
                                                       const Placement&, const Sampling&);

}  // namespace palpate::detail
