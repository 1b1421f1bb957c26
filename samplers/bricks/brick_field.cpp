#include "palpate/samplers/bricks/brick_field.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <limits>
#include <new>
#include <optional>
#include <utility>
#include <vector>

#include "palpate/samplers/bricks/bricks_about.h"
#include "palpate/samplers/grid/lattice_reader.h"

namespace palpate {
namespace {

using detail::IndexMap;
using detail::kNoCell;
using detail::LatticeReader;

/// Smallest distance to missing bricks at which a level has full weight [voxels of the level].
constexpr double kFade = 4.0;

/// Returns the index of the cell that is this number of bricks away, limited to the range of int.
int bricksFrom(int cell, int bricks) noexcept {
  using Limits = std::numeric_limits<int>;
  return static_cast<int>(std::clamp<std::int64_t>(std::int64_t{cell} + kBrickSide * bricks,
                                                   Limits::min(), Limits::max()));
}

/// Time in which the weight of a brick that arrives near a hand grows to 1 [ns].
constexpr double kArrives = 10e6;
/// Time constant of the velocity's filter, which smooths the steps of the encoders [s].
constexpr double kSmooth = 0.02;
/// Longest wait of a tick in virtual time for its bricks [s of real time].
constexpr double kLongestWait = 60.0;

template <int C>
class BrickLevelSource {
 public:
  struct Cache {
    BrickWindow::Entry entry;  ///< Entry of the brick that contains the last cell.
    /// False after a read of a missing brick. The reader sets the member to true before it reads.
    bool whole = true;
  };

  template <int W, bool Edges>
  class Block {
    static_assert(W == 4);

   public:
    Block(const BrickLevelSource& of, Cache& cache, const std::array<int, 3>& low) noexcept {
      const std::array<int, 3> cell{low[0] + 1, low[1] + 1, low[2] + 1};
      cache.entry = of.window_->entryAt(of.level_, cell[0], cell[1], cell[2]);
      if (!of.window_->cellAt(cache.entry, of.level_, cell, cell_)) {
        cache.whole = false;
        cell_.room.fill(0.0F);
        cell_.rows.fill(cell_.room.data());
      }
      rows_.first = cell_.rows;
    }
    Block(const Block&) = delete;
    Block& operator=(const Block&) = delete;

    [[nodiscard]] const Rows<float, 4>& rows() const noexcept { return rows_; }
    [[nodiscard]] std::uint64_t active() const noexcept { return cell_.active; }
    [[nodiscard]] std::uint64_t allActive() const noexcept { return cell_.active; }

   private:
    BrickWindow::Cell cell_;
    Rows<float, 4> rows_;
  };

  BrickLevelSource(const BrickWindow& window, std::int32_t level)
      : window_(&window), level_(level) {
    // Along each axis, voxel I of a level covers the voxels 2 I and 2 I + 1 of the finer level.
    const auto& [lower, upper] = window.manifest().activeBox();
    for (std::size_t a = 0; a < 3; ++a) {
      ends_.lower[a] = lower[a] >> level;
      ends_.upper[a] = upper[a] >> level;
    }
    ends_.inactive = window.manifest().inactive();
  }

  [[nodiscard]] static Cache cache() noexcept { return {}; }
  [[nodiscard]] const DataEnds& ends() const noexcept { return ends_; }
  [[nodiscard]] double background(int c) const noexcept {
    return window_->manifest().background()[static_cast<std::size_t>(c)];
  }

 private:
  const BrickWindow* window_;
  std::int32_t level_;
  DataEnds ends_;
};

FieldFrame frameOf(const BrickManifest& manifest, const Placement& placement, double slope_reach) {
  const Vec3 margin = manifest.levels().front().linear.cwiseAbs().rowwise().sum();
  const Box& file = manifest.info().bounds;
  FieldFrame frame;
  frame.voxel = manifest.info().voxel.minCoeff() * placement.scale;
  frame.metres_per_unit = placement.scale;
  for (int corner = 0; corner < 8; ++corner) {
    Vec3 p;
    for (int a = 0; a < 3; ++a) {
      p[a] = ((corner >> a) & 1) != 0 ? file.upper[a] + margin[a] : file.lower[a] - margin[a];
    }
    frame.bounds.extend(placement(p));
  }
  frame.background = manifest.info().background;
  frame.distance = manifest.info().grid_class == GridClass::kLevelSet;
  frame.reach =
      slope_reach * placement.scale * placement.rotation * manifest.levels().front().linear;
  return frame;
}

template <class Base, int C>
class BrickField : public Base {
 protected:
  using Kernel = TrilinearKernel<C>;
  using Level = LatticeReader<BrickLevelSource<C>, Kernel>;
  using Row = typename Level::Row;

