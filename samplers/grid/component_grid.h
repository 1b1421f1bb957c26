/// Private to samplers: the components of vector grids. Include it in .cpp files only.
#pragma once

#include <memory>

#include <openvdb/tree/LeafManager.h>

#include "palpate/samplers/grid/openvdb_grids.h"

namespace palpate::detail {

/// The type of one component of a vector grid.
template <class VectorGrid>
using ComponentGrid =
    typename VectorGrid::template ValueConverter<typename VectorGrid::ValueType::ValueType>::Type;

/// Returns one component of a vector grid, as a grid of its own with the identity transform.
template <class VectorGrid>
typename ComponentGrid<VectorGrid>::Ptr componentGrid(const VectorGrid& grid, int c) {
  using ScalarGrid = ComponentGrid<VectorGrid>;
  using ScalarTree = typename ScalarGrid::TreeType;
  using Leaf = typename ScalarTree::LeafNodeType;
  const auto& from = grid.constTree();
  auto tree = std::make_shared<ScalarTree>(from, grid.background()[c], openvdb::TopologyCopy());
  auto tile = tree->beginValueAll();
  tile.setMaxDepth(ScalarTree::ValueAllIter::LEAF_DEPTH - 1);
  for (; tile; ++tile) tile.setValue(from.getValue(tile.getCoord())[c]);
  openvdb::tree::LeafManager<ScalarTree> leaves(*tree);
  leaves.foreach ([&](Leaf& leaf, std::size_t) {
    const auto* vectors = from.probeConstLeaf(leaf.origin());
    for (openvdb::Index i = 0; i < Leaf::SIZE; ++i) {
      leaf.setValueOnly(i, vectors->getValue(i)[c]);
    }
  });
  return ScalarGrid::create(tree);
}

/// Replaces one component of the values in leaves by those of a grid of the same topology.
template <class VectorGrid>
void setComponent(VectorGrid& grid, int c, const ComponentGrid<VectorGrid>& component) {
  using Leaf = typename VectorGrid::TreeType::LeafNodeType;
  openvdb::tree::LeafManager<typename VectorGrid::TreeType> leaves(grid.tree());
  leaves.foreach ([&](Leaf& leaf, std::size_t) {
    const auto* values = component.constTree().probeConstLeaf(leaf.origin());
    for (openvdb::Index i = 0; i < Leaf::SIZE; ++i) {
      typename VectorGrid::ValueType vector = leaf.getValue(i);
      vector[c] = values->getValue(i);
      leaf.setValueOnly(i, vector);
    }
  });
}

// Defined in prepare_vec3s.cpp and prepare_vec3d.cpp.
extern template openvdb::FloatGrid::Ptr componentGrid(const openvdb::Vec3SGrid&, int);
extern template openvdb::DoubleGrid::Ptr componentGrid(const openvdb::Vec3DGrid&, int);

}  // namespace palpate::detail
