#include "palpate/devices/arm/servo.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

// [Hz]: at a lower rate, a tick would count as late only after 0.3 s (three periods).
constexpr double kSlowest = 10.0;
constexpr double kFastest = 1e5;
constexpr double kStands = 0.01;  // share of a period; shorter time steps count as a stopped clock

double checkedRate(const DeviceInfo& arm, double rate) {
  if (rate >= kSlowest && rate <= kFastest) return rate;
  throw DeviceError(arm.name, std::to_string(rate) + " Hz is outside of 10 to 100000 Hz",
                    "give a rate in this range");
}

}  // namespace

Servo::Servo(DeviceInfo arm, double rate, bool real)
    : arm_(std::move(arm)),
      loop_(arm_, checkedRate(arm_.info(), rate)),
      period_(1.0 / rate),
      real_(real) {}

Vec3 Servo::tick(const HandState& hand, double dt) noexcept {
  const double passed = dt > 0.0 && std::isfinite(dt) ? dt : 0.0;
  now_ += passed;
  stood_ = passed > kStands * period_ ? 0.0 : stood_ + period_;
  still_ = hand.position == arm_.hand.position ? still_ + passed : 0.0;
  arm_.hand = hand;
  if (arm_.info().hand)
    arm_.hand.still = std::max(still_, hand.still);  // std::max returns still_ for NaN
  TickTime time;
  time.now = now_;
  time.dt = dt;
  time.setLate(std::max({0.0, dt - period_, stood_}), period_);
  time.real = real_;
  loop_.tick(time);
  return arm_.force;
}

}  // namespace palpate
