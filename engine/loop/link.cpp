#include "palpate/engine/loop/link.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "palpate/engine/scoped_float_mode.h"

namespace palpate {
namespace {

constexpr double kFarthest = 1e6;  ///< Largest coordinate of a hand [m].
constexpr double kPeriods = 16.0;  ///< Number of periods over which the mean is taken.

bool isPlace(const Vec3& p) noexcept {
  return p.allFinite() && p.cwiseAbs().maxCoeff() < kFarthest;
}

/// Returns the energy of a spring that pulls with at most `peak` [J]. Beyond kLengths times the
/// length at which the spring reaches the peak, the energy is constant.
double energyOf(const LinkParams& params, double length) noexcept {
  constexpr double kLengths = 10.0;
  const double full = params.peak / params.stiffness;
  const double bent = std::min(length, full);
  const double drawn = std::min(length, kLengths * full) - bent;
  return 0.5 * params.stiffness * bent * bent + params.peak * drawn;
}

}  // namespace

void Link::forgetOther() noexcept {
  // Messages to the old life add no energy from now on.
  ++life_;
  begin(0);
}

void Link::begin(std::uint64_t other) noexcept {
  other_ = other;
  newest_ = 0;
  given_ = taken_ = 0.0;
  presence_ = 0.0;
}

void Link::hear(const LinkWord& word) noexcept {
  const ScopedFloatMode plain;
  const bool sane = isPlace(word.proxy) && std::isfinite(word.given);
  if (word.from < other_ || word.from == 0 || !sane) return;
  if (word.from > other_) begin(word.from);
  // When the sender learns the present life of this end, it begins a new sum of energy.
  if (word.to != life_) return;
  if (word.number > newest_) {
    newest_ = word.number;
    there_ = word.proxy;
    silence_ = 0.0;
  }
  if (word.given > taken_) {
    const double room = std::max(0.0, params_.start + held_ - energy_);
    energy_ += std::min(word.given - taken_, room);
    taken_ = word.given;
  }
}

void Link::count(const Vec3& hand) noexcept {
  const double work = force_.dot(hand - last_);
  energy_ -= work > 0.0 ? work : least_ * work;
  if (energy_ < lowest_) {
    trust_ *= 0.5;
    lowest_ = energy_;
  }
  if (energy_ >= 0.0) {
    trust_ = 1.0;
    lowest_ = 0.0;
  }
}

void Link::change(const Vec3& to) noexcept {
  energy_ -= 0.5 * params_.step * (to - sent_).norm();
  sent_ = to;
}

void Link::rest(const Vec3& hand) noexcept {
  const ScopedFloatMode plain;
  change(Vec3::Zero());
  if (known_) {
    least_ = 0.0;
    if (isPlace(hand)) {
      count(hand);
    } else {
      energy_ -= reserved_;
    }
  }
  known_ = false;
  span_ = before_ = mean_ = presence_ = reserved_ = 0.0;
  force_.setZero();
}

void Link::pulled(double share) noexcept {
  const double left = std::max(0.0, share);
  least_ = std::min(least_, left);
  // The sent force is an unknown part of force_. The change to this part and the change from it
  // cost at most D/2 |force_| each.
  if (share < 0.0) energy_ -= params_.step * force_.norm();
  change(left * force_);
}

Vec3 Link::pull(const Vec3& proxy, const HandState& hand, double part, double dt) noexcept {
  const ScopedFloatMode plain;
  if (!isPlace(hand.position) || !isPlace(proxy) || !(dt > 0.0) || !std::isfinite(dt)) {
    rest(hand.position);
    return force_;
  }
  span_ += dt;
  silence_ += dt;
  const bool there = newest_ != 0 && silence_ < kLinkSilence;
  presence_ = std::clamp(presence_ + (there ? dt : -dt) / kLinkRamp, 0.0, 1.0);
  const bool fresh = readings_.look(hand);
  if (known_ && !fresh) return force_;

  const bool first = !std::exchange(known_, true);
  const Vec3 way = first ? Vec3::Zero() : Vec3(hand.position - last_);
  count(hand.position);
  last_ = hand.position;
  // The next period is expected to be the mean period; if both of the last two periods are longer,
  // the shorter one. A single long period is often followed by a short one.
  mean_ = mean_ > 0.0 ? mean_ + (span_ - mean_) / kPeriods : span_;
  const double period = std::max(mean_, std::min(span_, before_));
  before_ = span_;
  const double speeds = period / span_;
  const double rise = span_ / kLinkRise;
  span_ = reserved_ = 0.0;
  least_ = 1.0;
  force_.setZero();

  const Vec3 offset = there_ - proxy;
  const double length = offset.norm();
  held_ = newest_ == 0 ? 0.0 : part * presence_ * energyOf(params_, length);
  // This end gives its spare energy to the other end. This end keeps `start`, half of the spring's
  // energy, and the energy that the resolution of the readings may hide.
  const double hidden = 0.5 * params_.step * sent_.norm();
  const double spare = energy_ - params_.start - 0.5 * held_ - hidden;
  if (other_ != 0 && spare > 0.0) {
    given_ += spare;
    energy_ -= spare;
  }
  // After a single reading, the speed of the hand is unknown.
  if (first || presence_ == 0.0 || length == 0.0) return force_;
  const double size = part * presence_ * std::min(params_.stiffness, params_.peak / length);
  const Vec3 wanted = hand.drives * (size * offset);
  // The largest work until the next reading, at an acceleration of at most kLinkNimble.
  const double turn = wanted.norm() * kLinkNimble * period * period;
  const double worst = speeds * wanted.dot(way) + turn;
  double pays = worst > 0.0 ? 0.0 : trust_;  // share of the force that a tank in debt allows
  constexpr double kRounding = 1e-13;        // [J]: a smaller debt is rounding
  if (energy_ >= -kRounding) {
    // A share s costs s worst + D/2 (|s wanted - sent| + |s wanted|). This cost is convex in s. So
    // the straight line between its values at s = 0, `hidden`, and at s = 1 is an upper bound.
    const double changes = 0.5 * params_.step * ((wanted - sent_).norm() + wanted.norm());
    const double more = std::max(0.0, worst) + changes - hidden;
    pays = more > 0.0 ? std::clamp((energy_ - hidden) / more, 0.0, 1.0) : 1.0;
  }
  paid_ = std::min(pays, paid_ + rise);
  force_ = paid_ * wanted;
  reserved_ = std::max(0.0, paid_ * worst);
  return force_;
}

LinkWord Link::word(const Vec3& proxy) noexcept {
  return {life_, other_, ++told_, proxy, given_};
}

}  // namespace palpate
