/// Private to samplers, for .cpp files only: reads a lattice of voxels through a kernel.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <tuple>
#include <type_traits>
#include <utility>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>

#include "palpate/engine/field/trace_cells.h"
#include "palpate/samplers/grid/band_cell.h"
#include "palpate/samplers/grid/cell.h"
#include "palpate/samplers/grid/data_ends.h"
#include "palpate/samplers/grid/free_map.h"
#include "palpate/samplers/grid/vdb_field.h"

namespace palpate::detail {

inline constexpr int kNoCell = std::numeric_limits<int>::max();

/// Copy of a block of vectors without sign, such as fibre axes. Negates vectors where needed, so
/// that none points against the main axis of the cell's eight vectors.
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
      // The kernel does not need the rows at the block's edges.
      if (i % 3 == 0 && j % 3 == 0) continue;
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

/// Returns M v. The compiler would not inline Eigen's product (cell.h).
[[gnu::always_inline]] inline Vec3 times(const Mat3& M, const Vec3& v) noexcept {
  const double* m = M.data();
  return {m[0] * v.x() + m[3] * v.y() + m[6] * v.z(), m[1] * v.x() + m[4] * v.y() + m[7] * v.z(),
          m[2] * v.x() + m[5] * v.y() + m[8] * v.z()};
}
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

struct IndexMap {
  Mat3 index_from_world;  ///< p_I = index_from_world p_W + origin_I
  Mat3 world_from_index;
  Vec3 origin_I;
  Mat3 rotation;  ///< Rotation from the file's world space to W.
  /// Matrix of gradients: g_W = gradient_from_index g_I, where g_W is per unit of the file.
  Mat3 gradient_from_index;
  /// True if each index axis is parallel to the W axis of the same number: the maps are diagonal.
  bool straight;

  IndexMap(const Mat3& linear, const Vec3& origin, const Placement& placement) {
    const Mat3 index_from_file = linear.inverse();
    index_from_world = index_from_file * placement.rotation.transpose() / placement.scale;
    world_from_index = placement.scale * placement.rotation * linear;
    origin_I = -index_from_world * placement.translate - index_from_file * origin;
    gradient_from_index = placement.rotation * index_from_file.transpose();
    rotation = placement.rotation;
    straight = index_from_world.isDiagonal(0.0);
  }

  /// Returns the position in index space. The branch saves time for volumes that are not rotated.
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

/// Reads one lattice through a kernel. Loads a cell if the previous reading was in another cell.
/// The reader is const; a Cache holds all mutable state.
///
/// A Source provides the voxels. Source::Block<W, Edges> reads W^3 voxels from the lowest corner
/// on: rows(), active() for voxels that can be corners, allActive() for all that the kernel reads.
/// Source::cache() returns an empty cache, background(c) the background of component c, ends() the
/// voxels with data.
template <class Source, class Kernel>
class LatticeReader {
  static constexpr int kComponents = static_cast<int>(std::tuple_size_v<typename Kernel::Row>) / 4;
  static constexpr int kWidth = Kernel::kWidth;
  /// True if differences must stop where the data end.
  static constexpr bool kEnds = std::is_same_v<Kernel, TrilinearKernel<3>>;

 public:
  using Row = typename Kernel::Row;

  struct Cache {
    alignas(64) Kernel kernel;
    std::uint64_t active = 0;
    std::array<int, 3> cell{kNoCell, kNoCell, kNoCell};
    typename Source::Cache source;

    explicit Cache(typename Source::Cache of) : source(std::move(of)) {}
  };

  /// @param all_corners  True for level sets, whose values are distances only within the band: a
  ///                     cell has data if all corners are active, or if one is active and the
  ///                     cell holds the surface (band_cell.h). Else one active corner suffices,
  ///                     unless inactive voxels are missing (Inactive).
  /// @param axial  See Sampling::axial.
  /// @param reach  See Sampling::slope_reach.
  LatticeReader(Source source, const IndexMap& map, std::shared_ptr<const FreeMap> free,
                bool all_corners, bool axial, double reach)
      : source_(std::move(source)),
        map_(map),
        ends_(source_.ends()),
        free_(std::move(free)),
        voxel_(1.0 / map_.index_from_world.rowwise().norm().maxCoeff()),
        reach_(reach),
        all_corners_(all_corners),
        axial_(axial) {
    background_.fill(0.0);
    for (std::size_t c = 0; c < kComponents; ++c) {
      background_[c] = source_.background(static_cast<int>(c));
    }
    turn(background_);
  }

