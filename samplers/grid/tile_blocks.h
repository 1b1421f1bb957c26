/// Private to samplers, for .cpp files only: blocks of a leaf's size in active tiles.
#pragma once

#include <vector>

#include "palpate/samplers/grid/openvdb_grids.h"

namespace palpate::detail {

/// Returns the origins of leaf-sized blocks in active tiles: all if `inner`, else those along each
/// tile's faces. Omits tiles wider than 128 voxels, which have millions of voxels on each face.
template <class TreeT>
std::vector<openvdb::Coord> tileBlocks(const TreeT& tree, bool inner) {
  constexpr int kSize = static_cast<int>(TreeT::LeafNodeType::DIM);
  constexpr int kLargest = 128;
  std::vector<openvdb::Coord> origins;
  auto tile = tree.cbeginValueOn();
  tile.setMaxDepth(TreeT::ValueOnCIter::LEAF_DEPTH - 1);
  for (; tile; ++tile) {
    const openvdb::CoordBBox box = tile.getBoundingBox();
    if (box.dim().x() > kLargest) continue;
    const int last = box.dim().x() - kSize;
    for (int i = 0; i <= last; i += kSize) {
      for (int j = 0; j <= last; j += kSize) {
        const bool all = inner || i == 0 || i == last || j == 0 || j == last;
        for (int k = 0; k <= last; k += all || last == 0 ? kSize : last) {
          origins.push_back(box.min().offsetBy(i, j, k));
        }
      }
    }
  }
  return origins;
}

}  // namespace palpate::detail
