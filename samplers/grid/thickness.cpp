#include "palpate/samplers/grid/thickness.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <tuple>
#include <type_traits>
#include <vector>

#include <openvdb/tree/ValueAccessor.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include "palpate/samplers/grid/cell.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/volume_grid.h"

namespace palpate {
namespace {

using openvdb::Coord;

constexpr int kLeaf = 8;

/// Orders numbers, and equal numbers by place: so the result does not depend on the order of
/// threads.
bool isBefore(double a, const Vec3& place_a, double b, const Vec3& place_b) noexcept {
  return std::make_tuple(a, place_a.x(), place_a.y(), place_a.z()) <
         std::make_tuple(b, place_b.x(), place_b.y(), place_b.z());
}

/// Counts thicknesses by hundredths of a voxel, and the rest of the result.
struct Tally {
  static constexpr double kBin = 0.01;
  static constexpr std::size_t kBins = 150;
  static_assert(kBins * kBin == kThick);

  Thickness found;
  std::array<std::uint64_t, kBins> bins{};

  void addSurface() noexcept { ++found.surface_cells; }
  void add(double voxels, const Vec3& p_F) noexcept {
    ++found.thin_cells;
    if (voxels < 1.0) ++found.below_one;
    ++bins[std::min(static_cast<std::size_t>(voxels / kBin), kBins - 1)];
    keep(voxels, p_F);
    ++leaf_.crowd;
    if (isBefore(voxels, p_F, leaf_.least, leaf_.thinnest_F)) {
      leaf_.least = voxels;
      leaf_.thinnest_F = p_F;
    }
  }
  /// Counts a cell at the edge of the data that the surface enters.
  void addOpen(const Vec3& p_F) noexcept {
    if (found.open_cells++ == 0 || isBefore(0.0, p_F, 0.0, found.open_F)) found.open_F = p_F;
  }
  /// Ends a leaf: all later additions belong to another leaf.
  void endLeaf() noexcept {
    if (leaf_.crowd > 0) gather(leaf_.crowd, leaf_.thinnest_F);
    leaf_ = {};
  }
  void join(const Tally& other) noexcept {
    found.surface_cells += other.found.surface_cells;
    found.thin_cells += other.found.thin_cells;
    found.below_one += other.found.below_one;
    for (std::size_t i = 0; i < kBins; ++i) bins[i] += other.bins[i];
    keep(other.found.least, other.found.thinnest_F);
    gather(other.found.crowd, other.found.crowd_F);
    const bool first =
        found.open_cells == 0 || isBefore(0.0, other.found.open_F, 0.0, found.open_F);
    if (other.found.open_cells > 0 && first) found.open_F = other.found.open_F;
    found.open_cells += other.found.open_cells;
  }
  [[nodiscard]] Thickness result() const noexcept {
    Thickness out = found;
    std::uint64_t below = 0;
    for (std::size_t i = 0; i < kBins && out.thin_cells > 0; ++i) {
      below += bins[i];
      if (10 * below < out.thin_cells) continue;
      out.tenth = std::max(out.least, static_cast<double>(i + 1) * kBin);
      break;
    }
    return out;
  }

 private:
  void keep(double voxels, const Vec3& p_F) noexcept {
    if (!isBefore(voxels, p_F, found.least, found.thinnest_F)) return;
    found.least = voxels;
    found.thinnest_F = p_F;
  }
  void gather(std::uint64_t crowd, const Vec3& p_F) noexcept {
    const auto less = [](std::uint64_t n) { return -static_cast<double>(n); };
    if (!isBefore(less(crowd), p_F, less(found.crowd), found.crowd_F)) return;
    found.crowd = crowd;
    found.crowd_F = p_F;
  }

  Thickness leaf_;
};

/// The voxels of a leaf's place and one more to each side, and the owners of the cells at its rim.
template <class TreeT>
class Surroundings {
 public:
  explicit Surroundings(const TreeT& tree) : accessor_(tree) {}