  struct Read {
    explicit Read(typename Level::Cache of) : cache(std::move(of)) {}
    typename Level::Cache cache;
    int level = -1;
  };
  /// A region in which only the finest level is read.
  struct Finest {
    bool settled = false;  ///< True if no brick in the region or next to it is still fading in.
    std::uint64_t changes = 0;  ///< BrickWindow::changes when the region was found.
    /// Brick around which the region was found.
    std::array<int, 3> brick{kNoCell, kNoCell, kNoCell};
    /// Lower corner of the region, which belongs to it, in the index space of level 0.
    Vec3 low = Vec3::Zero();
    Vec3 high = Vec3::Zero();  ///< Upper corner of the region, which does not belong to it.

    [[nodiscard]] bool holds(const Vec3& p_I) const noexcept {
      return (p_I.array() >= low.array()).all() && (p_I.array() < high.array()).all();
    }
  };
  struct Cache {
    Cache(typename Level::Cache&& a, typename Level::Cache&& b)
        : fine(std::move(a)), coarse(std::move(b)) {}
    Read fine;    ///< Finest level of the last reading.
    Read coarse;  ///< Coarsest level that contributed to the last reading of several levels.
    /// Time of the last tick, on the clock of BrickWindow::arrival. Before the first tick, and
    /// always if the window waits, it has its initial value: every loaded brick counts as
    /// completely faded in.
    std::int64_t now = std::numeric_limits<std::int64_t>::max();
    Vec3 probe = Vec3::Zero();     ///< Position of the probe in the last tick [m].
    Vec3 velocity = Vec3::Zero();  ///< Filtered velocity of the probe [m/s].
    bool met = false;              ///< True if a tick has set `probe` and `velocity`.
    std::size_t hand = 0;
    /// Value that BrickWindow::enter returned; set while the reader is registered.
    std::optional<std::uint32_t> side;
    Finest finest;  ///< Region of the finest level; used only while the reader is registered.
  };
  static_assert(sizeof(Cache) <= sizeof(FieldCache::bytes));

 public:
  BrickField(std::shared_ptr<const BrickWindow> window, const Placement& placement,
             double slope_reach)
      : Base(frameOf(window->manifest(), placement, slope_reach)), window_(std::move(window)) {
    const BrickManifest& manifest = window_->manifest();
    const auto count = static_cast<std::int32_t>(manifest.levels().size());
    const bool all_corners = manifest.info().grid_class == GridClass::kLevelSet;
    levels_.reserve(manifest.levels().size());
    for (std::int32_t l = 0; l < count; ++l) {
      const BrickLevel& level = manifest.levels()[static_cast<std::size_t>(l)];
      const IndexMap map(level.linear, level.origin, placement);
      maps_.push_back(map);
      levels_.emplace_back(BrickLevelSource<C>(*window_, l), map, nullptr, all_corners, false,
                           slope_reach);
    }
  }

  void reset(FieldCache& memory) const noexcept final {
    auto* cache = ::new (memory.bytes.data()) Cache(levels_[0].cache(), levels_[0].cache());
    cache->hand = window_->newHand();
  }

