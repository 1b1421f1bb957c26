#include "palpate/engine/safety/limit_force.h"

#include <algorithm>
#include <cmath>

#include "palpate/engine/safety/heat.h"

namespace palpate {

namespace {

/// Returns |v|, finite if possible. stableNorm costs more, so only extreme values use it.
double lengthOf(const Vec3& v) noexcept {
  const double square = v.squaredNorm();
  const bool plain = (square > 1e-200 && square < 1e200) || v.isZero(0.0);
  return plain ? std::sqrt(square) : v.stableNorm();
}

/// Advances an engagement by a time [s] and returns the share of the force that it allows.
double engaged(double asked, double time, LimiterState& state) noexcept {
  if (state.waiting) {
    state.waited += time;
    state.waiting = !(asked < kEngageBelow) && state.waited < kEngageWait;
    if (state.waiting) return 0.0;
  }
  if (state.share < 1.0) {
    state.share = state.ramp > 0.0 ? std::min(1.0, state.share + time / state.ramp) : 1.0;
  }
  return state.share;
}

double passTank(const Vec3& force, const Vec3& hand, bool fresh, double dt,
                const ForceLimits& limits, Tank& tank) noexcept {
  const double most = limits.peak * limits.peak / (2.0 * limits.tank.soft);
  return tank.pass(force, hand, fresh, dt, limits.tank, most);
}

}  // namespace

LimitedForce limitForce(const Vec3& wanted, const Vec3& hand, double dt, const ForceLimits& limits,
                        LimiterState& state, bool fresh) noexcept {
  LimitedForce out;
  const Vec3 previous = state.sent;
  const double time = dt > 0.0 && std::isfinite(dt) ? dt : 0.0;
  if (limits.heating > 0.0) {
    // The force that was sent was at most the peak, even if the remembered force is not.
    const double sent =
        previous.allFinite() ? std::min(lengthOf(previous), std::max(limits.peak, 0.0)) : 0.0;
    state.heat += (1.0 - std::exp(-time / limits.heating)) * (sent * sent - state.heat);
  }
  state.sent.setZero();

  // A force that is not finite becomes zero.
  const double asked = lengthOf(wanted);
  if (!wanted.allFinite() || !std::isfinite(asked)) {
    out.finite = false;
    (void)passTank(Vec3::Zero(), hand, fresh, dt, limits, state.tank);
    return out;
  }
  // A peak that is not positive and finite allows no force. A slew that is not positive allows no
  // growth. The limit is lower by 1e-12 of the peak, so that rounding cannot raise the result above
  // the peak.
  const double peak =
      limits.peak > 0.0 && std::isfinite(limits.peak) ? limits.peak * (1.0 - 1e-12) : 0.0;
  double growth = limits.slew > 0.0 ? limits.slew * time : 0.0;
  if (state.gentle > 0.0) {
    growth = std::min(growth, peak / kEngageEdit * time);
    state.gentle -= time;
  }

  Vec3 force = wanted;
  const double most = allowedByHeat(limits.continuous, peak, state.heat);
  out.peaked = asked > peak;
  out.heated = asked > most && most < peak;
  if (asked > most) force *= most / asked;

  const double share = engaged(asked, time, state);
  out.ramped = share < 1.0 && asked > 0.0;
  force *= share;

  // The slew limit keeps the part of the last force that is still wanted, and limits the rest.
  Vec3 kept = Vec3::Zero();
  const double last = previous.allFinite() ? lengthOf(previous) : 0.0;
  if (last > 0.0 && std::isfinite(last)) {
    const Vec3 direction = previous / last;
    kept = std::clamp(force.dot(direction), 0.0, last) * direction;
  }
  const Vec3 added = force - kept;
  const double grown = added.norm();
  out.slewed = grown > growth;
  out.force = out.slewed ? Vec3(kept + (growth / grown) * added) : force;

  out.share = passTank(out.force, hand, fresh, dt, limits, state.tank);
  out.drained = limits.tank.use == TankUse::kAct && out.share < 1.0;
  if (out.drained) out.force *= out.share;
  state.sent = out.force;
  return out;
}

}  // namespace palpate