  /// Reads the row at p_W, rotated into W. Returns true if there is data. If p_W is NaN, or at
  /// least 1e9 voxels from the index origin along an axis, the row is that of the background.
  [[gnu::always_inline]] bool read(const Vec3& p_W, Cache& cache, Row& row) const noexcept {
    Vec3 t;
    if (!locate(p_W, cache, t)) {
      row = background_;
      return false;
    }
    if constexpr (Kernel::kDifferences) {
      cache.kernel.read(t, reach_, row);
    } else {
      cache.kernel.read(t, row);
    }
    if constexpr (!Kernel::kBlendsRows) turn(row);
    return insideAt(t, cache);
  }

  /// Moves p_W to the nearest place, in index space, at which the slope uses only voxels in the box
  /// of active voxels; in a box that is too narrow, to its middle. Returns the slope's weight: 1 in
  /// the box, falling to 0 one voxel beyond it.
  [[nodiscard]] double towardData(Vec3& p_W) const noexcept {
    const Vec3 p_I = map_(p_W);
    Vec3 to = p_I;
    double weight = 1.0;
    for (Eigen::Index a = 0; a < 3; ++a) {
      const double lower = ends_.lower[static_cast<std::size_t>(a)];
      const double upper = ends_.upper[static_cast<std::size_t>(a)];
      const double middle = 0.5 * (lower + upper);
      to[a] =
          std::clamp(p_I[a], std::min(lower + reach_, middle), std::max(upper - reach_, middle));
      weight *= std::clamp(1.0 - std::max(lower - p_I[a], p_I[a] - upper), 0.0, 1.0);
    }
    if (to != p_I) p_W = times(map_.world_from_index, to - map_.origin_I);
    return weight;
  }

  [[nodiscard]] double freeWithin(const Vec3& p_W) const noexcept {
    // Largest distance, along an axis, at which a voxel affects a value [voxels].
    constexpr double kKernel = 2.0;
    return std::max(0.0, voxel_ * (free_->around(map_(p_W)) - kKernel));
  }

  /// Returns ScalarField::value. Only for trilinear scalars.
  [[nodiscard]] double value(const Vec3& p_W, Cache& cache) const noexcept {
    Vec3 t;
    if (!locate(p_W, cache, t)) return background_[0];
    std::array<double, 1> v;
    cache.kernel.value(t, v);
    return v[0];
  }

  /// Returns the gradient of the cell's polynomial, in W. Only for trilinear scalars.
  [[nodiscard]] Vec3 slope(const Vec3& p_W, Cache& cache) const noexcept {
    Vec3 t;
    if (!locate(p_W, cache, t)) return {0.0, 0.0, 0.0};
    return times(map_.gradient_from_index, cache.kernel.slope(t));
  }

  [[nodiscard]] Mat3 turning(const Vec3& p_W, Cache& cache) const noexcept {
    Mat3 by = Mat3::Zero();
    Vec3 t;
    if (!locate(p_W, cache, t)) return by;
    const auto rows = [&] {
      if constexpr (Kernel::kDifferences) {
        return cache.kernel.turning(t, reach_);
      } else {
        return cache.kernel.turning(t);
      }
    }();
    if (map_.straight && !Kernel::kBlendsRows) {
      const double* g = map_.gradient_from_index.data();
      const double* w = map_.index_from_world.data();
      for (std::size_t n = 0; n < 9; ++n) {
        by.data()[n] = g[n % 3 * 4] * rows[n % 3][n / 3] * w[n / 3 * 4];
      }
      return by;
    }
    for (Eigen::Index a = 0; a < 3; ++a) {
      const auto n = static_cast<std::size_t>(a);
      const Vec3 column(rows[0][n], rows[1][n], rows[2][n]);
      by.col(a) = Kernel::kBlendsRows ? column : times(map_.gradient_from_index, column);
    }
    return by * map_.index_from_world;
  }