  bool attend(const Attention& at, FieldCache& memory) const noexcept final {
    Cache& cache = cacheIn(memory);
    const IndexMap& map = maps_.front();
    if (cache.met && at.dt > 0.0) {
      const Vec3 now = (at.probe - cache.probe) / at.dt;
      cache.velocity += (1.0 - std::exp(-at.dt / kSmooth)) * (now - cache.velocity);
    }
    cache.met = true;
    cache.probe = at.probe;
    window_->aim(cache.hand, {map(at.proxy), map(at.probe),
                              detail::times(map.index_from_world, cache.velocity)});
    if (window_->params().waits) {
      (void)window_->settle(kLongestWait);
    } else {
      cache.now = std::chrono::steady_clock::now().time_since_epoch() / std::chrono::nanoseconds(1);
      if (!cache.side) cache.side = window_->enter();
      const std::uint64_t changes = window_->changes();
      if (!cache.finest.settled || cache.finest.changes != changes) cache.finest = {};
      cache.finest.changes = changes;
    }
    return false;  // arriving bricks fade in, so values do not jump
  }
  void leave(FieldCache& memory) const noexcept final {
    if (const auto side = std::exchange(cacheIn(memory).side, std::nullopt)) window_->leave(*side);
  }
  [[nodiscard]] bool attends() const noexcept final { return true; }
  [[nodiscard]] bool lost() const noexcept final { return window_->lost(); }

 protected:
  static Cache& cacheIn(FieldCache& memory) noexcept {
    return *std::launder(reinterpret_cast<Cache*>(memory.bytes.data()));
  }

  /// Registers a reader for one reading, outside of ticks or in a window that waits for bricks.
  class Visit {
   public:
    Visit(const BrickWindow& window, const Cache& cache) noexcept : window_(window) {
      if (!cache.side) side_ = window.enter();
    }
    ~Visit() {
      if (side_) window_.leave(*side_);
    }
    Visit(const Visit&) = delete;
    Visit& operator=(const Visit&) = delete;

   private:
    const BrickWindow& window_;
    std::optional<std::uint32_t> side_;
  };

  [[nodiscard]] static std::array<int, 3> cellOf(const Vec3& p_I) noexcept {
    std::array<int, 3> cell{};
    for (std::size_t a = 0; a < 3; ++a) {
      const double at = std::clamp(p_I[static_cast<Eigen::Index>(a)], -1e9, 1e9);
      cell[a] = static_cast<int>(std::floor(at));
    }
    return cell;
  }
  /// Returns the weight with which a brick has faded in, 0 to 1.
  [[nodiscard]] double arrived(const BrickWindow::Entry& entry, std::int64_t now) const noexcept {
    if (!entry.resident()) return 0.0;
    const double age = static_cast<double>(now) - static_cast<double>(window_->arrival(entry));
    return std::clamp(age / kArrives, 0.0, 1.0);
  }
  [[nodiscard]] BrickWindow::Entry entryOf(int level,
                                           const std::array<int, 3>& cell) const noexcept {
    return window_->entryAt(level, cell[0], cell[1], cell[2]);
  }
  struct At {
    Vec3 p_I;
    std::array<int, 3> cell;
    BrickWindow::Entry entry;
  };
  [[nodiscard]] At atLevel(const Vec3& p_W, int level) const noexcept {
    At out;
    out.p_I = maps_[static_cast<std::size_t>(level)](p_W);
    out.cell = cellOf(out.p_I);
    out.entry = entryOf(level, out.cell);
    return out;
  }
  /// Returns the share s of a level at a point. s is the minimum of a + d / kFade over all bricks
  /// within kFade voxels, where a is the brick's faded-in weight, and d its distance. So s is
  /// continuous.
  [[nodiscard]] double shareAt(const At& at, int level, std::int64_t now) const noexcept {
    double least = arrived(at.entry, now);
    std::array<int, 3> side{};
    std::array<double, 3> off{};
    for (std::size_t a = 0; a < 3; ++a) {
      const int first = at.cell[a] & ~(kBrickSide - 1);
      const double in = at.p_I[static_cast<Eigen::Index>(a)] - first;
      side[a] = in < kFade ? -1 : in > kBrickSide - kFade ? 1 : 0;
      off[a] = (side[a] < 0 ? in : kBrickSide - in) / kFade;
    }
    if (side == std::array{0, 0, 0}) return least;
    for (unsigned set = 1; set < 8; ++set) {
      std::array<int, 3> other = at.cell;
      double squared = 0.0;
      bool near = true;
      for (std::size_t a = 0; a < 3; ++a) {
        if ((set >> a & 1U) == 0) continue;
        near = near && side[a] != 0;
        other[a] = bricksFrom(other[a], side[a]);
        squared += off[a] * off[a];
      }
      if (!near || squared >= least * least) continue;
      least = std::min(least, arrived(entryOf(level, other), now) + std::sqrt(squared));
    }
    return least;
  }

