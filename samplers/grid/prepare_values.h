/// Private to samplers, for .cpp files only: checks and prepares the values of a grid.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <limits>
#include <new>
#include <string>
#include <type_traits>

#include <openvdb/tools/VectorTransformer.h>
#include <openvdb/tree/LeafManager.h>
#include <openvdb/tree/NodeManager.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/data_ends.h"
#include "palpate/samplers/grid/make_volume.h"
#include "palpate/samplers/grid/no_data_error.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/smooth.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate::detail {

using openvdb::Coord;
using Progress = std::function<void(double)>;

/// Returns true if v is finite and its magnitude is at most 1e100, so that derivatives and spline
/// coefficients in double precision cannot overflow.
template <class Real>
bool isUsable(Real v) noexcept {
  constexpr Real kMost = std::min<double>(1e100, std::numeric_limits<Real>::max());
  return std::abs(v) <= kMost;
}

/// Sum and range of the active values. `unusable` counts stored values, active or not.
struct Range {
  double sum = 0.0;
  double count = 0.0;
  double lowest = std::numeric_limits<double>::infinity();
  double highest = -std::numeric_limits<double>::infinity();
  std::uint64_t unusable = 0;

  void add(double v, bool active, double voxels = 1.0) noexcept {
    if (!isUsable(v)) {
      ++unusable;
    } else if (active) {
      sum += v * voxels;
      count += voxels;
      lowest = std::min(lowest, v);
      highest = std::max(highest, v);
    }
  }
  void join(const Range& other) noexcept {
    sum += other.sum;
    count += other.count;
    lowest = std::min(lowest, other.lowest);
    highest = std::max(highest, other.highest);
    unusable += other.unusable;
  }
  /// Adds the voxels of a leaf, eight at a time for speed.
  template <class Leaf>
  void addLeaf(const Leaf& leaf) noexcept {
    using Size = decltype(sizeOf(*leaf.buffer().data()));
    std::array<Size, 8> low;
    std::array<Size, 8> high;
    std::array<double, 8> total{};
    low.fill(std::numeric_limits<Size>::infinity());
    high.fill(-std::numeric_limits<Size>::infinity());
    const auto* data = leaf.buffer().data();
    for (openvdb::Index row = 0; row < Leaf::SIZE; row += 8) {
      const auto bits = leaf.valueMask().template getWord<std::uint8_t>(row / 8);
      std::array<Size, 8> v;
      int bad = 0;
      for (std::size_t z = 0; z < 8; ++z) v[z] = sizeOf(data[row + z]);
      for (std::size_t z = 0; z < 8; ++z) bad += static_cast<int>(!isUsable(v[z]));
      if (bad == 0 && bits == 0xFF) {
        for (std::size_t z = 0; z < 8; ++z) {
          low[z] = v[z] < low[z] ? v[z] : low[z];
          high[z] = v[z] > high[z] ? v[z] : high[z];
          total[z] += static_cast<double>(v[z]);
        }
        count += 8.0;
      } else if (bad != 0 || bits != 0) {
        for (std::size_t z = 0; z < 8; ++z) {
          add(static_cast<double>(v[z]), ((bits >> z) & 1) != 0);
        }
      }
    }
    for (std::size_t z = 0; z < 8; ++z) {
      sum += total[z];
      lowest = std::min(lowest, static_cast<double>(low[z]));
      highest = std::max(highest, static_cast<double>(high[z]));
    }
  }
};

template <class Leaf>
void readLeaf(Leaf& leaf) {
  using Buffer = typename Leaf::Buffer;
  using Value = typename Leaf::ValueType;
  static_assert(OPENVDB_LIBRARY_MAJOR_VERSION_NUMBER == 10,
                "check how this OpenVDB frees a leaf that it failed to read");
  try {
    (void)leaf.buffer().data();
  } catch (...) {
    // OpenVDB 10 leaves the failed buffer in a state that its destructor misinterprets. Frees its
    // memory, at the address in its first member, and constructs a valid buffer in its place.
    delete[] * reinterpret_cast<Value**>(&leaf.buffer());
    ::new (static_cast<void*>(&leaf.buffer())) Buffer(openvdb::zeroVal<Value>());
    throw;
  }
}

struct TileRange {
  Range range;

