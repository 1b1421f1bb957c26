/// Private to samplers, for .cpp files only: smooths grids of each supported type.
#pragma once

#include <algorithm>
#include <cmath>
#include <type_traits>
#include <utility>
#include <vector>

#include <openvdb/tools/LevelSetTracker.h>
#include <openvdb/tree/LeafManager.h>

#include "palpate/samplers/grid/filter_lines.h"
#include "palpate/samplers/grid/gaussian.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate::detail {

/// Returns the value of a scalar, or the magnitude of a vector.
template <class T>
auto sizeOf(const T& value) noexcept {
  if constexpr (std::is_arithmetic_v<T>) {
    return value;
  } else {
    return openvdb::Vec3d(value).length();
  }
}

/// Largest number of leaves that smoothing along one axis adds beside tiles (0.5 GB of floats), in
/// addition to ten for each leaf. Leaves beside other leaves are not limited.
inline constexpr std::size_t kMostAdded = 250'000;

/// Adds leaves along one axis, wherever a filter changes values that are not in leaves, except at
/// faces of tiles of 4096^3 voxels. Where the value changes, adds `count` leaves in both
/// directions. Throws openvdb::ValueError if tiles need too many leaves.
template <class TreeT>
void addLeavesAlong(TreeT& tree, int axis, int count) {
  using Leaf = typename TreeT::LeafNodeType;
  using Value = typename TreeT::ValueType;
  using openvdb::Coord;
  constexpr int kSize = static_cast<int>(Leaf::DIM);
  constexpr int kLargest = 128;
  const openvdb::tree::ValueAccessor<const TreeT, false> accessor(tree);
  std::vector<Coord> origins;
  // Adds a cube of 8^3 equal voxels if the value beyond its lower (-1) or upper (1) face differs.
  const auto add = [&](const Coord& origin, const Value& value, int side) {
    Coord beyond = origin;
    beyond[axis] += side * kSize;
    if (accessor.getValue(beyond) != value) origins.push_back(origin);
  };
  for (auto leaf = std::as_const(tree).cbeginLeaf(); leaf; ++leaf) {
    const Value* data = leaf->buffer().data();
    if (std::any_of(data, data + Leaf::SIZE, [&](const Value& v) { return v != data[0]; })) {
      origins.push_back(leaf->origin());
    } else {
      for (const int side : {-1, 1}) add(leaf->origin(), data[0], side);
    }
  }
  // In a damaged file, a great many tiles may differ from their neighbours.
  const std::size_t most = origins.size() + (kMostAdded + 10 * tree.leafCount()) /
                                                static_cast<std::size_t>(2 * count + 1);
  auto tile = std::as_const(tree).cbeginValueAll();
  tile.setMaxDepth(TreeT::ValueAllCIter::LEAF_DEPTH - 1);
  for (; tile; ++tile) {
    const Value value = *tile;
    if (value == tree.background()) continue;  // the neighbour adds the leaves
    if (origins.size() > most) {
      OPENVDB_THROW(openvdb::ValueError, "too many of its tiles differ from their neighbours");
    }
    const openvdb::CoordBBox box = tile.getBoundingBox();
    const int size = box.dim().x();
    if (size > kLargest) continue;
    for (int i = 0; i < size; i += kSize) {
      for (int j = 0; j < size; j += kSize) {
        Coord origin = box.min();
        origin[(axis + 1) % 3] += i;
        origin[(axis + 2) % 3] += j;
        add(origin, value, -1);
        origin[axis] += size - kSize;
        add(origin, value, 1);
      }
    }
  }
  for (Coord origin : origins) {
    origin[axis] -= count * kSize;
    for (int n = -count; n <= count; ++n, origin[axis] += kSize) tree.touchLeaf(origin);
  }
}

/// Applies a Gaussian along one axis. Every voxel counts, active or not.
template <class TreeT>
void applyGaussian(TreeT& tree, int axis, double deviation) {
  constexpr std::size_t kSize = TreeT::LeafNodeType::DIM;
  using Sum = SumOf<TreeT>;
  constexpr auto kMost = static_cast<std::size_t>(3.0 * kMostSmooth);
  std::vector<double> weights = gaussianWeights(deviation, kMost);
  const std::size_t reach = weights.size() - 1;
  if (reach == 0) return;
  double whole = weights[0];
  for (std::size_t n = 1; n <= reach; ++n) whole += 2.0 * weights[n];
  for (double& weight : weights) weight /= whole;
  const std::size_t pad = (reach + kSize - 1) / kSize;
  addLeavesAlong(tree, axis, static_cast<int>(pad));
  filterLines(tree, axis, static_cast<int>(pad * kSize), pad, [&](Lines<TreeT>& c) {
    const Lines<TreeT> from(c);
    for (std::size_t k = pad * kSize; k < c.size() - pad * kSize; ++k) {
      // Adds differences to the middle, so that equal values stay exactly the same.
      const std::array<Sum, kSize> middle = from[k];
      std::array<Sum, kSize> sum;
      sum.fill(Sum(0.0));
      for (std::size_t n = 1; n <= reach; ++n) {
        for (std::size_t v = 0; v < kSize; ++v) {
          sum[v] += weights[n] * ((from[k - n][v] - middle[v]) + (from[k + n][v] - middle[v]));
        }
      }
      for (std::size_t v = 0; v < kSize; ++v) c[k][v] = middle[v] + sum[v];
    }
  });
}