  /// Finds the region of the finest level around a point's brick. It includes neighbours that have
  /// faded in completely, and excludes points that are nearer than kFade to any other brick.
  void findFinest(const Vec3& p_I, const std::array<int, 3>& brick, Cache& cache) const noexcept {
    Finest& finest = cache.finest;
    finest.brick = brick;
    finest.low = finest.high;
    finest.settled = true;
    const auto there = [&](const std::array<int, 3>& off) {
      std::array<int, 3> cell = brick;
      for (std::size_t a = 0; a < 3; ++a) cell[a] = bricksFrom(cell[a], off[a]);
      const BrickWindow::Entry entry = entryOf(0, cell);
      const bool whole = arrived(entry, cache.now) >= 1.0;
      if (entry.resident() && !whole) finest.settled = false;
      return whole;
    };
    if (!there({0, 0, 0})) return;
    const Box box = detail::bricksAbout(p_I, Vec3(brick[0], brick[1], brick[2]), kFade, there);
    finest.low = box.lower;
    finest.high = box.upper;
    Read& read = cache.fine;
    const std::array<int, 3>& cell = read.cache.cell;
    const bool same =
        read.level == 0 && cell[0] != kNoCell && entryOf(0, cell) == read.cache.source.entry;
    if (!same) read.cache.cell.fill(kNoCell);
    read.level = 0;
  }
  /// Returns the half-extents [voxels of a level] of the box around a ball of radius `distance`
  /// [m].
  [[nodiscard]] Vec3 reachIn(int level, double distance) const noexcept {
    if (distance <= 0.0) return Vec3::Zero();
    const IndexMap& map = maps_[static_cast<std::size_t>(level)];
    return distance * map.index_from_world.rowwise().norm();
  }
  /// Calls `of(level, its cache)` if the box between two points, with `about` [m] around it, is in
  /// the region of the finest level. Returns false if the box is not in the region, or if a brick
  /// was removed during the call.
  template <class Of>
  [[nodiscard]] bool byFinest(const Vec3& p_W, const Vec3& q_W, double about, Cache& cache,
                              const Of& of) const noexcept {
    if (!cache.side) return false;
    const Vec3 p_I = maps_.front()(p_W);
    if (!cache.finest.holds(p_I)) {
      std::array<int, 3> brick = cellOf(p_I);
      for (int& i : brick) i &= ~(kBrickSide - 1);
      if (brick == cache.finest.brick) return false;
      findFinest(p_I, brick, cache);
      if (!cache.finest.holds(p_I)) return false;
    }
    Read& read = cache.fine;
    const Vec3 q_I = maps_.front()(q_W);
    const Vec3 reach = reachIn(0, about);
    const Finest& finest = cache.finest;
    if (read.level != 0 || !finest.holds(p_I.cwiseMin(q_I) - reach) ||
        !finest.holds(p_I.cwiseMax(q_I) + reach)) {
      return false;
    }
    read.cache.source.whole = true;
    of(levels_.front(), read.cache);
    if (!read.cache.source.whole) read.cache.cell.fill(kNoCell);
    return read.cache.source.whole;
  }

  /// Reads a level at a point. Returns false if the level's brick was removed during the call.
  [[nodiscard]] bool readAt(int level, const At& at, const Vec3& p_W, Read& read, Row& row,
                            bool& inside) const noexcept {
    if (read.level != level || !(read.cache.source.entry == at.entry)) {
      read.cache.cell.fill(kNoCell);
    }
    read.level = level;
    read.cache.source.whole = true;
    inside = levels_[static_cast<std::size_t>(level)].read(p_W, read.cache, row);
    if (!read.cache.source.whole) read.cache.cell.fill(kNoCell);
    return read.cache.source.whole;
  }

