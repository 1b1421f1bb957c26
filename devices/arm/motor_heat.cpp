#include "palpate/devices/arm/motor_heat.h"

#include <algorithm>
#include <cmath>

#include "palpate/engine/safety/heat.h"

namespace palpate {

void MotorHeat::pass(double dt) noexcept {
  if (!(continuous_ > 0.0) || !(dt > 0.0)) return;
  heat_ += -std::expm1(-dt / heating_) * (told_ * told_ - heat_);
}

double MotorHeat::allows(double peak) const noexcept {
  if (!(continuous_ > 0.0)) return peak;
  const double most = continuous_ * continuous_;
  // Square of the command that heats the winding from `heat_` to `most` within kHold.
  const double held = heat_ + (most - heat_) / -std::expm1(-kHold / heating_);
  return std::min(allowedByHeat(continuous_, peak, heat_), std::sqrt(std::max(held, 0.0)));
}

}  // namespace palpate