  /// Returns ScalarField::firstFall. Walks through at most kMostCells cells on the path. In cells
  /// that may contain the level, the value along the path is a cubic. Only for trilinear scalars.
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
      // Finds the share of the path at which the path leaves the cell.
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
      const bool data = hasData(cache);
      if (least >= 0.0 || !data) {
        // No fall in this cell. After a cell without data, any value below the level is a fall.
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

  /// Returns VectorField::trace, cell by cell. Only for trilinear vectors in one grid.
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

  [[nodiscard]] Cache cache() const noexcept { return Cache(source_.cache()); }

 private:
  /// Provides the cells in index space to traceCells (trace_cells.h).
  struct Flow {
    static constexpr bool kCells = true;
    const LatticeReader& reader;
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
      return reader.hasData(cache);
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

  /// Rotates components and derivatives by index into W, per unit of the file, for N places at
  /// once: rows[r][n]. The component of a scalar is not rotated.
  template <std::size_t N>
  [[gnu::always_inline]] void turn(
      std::array<std::array<double, N>, std::tuple_size_v<Row>>& rows) const noexcept {
    if constexpr (kComponents == 1) {
      combine(map_.gradient_from_index, rows[1], rows[2], rows[3]);
    } else {
      // First maps the derivatives of each component to W's axes, then rotates the components.
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
  /// Returns true if the cell has data, by the rule of insideAt in its middle.
  [[nodiscard]] bool hasData(const Cache& cache) const noexcept {
    return insideAt(Vec3(0.5, 0.5, 0.5), cache);
  }

  /// Loads the cell around p_W if the cell has changed, and computes the position t in the cell.
  /// Returns false if p_W is not finite, or at least 1e9 voxels from the index origin along an
  /// axis.
  [[gnu::always_inline]] bool locate(const Vec3& p_W, Cache& cache, Vec3& t) const noexcept {
    const Vec3 p_I = map_(p_W);
    if (!isPlace(p_I)) return false;
    std::array<int, 3> cell{};
    for (int a = 0; a < 3; ++a) {
      const double from = Kernel::kNearest ? p_I[a] + 0.5 : p_I[a];
      // Computes the floor without a function call: truncation rounds negative numbers up.
      int floor = static_cast<int>(from);
      floor -= static_cast<int>(from < floor);
      cell[static_cast<std::size_t>(a)] = floor;
      t[a] = p_I[a] - floor;
    }
    // Compares single numbers, because a wide load would wait for their separate stores.
    const bool same =
        cell[0] == cache.cell[0] && cell[1] == cache.cell[1] && cell[2] == cache.cell[2];
    if (!same) load(cell[0], cell[1], cell[2], cache);
    return true;
  }

  /// Loads cell (i, j, k) into the cache. Has three parameters in place of an array, because a wide
  /// load of the array would wait for the separate stores of its elements.
  [[gnu::noinline]] void load(int i, int j, int k, Cache& cache) const noexcept {
    constexpr int kBefore = Kernel::kBefore;
    const typename Source::template Block<kWidth, Kernel::kNeedsEdges> block(
        source_, cache.source, {i - kBefore, j - kBefore, k - kBefore});
    const auto take = [&](const auto& rows) __attribute__((always_inline)) {
      const auto turned = [&](auto& corners) __attribute__((always_inline)) {
        turn(corners);
      };
      if constexpr (kEnds) {
        const bool within = !ends_.activeOnly() && ends_.contains({i, j, k}, 2);
        const std::uint64_t known = within ? kAll : knownAbout({i, j, k}, block);
        if (known != kAll) return cache.kernel.loadKnown(rows, known, turned);
      }
      cache.kernel.load(rows, turned);
    };
    if (!axial_) {
      take(block.rows());
    } else if constexpr (std::is_same_v<Kernel, TrilinearKernel<3>>) {
      take(Aligned(block.rows()).rows());  // no other kernel is axial
    }
    cache.active = block.active();
    if constexpr (std::is_same_v<Kernel, TrilinearKernel<1>>) {
      constexpr std::uint64_t kCell = cellBits<kWidth>() << bitOf<kWidth>(1, 1, 1);
      const std::uint64_t here = cache.active & kCell;
      if (all_corners_ && here != kCell && here != 0 && surfaceIn(block.rows())) {
        cache.active |= kCell;
      }
    }
    cache.cell = {i, j, k};
  }

  static constexpr std::uint64_t kAll = ~std::uint64_t{0};

  /// Returns the bits of voxels with data, and of the unused voxels at the block's edges.
  template <class Block>
  [[nodiscard, gnu::noinline]] std::uint64_t knownAbout(const std::array<int, 3>& cell,
                                                        const Block& block) const noexcept {
    std::uint64_t bits = ends_.activeOnly() ? block.allActive() : kAll;
    for (int n = 0; n < 64; ++n) {
      const std::array<int, 3> at{n / 16, n / 4 % 4, n % 4};
      const auto rim = std::count_if(at.begin(), at.end(), [](int i) { return i % 3 == 0; });
      const std::array<int, 3> voxel{cell[0] + at[0] - 1, cell[1] + at[1] - 1, cell[2] + at[2] - 1};
      if (rim > 1) {
        bits |= std::uint64_t{1} << n;
      } else if (!ends_.contains(voxel)) {
        bits &= ~(std::uint64_t{1} << n);
      }
    }
    return bits;
  }

  /// Returns true if the block's middle cell holds a level set's surface (holdsSurface).
  template <class Number>
  [[nodiscard, gnu::noinline]] bool surfaceIn(const Rows<Number, 4>& rows) const noexcept {
    std::array<Number, 8> at;
    for (std::size_t n = 0; n < 8; ++n) at[n] = rows(1 + n / 4, 1 + n / 2 % 2)[1 + n % 2];
    return holdsSurface(at, background_[0]);
  }

  /// Returns true if the cell at t has data. In a level set, all corners are already marked as
  /// active if the cell holds the surface and has an active corner: load() marks them for a
  /// trilinear kernel, splineCoefficients() for a spline.
  [[nodiscard, gnu::always_inline]] bool insideAt(const Vec3& t,
                                                  const Cache& cache) const noexcept {
    const std::uint64_t active = cache.active;
    if constexpr (kWidth == 1) {
      return active != 0;
    } else {
      std::uint64_t cell = cellBits<kWidth>();
      if constexpr (Kernel::kNearest) {
        // In the block around the nearest voxel, selects the eight voxels around t.
        cell <<= bitOf<kWidth>(static_cast<int>(t.x() >= 0.0), static_cast<int>(t.y() >= 0.0),
                               static_cast<int>(t.z() >= 0.0));
      } else {
        cell <<= bitOf<kWidth>(1, 1, 1);
      }
      if (all_corners_ || ends_.inactive != Inactive::kMissing) {
        return all_corners_ ? (active & cell) == cell : (active & cell) != 0;
      }
      return (active & cell) == cell || ((active & cell) != 0 && isWhole(t, cache));
    }
  }
  /// Returns true if every voxel that a trilinear value at t would read has data, or is outside of
  /// the box of active voxels.
  [[nodiscard, gnu::noinline]] bool isWhole(const Vec3& t, const Cache& cache) const noexcept {
    for (std::size_t n = 0; n < 8; ++n) {
      std::array<int, 3> at{};  // relative to cache.cell
      bool read = true;
      for (std::size_t a = 0; a < 3; ++a) {
        const double along = t[static_cast<Eigen::Index>(a)];
        const bool upper = ((n >> a) & 1U) != 0;
        read = read && (!upper || along != 0.0);
        at[a] = static_cast<int>(upper) - static_cast<int>(along < 0.0);
      }
      constexpr int kBefore = Kernel::kBefore;
      const int bit = bitOf<kWidth>(at[0] + kBefore, at[1] + kBefore, at[2] + kBefore);
      const bool active = (cache.active >> bit & 1U) != 0;
      const auto& cell = cache.cell;
      if (read && !active && ends_.contains({cell[0] + at[0], cell[1] + at[1], cell[2] + at[2]})) {
        return false;
      }
    }
    return true;
  }

  Source source_;
  IndexMap map_;
  DataEnds ends_;
  std::shared_ptr<const FreeMap> free_;
  /// A straight path of this length, in any direction, changes each index by at most 1 [m].
  double voxel_;
  Row background_;
  double reach_;
  bool all_corners_;
  bool axial_;
};

}  // namespace palpate::detail
