/// Private to samplers, for .cpp files only: computes derived properties of grids.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

#include <openvdb/tree/LeafManager.h>

#include "palpate/engine/field/flow.h"
#include "palpate/samplers/grid/derive.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/tile_blocks.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume_grid.h"

namespace palpate::detail {

using openvdb::Coord;

template <class Value>
constexpr bool kIsVector = !std::is_arithmetic_v<Value>;

template <class Value>
struct RealOf {
  using Type = Value;
};
template <class Real>
struct RealOf<openvdb::math::Vec3<Real>> {
  using Type = Real;
};
template <class Value>
auto toEngine(const Value& value) noexcept {
  if constexpr (kIsVector<Value>) {
    return Vec3(value[0], value[1], value[2]);
  } else {
    return static_cast<double>(value);
  }
}
template <class Value>
Value toGrid(double value) noexcept {
  return static_cast<Value>(value);
}
template <class Value>
Value toGrid(const Vec3& value) noexcept {
  return Value(value.x(), value.y(), value.z());
}

inline double scalarOf(Derivation what, const Vec3& v, const Mat3& J) noexcept {
  switch (what) {
    case Derivation::kMagnitude:
      return v.norm();
    case Derivation::kDivergence:
      return divergence(J);
    case Derivation::kQ:
      return qCriterion(J);
    case Derivation::kLambda2:
      return lambda2(J);
    default:
      return 0.0;
  }
}
inline Vec3 vectorOf(Derivation what, const Vec3& v, const Mat3& J) noexcept {
  return what == Derivation::kUnit ? unit(v) : curl(J);
}
template <class Value>
Value derived(Derivation what, const Vec3& v, const Mat3& J) noexcept {
  if constexpr (kIsVector<Value>) {
    return toGrid<Value>(vectorOf(what, v, J));
  } else {
    return toGrid<Value>(scalarOf(what, v, J));
  }
}

/// A leaf and its six neighbours, leaves or tiles. Differences use only voxels that have data by
/// `ends`; by default, all voxels.
template <class TreeT>
class Neighbourhood {
  using Leaf = typename TreeT::LeafNodeType;
  using Value = typename TreeT::ValueType;

 public:
  Neighbourhood(const TreeT& tree, const Coord& origin, const DataEnds& ends = {})
      : origin_(origin), ends_(ends) {
    openvdb::tree::ValueAccessor<const TreeT, false> accessor(tree);
    const auto look = [&](const Coord& at) -> Place {
      const Leaf* leaf = accessor.probeConstLeaf(at);
      if (leaf != nullptr) return {leaf->buffer().data(), leaf, Value(), false};
      Place tile;
      tile.tile_active = accessor.probeValue(at, tile.tile);
      return tile;
    };
    own_ = look(origin);
    for (int axis = 0; axis < 3; ++axis) {
      const auto a = static_cast<std::size_t>(axis);
      Coord at = origin;
      at[axis] -= kSize;
      below_[a] = look(at);
      at[axis] += 2 * kSize;
      above_[a] = look(at);
    }
  }

  [[nodiscard]] Value value(int n) const noexcept { return own_.value(n); }

  /// Returns the derivative at voxel n by the index along an axis: half the difference of its two
  /// neighbours. If only one neighbour has data, returns the difference to that neighbour; if
  /// neither has data, 0.
  [[nodiscard]] auto slope(int n, int axis) const noexcept {
    const int shift = 6 - 3 * axis;
    const int step = 1 << shift;
    const int at = (n >> shift) & (kSize - 1);
    const auto a = static_cast<std::size_t>(axis);
    const Place& below = at > 0 ? own_ : below_[a];
    const Place& above = at < 7 ? own_ : above_[a];
    const int n_below = at > 0 ? n - step : n + 7 * step;
    const int n_above = at < 7 ? n + step : n - 7 * step;
    const int here = origin_[axis] + at;
    const bool low = here > ends_.lower[a] && (!ends_.activeOnly() || below.active(n_below));
    const bool high = here < ends_.upper[a] && (!ends_.activeOnly() || above.active(n_above));
    using Number = decltype(toEngine(Value()));
    const Number from = toEngine(low ? below.value(n_below) : own_.value(n));
    const Number to = toEngine(high ? above.value(n_above) : own_.value(n));
    return Number((low && high ? 0.5 : 1.0) * (to - from));
  }

 private:
  static constexpr int kSize = static_cast<int>(Leaf::DIM);
  static_assert(kSize == 8);