  /// Blends the levels at a point: B_l = s_l L_l + (1 - s_l) B_(l+1), with s = 1 at the coarsest.
  /// All B_l are continuous where L and s are. Calls `add(weight, level, read, row, inside)` for
  /// each level with a weight above 0, the finest first. A brick that is removed during the call
  /// counts as missing. Returns true if a level other than 0 has contributed.
  template <class Add>
  bool readLevels(const Vec3& p_W, Cache& cache, const Add& add) const noexcept {
    const Visit visit(*window_, cache);
    const auto last = static_cast<int>(levels_.size()) - 1;
    double left = 1.0;
    bool any = false;
    for (int level = 0; level <= last; ++level) {
      const At at = atLevel(p_W, level);
      const double share = level == last ? 1.0 : shareAt(at, level, cache.now);
      if (!(share > 0.0)) continue;
      Read& read = any ? cache.coarse : cache.fine;
      Row row;
      bool inside = false;
      if (!readAt(level, at, p_W, read, row, inside) && level < last) continue;
      add(left * share, level, read, row, inside);
      if (share >= 1.0) return level > 0 || any;
      any = true;
      left *= 1.0 - share;
    }
    return true;
  }

  /// Reads the row at p_W. Sets `coarse` to true if a coarser level has contributed. Returns true
  /// if there is data.
  [[nodiscard]] bool read(const Vec3& p_W, Cache& cache, Row& row, bool& coarse) const noexcept {
    bool inside = false;
    const auto straight = [&](const Level& level, typename Level::Cache& of) {
      inside = level.read(p_W, of, row);
    };
    if (byFinest(p_W, p_W, 0.0, cache, straight)) {
      coarse = false;
      return inside;
    }
    inside = false;
    bool first = true;
    const auto add = [&](double weight, int /*level*/, const Read& /*of*/, const Row& one,
                         bool in) {
      inside = inside || in;
      for (std::size_t n = 0; n < row.size(); ++n) {
        row[n] = first ? weight * one[n] : row[n] + weight * one[n];
      }
      first = false;
    };
    coarse = readLevels(p_W, cache, add);
    return inside;
  }

  /// Numbers of a level's bricks in a box: all, in memory, and completely faded in.
  struct Counted {
    int all = 0;
    int resident = 0;
    int arrived = 0;
  };
  [[nodiscard]] Counted countIn(const Vec3& a_W, const Vec3& b_W, double about, int level,
                                std::int64_t now) const noexcept {
    const IndexMap& map = maps_[static_cast<std::size_t>(level)];
    const Vec3 a = map(a_W);
    const Vec3 b = map(b_W);
    const Vec3 fade = Vec3::Constant(kFade) + reachIn(level, about);
    const std::array<int, 3> low = cellOf(a.cwiseMin(b) - fade);
    const std::array<int, 3> high = cellOf(a.cwiseMax(b) + fade);
    Counted out;
    for (int i = low[0] & ~63; i <= high[0]; i += kBrickSide) {
      for (int j = low[1] & ~63; j <= high[1]; j += kBrickSide) {
        for (int k = low[2] & ~63; k <= high[2]; k += kBrickSide) {
          const double share = arrived(entryOf(level, {i, j, k}), now);
          ++out.all;
          out.resident += share > 0.0 ? 1 : 0;
          out.arrived += share >= 1.0 ? 1 : 0;
        }
      }
    }
    return out;
  }
  /// Calls `of` for the region between two points and `about` [m] around them, if one level
  /// provides all of it. Returns false if no single level does, or if a brick was removed during
  /// the call.
  template <class Of>
  [[nodiscard]] bool byOneLevel(const Vec3& a_W, const Vec3& b_W, double about, Cache& cache,
                                const Of& of) const noexcept {
    if (byFinest(a_W, b_W, about, cache, of)) return true;
    constexpr double kFarthest = 256.0;  // longest path for which the bricks are counted [voxels]
    const double size = ((b_W - a_W).norm() + 2.0 * about) / this->frame().voxel;
    if (!(size <= kFarthest)) return false;
    const Visit visit(*window_, cache);
    const auto last = static_cast<int>(levels_.size()) - 1;
    int level = 0;
    for (; level < last; ++level) {
      const Counted counted = countIn(a_W, b_W, about, level, cache.now);
      if (counted.arrived == counted.all) break;
      if (counted.resident > 0) return false;
    }
    Read& read = cache.fine;
    read.level = level;
    read.cache.cell.fill(kNoCell);
    read.cache.source.whole = true;
    of(levels_[static_cast<std::size_t>(level)], read.cache);
    if (!read.cache.source.whole) read.cache.cell.fill(kNoCell);
    return read.cache.source.whole;
  }

  [[nodiscard]] const std::vector<Level>& levels() const noexcept { return levels_; }

