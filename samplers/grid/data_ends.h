/// Private to samplers: the voxels of a lattice that have data, for differences of vectors.
#pragma once

#include <array>
#include <cstddef>
#include <limits>

namespace palpate {

/// The voxels that have data. A difference to other voxels is not a derivative of the data. Voxels
/// outside of the box of active voxels have no data. In a grid that was resampled from a mesh, or
/// that has the metadata kMetaInactiveIsMissing, inactive voxels in the box lack data too. In other
/// grids, an inactive voxel in the box has the value of the background: the centre of a vortex is
/// at rest.
struct DataEnds {
  std::array<int, 3> lower{kLeast, kLeast, kLeast};  ///< First voxel of the box.
  std::array<int, 3> upper{kMost, kMost, kMost};     ///< Last voxel of the box.
  bool active_only = false;  ///< True if inactive voxels in the box have no data.
  /// True if a place has no data if its value would read an inactive voxel in the box. In a grid
  /// from a mesh, one active voxel suffices: the mesh ends between the voxels.
  bool whole_cells = false;

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