  TileRange() = default;
  TileRange(const TileRange& /*whole*/, tbb::split /*tag*/) {}
  template <class Node>
  bool operator()(const Node& node) {
    for (auto tile = node.cbeginValueAll(); tile; ++tile) {
      range.add(static_cast<double>(sizeOf(*tile)), tile.isValueOn(),
                static_cast<double>(Node::ChildNodeType::NUM_VOXELS));
    }
    return true;
  }
  void join(const TileRange& other) noexcept { range.join(other.range); }
};

template <class GridT>
Range rangeOf(GridT& grid, const Progress& progress = nullptr) {
  using Tree = typename GridT::TreeType;
  openvdb::tree::LeafManager<Tree> leaves(grid.tree());
  // Divides the leaves into several parts, to report the progress after each part.
  const std::size_t parts = progress && leaves.leafCount() > 10000
                                ? std::max<std::size_t>(16, leaves.leafCount() >> 16U)
                                : 1;
  Range range;
  for (std::size_t part = 0; part < parts; ++part) {
    const tbb::blocked_range<std::size_t> here(leaves.leafCount() * part / parts,
                                               leaves.leafCount() * (part + 1) / parts, 64);
    range.join(tbb::parallel_deterministic_reduce(
        here, Range{},
        [&](const tbb::blocked_range<std::size_t>& some, Range sum) {
          for (std::size_t i = some.begin(); i < some.end(); ++i) {
            readLeaf(leaves.leaf(i));
            sum.addLeaf(leaves.leaf(i));
          }
          return sum;
        },
        [](Range a, const Range& b) {
          a.join(b);
          return a;
        }));
    if (progress) progress(static_cast<double>(part + 1) / static_cast<double>(parts));
  }
  TileRange tiles;
  openvdb::tree::NodeManager<const Tree, Tree::RootNodeType::LEVEL - 1>(grid.constTree())
      .reduceTopDown(tiles);
  range.join(tiles.range);
  range.add(sizeOf(grid.background()), false);
  return range;
}

/// Replaces unusable values by the background, and deactivates their voxels and tiles. An unusable
/// background becomes zero.
template <class GridT>
void fillUnusable(GridT& grid) {
  using Value = typename GridT::ValueType;
  using Tree = typename GridT::TreeType;
  if (!isUsable(sizeOf(grid.background()))) {
    grid.tree().root().setBackground(openvdb::zeroVal<Value>(), /*updateChildNodes=*/false);
  }
  const Value background = grid.background();
  openvdb::tree::LeafManager<Tree> leaves(grid.tree());
  leaves.foreach ([&](typename Tree::LeafNodeType& leaf, std::size_t) {
    for (openvdb::Index i = 0; i < Tree::LeafNodeType::SIZE; ++i) {
      if (!isUsable(sizeOf(leaf.getValue(i)))) leaf.setValueOff(i, background);
    }
  });
  auto tile = grid.beginValueAll();
  tile.setMaxDepth(GridT::ValueAllIter::LEAF_DEPTH - 1);
  for (; tile; ++tile) {
    if (isUsable(sizeOf(*tile))) continue;
    tile.setValue(background);
    tile.setValueOff();
  }
}

/// Converts vectors from index space to the file's world space by the rule of their VecType.
template <class GridT>
void turnVectors(GridT& grid) {
  const openvdb::Mat4d map = grid.transform().baseMap()->getAffineMap()->getMat4();
  grid.setIsInWorldSpace(true);  // otherwise OpenVDB does not transform vectors
  // OpenVDB does not transform the background, so this function transforms it as a voxel of another
  // grid.
  auto one = GridT::create();
  one->setVectorType(grid.getVectorType());
  one->tree().setValue(Coord(0, 0, 0), grid.background());
  openvdb::tools::transformVectors(*one, map);
  openvdb::tools::transformVectors(grid, map);
  grid.tree().root().setBackground(one->tree().getValue(Coord(0, 0, 0)),
                                   /*updateChildNodes=*/false);
}

[[nodiscard]] inline Inactive inactiveOf(const openvdb::GridBase& grid) {
  const auto missing = grid.getMetadata<openvdb::BoolMetadata>(kMetaInactiveIsMissing);
  const auto from = grid.getMetadata<openvdb::StringMetadata>(kMetaImportedFrom);
  return inactiveVoxels(from != nullptr ? from->value() : "",
                        missing != nullptr && missing->value());
}

