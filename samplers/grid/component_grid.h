/// Private to samplers, for .cpp files only: the components of vector grids.
#pragma once

#include <memory>

#include <openvdb/tree/LeafManager.h>

#include "palpate/samplers/grid/volume_grid.h"

namespace palpate::detail {

template <class Vectors>
using ComponentGrid = ScalarGrid<typename Vectors::ValueType::ValueType>;

template <class Vectors>
typename ComponentGrid<Vectors>::Ptr componentGrid(const Vectors& grid, int c) {
  using ScalarTree = typename ComponentGrid<Vectors>::TreeType;
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
  return ComponentGrid<Vectors>::create(tree);
}

// Defined in prepare_vec3s.cpp and prepare_vec3d.cpp.
extern template openvdb::FloatGrid::Ptr componentGrid(const openvdb::Vec3SGrid&, int);
extern template openvdb::DoubleGrid::Ptr componentGrid(const openvdb::Vec3DGrid&, int);

}  // namespace palpate::detail
