#include "engine/coupling.h"

#include <algorithm>
#include <cmath>

namespace palpate {

Vec3 couplingForce(const CouplingParams& params, const Vec3& offset,
                   const Vec3& offset_rate) noexcept {
  Vec3 spring = params.stiffness * offset;
  const double length = offset.norm();
  if (!(params.damping > 0.0) || !(length > 0.0)) return spring;
  const double damper = params.damping * offset_rate.dot(offset) / length;
  const double share = damper / (params.stiffness * length);
  spring *= 1.0 + std::clamp(std::isnan(share) ? 0.0 : share, -1.0, 1.0);
  return spring;
}

VaryingStiffness nextStiffness(const VaryingStiffness& last, double wanted, const Vec3& offset,
                               double dissipated, double dt) noexcept {
  VaryingStiffness next = last;
  next.tank = std::min(kStiffnessTank, last.tank + std::max(0.0, dissipated));
  if (!(wanted > 0.0) || !std::isfinite(wanted) || !(dt > 0.0)) return next;
  const double most = kStiffnessRate * dt;
  const double per_stiffness = 0.5 * offset.squaredNorm();  // d energy / d k
  double change = std::clamp(wanted - last.value, -most, most);
  // A spring that only rounding stretches costs nothing.
  constexpr double kRounding = 1e-16;  // [J]
  if (change * per_stiffness > next.tank + kRounding) change = next.tank / per_stiffness;
  next.value += change;
  next.tank = std::clamp(next.tank - change * per_stiffness, 0.0, kStiffnessTank);
  return next;
}

}  // namespace palpate
