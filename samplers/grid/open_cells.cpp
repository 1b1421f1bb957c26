#include "palpate/samplers/grid/open_cells.h"

#include <cstddef>
#include <type_traits>
#include <variant>
#include <vector>

#include <openvdb/tree/ValueAccessor.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/tile_blocks.h"
#include "palpate/samplers/grid/volume_grid.h"

namespace palpate {
namespace {

using openvdb::Coord;

constexpr int kLeaf = 8;

/// The number of open cells found, and the first of them. The result does not depend on the order
/// of threads.
struct Tally {
  std::uint64_t count = 0;
  Coord first;

  void add(const Coord& low, std::uint64_t cells) noexcept {
    if (cells == 0) return;
    if (count == 0 || low < first) first = low;
    count += cells;
  }
};

/// Returns the origins of the leaves, and of the outer blocks of active tiles: a tile has no
/// surface inside.
template <class TreeT>
std::vector<Coord> blocksOf(const TreeT& tree) {
  std::vector<Coord> out = detail::tileBlocks(tree, /*inner=*/false);
  out.reserve(out.size() + tree.leafCount());
  for (auto leaf = tree.cbeginLeaf(); leaf; ++leaf) out.push_back(leaf->origin());
  return out;
}

/// Returns the offset of corner n of a cell from the cell's lowest corner.
inline Coord corner(int n) noexcept {
  return {n >> 2, (n >> 1) & 1, n & 1};
}

/// Finds open cells. Each thread has its own object.
template <class TreeT>
class Finder {
 public:
  Finder(const TreeT& tree, double level, double sign)
      : accessor_(tree), level_(level), sign_(sign) {}

  /// Counts the open cells of which this voxel is the first active corner. So each open cell is
  /// counted once.
  void countAt(const Coord& voxel, Tally& tally) const noexcept {
    if (!accessor_.isValueOn(voxel)) return;
    for (int n = 0; n < 8; ++n) {
      const Coord low = voxel - corner(n);
      if (isOpen(low, n)) tally.add(low, 1);
    }
  }

 private:
  /// Returns true if the cell is open and none of its corners before `first` is active.
  [[nodiscard]] bool isOpen(const Coord& low, int first) const noexcept {
    int active = 0;
    int free = 0;
    for (int n = 0; n < 8; ++n) {
      typename TreeT::ValueType value{};
      const bool on = accessor_.probeValue(low + corner(n), value);
      if (on && n < first) return false;
      active += static_cast<int>(on);
      free += static_cast<int>(sign_ * (static_cast<double>(value) - level_) >= 0.0);
    }
    return active < 8 && free > 0 && free < 8;
  }

  openvdb::tree::ValueAccessor<const TreeT, false> accessor_;
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
          if (out.count > 0) out.first_F = part.toFile(Vec3(low.x(), low.y(), low.z()));
        }
      },
      part.data);
  return out;
}

}  // namespace palpate
