#include "samplers/spline.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <mutex>
#include <type_traits>
#include <vector>

#include <openvdb/tree/LeafManager.h>

namespace palpate {
namespace {

using openvdb::Coord;

/// Taps on each side: |pole|^16 < 1e-9 for the cubic, the slower of the two.
constexpr int kReach = 16;

/// The two-sided exponential that undoes a spline's samples; its taps add up to 1.
std::array<double, 2 * kReach + 1> inverseTaps(int degree) {
  const double pole = degree == 2 ? 2.0 * std::sqrt(2.0) - 3.0 : std::sqrt(3.0) - 2.0;
  std::array<double, 2 * kReach + 1> taps{};
  double sum = 0.0;
  for (std::size_t i = 0; i < taps.size(); ++i) {
    taps[i] = std::pow(pole, std::abs(static_cast<int>(i) - kReach));
    sum += taps[i];
  }
  for (double& tap : taps) tap /= sum;
  return taps;
}

/// As the grid stores it: beyond its range the largest number, never infinity.
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

/// Leaves wherever the filter reaches: about the grid's own, in place of its small tiles, and along
/// both sides of the faces of larger ones.
template <class TreeT>
void addLeavesAround(TreeT& tree) {
  using Leaf = typename TreeT::LeafNodeType;
  constexpr int kSize = static_cast<int>(Leaf::DIM);
  constexpr int kLargest = 128;
  std::vector<Coord> origins;
  for (auto leaf = tree.cbeginLeaf(); leaf; ++leaf) origins.push_back(leaf->origin());
  auto tile = tree.cbeginValueOn();
  tile.setMaxDepth(TreeT::ValueOnCIter::LEAF_DEPTH - 1);
  for (; tile; ++tile) {
    const openvdb::CoordBBox box = tile.getBoundingBox();
    if (box.dim().x() > kLargest) continue;
    const int last = box.dim().x() - kSize;
    for (int i = 0; i <= last; i += kSize) {
      for (int j = 0; j <= last; j += kSize) {
        const bool edge = i == 0 || i == last || j == 0 || j == last;
        for (int k = 0; k <= last; k += edge || last == 0 ? kSize : last) {
          origins.push_back(box.min().offsetBy(i, j, k));
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

/// Filters along one axis, from `in` to `out` of equal topology.
template <class TreeT>
void filter(const TreeT& in, int axis, const std::array<double, 2 * kReach + 1>& taps, TreeT& out) {
  using Leaf = typename TreeT::LeafNodeType;
  using Value = typename TreeT::ValueType;
  using Sum = std::conditional_t<std::is_arithmetic_v<Value>, double, openvdb::Vec3d>;
  constexpr int kSize = static_cast<int>(Leaf::DIM);
  openvdb::tree::LeafManager<TreeT> leaves(out);
  leaves.foreach ([&](Leaf& leaf, std::size_t) {
    openvdb::tree::ValueAccessor<const TreeT, false> accessor(in);
    std::array<Sum, kSize + 2 * kReach> line;
    for (int u = 0; u < kSize; ++u) {
      for (int v = 0; v < kSize; ++v) {
        Coord at = leaf.origin();
        at[(axis + 1) % 3] += u;
        at[(axis + 2) % 3] += v;
        Coord from = at;
        from[axis] -= kReach;
        for (Sum& value : line) {
          value = Sum(accessor.getValue(from));
          ++from[axis];
        }
        for (std::size_t i = 0; i < kSize; ++i) {
          Sum sum = openvdb::zeroVal<Sum>();
          for (std::size_t k = 0; k < taps.size(); ++k) sum += taps[k] * line[i + k];
          leaf.setValueOnly(at, stored<Value>(sum));
          ++at[axis];
        }
      }
    }
  });
}

template <class GridT>
typename GridT::Ptr coefficientsOf(const GridT& grid, int degree) {
  typename GridT::Ptr coefficients = grid.deepCopy();
  auto& tree = coefficients->tree();
  addLeavesAround(tree);
  const auto taps = inverseTaps(degree);
  typename GridT::TreeType other(tree);
  filter(other, 0, taps, tree);
  filter(tree, 1, taps, other);
  filter(other, 2, taps, tree);
  return coefficients;
}

}  // namespace

const std::vector<GridData>& splineCoefficients(const Volume& volume, int degree) {
  const Volume::Grid& grid = volume.grid();
  Volume::Grid::Coefficients& made = grid.coefficients[degree == 2 ? 0 : 1];
  const std::lock_guard lock(made.mutex);
  if (!made.parts.empty()) return made.parts;
  std::vector<GridData> parts;
  for (const Volume::Grid::Part& part : grid.parts) {
    parts.push_back(std::visit(
        [&](const auto& data) -> GridData {
          using GridT = std::remove_const_t<typename std::decay_t<decltype(data)>::element_type>;
          return typename GridT::ConstPtr(coefficientsOf(*data, degree));
        },
        part.data));
  }
  made.parts = std::move(parts);
  return made.parts;
}

}  // namespace palpate
