#include "palpate/engine/tick/step.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>

#include "palpate/engine/scoped_float_mode.h"
#include "palpate/engine/tick/move_proxy.h"

namespace palpate {
namespace {

/// Returns true if p [m] is a possible position of a hand; false for NaN.
bool isHand(const Vec3& p) noexcept {
  constexpr double kFarthest = 1e6;
  return p.cwiseAbs().maxCoeff() < kFarthest && p.allFinite();
}

/// Brakes a hand that is too fast, only along the directions in which the motors can push.
Vec3 braked(const Vec3& force, const HandState& hand) noexcept {
  const Vec3 along = hand.drives * hand.velocity;
  if (!hand.too_fast || !hand.ready || !(along.norm() > 0.0)) return force;
  const double share = hand.velocity.norm() / along.norm();
  return brake(force, share * along, hand.max_speed);
}

}  // namespace

void ProxyState::meet(const Scene& scene, const Vec3& hand) noexcept {
  const bool swapped = met_.id != scene.id;
  if (swapped) {
    const bool edit = met_.shape == scene.shape;
    met_ = {scene.id, scene.shape, 0.0};
    // If only the numbers of a scene have changed, the force grows gently instead of an engagement.
    if (edit && gate_.limits.engage > 0.0) {
      gate_.limiter.gentle = kEngageEdit;
    } else {
      engage();
    }
  }
  if (swapped || !proxy_.placed || proxy_.lost) {
    proxy_.lost = proxy_.known = false;
    around_.bodies.place(scene.graph, met_.time, proxy_.placed ? proxy_.position : hand);
    const auto& modes = scene.graph.modes;
    std::transform(modes.begin(), modes.end(), around_.memories.begin(), memoryFor);
    around_.near.forget();
    balance_.warm.forget();
    balance_.friction.forget();
    // A constant stiffness takes effect at once. A varying stiffness continues from the old value.
    const bool varies = !scene.graph.stiffness.factors.empty();
    if (!varies || !proxy_.placed) stiffness_ = {scene.coupling.stiffness, 0.0};
  }
  if (!proxy_.placed) {
    proxy_.placed = true;
    proxy_.position = hand;
    proxy_.offset.setZero();
    proxy_.beyond.setZero();
    length_rate_.forget();
  }
}

StepReport hapticStep(const Scene& scene, Reader& reader, const HandState& hand, ProxyState& state,
                      double dt, StepTrace* trace) noexcept {
  const ScopedFloatMode plain;
  StepReport report;
  if (trace != nullptr) trace->count = 0;
  if (dt > 0.0 && std::isfinite(dt)) state.met_.time += dt;
  bool good = isHand(hand.position) && !state.faulted();
  if (good) {
    state.meet(scene, hand.position);
    Proxy& proxy = state.proxy_;
    const double k = report.stiffness = state.balance_.stiffness = state.stiffness_.value;
    const Vec3 last = proxy.offset;
    const Vec3 before = proxy.position - hand.position;

    // Steps 1 and 2: reads and balances until the proxy has arrived.
    state.around_.graphs[0] = {reader.bind(scene), &state.around_.properties,
                               state.around_.memories.data()};
    state.around_.count = 1;
    const BoundGraph& bound = state.around_.graphs[0].bound;
    const bool changed =
        bound.attend({proxy.position, hand.position, dt, state.play_, state.play_rate_},
                     state.around_.bodies.items());
    Tick tick{scene, reader, proxy, state.around_, state.balance_, report, trace, hand.position};
    tick.changed = changed;
    good = moveProxy(tick, state.met_.time);
    bound.leave();

    // Step 3, eq. (3). Counts the energy that the proxy's motion adds to the spring [J]. The sum
    // over several moves may be less than for the tick as a whole: docs/tick.md, Energy.
    const Vec3& offset = proxy.offset;
    const double rate = state.length_rate_.next(offset.norm(), dt);
    const double at_once = k * (offset.dot(offset - before) - 0.5 * (offset - last).squaredNorm());
    report.injected = std::max(report.injected, at_once);
    if (good) {
      const Vec3 spring = couplingForce({k, scene.coupling.damping}, offset, rate);
      assert(report.primitives > 0 || spring.isZero(0.0));  // without primitives the force is zero
      // DataFade smooths only changes of the force above `own`. The hand's motion and the slew
      // limit can explain smaller changes.
      const Vec3 eased = k * (last - before);
      const double own = state.gate_.limits.slew * dt + 2.0 * eased.norm();
      constexpr double kAll = std::numeric_limits<double>::infinity();
      const Vec3 driven = hand.drives * spring;
      report.wanted = state.gate_.data.pass(driven, changed ? own : kAll, eased, dt) +
                      hand.drives * state.pull_;
      const Transfer& stiffness = scene.graph.stiffness;
      if (!stiffness.factors.empty()) {
        state.stiffness_ =
            nextStiffness(state.stiffness_, stiffness.anywhere(state.around_.properties), offset,
                          k * offset.dot(before - offset), dt);
      }
    }
  }
  report.proxy = state.proxy_.position;
  state.limitOutput(hand, good, dt, report);
  return report;
}

void ProxyState::limitOutput(const HandState& hand, bool good, double dt,
                             StepReport& report) noexcept {
  LimiterState& limiter = gate_.limiter;
  const Vec3 asked = report.wanted;
  if (!good) {
    report.wanted.setConstant(std::numeric_limits<double>::quiet_NaN());
  } else {
    if (!hand.ready) report.wanted.setZero();
    report.moving = gate_.still.pass(limiter.letsOut(report.wanted.norm(), gate_.limits.peak),
                                     hand.still, gate_.limits.friction, dt);
    report.wanted = braked(report.moving * report.wanted, hand);
  }
  if (dt > 0.0 && report.injected > 0.0) {
    limiter.tank.refill(std::min(report.injected, gate_.limits.tank.refill * dt));
  }
  // The tank cannot count energy from an invalid position, or before the arm is homed.
  if (!good || !hand.ready) limiter.tank.forget();
  report.fresh = gate_.readings.look(hand);
  // limitForce is the last gate: later code does not change the force.
  const LimitedForce out =
      limitForce(report.wanted, hand.position, dt, gate_.limits, limiter, report.fresh);
  if (!out.finite) {
    cut(Fault::kNotFinite);
    report.status = StepStatus::kFault;
    report.wanted.setZero();
  }
  report.limited = out.limited();
  report.force = out.force;
  report.share = out.share;
  // If the slew limit or a brake has changed the direction of the force, the share is unknown.
  const double along = out.force.dot(asked);
  constexpr double kAlong = 1.0 - 1e-6;
  if (along > kAlong * out.force.norm() * asked.norm()) {
    report.left = std::min(1.0, along / asked.squaredNorm());
  }
  report.energy = limiter.tank.energy();
}

}  // namespace palpate
