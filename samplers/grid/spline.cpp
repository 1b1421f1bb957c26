#include "palpate/samplers/grid/spline.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <mutex>
#include <type_traits>
#include <vector>

#include <openvdb/tree/ValueAccessor.h>
#include <tbb/task_arena.h>

#include "palpate/samplers/grid/band_cell.h"
#include "palpate/samplers/grid/cells_at.h"
#include "palpate/samplers/parallel.h"

namespace palpate {
namespace {

using openvdb::Coord;

/// Distance beyond which the filter ignores values [voxels]: |pole|^16 < 1e-9 for degree 3.
constexpr int kSplineReach = 16;

double poleOf(int degree) {
  return degree == 2 ? 2.0 * std::sqrt(2.0) - 3.0 : std::sqrt(3.0) - 2.0;
}

/// Converts a number to the grid's type. Beyond its range, returns its largest number.
template <class Value, class Sum>
Value stored(const Sum& sum) {
  if constexpr (std::is_arithmetic_v<Value>) {
    constexpr double kLargest = std::numeric_limits<Value>::max();
    return static_cast<Value>(std::clamp(static_cast<double>(sum), -kLargest, kLargest));
  } else {
    using Component = typename Value::ValueType;
    return Value(stored<Component>(sum[0]), stored<Component>(sum[1]), stored<Component>(sum[2]));
  }
}

/// Adds leaves where the filter changes values: around the existing leaves, in place of small
/// tiles, and along the faces of larger tiles with a different neighbour.
template <class TreeT>
void addLeavesAround(TreeT& tree) {
  using Leaf = typename TreeT::LeafNodeType;
  constexpr int kSize = static_cast<int>(Leaf::DIM);
  constexpr int kLargest = 128;
  std::vector<Coord> origins;
  for (auto leaf = tree.cbeginLeaf(); leaf; ++leaf) origins.push_back(leaf->origin());
  const openvdb::tree::ValueAccessor<const TreeT, false> accessor(tree);
  auto tile = tree.cbeginValueOn();
  tile.setMaxDepth(TreeT::ValueOnCIter::LEAF_DEPTH - 1);
  for (; tile; ++tile) {
    const openvdb::CoordBBox box = tile.getBoundingBox();
    const int size = box.dim().x();
    if (size > kLargest) continue;
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
  for (const Coord& origin : origins) {
    for (int n = 0; n < 27; ++n) {
      tree.touchLeaf(
          origin.offsetBy(kSize * (n / 9 - 1), kSize * (n / 3 % 3 - 1), kSize * (n % 3 - 1)));
    }
  }
}

/// Returns the leaves in ordered runs along one axis. A gap wider than kSplineReach ends a run.
template <class TreeT>
std::vector<std::vector<typename TreeT::LeafNodeType*>> runsAlong(TreeT& tree, int axis) {
  using Leaf = typename TreeT::LeafNodeType;
  std::vector<Leaf*> leaves;
  tree.getNodes(leaves);
  const auto key = [axis](const Leaf* leaf) {
    const Coord& o = leaf->origin();
    return std::array<int, 3>{o[(axis + 1) % 3], o[(axis + 2) % 3], o[axis]};
  };
  std::sort(leaves.begin(), leaves.end(),
            [&](const Leaf* a, const Leaf* b) { return key(a) < key(b); });
  std::vector<std::vector<Leaf*>> runs;
  std::array<int, 3> last{};
  for (Leaf* leaf : leaves) {
    const std::array<int, 3> here = key(leaf);
    const bool goes_on = !runs.empty() && here[0] == last[0] && here[1] == last[1] &&
                         here[2] - last[2] <= static_cast<int>(Leaf::DIM) + kSplineReach;
    if (!goes_on) runs.emplace_back();
    runs.back().push_back(leaf);
    last = here;
  }
  return runs;
}

/// Converts samples to coefficients along one axis, in place: forward and back with one pole.
/// Outside of a run's leaves, values are those of the tiles.
template <class TreeT>
void filterAlong(TreeT& tree, int axis, double pole) {
  using Leaf = typename TreeT::LeafNodeType;
  using Value = typename TreeT::ValueType;
  using Sum = std::conditional_t<std::is_arithmetic_v<Value>, double, openvdb::Vec3d>;
  constexpr std::size_t kSize = Leaf::DIM;
  constexpr std::array<std::size_t, 3> kStride{kSize * kSize, kSize, 1};
  const auto along = static_cast<std::size_t>(axis);
  const std::size_t stride = kStride[along];
  const std::size_t across = kStride[(along + 1) % 3];
  const std::size_t lines = kStride[(along + 2) % 3];
  const std::vector<std::vector<Leaf*>> runs = runsAlong(tree, axis);
  inParallel(runs.size(), [&](std::size_t r) {
    const std::vector<Leaf*>& leaves = runs[r];
    openvdb::tree::ValueAccessor<const TreeT, false> accessor(tree);
    const int first = leaves.front()->origin()[axis];
    const auto length = static_cast<std::size_t>(leaves.back()->origin()[axis] - first) + kSize;
    const auto value_at = [&](int position) {
      Coord at = leaves.front()->origin();
      at[axis] = position;
      return Sum(accessor.getValue(at));
    };
    // The tiles before the run, after it and in its gaps. A gap is at most a few leaves long.
    const Sum before = value_at(first - 1) * (1.0 / (1.0 - pole));
    const Sum after = value_at(first + static_cast<int>(length)) * (1.0 / (1.0 - pole));
    std::vector<Leaf*> at(length / kSize, nullptr);
    for (Leaf* leaf : leaves) {
      at[static_cast<std::size_t>(leaf->origin()[axis] - first) / kSize] = leaf;
    }
    std::vector<std::array<Sum, kSize>> c(length);
    for (std::size_t u = 0; u < kSize; ++u) {
      for (std::size_t i = 0; i < at.size(); ++i) {
        const Value* data = at[i] == nullptr ? nullptr : at[i]->buffer().data() + u * across;
        const Sum tile = data == nullptr ? value_at(first + static_cast<int>(i * kSize)) : Sum(0.0);
        for (std::size_t k = 0; k < kSize; ++k) {
          for (std::size_t v = 0; v < kSize; ++v) {
            c[i * kSize + k][v] = data == nullptr ? tile : Sum(data[k * stride + v * lines]);
          }
        }
      }
      std::array<Sum, kSize> last;
      last.fill(before);
      for (std::array<Sum, kSize>& row : c) {
        for (std::size_t v = 0; v < kSize; ++v) last[v] = row[v] = row[v] + pole * last[v];
      }
      // The state of a backward pass that begins infinitely far away, in the constant values beyond
      // the run.
      for (Sum& value : last) {
        value = -pole / (1.0 - pole) * after - pole * pole / (1.0 - pole * pole) * (value - after);
      }
      for (std::size_t k = length; k-- > 0;) {
        for (std::size_t v = 0; v < kSize; ++v) last[v] = c[k][v] = pole * (last[v] - c[k][v]);
      }
      const double gain = (1.0 - pole) * (1.0 - 1.0 / pole);
      for (std::size_t i = 0; i < at.size(); ++i) {
        if (at[i] == nullptr) continue;
        Value* data = at[i]->buffer().data() + u * across;
        for (std::size_t k = 0; k < kSize; ++k) {
          for (std::size_t v = 0; v < kSize; ++v) {
            data[k * stride + v * lines] = stored<Value>(gain * c[i * kSize + k][v]);
          }
        }
      }
    }
  });
}

/// Makes all corners active in cells that hold a level set's surface (band_cell.h). Readers of the
/// coefficients cannot find these cells.
template <class GridT>
void completeSurface(const GridT& values, typename GridT::TreeType& coefficients) {
  const openvdb::tree::ValueAccessor<const typename GridT::TreeType, false> accessor(values.tree());
  const double background = values.background();
  for (auto leaf = values.tree().cbeginLeaf(); leaf; ++leaf) {
    for (auto voxel = leaf->cbeginValueOn(); voxel; ++voxel) {
      detail::eachCellAt(accessor, voxel.getCoord(),
                         [&](const Coord& low, const auto& at, int active) {
                           if (active == 8 || !detail::holdsSurface(at, background)) return;
                           for (int n = 0; n < 8; ++n) {
                             coefficients.setActiveState(low + detail::cornerOf(n), true);
                           }
                         });
    }
  }
}

template <class GridT>
typename GridT::Ptr coefficientsOf(const GridT& grid, int degree) {
  typename GridT::Ptr coefficients = grid.deepCopy();
  auto& tree = coefficients->tree();
  addLeavesAround(tree);
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
  // Isolated: a thread that waits here might begin a task that waits for the same lock.
  tbb::this_task_arena::isolate([&] {
    for (const Volume::Grid::Part& part : grid.parts) {
      parts.push_back(std::visit(
          [&](const auto& data) -> GridData {
            using GridT = std::remove_const_t<typename std::decay_t<decltype(data)>::element_type>;
            return typename GridT::ConstPtr(coefficientsOf(*data, degree));
          },
          part.data));
    }
  });
  made.parts = std::move(parts);
  return made.parts;
}

}  // namespace palpate