  /// Reads the voxels around a leaf. Returns false if all values are on one side, without a
  /// surface.
  bool gather(const Coord& origin, double level, double sign) noexcept {
    double least = std::numeric_limits<double>::infinity();
    double most = -least;
    for (int n = 0; n < 27; ++n) {
      const std::array<int, 3> block{n / 9, n / 3 % 3, n % 3};
      std::array<int, 3> from{};
      std::array<int, 3> to{};
      Coord at = origin;
      for (std::size_t a = 0; a < 3; ++a) {
        const int axis = static_cast<int>(a);
        from[a] = block[a] == 0 ? -1 : block[a] == 1 ? 0 : kLeaf;
        to[a] = block[a] == 0 ? 0 : block[a] == 1 ? kLeaf : kLeaf + 1;
        at[axis] += (block[a] - 1) * kLeaf;
      }
      const auto* leaf = accessor_.probeConstLeaf(at);
      typename TreeT::ValueType tile{};
      bool on = false;
      if (leaf == nullptr) on = accessor_.probeValue(at, tile);
      listed_[static_cast<std::size_t>(n)] =
          leaf != nullptr || (on && accessor_.getValueDepth(at) > 0);
      for (int i = from[0]; i < to[0]; ++i) {
        for (int j = from[1]; j < to[1]; ++j) {
          for (int k = from[2]; k < to[2]; ++k) {
            const auto voxel =
                static_cast<openvdb::Index>(((i & 7) << 6) | ((j & 7) << 3) | (k & 7));
            const auto value =
                static_cast<double>(leaf != nullptr ? leaf->buffer().data()[voxel] : tile);
            const double height = sign * (value - level);
            const std::size_t to_voxel = index(i, j, k);
            heights_[to_voxel] = height;
            active_[to_voxel] = leaf != nullptr ? leaf->isValueOn(voxel) : on;
            least = std::min(least, height);
            most = std::max(most, height);
          }
        }
      }
    }
    return least < 0.0 && most >= 0.0;
  }

  /// A cell, found by its lowest corner: the corners' heights above the level (free at 0 and
  /// above), in the order of cell.h.
  struct Cell {
    std::array<double, 8> heights{};
    int free = 0;
    int active = 0;
  };
  [[nodiscard]] Cell cell(int i, int j, int k) const noexcept {
    Cell out;
    for (int n = 0; n < 8; ++n) {
      const std::size_t v = index(i + (n >> 2), j + ((n >> 1) & 1), k + (n & 1));
      out.heights[static_cast<std::size_t>(n)] = heights_[v];
      out.free += static_cast<int>(heights_[v] >= 0.0);
      out.active += static_cast<int>(active_[v]);
    }
    return out;
  }

  /// Returns whether this leaf owns a cell. The leaf or tile of the cell's first corner that is in
  /// one owns the cell.
  [[nodiscard]] bool owns(int i, int j, int k) const noexcept {
    if (i >= 0 && j >= 0 && k >= 0) return true;
    const auto block = [](int v) { return v < 0 ? 0 : v < kLeaf ? 1 : 2; };
    for (int n = 0; n < 8; ++n) {
      const int b = 9 * block(i + (n >> 2)) + 3 * block(j + ((n >> 1) & 1)) + block(k + (n & 1));
      if (b == 13) return true;
      if (listed_[static_cast<std::size_t>(b)]) return false;
    }
    return false;
  }

 private:
  static constexpr int kSide = kLeaf + 2;
  static constexpr std::size_t index(int i, int j, int k) noexcept {
    const int n = ((i + 1) * kSide + j + 1) * kSide + k + 1;
    return static_cast<std::size_t>(n);
  }