  struct Place {
    const Value* data = nullptr;
    const Leaf* leaf = nullptr;
    Value tile{};
    bool tile_active = false;
    [[nodiscard]] Value value(int n) const noexcept { return data != nullptr ? data[n] : tile; }
    [[nodiscard]] bool active(int n) const noexcept {
      return leaf != nullptr ? leaf->isValueOn(static_cast<openvdb::Index>(n)) : tile_active;
    }
  };
  Coord origin_;
  DataEnds ends_;
  Place own_;
  std::array<Place, 3> below_;
  std::array<Place, 3> above_;
};

/// The voxels of an active tile that are stored in leaves of the derived grid. Tiles of more than
/// 128 voxels along an edge stay tiles (tileBlocks).
enum class Tiles : std::uint8_t {
  kKept,    ///< No voxels: the tile stays a tile.
  kOpened,  ///< Voxels along the tile's faces, because their neighbours are outside.
  kSplit,   ///< All voxels.
};

template <class OutGrid, class InGrid, class Rule>
typename OutGrid::Ptr sameVoxels(const InGrid& in, Tiles tiles, Rule rule) {
  using OutTree = typename OutGrid::TreeType;
  auto tree = std::make_shared<OutTree>(in.tree(), openvdb::zeroVal<typename OutTree::ValueType>(),
                                        openvdb::TopologyCopy());
  if (tiles != Tiles::kKept) {
    for (const Coord& at : tileBlocks(*tree, tiles == Tiles::kSplit)) tree->touchLeaf(at);
  }
  openvdb::tree::LeafManager<OutTree> leaves(*tree);
  leaves.foreach ([&](typename OutTree::LeafNodeType& leaf, std::size_t) { rule(leaf); });
  return OutGrid::create(tree);
}

/// Derives a property of a vector grid. The vectors are in the file's world space.
template <class OutGrid, class InGrid>
typename OutGrid::Ptr ofVector(const InGrid& in, const Volume::Grid::Part& part, Derivation what) {
  const Mat3 index_from_file = part.linear.inverse();
  using Out = typename OutGrid::ValueType;
  const bool slopes = kindOf(what).of_volume;
  auto out = sameVoxels<OutGrid>(in, slopes ? Tiles::kOpened : Tiles::kKept, [&](auto& leaf) {
    const Neighbourhood<typename InGrid::TreeType> about(in.tree(), leaf.origin(), part.ends);
    for (auto voxel = leaf.beginValueOn(); voxel; ++voxel) {
      const int n = static_cast<int>(voxel.pos());
      Mat3 J = Mat3::Zero();
      if (slopes) {
        Mat3 by_index;
        for (int a = 0; a < 3; ++a) by_index.col(a) = about.slope(n, a);
        J = by_index * index_from_file;
      }
      voxel.setValue(derived<Out>(what, toEngine(about.value(n)), J));
    }
  });
  if (!slopes) {
    auto tile = out->beginValueOn();
    tile.setMaxDepth(OutGrid::ValueOnIter::LEAF_DEPTH - 1);
    for (; tile; ++tile) {
      const Vec3 v = toEngine(in.tree().getValue(tile.getCoord()));
      tile.setValue(derived<Out>(what, v, Mat3::Zero()));
    }
  }
  return out;
}

template <class OutGrid, class InGrid>
typename OutGrid::Ptr gradientOf(const InGrid& in, const Mat3& index_from_file) {
  using Out = typename OutGrid::ValueType;
  const Mat3 gradient_from_index = index_from_file.transpose();
  return sameVoxels<OutGrid>(in, Tiles::kOpened, [&](auto& leaf) {
    const Neighbourhood<typename InGrid::TreeType> about(in.tree(), leaf.origin());
    for (auto voxel = leaf.beginValueOn(); voxel; ++voxel) {
      const int n = static_cast<int>(voxel.pos());
      const Vec3 by_index(about.slope(n, 0), about.slope(n, 1), about.slope(n, 2));
      voxel.setValue(toGrid<Out>(Vec3(gradient_from_index * by_index)));
    }
  });
}

/// Derives a property of a vector of three grids, at the voxels of the first grid. A voxel becomes
/// inactive if one of the grids has no data at the voxel's position.
template <class OutGrid, class InGrid>
typename OutGrid::Ptr ofComponents(const std::shared_ptr<const Volume>& volume, const InGrid& first,
                                   const Volume::Grid::Part& part, Derivation what) {
  using Out = typename OutGrid::ValueType;
  const auto field = std::get<1>(makeVdbField(volume, Placement{}));
  return sameVoxels<OutGrid>(first, Tiles::kSplit, [&](auto& leaf) {
    FieldCache cache;
    field->reset(cache);
    for (auto voxel = leaf.beginValueOn(); voxel; ++voxel) {
      const Coord at = voxel.getCoord();
      const VectorSample s = field->sample(part.toFile(Vec3(at.x(), at.y(), at.z())), cache);
      if (s.inside) {
        voxel.setValue(derived<Out>(what, s.value, s.jacobian));
      } else {
        voxel.setValueOff();
      }
    }
  });
}

/// Makes the derived grid, in the index space of the original grid (identity map).
template <class GridT>
openvdb::GridBase::Ptr derivedGrid(const std::shared_ptr<const Volume>& volume, const GridT& grid,
                                   Derivation what) {
  using Value = typename GridT::ValueType;
  using Real = typename RealOf<Value>::Type;
  using Scalars = ScalarGrid<Real>;
  using Vectors = VectorGrid<Real>;
  const Volume::Grid::Part& part = volume->grid().parts.front();
  if constexpr (kIsVector<Value>) {
    if (kindOf(what).vector) return ofVector<Vectors>(grid, part, what);
    return ofVector<Scalars>(grid, part, what);
  } else {
    if (!volume->info().vector) return gradientOf<Vectors>(grid, part.linear.inverse());
    if (kindOf(what).vector) return ofComponents<Vectors>(volume, grid, part, what);
    return ofComponents<Scalars>(volume, grid, part, what);
  }
}

// Defined in derive_float.cpp and derive_double.cpp.
extern template openvdb::GridBase::Ptr derivedGrid(const std::shared_ptr<const Volume>&,
                                                   const openvdb::FloatGrid&, Derivation);
extern template openvdb::GridBase::Ptr derivedGrid(const std::shared_ptr<const Volume>&,
                                                   const openvdb::DoubleGrid&, Derivation);
extern template openvdb::GridBase::Ptr derivedGrid(const std::shared_ptr<const Volume>&,
                                                   const openvdb::Vec3SGrid&, Derivation);
extern template openvdb::GridBase::Ptr derivedGrid(const std::shared_ptr<const Volume>&,
                                                   const openvdb::Vec3DGrid&, Derivation);

}  // namespace palpate::detail
