/// Private to the scene guess: samples a grid's active voxels and their neighbours.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <type_traits>
#include <vector>

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>

#include "palpate/scenes/guess/suggest.h"

namespace palpate::guess {

/// Return the splitmix64 hash of a number or of coordinates.
[[nodiscard]] std::uint64_t hashOf(std::uint64_t x);
[[nodiscard]] std::uint64_t hashOf(const openvdb::Coord& c);

[[nodiscard]] openvdb::Coord voxelOf(const openvdb::CoordBBox& box, std::uint64_t n);

/// Returns voxels spread evenly over the faces of a box.
[[nodiscard]] std::vector<openvdb::Coord> facesOf(const openvdb::CoordBBox& box);

/// Returns the edges of a voxel [units of the file].
[[nodiscard]] std::array<double, 3> edgesOf(const openvdb::GridBase& grid);

/// Reads a scalar grid of any type as floats.
template <class GridT>
class ScalarReader {
 public:
  using ValueType = float;
  explicit ScalarReader(const SuggestInput& input)
      : accessor_(static_cast<const GridT&>(*input.grid).getConstAccessor()) {}
  float getValue(const openvdb::Coord& c) const {
    return static_cast<float>(accessor_.getValue(c));
  }
  bool probeValue(const openvdb::Coord& c, float& value) const {
    typename GridT::ValueType read{};
    const bool active = accessor_.probeValue(c, read);
    value = static_cast<float>(read);
    return active;
  }

 private:
  typename GridT::ConstAccessor accessor_;
};

/// Reads a vector grid of any type as floats.
template <class GridT>
class VectorReader {
 public:
  using ValueType = openvdb::Vec3f;
  explicit VectorReader(const SuggestInput& input)
      : accessor_(static_cast<const GridT&>(*input.grid).getConstAccessor()) {}
  openvdb::Vec3f getValue(const openvdb::Coord& c) const {
    return openvdb::Vec3f(accessor_.getValue(c));
  }
  bool probeValue(const openvdb::Coord& c, openvdb::Vec3f& value) const {
    typename GridT::ValueType read;
    const bool active = accessor_.probeValue(c, read);
    value = openvdb::Vec3f(read);
    return active;
  }

 private:
  typename GridT::ConstAccessor accessor_;
};

/// Reads vectors as floats from three grids, one for each component.
template <class GridT>
class ComponentReader {
 public:
  using ValueType = openvdb::Vec3f;
  explicit ComponentReader(const SuggestInput& input)
      : accessors_{of(*input.grid), of(*input.y), of(*input.z)} {}
  openvdb::Vec3f getValue(const openvdb::Coord& c) const {
    openvdb::Vec3f value;
    (void)probeValue(c, value);
    return value;
  }
  bool probeValue(const openvdb::Coord& c, openvdb::Vec3f& value) const {
    bool active = true;
    for (int axis = 0; axis < 3; ++axis) {
      typename GridT::ValueType read{};
      active = accessors_[static_cast<std::size_t>(axis)].probeValue(c, read) && active;
      value[axis] = static_cast<float>(read);
    }
    return active;
  }