  openvdb::tree::ValueAccessor<const TreeT, false> accessor_;
  std::array<double, static_cast<std::size_t>(kSide* kSide* kSide)> heights_{};
  std::array<bool, static_cast<std::size_t>(kSide* kSide* kSide)> active_{};
  std::array<bool, 27> listed_{};
};

/// Returns the leaves, and the outermost places of leaves in active tiles: a tile has no surface
/// inside.
template <class TreeT>
std::vector<Coord> places(const TreeT& tree) {
  std::vector<Coord> out;
  out.reserve(tree.leafCount());
  for (auto leaf = tree.cbeginLeaf(); leaf; ++leaf) out.push_back(leaf->origin());
  constexpr int kLargest = 128;  // larger tiles have millions of voxels per face
  auto tile = tree.cbeginValueOn();
  tile.setMaxDepth(TreeT::ValueOnCIter::LEAF_DEPTH - 1);
  for (; tile; ++tile) {
    const openvdb::CoordBBox box = tile.getBoundingBox();
    const int last = box.dim().x() - kLeaf;
    if (box.dim().x() > kLargest) continue;
    for (int i = 0; i <= last; i += kLeaf) {
      for (int j = 0; j <= last; j += kLeaf) {
        const bool all = i == 0 || i == last || j == 0 || j == last;
        for (int k = 0; k <= last; k += all || last == 0 ? kLeaf : last) {
          out.push_back(box.min().offsetBy(i, j, k));
        }
      }
    }
  }
  return out;
}

/// Returns a root of a cell's polynomial within the cell, just on the free side.
template <class Cell>
Vec3 onSurface(const Cell& cell) noexcept {
  std::array<double, 64> block{};
  Rows<double, 4> rows;
  for (std::size_t n = 0; n < 16; ++n) rows.first[n] = block.data() + 4 * n;
  for (int n = 0; n < 8; ++n) {
    block[static_cast<std::size_t>(bitOf<4>(1 + (n >> 2), 1 + ((n >> 1) & 1), 1 + (n & 1)))] =
        cell.heights[static_cast<std::size_t>(n)];
  }
  TrilinearKernel<1> kernel;
  kernel.load(rows, [](auto& /*rows*/) {});
  const Vec3 centre = Vec3::Constant(0.5);
  std::array<double, 1> height{};
  kernel.value(centre, height);
  const bool free = height[0] >= 0.0;
  // The way to the steepest corner of the other side.
  const Vec3 slope = kernel.slope(centre);
  Vec3 way = Vec3::Zero();
  double steepest = -std::numeric_limits<double>::infinity();
  for (int n = 0; n < 8; ++n) {
    if ((cell.heights[static_cast<std::size_t>(n)] >= 0.0) == free) continue;
    const Vec3 to = Vec3(n >> 2, (n >> 1) & 1, n & 1) - centre;
    const double steep = free ? -slope.dot(to) : slope.dot(to);
    if (steep <= steepest) continue;
    steepest = steep;
    way = to;
  }
  // From free to solid.
  const Vec3 from = free ? centre : Vec3(centre + way);
  if (!free) way = -way;
  bool above = true;
  const double share = firstFall(kernel.along(from, way), false, above);
  return from + std::min(share, 1.0) * way;
}

/// Measures thickness, for one thread.
class Feeler {
 public:
  Feeler(const ScalarField& field, const Volume::Grid::Part& part, double level, double sign)
      : field_(field),
        part_(part),
        index_from_file_(part.linear.inverse()),
        level_(level),
        sign_(sign) {
    field.reset(cache_);
  }

  void measure(const Vec3& p_I, Tally& tally) noexcept {
    const Vec3 p_F = part_.toFile(p_I);
    // If the polynomial is flat, the smooth gradient leads. If that is zero too, the cell is
    // skipped.
    Vec3 inward = -sign_ * field_.cellGradient(p_F, cache_);
    if (inward.isZero(0.0)) inward = -sign_ * field_.sample(p_F, cache_).gradient;
    const double length = Vec3(index_from_file_ * inward).norm();
    if (!(length > 0.0) || !std::isfinite(length)) return;
    const Vec3 end_F = p_F + (kThick / length) * inward;
    const Crossing out = field_.firstFall(p_F, end_F, level_, -sign_, cache_);
    const double voxels = out.share * kThick;
    if (out.found && voxels < kThick) tally.add(voxels, p_F);
  }

