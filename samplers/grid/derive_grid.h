/// Private to samplers: fields computed from grids, for each supported type. Include it in .cpp
/// files only.
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
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume_grid.h"

namespace palpate::detail {

using openvdb::Coord;

template <class Value>
constexpr bool kIsVector = !std::is_arithmetic_v<Value>;

/// The precision of a grid's numbers.
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

/// Computes the derived scalar or vector from a vector and its Jacobian.
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
/// Calls vectorOf or scalarOf, depending on `Value`.
template <class Value>
Value derived(Derivation what, const Vec3& v, const Mat3& J) noexcept {
  if constexpr (kIsVector<Value>) {
    return toGrid<Value>(vectorOf(what, v, J));
  } else {
    return toGrid<Value>(scalarOf(what, v, J));
  }
}

/// A leaf of a tree and its six neighbours across its faces, or the tiles in their place.
template <class TreeT>
class Neighbourhood {
  using Leaf = typename TreeT::LeafNodeType;
  using Value = typename TreeT::ValueType;

 public:
  Neighbourhood(const TreeT& tree, const Coord& origin) {
    openvdb::tree::ValueAccessor<const TreeT, false> accessor(tree);
    const auto look = [&](const Coord& at) -> Place {
      const Leaf* leaf = accessor.probeConstLeaf(at);
      if (leaf != nullptr) return {leaf->buffer().data(), Value()};
      return {nullptr, accessor.getValue(at)};
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

  /// Returns the value of the leaf's voxel n.
  [[nodiscard]] Value value(int n) const noexcept { return own_.value(n); }

  /// Returns half the difference of the voxel's neighbours along an axis: the derivative by index.
  [[nodiscard]] auto slope(int n, int axis) const noexcept {
    const int shift = 6 - 3 * axis;
    const int step = 1 << shift;
    const int at = (n >> shift) & (kSize - 1);
    const auto a = static_cast<std::size_t>(axis);
    const Value low = at > 0 ? own_.value(n - step) : below_[a].value(n + 7 * step);
    const Value high = at < 7 ? own_.value(n + step) : above_[a].value(n - 7 * step);
    using Number = decltype(toEngine(low));
    return Number(0.5 * (toEngine(high) - toEngine(low)));
  }

 private:
  static constexpr int kSize = static_cast<int>(Leaf::DIM);
  static_assert(kSize == 8);

  struct Place {
    const Value* data = nullptr;
    Value tile{};
    [[nodiscard]] Value value(int n) const noexcept { return data != nullptr ? data[n] : tile; }
  };
  Place own_;
  std::array<Place, 3> below_;
  std::array<Place, 3> above_;
};

/// Selects the voxels of an active tile that get a leaf.
enum class Tiles : std::uint8_t {
  kKept,    ///< No voxels.
  kOpened,  ///< Voxels along its faces, which have other neighbours.
  kSplit,   ///< All voxels.
};

template <class TreeT>
void open(TreeT& tree, Tiles tiles) {
  constexpr int kSize = static_cast<int>(TreeT::LeafNodeType::DIM);
  constexpr int kLargest = 128;  // larger tiles have millions of voxels per face
  std::vector<Coord> origins;
  auto tile = std::as_const(tree).cbeginValueOn();
  tile.setMaxDepth(TreeT::ValueOnCIter::LEAF_DEPTH - 1);
  for (; tile; ++tile) {
    const openvdb::CoordBBox box = tile.getBoundingBox();
    if (box.dim().x() > kLargest) continue;
    const int last = box.dim().x() - kSize;
    for (int i = 0; i <= last; i += kSize) {
      for (int j = 0; j <= last; j += kSize) {
        const bool all = tiles == Tiles::kSplit || i == 0 || i == last || j == 0 || j == last;
        for (int k = 0; k <= last; k += all || last == 0 ? kSize : last) {
          origins.push_back(box.min().offsetBy(i, j, k));
        }
      }
    }
  }
  for (const Coord& origin : origins) tree.touchLeaf(origin);
}

/// Makes a grid with the same active voxels as `in`; `rule` fills each leaf.
template <class OutGrid, class InGrid, class Rule>
typename OutGrid::Ptr sameVoxels(const InGrid& in, Tiles tiles, Rule rule) {
  using OutTree = typename OutGrid::TreeType;
  auto tree = std::make_shared<OutTree>(in.tree(), openvdb::zeroVal<typename OutTree::ValueType>(),
                                        openvdb::TopologyCopy());
  if (tiles != Tiles::kKept) open(*tree, tiles);
  openvdb::tree::LeafManager<OutTree> leaves(*tree);
  leaves.foreach ([&](typename OutTree::LeafNodeType& leaf, std::size_t) { rule(leaf); });
  return OutGrid::create(tree);
}

/// Derives from a vector grid whose vectors are in the file's space.
template <class OutGrid, class InGrid>
typename OutGrid::Ptr ofVector(const InGrid& in, const Mat3& index_from_file, Derivation what) {
  using Out = typename OutGrid::ValueType;
  const bool slopes = kindOf(what).of_volume;
  auto out = sameVoxels<OutGrid>(in, slopes ? Tiles::kOpened : Tiles::kKept, [&](auto& leaf) {
    const Neighbourhood<typename InGrid::TreeType> about(in.tree(), leaf.origin());
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

/// Computes the gradient of a scalar.
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

/// Derives from a vector of three grids, at the voxels of the first. A voxel becomes inactive if
/// one of the grids has no data there.
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

/// Makes the derived grid, in index space.
template <class GridT>
openvdb::GridBase::Ptr derivedGrid(const std::shared_ptr<const Volume>& volume, const GridT& grid,
                                   Derivation what) {
  using Value = typename GridT::ValueType;
  using Real = typename RealOf<Value>::Type;
  using Scalars = ScalarGrid<Real>;
  using Vectors = VectorGrid<Real>;
  const Volume::Grid::Part& part = volume->grid().parts.front();
  const Mat3 index_from_file = part.linear.inverse();
  if constexpr (kIsVector<Value>) {
    if (kindOf(what).vector) return ofVector<Vectors>(grid, index_from_file, what);
    return ofVector<Scalars>(grid, index_from_file, what);
  } else {
    if (!volume->info().vector) return gradientOf<Vectors>(grid, index_from_file);
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