/// Rebuilds the band of a level set from smoothed values: voxels closer to the surface than the
/// band is wide become active, and get distances. Throws openvdb::ValueError if the voxels are not
/// cubes, or if the background is not above zero.
template <class GridT>
void rebuildBand(GridT& grid) {
  using Value = typename GridT::ValueType;
  const Value band = grid.background();
  if (!(band > Value(0))) OPENVDB_THROW(openvdb::ValueError, "its background is not above zero");
  // Without this check, the tracker's constructor would throw, but would leak memory.
  if (!grid.hasUniformVoxels()) OPENVDB_THROW(openvdb::ValueError, "its voxels are not cubes");
  using Leaf = typename GridT::TreeType::LeafNodeType;
  openvdb::tools::LevelSetTracker<GridT> tracker(grid);
  tracker.leafs().foreach ([&](Leaf& leaf, std::size_t) {
    for (openvdb::Index i = 0; i < Leaf::SIZE; ++i) {
      const Value v = leaf.getValue(i);
      if (std::abs(v) < band) {
        leaf.setValueOn(i);
      } else {
        leaf.setValueOff(i, v < Value(0) ? -band : band);
      }
    }
  });
  // Each step of the tracker corrects the distances in 0.3 voxels more of the band.
  constexpr double kSteps = 1.0 / 0.3;
  constexpr double kMostSteps = 40.0;
  tracker.setNormCount(static_cast<int>(
      std::min(kMostSteps, std::ceil(kSteps * static_cast<double>(tracker.getHalfWidth())))));
  tracker.track();
}

/// Changes of active values by smoothing, in a leaf or in a grid.
struct Change {
  double squares = 0.0;  ///< Sum of the squares of the changes.
  double largest = 0.0;  ///< Largest change.
};

/// Compares a grid with its values before it was smoothed. With `activate`, an inactive voxel that
/// has changed and differs from the background becomes active.
template <class TreeT>
Change compare(TreeT& tree, const TreeT& before, bool activate) {
  using Leaf = typename TreeT::LeafNodeType;
  using Value = typename TreeT::ValueType;
  openvdb::tree::LeafManager<TreeT> leaves(tree);
  std::vector<Change> changes(leaves.leafCount());
  leaves.foreach ([&](Leaf& leaf, std::size_t n) {
    const Leaf* old = before.probeConstLeaf(leaf.origin());
    const Value tile = before.getValue(leaf.origin());
    const bool on = before.isValueOn(leaf.origin());
    for (openvdb::Index i = 0; i < Leaf::SIZE; ++i) {
      const Value was = old != nullptr ? old->getValue(i) : tile;
      const Value is = leaf.getValue(i);
      if (is == was) continue;
      if (old != nullptr ? old->isValueOn(i) : on) {
        const auto change = std::abs(static_cast<double>(sizeOf(Value(is - was))));
        changes[n].squares += change * change;
        changes[n].largest = std::max(changes[n].largest, change);
      } else if (activate && is != tree.background()) {
        leaf.setValueOn(i);
      }
    }
  });
  Change all;
  for (const Change& change : changes) {
    all.squares += change.squares;
    all.largest = std::max(all.largest, change.largest);
  }
  return all;
}

/// Smooths a grid by a Gaussian. Returns the changes of the active values. Throws
/// openvdb::ValueError as addLeavesAlong() and, for a level set, rebuildBand() do.
/// @param deviations   Standard deviations along i, j and k, 0 to kMostSmooth [voxels].
/// @param data_active  True if inactive voxels have no data, and stay inactive.
template <class GridT>
Smoothing smooth(GridT& grid, const Vec3& deviations, bool data_active) {
  using Tree = typename GridT::TreeType;
  const Tree before(grid.constTree());
  bool is_level_set = false;
  if constexpr (std::is_floating_point_v<typename GridT::ValueType>) {
    is_level_set = grid.getGridClass() == openvdb::GRID_LEVEL_SET;
  }
  for (int axis = 0; axis < 3; ++axis) applyGaussian(grid.tree(), axis, deviations[axis]);
  if constexpr (std::is_floating_point_v<typename GridT::ValueType>) {
    if (is_level_set) rebuildBand(grid);
  }
  const Change change = compare(grid.tree(), before, !is_level_set && !data_active);
  Smoothing report;
  report.sigma = deviations.maxCoeff();
  const auto voxels = static_cast<double>(before.activeVoxelCount());
  report.rms_change = voxels > 0.0 ? std::sqrt(change.squares / voxels) : 0.0;
  report.largest_change = change.largest;
  // A wave of length l keeps exp(-2 (pi sigma / l)^2) of its height.
  report.half_height_voxels = report.sigma * M_PI * std::sqrt(2.0 / std::log(2.0));
  return report;
}

}  // namespace palpate::detail
