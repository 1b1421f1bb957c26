/// Random values at grid points with linear interpolation, for the data of rough volumes.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "palpate/engine/types.h"

namespace palpate::bench {

/// Returns the value at q, whose coordinates are >= 0, in units of the spacing from the first
/// point. `corners` has side^3 values, with the last axis fastest. Beyond the last point, the value
/// is constant.
inline double betweenCorners(const std::vector<double>& corners, std::size_t side, const Vec3& q) {
  const Vec3 low = q.array().floor();
  const double last = static_cast<double>(side) - 1.0;
  double sum = 0.0;
  for (int corner = 0; corner < 8; ++corner) {
    double weight = 1.0;
    std::size_t index = 0;
    for (int a = 0; a < 3; ++a) {
      const bool up = (corner >> a & 1) != 0;
      weight *= up ? q[a] - low[a] : 1.0 - q[a] + low[a];
      index = index * side + static_cast<std::size_t>(std::min(low[a] + (up ? 1.0 : 0.0), last));
    }
    sum += weight * corners[index];
  }
  return sum;
}

}  // namespace palpate::bench