 private:
  std::shared_ptr<const BrickWindow> window_;
  std::vector<IndexMap> maps_;
  std::vector<Level> levels_;
};

class BrickScalarField final : public BrickField<ScalarField, 1> {
  using Base = BrickField<ScalarField, 1>;

 public:
  using Base::Base;

  [[nodiscard]] ScalarSample sample(const Vec3& p_W, FieldCache& memory) const noexcept override {
    Row row{};
    bool coarse = false;
    const bool inside = read(p_W, cacheIn(memory), row, coarse);
    return {row[0], Vec3(row[1], row[2], row[3]), inside, coarse};
  }

  [[nodiscard]] double value(const Vec3& p_W, FieldCache& memory) const noexcept override {
    return mixed<double>(p_W, memory, [&](const Level& level, typename Level::Cache& cache) {
      return level.value(p_W, cache);
    });
  }

  [[nodiscard]] Vec3 cellGradient(const Vec3& p_W, FieldCache& memory) const noexcept override {
    return mixed<Vec3>(p_W, memory, [&](const Level& level, typename Level::Cache& cache) {
      return level.slope(p_W, cache);
    });
  }

  [[nodiscard]] Mat3 gradientJacobian(const Vec3& p_W, FieldCache& memory) const noexcept override {
    return mixed<Mat3>(p_W, memory, [&](const Level& level, typename Level::Cache& cache) {
      return level.turning(p_W, cache);
    });
  }

  [[nodiscard]] Crossing firstFall(const Vec3& a_W, const Vec3& b_W, double level, double sign,
                                   FieldCache& memory) const noexcept override {
    Crossing out;
    const auto fall = [&](const Level& of, typename Level::Cache& cache) {
      out = of.firstFall(a_W, b_W, level, sign, cache);
    };
    if (byOneLevel(a_W, b_W, 0.0, cacheIn(memory), fall)) return out;
    return ScalarField::firstFall(a_W, b_W, level, sign, memory);
  }

 private:
  /// Returns the results of `of` for the levels at a point, blended in the same way as the values.
  template <class Out, class Of>
  [[nodiscard]] Out mixed(const Vec3& p_W, FieldCache& memory, const Of& of) const noexcept {
    Out out{};
    Cache& cache = cacheIn(memory);
    if (byFinest(p_W, p_W, 0.0, cache,
                 [&](const Level& level, typename Level::Cache& in) { out = of(level, in); })) {
      return out;
    }
    bool first = true;
    (void)readLevels(p_W, cache,
                     [&](double weight, int level, Read& read, const Row& /*row*/, bool /*in*/) {
                       const Out one = of(levels()[static_cast<std::size_t>(level)], read.cache);
                       out = first ? Out(weight * one) : Out(out + weight * one);
                       first = false;
                     });
    return out;
  }
};

class BrickVectorField final : public BrickField<VectorField, 3> {
  using Base = BrickField<VectorField, 3>;

 public:
  using Base::Base;

  [[nodiscard]] VectorSample sample(const Vec3& p_W, FieldCache& memory) const noexcept override {
    VectorSample out;
    Row row{};
    out.inside = read(p_W, cacheIn(memory), row, out.coarse);
    out.value = Vec3(row[0], row[1], row[2]);
    std::copy_n(row.begin() + 3, 9, out.jacobian.data());
    return out;
  }

  [[nodiscard]] Trace trace(const Vec3& p_W, const TraceOrder& order,
                            FieldCache& memory) const noexcept override {
    Trace out;
    const auto go = [&](const Level& of, typename Level::Cache& cache) {
      out = of.trace(p_W, order, this->frame().voxel, cache);
    };
    if (byOneLevel(p_W, p_W, std::abs(order.length), cacheIn(memory), go)) return out;
    return VectorField::trace(p_W, order, memory);
  }
};

}  // namespace

FieldPtr makeBrickField(std::shared_ptr<const BrickWindow> window, const Placement& placement,
                        double slope_reach) {
  if (window->manifest().format().vector) {
    return std::make_shared<const BrickVectorField>(std::move(window), placement, slope_reach);
  }
  return std::make_shared<const BrickScalarField>(std::move(window), placement, slope_reach);
}

}  // namespace palpate
