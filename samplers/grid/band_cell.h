/// Private to samplers: cells at the edge of a level set's band that hold the surface.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace palpate::detail {

/// Returns true if the values at a cell's eight corners describe the surface of a level set, also
/// if some corners are inactive.
///
/// Along an edge, a distance changes by at most the edge's length, also if it is clipped at the
/// band's width. A valid level set has that width as background, at least one voxel. So in a cell
/// with the surface, values change by at most the background along each edge. A corner without data
/// has the value of the background, so its difference to a negative neighbour exceeds the
/// background.
///
/// kSlack allows for rounding and for inexact distances. It admits a corner without data only
/// beside a neighbour within kSlack times the background of the surface. The surface moves by less
/// than kSlack times the band's width: 0.15 voxel for the usual band of three voxels.
///
/// @param at  Values of the corners; the last index varies fastest.
/// @param background  Background of the grid, in the unit of the values.
template <class Number>
[[nodiscard]] bool holdsSurface(const std::array<Number, 8>& at, double background) noexcept {
  constexpr double kSlack = 0.05;
  const auto [least, most] = std::minmax_element(at.begin(), at.end());
  if (!(*least <= Number(0) && *most >= Number(0) && *least < *most)) return false;
  double steepest = 0.0;
  for (std::size_t n = 0; n < 8; ++n) {
    for (const std::size_t axis : {1U, 2U, 4U}) {
      if ((n & axis) != 0) continue;
      steepest = std::max(steepest,
                          std::abs(static_cast<double>(at[n | axis]) - static_cast<double>(at[n])));
    }
  }
  return steepest <= (1.0 + kSlack) * std::abs(background);
}

}  // namespace palpate::detail