 private:
  const ScalarField& field_;
  const Volume::Grid::Part& part_;
  Mat3 index_from_file_;
  double level_;
  double sign_;
  FieldCache cache_{};
};

/// Counts gaps by hundredths of a voxel.
struct GapTally {
  static constexpr double kBin = 0.01;
  static constexpr std::size_t kBins = 200;
  static_assert(kBins * kBin == kGap);

  Gap found;
  std::array<std::uint64_t, kBins> bins{};

  void addSurface() noexcept { ++found.surface_cells; }
  void add(double voxels, double length_F, const Vec3& p_F) noexcept {
    ++found.facing_cells;
    ++bins[std::min(static_cast<std::size_t>(voxels / kBin), kBins - 1)];
    keep(voxels, length_F, p_F);
  }
  void addOpen(const Vec3& /*p_F*/) noexcept {}
  void endLeaf() noexcept {}
  void join(const GapTally& other) noexcept {
    found.surface_cells += other.found.surface_cells;
    found.facing_cells += other.found.facing_cells;
    for (std::size_t i = 0; i < kBins; ++i) bins[i] += other.bins[i];
    if (other.found.facing_cells == 0) return;
    keep(other.found.widest, other.found.length_F, other.found.widest_F);
  }
  [[nodiscard]] Gap result() const noexcept {
    Gap out = found;
    std::uint64_t below = 0;
    for (std::size_t i = 0; i < kBins && 2 * below < found.facing_cells; ++i) {
      below += bins[i];
      out.median = std::min(out.widest, static_cast<double>(i + 1) * kBin);
    }
    return out;
  }

 private:
  void keep(double voxels, double length_F, const Vec3& p_F) noexcept {
    if (!isBefore(-voxels, p_F, -found.widest, found.widest_F)) return;
    found.widest = voxels;
    found.length_F = length_F;
    found.widest_F = p_F;
  }
};

/// Measures the gap to another solid, for one thread.
class GapFeeler {
 public:
  /// The other solid, in its own space, and the place of the surface in that space.
  struct Other {
    const ScalarField& field;
    double level;
    double sign;
    const Placement& place;
  };

  GapFeeler(const ScalarField& field, const Volume::Grid::Part& part, double sign,
            const Other& other)
      : field_(field),
        part_(part),
        index_from_file_(part.linear.inverse()),
        sign_(sign),
        other_(other) {
    field.reset(cache_);
    other.field.reset(other_cache_);
  }

  void measure(const Vec3& p_I, GapTally& tally) noexcept {
    constexpr double kTouch = 0.05;  // [voxels]
    const Vec3 p_F = part_.toFile(p_I);
    const Vec3 outward = sign_ * field_.cellGradient(p_F, cache_);
    const double length = Vec3(index_from_file_ * outward).norm();
    if (!(length > 0.0) || !std::isfinite(length)) return;
    const Vec3 way_F = (kGap / length) * outward;
    const Vec3 from = other_.place(p_F);
    // A path that begins deep in a level set, beyond its band, would meet the band from within.
    if (other_.sign * (other_.field.value(from, other_cache_) - other_.level) < 0.0) return;
    const Crossing into = other_.field.firstFall(from, other_.place(p_F + way_F), other_.level,
                                                 other_.sign, other_cache_);
    const double voxels = into.share * kGap;
    if (into.found && voxels > kTouch) tally.add(voxels, into.share * way_F.norm(), p_F);
  }

