#include "engine/passivity.h"

#include <algorithm>
#include <cmath>

namespace palpate {

/// Follows the force that acts through time: held, late, and behind its order by a first-order lag.
struct Tank::Amplifier {
  Vec3 force;  ///< Now [N].
  double lag;  ///< [s]

  /// A time in which `order` holds.
  void hold(const Vec3& order, double time, Acting& acting) noexcept {
    if (time <= 0.0) return;
    if (lag <= 0.0) {
      force = order;
      acting.sum += time * order;
      acting.square += time * order.squaredNorm();
      return;
    }
    const Vec3 behind = force - order;
    const double left = std::exp(-time / lag);
    acting.sum += time * order + lag * (1.0 - left) * behind;
    acting.square += time * order.squaredNorm() + 2.0 * lag * (1.0 - left) * order.dot(behind) +
                     0.5 * lag * (1.0 - left * left) * behind.squaredNorm();
    force = order + left * behind;
  }
};

void Tank::forget() noexcept {
  sure_ = 0.0;
  counted_ = 0.0;
  known_ = false;
  recovers_ = true;
  since_ = {};
  span_ = 0.0;
  mean_.setZero();
  acting_.setZero();
  count_ = 1;
  sent_[0] = {};
}

void Tank::refill(double energy) noexcept {
  if (!(energy > 0.0) || !std::isfinite(energy)) return;
  sure_ += energy;
  counted_ += energy;
  refilled_ += energy;
}

void Tank::elapse(double dt, const ArmDissipation& arm) noexcept {
  Amplifier amplifier{acting_, arm.lag};
  Acting acting;
  std::size_t first = 0;
  double at = 0.0;
  for (; first + 1 < count_ && sent_[first + 1].from < dt; ++first) {
    const double until = std::max(at, sent_[first + 1].from);
    amplifier.hold(sent_[first].force, until - at, acting);
    at = until;
  }
  amplifier.hold(sent_[first].force, dt - at, acting);
  acting_ = amplifier.force;
  for (std::size_t i = first; i < count_; ++i) {
    sent_[i - first] = {sent_[i].force, sent_[i].from - dt};
  }
  count_ -= first;
  since_.sum += acting.sum;
  since_.square += acting.square;
  span_ += dt;
  // Whatever the hand did in it.
  sure_ -= acting.square / (4.0 * arm.viscous);
}

void Tank::arrive(const Vec3& hand, const ArmDissipation& arm) noexcept {
  if (!(span_ > 0.0)) return;
  // The mean of the force does the work; what it varies about the mean a hand could take out by
  // moving with it, against b.
  const Vec3 mean = since_.sum / span_;
  const double varies = std::max(0.0, since_.square - span_ * mean.squaredNorm());
  const Vec3 moved = hand - last_;
  // Forces are on the hand: work that it does against them is minus their product.
  counted_ -=
      mean.dot(moved) + varies / (4.0 * arm.viscous) + 0.5 * arm.step * (mean - mean_).norm();
  const double surely = std::max(0.0, moved.norm() - arm.step);
  counted_ += arm.viscous / span_ * surely * surely;
  // Coulomb's friction: of a way that is known to D/2 only what drags an anchor on a rope of length
  // D is certain, and of that the cosine of 30 degrees.
  const Vec3 rope = hand - anchor_;
  const double length = rope.norm();
  if (length > arm.step) {
    const double certain = arm.step > 0.0 ? 0.5 * std::sqrt(3.0) : 1.0;
    counted_ += certain * arm.coulomb * (length - arm.step);
    anchor_ += (1.0 - arm.step / length) * rope;
  }
  mean_ = mean;
  last_ = hand;
  since_ = {};
  span_ = 0.0;
}

double Tank::reserve(const Vec3& next, const ArmDissipation& arm) const noexcept {
  Amplifier amplifier{acting_, arm.lag};
  Acting acting;
  const double begins = std::max(arm.delay, count_ > 1 ? sent_[count_ - 1].from : 0.0);
  double at = 0.0;
  for (std::size_t i = 0; i < count_; ++i) {
    const double until = std::max(at, i + 1 < count_ ? sent_[i + 1].from : begins);
    amplifier.hold(sent_[i].force, until - at, acting);
    at = until;
  }
  amplifier.hold(next, arm.period, acting);
  // What the amplifier still gives then dies away.
  const double left = arm.lag > 0.0 ? 0.5 * arm.lag * amplifier.force.squaredNorm() : 0.0;
  return (acting.square + left) / (4.0 * arm.viscous);
}

double Tank::pass(const Vec3& wanted, const Vec3& hand, bool fresh, double dt,
                  const TankParams& params, double cap) noexcept {
  const ArmDissipation& arm = params.arm;
  if (params.use == TankUse::kOff) return 1.0;
  const bool acts = params.use == TankUse::kAct;
  constexpr double kFarthest = 1e6;  // [m]: no hand is there; false for NaN as well
  if (!(hand.cwiseAbs().maxCoeff() < kFarthest) || !(arm.viscous > 0.0) || !(arm.period > 0.0)) {
    forget();
    return acts ? 0.0 : 1.0;
  }
  if (recovers_) {
    constexpr double kDead = 10.0;  // lags after which nothing acts any more
    recovers_ = false;
    blind_ = arm.delay + kDead * arm.lag + arm.period;
  }
  const bool timed = dt > 0.0 && std::isfinite(dt);
  if (timed) elapse(dt, arm);
  if (!known_ || blind_ > 0.0) {
    // Nothing is credited for a time in which something unknown may have acted.
    if (timed) blind_ -= dt;
    known_ = true;
    last_ = anchor_ = hand;
    sure_ = std::min(sure_, 0.0);
    counted_ = sure_;
    since_ = {};
    span_ = 0.0;
    mean_ = acting_;
    if (blind_ > 0.0 && acts) {
      sent_[0] = {};
      count_ = 1;
      sure_ = counted_ = 0.0;
      return 0.0;
    }
  } else if (timed && fresh) {
    arrive(hand, arm);
    counted_ = std::min(counted_, cap);
    sure_ = std::min(cap, std::max(sure_, counted_ - 0.5 * arm.step * mean_.norm()));
  }
  double share = 1.0;
  // Asked this way round a number that is none pays for nothing.
  if (!(reserve(wanted, arm) <= sure_)) {
    // Convex in the share: where zero can be paid for, so can all up to the largest.
    double more = 1.0;
    share = 0.0;
    constexpr int kHalvings = 30;
    for (int i = 0; i < kHalvings; ++i) {
      const double middle = 0.5 * (share + more);
      (reserve(middle * wanted, arm) <= sure_ ? share : more) = middle;
    }
    const double owed = acts && share == 0.0 ? reserve(Vec3::Zero(), arm) - sure_ : 0.0;
    if (owed > 1e-15) {  // rounding is no debt
      debt_ += owed;
      counted_ += owed;
      sure_ += owed;
    }
  }
  Vec3 sent = acts ? Vec3(share * wanted) : wanted;
  if (count_ == kForces) {
    // The newest is forgotten.
    debt_ += reserve(sent, arm);
    --count_;
    if (acts) sent.setZero(), share = 0.0;
  }
  if (arm.delay > 0.0) {
    sent_[count_++] = {sent, arm.delay};
  } else {
    sent_[0] = {sent, 0.0};
    count_ = 1;
  }
  return share;
}

}  // namespace palpate
