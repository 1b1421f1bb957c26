#include "palpate/engine/balance/coupling.h"

#include <algorithm>
#include <cmath>

namespace palpate {

double LengthRate::next(double length, double dt) noexcept {
  if (!(dt > 0.0)) return 0.0;
  if (count_ == 0) {
    last_ = then_ = 0;
    now_ = 0.0;
  } else {
    last_ = after(last_);
    now_ += dt;
    if (count_ >= kMost && then_ == last_) then_ = after(then_);
  }
  readings_[last_] = {length, now_};
  count_ = std::min(count_ + 1, kMost);
  if (count_ == 1) return 0.0;
  const auto off = [&](std::size_t i) { return std::abs(now_ - readings_[i].time - time_); };
  while (after(then_) != last_ && off(after(then_)) <= off(then_)) then_ = after(then_);
  const Reading& then = readings_[then_];
  return (length - then.length) / (now_ - then.time);
}

Vec3 couplingForce(const CouplingParams& params, const Vec3& offset, double length_rate) noexcept {
  Vec3 spring = params.stiffness * offset;
  const double length = offset.norm();
  if (!(params.damping > 0.0) || !(length > 0.0)) return spring;
  const double share = params.damping * length_rate / (params.stiffness * length);
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
  // If the stretch of the spring is within rounding, a change of its stiffness needs no energy.
  constexpr double kRounding = 1e-16;  // [J]
  if (change * per_stiffness > next.tank + kRounding) change = next.tank / per_stiffness;
  next.value += change;
  next.tank = std::clamp(next.tank - change * per_stiffness, 0.0, kStiffnessTank);
  return next;
}

}  // namespace palpate
