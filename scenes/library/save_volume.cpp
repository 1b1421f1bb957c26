#include "palpate/scenes/library/save_volume.h"

#include <array>
#include <cmath>
#include <cstddef>
#include <memory>
#include <string>
#include <type_traits>
#include <variant>

#include <openvdb/tree/LeafManager.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/volume_grid.h"
#include "palpate/samplers/parallel.h"
#include "palpate/scenes/library/write_grids.h"

namespace palpate {
namespace {

/// Smallest number that becomes infinite when it is rounded to 16 bits.
constexpr double kBeyondHalf = 65520.0;

template <class Value>
bool fitsHalf(const Value& value) {
  if constexpr (std::is_arithmetic_v<Value>) {
    return std::abs(value) < kBeyondHalf;
  } else {
    return fitsHalf(value[0]) && fitsHalf(value[1]) && fitsHalf(value[2]);
  }
}

/// Throws VolumeError if a value of the grid, active or not, does not fit into 16 bits.
template <class GridT>
void checkHalf(const GridT& grid, const std::string& name) {
  using Tree = typename GridT::TreeType;
  using Value = typename GridT::ValueType;
  const auto check = [&](const Value& value) {
    if (fitsHalf(value)) return;
    throw VolumeError("\"" + name + "\"", "a value is too large for 16 bits (at most 65504)",
                      "save it with 32 bits (half=False)");
  };
  check(grid.background());
  auto tile = grid.tree().cbeginValueAll();
  tile.setMaxDepth(Tree::ValueAllCIter::LEAF_DEPTH - 1);
  for (; tile; ++tile) check(*tile);
  const openvdb::tree::LeafManager<const Tree> leaves(grid.tree());
  inParallel(leaves.leafCount(), [&](std::size_t n) {
    const Value* values = leaves.leaf(n).buffer().data();
    for (openvdb::Index i = 0; i < Tree::LeafNodeType::SIZE; ++i) check(values[i]);
  });
}

}  // namespace

void saveVolume(const std::filesystem::path& file, const Volume& volume, bool half) {
  const GridInfo& info = volume.info();
  const auto& parts = volume.grid().parts;
  if (parts.size() != 1 && info.grid_class == GridClass::kStaggered) {
    throw VolumeError("\"" + info.name + "\"", "it is staggered, and was split when it was loaded",
                      "copy its file, or save a vector at the voxels' centres");
  }
  // Smoothing changes values that had 16 bits in the file.
  const bool was_half = info.half && info.smoothing.sigma == 0.0;
  constexpr std::array kComponents{".x", ".y", ".z"};
  openvdb::GridCPtrVec grids;
  for (std::size_t p = 0; p < parts.size(); ++p) {
    std::visit(
        [&](const auto& grid) {
          using GridT = std::remove_const_t<typename std::decay_t<decltype(grid)>::element_type>;
          if (half) checkHalf<GridT>(*grid, info.name);
          // The copy shares the values, and has its own metadata.
          const openvdb::GridBase::Ptr copy = std::const_pointer_cast<GridT>(grid)->copyGrid();
          if (parts.size() > 1) copy->setName(info.name + kComponents.at(p));
          copy->setSaveFloatAsHalf(half || was_half);
          grids.push_back(copy);
        },
        parts[p].data);
  }
  writeGrids(file, grids);
}

}  // namespace palpate
