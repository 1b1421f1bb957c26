#include "palpate/engine/safety/heat.h"

#include <algorithm>
#include <cmath>

namespace palpate {

double allowedByHeat(double continuous, double peak, double heat) noexcept {
  if (!(continuous > 0.0) || continuous >= peak) return peak;
  const double most = continuous * continuous;
  const double left = std::clamp((most - heat) / ((1.0 - kWarm) * most), 0.0, 1.0);
  return std::sqrt(most + left * (peak * peak - most));
}

}  // namespace palpate
