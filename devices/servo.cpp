#include "palpate/devices/servo.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

double checkedRate(const DeviceInfo& arm, double rate) {
  if (rate > 0.0 && std::isfinite(rate)) return rate;
  throw DeviceError(arm.name, "the servo's rate is " + std::to_string(rate), "give Hz");
}

}  // namespace

Servo::Servo(DeviceInfo arm, double rate)
    : arm_(std::move(arm)), loop_(arm_, checkedRate(arm_.info(), rate)), period_(1.0 / rate) {}

Vec3 Servo::tick(const HandState& hand, double dt) noexcept {
  arm_.hand = hand;
  TickTime time;
  if (dt > 0.0 && std::isfinite(dt)) now_ += dt;  // else the clock would never tell again
  time.now = now_;
  time.dt = dt;
  time.late = std::max(0.0, dt - period_);
  time.missed = time.late >= period_;
  time.real = true;
  loop_.tick(time);
  return arm_.force;
}

}  // namespace palpate