 private:
  static typename GridT::ConstAccessor of(const openvdb::GridBase& grid) {
    return static_cast<const GridT&>(grid).getConstAccessor();
  }
  std::array<typename GridT::ConstAccessor, 3> accessors_;
};

/// Returns the boxes of a tree's active tiles: nodes with one value for all their voxels.
template <class TreeT>
std::vector<openvdb::CoordBBox> tilesOf(const TreeT& tree) {
  std::vector<openvdb::CoordBBox> tiles;
  auto it = tree.cbeginValueOn();
  it.setMaxDepth(TreeT::ValueOnCIter::LEAF_DEPTH - 1);
  for (; it; ++it) tiles.push_back(it.getBoundingBox());
  return tiles;
}

struct KeepAll {};

/// Returns make(reader, coord) for every n-th active voxel with keep(value), leaves before tiles. n
/// is the smallest number for which there are about `most` results or fewer. In each leaf and tile,
/// a hash of its origin selects the first voxel, so that the results do not depend on threads.
/// `keep` requires another pass over all active voxels.
template <class Out, class ReaderT, class GridT, class Make, class Keep = KeepAll>
std::vector<Out> gather(const SuggestInput& input, std::size_t most, const Make& make,
                        const Keep& keep = {}) {
  constexpr bool kAll = std::is_same_v<Keep, KeepAll>;
  const auto& grid = static_cast<const GridT&>(*input.grid);
  using Leaf = typename GridT::TreeType::LeafNodeType;
  std::vector<const Leaf*> leaves;
  grid.tree().getNodes(leaves);
  const std::vector<openvdb::CoordBBox> tiles = tilesOf(grid.tree());
  const auto kept = [&keep](const auto& value) {
    if constexpr (kAll) {
      return true;
    } else {
      return keep(static_cast<typename ReaderT::ValueType>(value));
    }
  };
  const auto kept_tile = [&](std::size_t i) {
    return kept(grid.tree().getValue(tiles[i - leaves.size()].min()));
  };
  std::uint64_t count = grid.activeVoxelCount();
  if constexpr (!kAll) {
    count = tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, leaves.size() + tiles.size()), std::uint64_t{0},
        [&](const auto& range, std::uint64_t sum) {
          for (std::size_t i = range.begin(); i < range.end(); ++i) {
            if (i >= leaves.size()) {
              sum += kept_tile(i) ? tiles[i - leaves.size()].volume() : 0;
              continue;
            }
            for (auto it = leaves[i]->cbeginValueOn(); it; ++it) sum += kept(*it) ? 1 : 0;
          }
          return sum;
        },
        std::plus<>());
  }
  const std::uint64_t step = count / most + 1;
  constexpr std::size_t kChunk = 256;
  std::vector<std::vector<Out>> parts((leaves.size() + tiles.size() + kChunk - 1) / kChunk);
  tbb::parallel_for(std::size_t{0}, parts.size(), [&](std::size_t part) {
    const ReaderT reader(input);
    const std::size_t end = std::min(leaves.size() + tiles.size(), (part + 1) * kChunk);
    for (std::size_t i = part * kChunk; i < end; ++i) {
      if (i < leaves.size()) {
        std::uint64_t n = hashOf(leaves[i]->origin()) % step;
        for (auto it = leaves[i]->cbeginValueOn(); it; ++it) {
          if (kept(*it) && n++ % step == 0) parts[part].push_back(make(reader, it.getCoord()));
        }
        continue;
      }
      if (!kept_tile(i)) continue;
      const openvdb::CoordBBox& tile = tiles[i - leaves.size()];
      for (std::uint64_t n = hashOf(tile.min()) % step; n < tile.volume(); n += step) {
        parts[part].push_back(make(reader, voxelOf(tile, n)));
      }
    }
  });
  std::vector<Out> all;
  for (const auto& part : parts) all.insert(all.end(), part.begin(), part.end());
  return all;
}

inline openvdb::Coord beside(openvdb::Coord c, int axis, int offset) {
  c[axis] += offset;
  return c;
}

template <class Value>
struct Neighbours {
  Value before{};
  Value after{};
  bool known = false;
  bool at_edge = false;  ///< True if a neighbour is in an image's surroundings.
};

/// Returns the values of the two neighbours of a voxel along an axis. In an image
/// (SuggestInput::inactive_is_data), inactive neighbours within the extent are data; if the extent
/// is unknown, all inactive neighbours are.
template <class Accessor>
auto neighboursOf(const Accessor& accessor, const openvdb::Coord& c, int axis,
                  const SuggestInput& input) {
  Neighbours<typename Accessor::ValueType> out;
  const openvdb::Coord before = beside(c, axis, -1);
  const openvdb::Coord after = beside(c, axis, 1);
  const bool active = static_cast<int>(accessor.probeValue(before, out.before)) +
                          static_cast<int>(accessor.probeValue(after, out.after)) ==
                      2;
  const bool within =
      input.extent.empty() || (input.extent.isInside(before) && input.extent.isInside(after));
  out.known = active || (input.inactive_is_data && within);
  out.at_edge = out.known && !active;
  return out;
}

template <class F>
auto withScalars(const SuggestInput& input, const F& f) {
  using openvdb::DoubleGrid;
  using openvdb::FloatGrid;
  if (input.grid->isType<DoubleGrid>()) {
    return f(std::type_identity<ScalarReader<DoubleGrid>>(), std::type_identity<DoubleGrid>());
  }
  return f(std::type_identity<ScalarReader<FloatGrid>>(), std::type_identity<FloatGrid>());
}
template <class F>
auto withVectors(const SuggestInput& input, const F& f) {
  using openvdb::DoubleGrid;
  using openvdb::FloatGrid;
  using openvdb::Vec3DGrid;
  using openvdb::Vec3SGrid;
  if (input.grid->isType<Vec3DGrid>()) {
    return f(std::type_identity<VectorReader<Vec3DGrid>>(), std::type_identity<Vec3DGrid>());
  }
  if (input.grid->isType<DoubleGrid>()) {
    return f(std::type_identity<ComponentReader<DoubleGrid>>(), std::type_identity<DoubleGrid>());
  }
  if (input.grid->isType<FloatGrid>()) {
    return f(std::type_identity<ComponentReader<FloatGrid>>(), std::type_identity<FloatGrid>());
  }
  return f(std::type_identity<VectorReader<Vec3SGrid>>(), std::type_identity<Vec3SGrid>());
}

/// Returns about `count` active voxels, which are the same for grids with the same active voxels.
[[nodiscard]] std::vector<openvdb::Coord> placesOf(const SuggestInput& input, std::size_t count);

/// Values of a scalar at some voxels, and for each voxel whether it is active.
struct Readings {
  std::vector<float> values;
  std::vector<bool> active;
};
[[nodiscard]] Readings readAt(const SuggestInput& input, const std::vector<openvdb::Coord>& at);

}  // namespace palpate::guess