 private:
  const ScalarField& field_;
  const Volume::Grid::Part& part_;
  Mat3 index_from_file_;
  double sign_;
  const Other& other_;
  FieldCache cache_{};
  FieldCache other_cache_{};
};

/// Makes a feeler for each thread; it measures at one place in every cell that the surface crosses.
template <class Tally, class GridT, class MakeFeeler>
Tally atEachCell(const Volume& volume, const GridT& grid, double level, double sign,
                 const MakeFeeler& make_feeler) {
  using TreeT = typename GridT::TreeType;
  const bool all_corners = volume.info().grid_class == GridClass::kLevelSet;
  const std::vector<Coord> blocks = places(grid.tree());
  const Volume::Grid::Part& part = volume.grid().parts.front();
  const auto look = [&](const tbb::blocked_range<std::size_t>& range, Tally tally) {
    Surroundings<TreeT> around(grid.tree());
    auto feeler = make_feeler(part);
    for (std::size_t b = range.begin(); b < range.end(); ++b) {
      if (!around.gather(blocks[b], level, sign)) continue;
      for (int i = -1; i < kLeaf; ++i) {
        for (int j = -1; j < kLeaf; ++j) {
          for (int k = -1; k < kLeaf; ++k) {
            const auto cell = around.cell(i, j, k);
            if (cell.free == 0 || cell.free == 8) continue;
            if (!around.owns(i, j, k)) continue;
            const Coord low = blocks[b].offsetBy(i, j, k);
            const Vec3 low_I(low.x(), low.y(), low.z());
            if (cell.active < (all_corners ? 8 : 1)) {
              if (cell.active > 0) tally.addOpen(part.toFile(low_I));
              continue;
            }
            tally.addSurface();
            feeler.measure(low_I + onSurface(cell), tally);
          }
        }
      }
      tally.endLeaf();
    }
    return tally;
  };
  const auto join = [](Tally a, const Tally& b) {
    a.join(b);
    return a;
  };
  return tbb::parallel_reduce(tbb::blocked_range<std::size_t>(0, blocks.size(), 16), Tally(), look,
                              join);
}

/// Returns the sign with which the gradient points outward.
double signOf(Solid solid) noexcept {
  return solid == Solid::kAbove ? -1.0 : 1.0;
}

/// Calls atEachCell for a volume of any type. Returns an empty result unless it is a trilinear
/// scalar. `make_feeler` makes a feeler from the volume's own field and part.
template <class Tally, class MakeFeeler>
auto measured(const std::shared_ptr<const Volume>& volume, const Sampling& sampling, double level,
              Solid solid, const MakeFeeler& make_feeler) {
  using Result = std::optional<decltype(Tally().result())>;
  if (volume->info().vector || sampling.interpolation != Interpolation::kTrilinear) {
    return Result();
  }
  const FieldPtr field = makeVdbField(volume, Placement{}, sampling);
  return std::visit(
      [&](const auto& grid) -> Result {
        using GridT = std::remove_const_t<typename std::decay_t<decltype(grid)>::element_type>;
        if constexpr (std::is_arithmetic_v<typename GridT::ValueType>) {
          return atEachCell<Tally>(*volume, *grid, level, signOf(solid),
                                   [&](const Volume::Grid::Part& part) {
                                     return make_feeler(*std::get<0>(field), part);
                                   })
              .result();
        } else {
          return Result();
        }
      },
      volume->grid().parts.front().data);
}

}  // namespace

std::optional<Thickness> measureThickness(const std::shared_ptr<const Volume>& volume,
                                          const Sampling& sampling, double level, Solid solid) {
  return measured<Tally>(volume, sampling, level, solid,
                         [&](const ScalarField& field, const Volume::Grid::Part& part) {
                           return Feeler(field, part, level, signOf(solid));
                         });
}

std::optional<Gap> measureGap(const std::shared_ptr<const Volume>& volume, const Sampling& sampling,
                              double level, Solid solid, const Placement& place,
                              const ScalarField& other, double other_level, Solid other_solid) {
  const GapFeeler::Other to{other, other_level, signOf(other_solid), place};
  return measured<GapTally>(volume, sampling, level, solid,
                            [&](const ScalarField& field, const Volume::Grid::Part& part) {
                              return GapFeeler(field, part, signOf(solid), to);
                            });
}

}  // namespace palpate
