/// Private to samplers, for .cpp files only: visits the cells that have an active corner.
#pragma once

#include <array>
#include <cstddef>

#include "palpate/samplers/grid/openvdb_grids.h"

namespace palpate::detail {

/// Returns the offset of corner n of a cell from the cell's lowest corner.
[[nodiscard]] inline openvdb::Coord cornerOf(int n) noexcept {
  return {n >> 2, (n >> 1) & 1, n & 1};
}

/// Calls visit(low, values, active) for each cell that has this active voxel as its first active
/// corner. `low` is the lowest corner, `values` are the values at the eight corners, and `active`
/// is the number of active corners. A loop over all active voxels visits each cell once. Cost: 15
/// reads for a voxel among active voxels, at most 64.
template <class Accessor, class Visit>
void eachCellAt(const Accessor& accessor, const openvdb::Coord& voxel, const Visit& visit) {
  for (int first = 0; first < 8; ++first) {
    const openvdb::Coord low = voxel - cornerOf(first);
    std::array<typename Accessor::ValueType, 8> at{};
    int active = 0;
    bool seen = false;
    for (int n = 0; n < 8 && !seen; ++n) {
      const bool on = accessor.probeValue(low + cornerOf(n), at[static_cast<std::size_t>(n)]);
      seen = on && n < first;
      active += static_cast<int>(on);
    }
    if (!seen) visit(low, at, active);
  }
}

}  // namespace palpate::detail
