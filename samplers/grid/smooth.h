/// Private to samplers, for .cpp files only: smooths grids of each supported type.
#pragma once

#include <algorithm>
#include <cmath>
#include <type_traits>

#include <openvdb/tools/Filter.h>
#include <openvdb/tools/LevelSetFilter.h>

#include "palpate/samplers/grid/component_grid.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate::detail {

/// Returns the value of a scalar, or the magnitude of a vector.
template <class T>
auto sizeOf(const T& value) noexcept {
  if constexpr (std::is_arithmetic_v<T>) {
    return value;
  } else {
    return openvdb::Vec3d(value).length();
  }
}

/// Applies OpenVDB's Gaussian, to vectors component by component: OpenVDB's library has the filter
/// for scalars compiled.
template <class GridT>
void applyGaussian(GridT& grid, int width) {
  if constexpr (std::is_floating_point_v<typename GridT::ValueType>) {
    if (grid.getGridClass() == openvdb::GRID_LEVEL_SET) {
      openvdb::tools::LevelSetFilter<GridT>(grid).gaussian(width);
    } else {
      openvdb::tools::Filter<GridT>(grid).gaussian(width);
    }
  } else {
    for (int c = 0; c < 3; ++c) {
      const auto component = componentGrid(grid, c);
      applyGaussian(*component, width);
      setComponent(grid, c, *component);
    }
  }
}

/// Applies OpenVDB's Gaussian. Returns its effect on the active values.
template <class GridT>
Smoothing smooth(GridT& grid, int width) {
  using Value = typename GridT::ValueType;
  using Tree = typename GridT::TreeType;
  const Tree before(grid.constTree());
  applyGaussian(grid, width);
  Smoothing report;
  report.width = width;
  double squares = 0.0;
  double voxels = 0.0;
  openvdb::tree::ValueAccessor<const Tree, false> now(grid.constTree());
  for (auto leaf = before.cbeginLeaf(); leaf; ++leaf) {
    const auto* after = now.probeConstLeaf(leaf->origin());
    for (auto value = leaf->cbeginValueOn(); value; ++value) {
      const Value moved =
          after != nullptr ? after->getValue(value.pos()) : now.getValue(value.getCoord());
      const double change = std::abs(static_cast<double>(sizeOf(Value(moved - *value))));
      squares += change * change;
      voxels += 1.0;
      report.largest_change = std::max(report.largest_change, change);
    }
  }
  report.rms_change = voxels > 0.0 ? std::sqrt(squares / voxels) : 0.0;
  // Four box filters of 2 width + 1 voxels make a Gaussian of this variance. A wave of length l
  // keeps exp(-2 (pi sigma / l)^2) of its height.
  const double box = 2.0 * width + 1.0;
  const double sigma = std::sqrt(4.0 * (box * box - 1.0) / 12.0);
  report.half_height_voxels = sigma * M_PI * std::sqrt(2.0 / std::log(2.0));
  return report;
}

}  // namespace palpate::detail
