#include "palpate/samplers/grid/spline.h"

#include <array>
#include <cmath>
#include <mutex>
#include <type_traits>
#include <vector>

#include <openvdb/tools/Morphology.h>
#include <openvdb/tree/ValueAccessor.h>
#include <tbb/task_arena.h>

#include "palpate/samplers/grid/band_cell.h"
#include "palpate/samplers/grid/cells_at.h"
#include "palpate/samplers/grid/filter_lines.h"
#include "palpate/samplers/grid/smooth.h"
#include "palpate/samplers/grid/tile_blocks.h"

namespace palpate {
namespace {

using openvdb::Coord;

/// Leaves that are farther apart than this are filtered separately [voxels]. At this distance, a
/// value has the weight |pole|^16 < 1e-9 for degree 3.
constexpr int kSplineReach = 16;

double poleOf(int degree) {
  return degree == 2 ? 2.0 * std::sqrt(2.0) - 3.0 : std::sqrt(3.0) - 2.0;
}

/// Adds leaves where the filter changes values: around the existing leaves, and along faces of
/// active tiles of 8^3 and of 128^3 voxels with a different neighbour. Returns false if it would
/// add more than kMostAdded leaves, and ten for each existing leaf.
template <class TreeT>
[[nodiscard]] bool addLeavesAround(TreeT& tree) {
  using Leaf = typename TreeT::LeafNodeType;
  constexpr int kSize = static_cast<int>(Leaf::DIM);
  constexpr int kLargest = 128;
  std::vector<Coord> origins;
  for (auto leaf = tree.cbeginLeaf(); leaf; ++leaf) origins.push_back(leaf->origin());
  const std::size_t leaves = origins.size();
  const std::size_t most = leaves + detail::kMostAdded + 10 * leaves;
  const openvdb::tree::ValueAccessor<const TreeT, false> accessor(tree);
  auto tile = tree.cbeginValueOn();
  tile.setMaxDepth(TreeT::ValueOnCIter::LEAF_DEPTH - 1);
  for (; tile; ++tile) {
    const openvdb::CoordBBox box = tile.getBoundingBox();
    const int size = box.dim().x();
    if (size > kLargest) continue;
    if (origins.size() > leaves + 3 * (most - leaves)) return false;  // a corner has three faces
    const auto value = *tile;
    for (int face = 0; face < 6; ++face) {
      const int axis = face / 2;
      const bool upper = face % 2 == 1;
      for (int i = 0; i < size; i += kSize) {
        for (int j = 0; j < size; j += kSize) {
          Coord within = box.min();
          within[axis] += upper ? size - kSize : 0;
          within[(axis + 1) % 3] += i;
          within[(axis + 2) % 3] += j;
          Coord beyond = within;
          beyond[axis] += upper ? kSize : -kSize;
          const bool goes_on =
              accessor.probeConstLeaf(beyond) == nullptr && accessor.getValue(beyond) == value;
          if (!goes_on) origins.push_back(within);
        }
      }
    }
  }
  std::size_t count = leaves;
  for (const Coord& origin : origins) {
    for (int n = 0; n < 27; ++n) {
      const Coord at =
          origin.offsetBy(kSize * (n / 9 - 1), kSize * (n / 3 % 3 - 1), kSize * (n % 3 - 1));
      if (tree.probeConstLeaf(at) != nullptr) continue;
      if (++count > most) return false;
      tree.touchLeaf(at);
    }
  }
  return true;
}

/// Converts samples to coefficients along one axis, in place. Filters in both directions, with the
/// same pole. Outside of the leaves of a run, the values are those of the tile there.
template <class TreeT>
void filterAlong(TreeT& tree, int axis, double pole) {
  using Leaf = typename TreeT::LeafNodeType;
  using Sum = detail::SumOf<TreeT>;
  constexpr std::size_t kSize = Leaf::DIM;
  detail::filterLines(tree, axis, kSplineReach, 1, [pole](detail::Lines<TreeT>& c) {
    const std::size_t end = c.size() - kSize;
    // Filter states in the constant tiles before and after the run.
    const Sum before = c.front()[0] * (1.0 / (1.0 - pole));
    const Sum after = c.back()[0] * (1.0 / (1.0 - pole));
    std::array<Sum, kSize> last;
    last.fill(before);
    for (std::size_t k = kSize; k < end; ++k) {
      for (std::size_t v = 0; v < kSize; ++v) last[v] = c[k][v] = c[k][v] + pole * last[v];
    }
    // Starts the backward pass as if it came from infinitely far away, through the constant values
    // beyond the run.
    for (Sum& value : last) {
      value = -pole / (1.0 - pole) * after - pole * pole / (1.0 - pole * pole) * (value - after);
    }
    const double gain = (1.0 - pole) * (1.0 - 1.0 / pole);
    for (std::size_t k = end; k-- > kSize;) {
      for (std::size_t v = 0; v < kSize; ++v) {
        last[v] = pole * (last[v] - c[k][v]);
        c[k][v] = gain * last[v];
      }
    }
  });
}

/// Makes all corners active in cells that hold a level set's surface. Readers find these cells by
/// the grid's values (band_cell.h), which the coefficients replace. Omits cells whose active
/// corners all belong to tiles wider than 128 voxels.
template <class GridT>
void completeSurface(const GridT& values, typename GridT::TreeType& coefficients) {
  const openvdb::tree::ValueAccessor<const typename GridT::TreeType, false> accessor(values.tree());
  const double background = values.background();
  const auto complete = [&](const Coord& voxel) {
    detail::eachCellAt(accessor, voxel, [&](const Coord& low, const auto& at, int active) {
      if (active == 8 || !detail::holdsSurface(at, background)) return;
      for (int n = 0; n < 8; ++n) coefficients.setActiveState(low + detail::cornerOf(n), true);
    });
  };
  for (auto leaf = values.tree().cbeginLeaf(); leaf; ++leaf) {
    for (auto voxel = leaf->cbeginValueOn(); voxel; ++voxel) complete(voxel.getCoord());
  }
  constexpr int kSize = GridT::TreeType::LeafNodeType::DIM;
  for (const Coord& block : detail::tileBlocks(values.tree(), /*inner=*/false)) {
    const auto box = openvdb::CoordBBox::createCube(block, kSize);
    for (auto voxel = box.begin(); voxel; ++voxel) complete(*voxel);
  }
}

/// Extrapolates the values of active voxels into the inactive voxels around them, so that a spline
/// does not bend towards the background at the edge of the data. Works outwards in kLayers layers.
/// A voxel gets the mean over its neighbours: along each axis two values are extrapolated linearly,
/// and a single value is repeated. The voxels stay inactive.
template <class TreeT>
void continueOutward(TreeT& tree) {
  using Sum = detail::SumOf<TreeT>;
  // the cubic's filter reduces a step beyond the layers to |pole|^6 = 4e-4
  constexpr int kLayers = 6;
  using Mask = openvdb::MaskTree;
  Mask known(tree, false, true, openvdb::TopologyCopy());
  for (int layer = 0; layer < kLayers; ++layer) {
    Mask next = known;
    openvdb::tools::dilateActiveValues(next, 1, openvdb::tools::NN_FACE,
                                       openvdb::tools::PRESERVE_TILES);
    next.topologyDifference(known);
    const openvdb::tree::ValueAccessor<const Mask, false> is_known(known);
    openvdb::tree::ValueAccessor<TreeT, false> values(tree);
    for (auto voxel = next.cbeginValueOn(); voxel; ++voxel) {
      const Coord at = voxel.getCoord();
      Sum sum(0.0);
      int count = 0;
      for (int face = 0; face < 6; ++face) {
        Coord beside = at;
        Coord beyond = at;
        beside[face / 2] += face % 2 == 0 ? 1 : -1;
        beyond[face / 2] += face % 2 == 0 ? 2 : -2;
        if (!is_known.isValueOn(beside)) continue;
        const Sum last(values.getValue(beside));
        sum += is_known.isValueOn(beyond) ? 2.0 * last - Sum(values.getValue(beyond)) : last;
        ++count;
      }
      values.setValueOnly(at, detail::stored<typename TreeT::ValueType>(sum * (1.0 / count)));
    }
    known.topologyUnion(next);
  }
}

/// Returns a grid's coefficients. `active_only`: inactive voxels have no data (DataEnds). Throws
/// VolumeError if tiles need too many leaves, as in a damaged file.
template <class GridT>
typename GridT::Ptr coefficientsOf(const GridT& grid, int degree, bool active_only) {
  typename GridT::Ptr coefficients = grid.deepCopy();
  auto& tree = coefficients->tree();
  if (active_only && grid.getGridClass() != openvdb::GRID_LEVEL_SET) continueOutward(tree);
  if (!addLeavesAround(tree)) {
    throw VolumeError("grid \"" + grid.getName() + "\"",
                      "too many of its tiles differ from their neighbours for a spline",
                      "use trilinear, or write the file again: it may be damaged");
  }
  if constexpr (std::is_arithmetic_v<typename GridT::ValueType>) {
    if (grid.getGridClass() == openvdb::GRID_LEVEL_SET) completeSurface(grid, tree);
  }
  for (int axis = 0; axis < 3; ++axis) filterAlong(tree, axis, poleOf(degree));
  return coefficients;
}

}  // namespace

const std::vector<GridData>& splineCoefficients(const Volume& volume, int degree) {
  const Volume::Grid& grid = volume.grid();
  Volume::Grid::Coefficients& made = grid.coefficients[degree == 2 ? 0 : 1];
  const std::lock_guard lock(made.mutex);
  if (!made.parts.empty()) return made.parts;
  std::vector<GridData> parts;
  // Without isolation, a thread that waits here could start a task that waits for the same lock.
  tbb::this_task_arena::isolate([&] {
    for (const Volume::Grid::Part& part : grid.parts) {
      parts.push_back(std::visit(
          [&](const auto& data) -> GridData {
            using GridT = std::remove_const_t<typename std::decay_t<decltype(data)>::element_type>;
            return typename GridT::ConstPtr(coefficientsOf(*data, degree, part.ends.activeOnly()));
          },
          part.data));
    }
  });
  made.parts = std::move(parts);
  return made.parts;
}

}  // namespace palpate
