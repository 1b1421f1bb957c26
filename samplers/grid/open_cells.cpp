#include "palpate/samplers/grid/open_cells.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <type_traits>
#include <variant>
#include <vector>

#include <openvdb/tree/ValueAccessor.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include "palpate/samplers/grid/band_cell.h"
#include "palpate/samplers/grid/cells_at.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/tile_blocks.h"
#include "palpate/samplers/grid/volume_grid.h"

namespace palpate {
namespace {

using openvdb::Coord;

constexpr int kLeaf = 8;

/// Numbers of surface cells and of open cells, and the first open cell in a fixed order.
struct Tally {
  std::uint64_t surface = 0;
  std::uint64_t count = 0;
  Coord first;

  void add(const Coord& low, std::uint64_t cells) noexcept {
    if (cells == 0) return;
    if (count == 0 || low < first) first = low;
    count += cells;
  }
};

/// Returns the origins of leaves and of outer blocks of active tiles. A tile has no surface inside.
template <class TreeT>
std::vector<Coord> blocksOf(const TreeT& tree) {
  std::vector<Coord> out = detail::tileBlocks(tree, /*inner=*/false);
  out.reserve(out.size() + tree.leafCount());
  for (auto leaf = tree.cbeginLeaf(); leaf; ++leaf) out.push_back(leaf->origin());
  return out;
}

/// Finds surface cells and open cells. Each thread has its own object.
template <class TreeT>
class Finder {
 public:
  Finder(const TreeT& tree, double level, double sign)
      : accessor_(tree), background_(tree.background()), level_(level), sign_(sign) {}

  /// Counts the surface cells with this voxel as first active corner, and open cells beside them.
  void countAt(const Coord& voxel, Tally& tally) const {
    if (!accessor_.isValueOn(voxel)) return;
    detail::eachCellAt(accessor_, voxel, [&](const Coord& low, const Values& values, int active) {
      if (!crosses(values)) return;
      ++tally.surface;
      if (active == 8) return;
      if (!detail::holdsSurface(values, background_)) return tally.add(low, 1);
      // Cells beside this one may contain the surface without an active corner.
      for (int n = 0; n < kAround; ++n) {
        const Coord beyond = low + aside(n);
        const Cell cell = cellAt(beyond);
        if (cell.active > 0 || !crosses(cell.values) || firstBeside(beyond) != low) continue;
        ++tally.surface;
        tally.add(beyond, 1);
      }
    });
  }

 private:
  using Values = std::array<typename TreeT::ValueType, 8>;
  struct Cell {
    Values values{};
    int active = 0;
  };
  /// Number of cells that share a corner with a cell, with the cell itself.
  static constexpr int kAround = 27;

  [[nodiscard]] static Coord aside(int n) noexcept { return {n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1}; }

  [[nodiscard]] bool crosses(const Values& values) const noexcept {
    const auto free = std::count_if(values.begin(), values.end(), [&](const auto& value) {
      return sign_ * (static_cast<double>(value) - level_) >= 0.0;
    });
    return free > 0 && free < 8;
  }
  [[nodiscard]] Cell cellAt(const Coord& low) const noexcept {
    Cell cell;
    for (int n = 0; n < 8; ++n) {
      auto& value = cell.values[static_cast<std::size_t>(n)];
      cell.active += static_cast<int>(accessor_.probeValue(low + detail::cornerOf(n), value));
    }
    return cell;
  }
  /// Returns the first cell around cell `low` from which countAt() counts `low` as open; `low` if
  /// there is none.
  [[nodiscard]] Coord firstBeside(const Coord& low) const noexcept {
    for (int n = 0; n < kAround; ++n) {
      const Cell cell = cellAt(low + aside(n));
      const bool felt = cell.active > 0 && cell.active < 8 && crosses(cell.values) &&
                        detail::holdsSurface(cell.values, background_);
      if (felt) return low + aside(n);
    }
    return low;
  }

  openvdb::tree::ValueAccessor<const TreeT, false> accessor_;
  double background_;
  double level_;
  double sign_;  ///< Factor that makes the gradient point outward: 1 or -1.
};

template <class TreeT>
Tally countIn(const TreeT& tree, double level, double sign) {
  const std::vector<Coord> blocks = blocksOf(tree);
  const auto count = [&](const tbb::blocked_range<std::size_t>& range, Tally tally) {
    const Finder<TreeT> finder(tree, level, sign);
    for (std::size_t b = range.begin(); b < range.end(); ++b) {
      for (auto voxel = openvdb::CoordBBox::createCube(blocks[b], kLeaf).begin(); voxel; ++voxel) {
        finder.countAt(*voxel, tally);
      }
    }
    return tally;
  };
  const auto join = [](Tally a, const Tally& b) {
    a.add(b.first, b.count);
    a.surface += b.surface;
    return a;
  };
  return tbb::parallel_reduce(tbb::blocked_range<std::size_t>(0, blocks.size(), 16), Tally(), count,
                              join);
}

}  // namespace

std::optional<OpenCells> findOpenCells(const Volume& volume, const Sampling& sampling, double level,
                                       Solid solid) {
  if (volume.info().vector || sampling.interpolation != Interpolation::kTrilinear) {
    return std::nullopt;
  }
  OpenCells out;
  if (volume.info().grid_class != GridClass::kLevelSet) return out;
  const Volume::Grid::Part& part = volume.grid().parts.front();
  std::visit(
      [&](const auto& grid) {
        using GridT = std::remove_const_t<typename std::decay_t<decltype(grid)>::element_type>;
        if constexpr (std::is_arithmetic_v<typename GridT::ValueType>) {
          const Tally found = countIn(grid->tree(), level, solid == Solid::kAbove ? -1.0 : 1.0);
          const Coord& low = found.first;
          out.count = found.count;
          out.surface = found.surface;
          if (out.count > 0) out.first_F = part.toFile(Vec3(low.x(), low.y(), low.z()));
        }
      },
      part.data);
  return out;
}

}  // namespace palpate
