#include "palpate/engine/link.h"

#include <algorithm>
#include <cmath>

#include "palpate/engine/plain_floats.h"

namespace palpate {
namespace {

constexpr double kFarthest = 1e6;  ///< As of hands [m].
constexpr double kPeriods = 16.0;  ///< So many are in their mean.

bool isPlace(const Vec3& p) noexcept {
  return p.allFinite() && p.cwiseAbs().maxCoeff() < kFarthest;
}

/// Of a spring that pulls with at most `peak` [J].
double energyOf(const LinkParams& params, double length) noexcept {
  const double full = params.peak / params.stiffness;
  const double bent = std::min(length, full);
  return 0.5 * params.stiffness * bent * bent + params.peak * (length - bent);
}

}  // namespace

void Link::forgetOther() noexcept {
  other_ = newest_ = 0;
  given_ = taken_ = 0.0;
}

void Link::hear(const LinkWord& word) noexcept {
  const PlainFloats plain;
  const bool sane = isPlace(word.proxy) && std::isfinite(word.given);
  if (word.from < other_ || word.from == 0 || !sane) return;
  if (word.from > other_) {
    forgetOther();
    other_ = word.from;
  }
  if (word.number > newest_) {
    newest_ = word.number;
    there_ = word.proxy;
    silence_ = 0.0;
  }
  if (word.to == life_ && word.given > taken_) {
    const double room = std::max(0.0, params_.start + held_ - energy_);
    energy_ += std::min(word.given - taken_, room);
    taken_ = word.given;
  }
}

void Link::rest() noexcept {
  known_ = false;
  presence_ = 0.0;
  force_.setZero();
  driven_.setZero();
}

void Link::pulled(double share, const Mat3& drives) noexcept {
  driven_ = drives * force_;
  least_ = std::min(least_, share);
  greatest_ = std::max(greatest_, share);
}

Vec3 Link::pull(const Vec3& proxy, const Vec3& hand, bool fresh, double dt) noexcept {
  const PlainFloats plain;
  if (!isPlace(hand) || !isPlace(proxy) || !(dt > 0.0) || !std::isfinite(dt)) {
    rest();
    return force_;
  }
  span_ += dt;
  silence_ += dt;
  const bool there = other_ != 0 && silence_ < kLinkSilence;
  presence_ = std::clamp(presence_ + (there ? dt : -dt) / kLinkRamp, 0.0, 1.0);
  if (known_ && !fresh) return force_;

  // What has left is counted as what takes most, or brings least.
  const Vec3 way = known_ ? Vec3(hand - last_) : Vec3::Zero();
  const double work = driven_.dot(way);
  energy_ -= (work > 0.0 ? greatest_ : least_) * work;
  // The next one is as long as they are in the mean: after a late tick comes a short one.
  period_ = period_ > 0.0 ? period_ + (span_ - period_) / kPeriods : span_;
  const double speeds = period_ / span_;
  last_ = hand;
  known_ = true;
  span_ = 0.0;
  least_ = 1.0;
  greatest_ = 0.0;
  force_.setZero();
  driven_.setZero();

  const Vec3 offset = there_ - proxy;
  const double length = offset.norm();
  held_ = other_ == 0 ? 0.0 : presence_ * energyOf(params_, length);
  // Each end keeps its half of what the spring holds.
  const double spare = energy_ - params_.start - 0.5 * held_;
  if (other_ != 0 && spare > 0.0) {
    given_ += spare;
    energy_ -= spare;
  }
  if (presence_ == 0.0 || length == 0.0) return force_;
  const double size = presence_ * std::min(params_.stiffness, params_.peak / length);
  const Vec3 wanted = size * offset;
  // The most that it does until the next reading: the hand goes on as it went, but for a turn.
  const double turn = wanted.norm() * kLinkNimble * period_ * period_;
  const double worst = speeds * wanted.dot(way) + turn;
  paid_ = worst > 0.0 ? std::clamp(energy_ / worst, 0.0, 1.0) : 1.0;
  force_ = paid_ * wanted;
  return force_;
}

LinkWord Link::word(const Vec3& proxy) noexcept {
  return {life_, other_, ++told_, proxy, given_};
}

}  // namespace palpate
