/// Private to samplers, for .cpp files only: applies a filter to all lines of voxels along an axis.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <limits>
#include <type_traits>
#include <vector>

#include <openvdb/tree/ValueAccessor.h>

#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/parallel.h"

namespace palpate::detail {

/// Type of a filter's sums.
template <class TreeT>
using SumOf =
    std::conditional_t<std::is_arithmetic_v<typename TreeT::ValueType>, double, openvdb::Vec3d>;

/// Values of eight neighbouring lines. A row has the values of all lines at one position.
template <class TreeT>
using Lines = std::vector<std::array<SumOf<TreeT>, 8>>;

/// Converts a number to the grid's type. A number beyond the range of the type becomes the largest
/// finite number of the same sign, not infinity.
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

/// Returns the leaves in runs along one axis, each in order. A run ends at a gap that is wider than
/// `reach` voxels.
template <class TreeT>
std::vector<std::vector<typename TreeT::LeafNodeType*>> runsAlong(TreeT& tree, int axis,
                                                                  int reach) {
  using Leaf = typename TreeT::LeafNodeType;
  std::vector<Leaf*> leaves;
  tree.getNodes(leaves);
  const auto key = [axis](const Leaf* leaf) {
    const openvdb::Coord& o = leaf->origin();
    return std::array<int, 3>{o[(axis + 1) % 3], o[(axis + 2) % 3], o[axis]};
  };
  std::sort(leaves.begin(), leaves.end(),
            [&](const Leaf* a, const Leaf* b) { return key(a) < key(b); });
  std::vector<std::vector<Leaf*>> runs;
  std::array<int, 3> last{};
  for (Leaf* leaf : leaves) {
    const std::array<int, 3> here = key(leaf);
    const bool goes_on = !runs.empty() && here[0] == last[0] && here[1] == last[1] &&
                         here[2] - last[2] <= static_cast<int>(Leaf::DIM) + reach;
    if (!goes_on) runs.emplace_back();
    runs.back().push_back(leaf);
    last = here;
  }
  return runs;
}

/// Filters the values in leaves along one axis, in place and in parallel. Calls filter(lines) for
/// each group of eight lines through a run of leaves. The lines begin and end with 8 * `pad` rows
/// of the values beyond the run; values that the filter writes there are ignored.
/// @param reach  The widest gap within a run [voxels], at least 8 * (pad - 1).
template <class TreeT, class Filter>
void filterLines(TreeT& tree, int axis, int reach, std::size_t pad, Filter filter) {
  using Leaf = typename TreeT::LeafNodeType;
  using Value = typename TreeT::ValueType;
  using Sum = SumOf<TreeT>;
  constexpr std::size_t kSize = Leaf::DIM;
  constexpr std::array<std::size_t, 3> kStride{kSize * kSize, kSize, 1};
  const auto along = static_cast<std::size_t>(axis);
  const std::size_t stride = kStride[along];
  const std::size_t across = kStride[(along + 1) % 3];
  const std::size_t lines = kStride[(along + 2) % 3];
  const std::vector<std::vector<Leaf*>> runs = runsAlong(tree, axis, reach);
  inParallel(runs.size(), [&](std::size_t r) {
    const std::vector<Leaf*>& leaves = runs[r];
    openvdb::tree::ValueAccessor<const TreeT, false> accessor(tree);
    const int first = leaves.front()->origin()[axis] - static_cast<int>(pad * kSize);
    const auto length =
        static_cast<std::size_t>(leaves.back()->origin()[axis] - first) + kSize + pad * kSize;
    std::vector<Leaf*> at(length / kSize, nullptr);
    for (Leaf* leaf : leaves) {
      at[static_cast<std::size_t>(leaf->origin()[axis] - first) / kSize] = leaf;
    }
    // Values of the tiles before the run, after the run and in its gaps.
    std::vector<Sum> tiles(at.size(), Sum(0.0));
    for (std::size_t i = 0; i < at.size(); ++i) {
      openvdb::Coord place = leaves.front()->origin();
      place[axis] = first + static_cast<int>(i * kSize);
      if (at[i] == nullptr) tiles[i] = Sum(accessor.getValue(place));
    }
    Lines<TreeT> c(length);
    for (std::size_t u = 0; u < kSize; ++u) {
      for (std::size_t i = 0; i < at.size(); ++i) {
        const Value* data = at[i] == nullptr ? nullptr : at[i]->buffer().data() + u * across;
        for (std::size_t k = 0; k < kSize; ++k) {
          for (std::size_t v = 0; v < kSize; ++v) {
            c[i * kSize + k][v] = data == nullptr ? tiles[i] : Sum(data[k * stride + v * lines]);
          }
        }
      }
      filter(c);
      for (std::size_t i = 0; i < at.size(); ++i) {
        if (at[i] == nullptr) continue;
        Value* data = at[i]->buffer().data() + u * across;
        for (std::size_t k = 0; k < kSize; ++k) {
          for (std::size_t v = 0; v < kSize; ++v) {
            data[k * stride + v * lines] = stored<Value>(c[i * kSize + k][v]);
          }
        }
      }
    }
  });
}

}  // namespace palpate::detail