/// Boxes of the active voxels of a grid.
struct ActiveBoxes {
  openvdb::CoordBBox as_read;  ///< Box before smoothing.
  openvdb::CoordBBox now;      ///< Box after smoothing.
};

/// Returns the standard deviations along i, j and k [voxels]. Throws VolumeError if one is invalid.
[[nodiscard]] inline Vec3 deviationsOf(const openvdb::GridBase& grid, const SmoothWidth& width,
                                       const std::string& name) {
  const openvdb::Vec3d edges = grid.voxelSize();
  Vec3 voxels = Vec3::Constant(width.sigma);
  if (width.in_file_units) voxels = voxels.cwiseQuotient(Vec3(edges.x(), edges.y(), edges.z()));
  const double most = voxels.maxCoeff();
  if (!(voxels.minCoeff() >= 0.0 && most <= kMostSmooth)) {
    std::array<char, 32> written{};
    std::snprintf(written.data(), written.size(), "%.3g", most);
    throw VolumeError(
        "grid \"" + name + "\"", "\"smooth\" is " + std::string(written.data()) + " voxels",
        "give a width from 0 to " + std::to_string(static_cast<int>(kMostSmooth)) + " voxels");
  }
  return voxels;
}

template <class GridT>
void smoothValues(GridT& grid, const SmoothWidth& width, GridInfo& info) {
  const Vec3 deviations = deviationsOf(grid, width, info.name);
  try {
    info.smoothing = smooth(grid, deviations, inactiveOf(grid) != Inactive::kBackground);
  } catch (const openvdb::Exception& e) {
    throw VolumeError("grid \"" + info.name + "\"",
                      "it cannot be smoothed (" + std::string(e.what()) + ")", "remove \"smooth\"");
  }
  if (grid.activeVoxelCount() == 0) {
    throw NoDataError("grid \"" + info.name + "\"", "smoothing removes its whole surface",
                      "give a smaller \"smooth\"");
  }
}

/// Checks, fills, smooths and transforms the values of a grid of a supported type.
template <class GridT>
ActiveBoxes prepareValues(GridT& grid, const LoadOptions& options, bool affine, GridInfo& info) {
  Range range = rangeOf(grid, options.progress);
  const auto fill = [&] {
    if (range.unusable == 0 || options.non_finite == NonFinite::kRefuse) return;
    info.filled += range.unusable;
    fillUnusable(grid);
    range = rangeOf(grid);
  };
  fill();
  ActiveBoxes boxes;
  boxes.as_read = grid.evalActiveVoxelBoundingBox();
  const bool smooths =
      options.smooth.sigma != 0.0 && affine && range.unusable == 0 && !boxes.as_read.empty();
  if (smooths) {
    smoothValues(grid, options.smooth, info);
    range = rangeOf(grid);
  }
  if constexpr (!std::is_arithmetic_v<typename GridT::ValueType>) {
    info.vector = true;
    info.was_local = !grid.isInWorldSpace() && grid.getVectorType() != openvdb::VEC_INVARIANT;
    if (info.was_local && affine) {
      turnVectors(grid);
      range = rangeOf(grid);
      fill();
    }
  }
  info.non_finite = range.unusable;
  info.background = sizeOf(grid.background());
  if (range.lowest <= range.highest) {
    info.lowest = range.lowest;
    info.highest = range.highest;
    info.mean = range.sum / range.count;
  }
  boxes.now = smooths ? grid.evalActiveVoxelBoundingBox() : boxes.as_read;
  return boxes;
}

// The instances are in prepare_float.cpp, prepare_double.cpp, prepare_vec3s.cpp and
// prepare_vec3d.cpp.
extern template ActiveBoxes prepareValues(openvdb::FloatGrid&, const LoadOptions&, bool, GridInfo&);
extern template ActiveBoxes prepareValues(openvdb::DoubleGrid&, const LoadOptions&, bool,
                                          GridInfo&);
extern template ActiveBoxes prepareValues(openvdb::Vec3SGrid&, const LoadOptions&, bool, GridInfo&);
extern template ActiveBoxes prepareValues(openvdb::Vec3DGrid&, const LoadOptions&, bool, GridInfo&);

}  // namespace palpate::detail
