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
  energy_ = 0.0;
  known_ = false;
  mean_.setZero();
  acting_.setZero();
  count_ = 1;
  sent_[0] = {};
}

void Tank::account(const Vec3& hand, double dt, const ArmDissipation& arm) noexcept {
  // The force of the interval, whose mean does the work; what it varies about the mean a hand could
  // take out by moving with it, against b.
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

  const Vec3 mean = acting.sum / dt;
  const double varies = std::max(0.0, acting.square - dt * mean.squaredNorm());
  const Vec3 moved = hand - last_;
  // Forces are on the hand: work that it does against them is minus their product.
  energy_ -=
      mean.dot(moved) + varies / (4.0 * arm.viscous) + 0.5 * arm.step * (mean - mean_).norm();
  const double surely = std::max(0.0, moved.norm() - arm.step);
  energy_ += arm.viscous / dt * surely * surely;
  // Coulomb's friction: of a way that is known to D/2 only what drags an anchor on a rope of length
  // D is certain, and of that the cosine of 30 degrees.
  const Vec3 rope = hand - anchor_;
  const double length = rope.norm();
  if (length > arm.step) {
    const double certain = arm.step > 0.0 ? 0.5 * std::sqrt(3.0) : 1.0;
    energy_ += certain * arm.coulomb * (length - arm.step);
    anchor_ += (1.0 - arm.step / length) * rope;
  }
  mean_ = mean;
  last_ = hand;
}

double Tank::reserve(const Vec3& next, const ArmDissipation& arm) const noexcept {
  Amplifier amplifier{acting_, arm.lag};
  double square = 0.0;     // integral of the force's square
  double sum = 0.0;        // of the means of intervals,
  double variation = 0.0;  // and how much those change
  Vec3 mean = mean_;
  const auto over = [&](const Acting& interval) {
    const Vec3 now = interval.sum / arm.period;
    square += interval.square;
    sum += now.norm();
    variation += (now - mean).norm();
    mean = now;
  };
  // Interval by interval, until `next` has had its time.
  const double begins = std::max(arm.delay, count_ > 1 ? sent_[count_ - 1].from : 0.0);
  const double ends = begins + arm.period;
  double at = 0.0;
  for (std::size_t i = 0; at < ends;) {
    Acting interval;
    const double until = at + arm.period;
    while (at < until) {
      // The order that holds now, and until when.
      while (i + 1 < count_ && sent_[i + 1].from <= at) ++i;
      const bool pending = i + 1 < count_;
      const double change = at < begins ? (pending ? sent_[i + 1].from : begins)
                            : at < ends ? ends
                                        : until;
      const Vec3 order = at < begins ? sent_[i].force : at < ends ? next : Vec3(Vec3::Zero());
      const double stop = std::min(change, until);
      amplifier.hold(order, stop - at, interval);
      at = stop;
    }
    over(interval);
  }
  // What the amplifier still gives then dies away.
  if (arm.lag > 0.0) {
    const double left = amplifier.force.norm();
    const double share = arm.lag / arm.period;
    const Vec3 first = share * (1.0 - std::exp(-1.0 / share)) * amplifier.force;
    square += 0.5 * arm.lag * left * left;
    sum += share * left;
    variation += (first - mean).norm();
    mean = first;
  }
  variation += mean.norm();
  return square / (4.0 * arm.viscous) + arm.step * (sum + 0.5 * variation);
}

double Tank::pass(const Vec3& wanted, const Vec3& hand, double dt, const TankParams& params,
                  double cap) noexcept {
  const ArmDissipation& arm = params.arm;
  if (params.use == TankUse::kOff) return 1.0;
  const bool acts = params.use == TankUse::kAct;
  if (!hand.allFinite() || !(arm.viscous > 0.0) || !(arm.period > 0.0)) {
    forget();
    return acts ? 0.0 : 1.0;
  }
  if (!known_) {
    known_ = true;
    last_ = anchor_ = hand;
  } else if (dt > 0.0 && std::isfinite(dt)) {
    account(hand, dt, arm);
    energy_ = std::min(energy_, cap);
  }
  double share = 1.0;
  if (reserve(wanted, arm) > energy_) {
    // Convex in the share: where zero can be paid for, so can all up to the largest.
    double more = 1.0;
    share = 0.0;
    constexpr int kHalvings = 30;
    for (int i = 0; i < kHalvings; ++i) {
      const double middle = 0.5 * (share + more);
      (reserve(middle * wanted, arm) > energy_ ? more : share) = middle;
    }
    const double least = acts && share == 0.0 ? reserve(Vec3::Zero(), arm) : 0.0;
    // Rounding is no debt.
    if (least > energy_ + 1e-15) {
      debt_ += least - energy_;
      energy_ = least;
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
