/// Private to samplers: the voxels of a lattice that have data.
#pragma once

#include <array>
#include <cstddef>
#include <limits>
#include <string_view>

#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Returns the meaning of inactive voxels that a grid's metadata state.
/// @param imported_from  Value of kMetaImportedFrom; empty if it is not set.
/// @param missing        Value of kMetaInactiveIsMissing; false if it is not set.
[[nodiscard]] constexpr Inactive inactiveVoxels(std::string_view imported_from,
                                                bool missing) noexcept {
  if (missing) return Inactive::kMissing;
  return imported_from == "mesh" ? Inactive::kOutside : Inactive::kBackground;
}

/// The voxels that have data. A difference to other voxels is not a derivative of the data. Voxels
/// outside of the box of active voxels have no data. The default box is unlimited.
struct DataEnds {
  std::array<int, 3> lower{kLeast, kLeast, kLeast};  ///< First voxel of the box.
  std::array<int, 3> upper{kMost, kMost, kMost};     ///< Last voxel of the box.
  /// Meaning of the inactive voxels in the box. If kMissing, a place has no data if its value would
  /// read an inactive voxel. If kOutside, a place has data if its value reads one active voxel.
  Inactive inactive = Inactive::kBackground;

  /// Returns true if inactive voxels in the box have no data.
  [[nodiscard]] bool activeOnly() const noexcept { return inactive != Inactive::kBackground; }
  /// Returns true if the box contains the voxel and, along each axis, `margin` voxels around it.
  [[nodiscard]] bool contains(const std::array<int, 3>& voxel, int margin = 0) const noexcept {
    for (std::size_t a = 0; a < 3; ++a) {
      if (voxel[a] < lower[a] + margin || voxel[a] > upper[a] - margin) return false;
    }
    return true;
  }

 private:
  static constexpr int kMost = std::numeric_limits<int>::max() / 2;
  static constexpr int kLeast = -kMost;
};

}  // namespace palpate
