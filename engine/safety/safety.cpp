#include "palpate/engine/safety/safety.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

namespace palpate {

namespace {

struct FaultWords {
  const char* word;
  const char* words;
  const char* remedy;
};

constexpr std::array<FaultWords, kFaults> kFaultWords{{
    {"none", "", ""},
    {"not-finite", "a position, sample or force was not finite, or a position was out of range",
     "repair the device or the volume"},
    {"late", "the loop was late", "give the loop a core, real-time priority or a lower rate"},
    {"stale", "the device's reports are too old", "check its cable, or the program that shares it"},
    {"jump", "the position jumped: an encoder may have lost counts", "home the device"},
    {"over-speed", "the device stayed above its speed limit although the loop braked it",
     "hold it; if it accelerates by itself, correct the signs of its motors"},
    {"write", "the device did not take a force in time",
     "check its cable, or its plug-in if it has one"},
    {"gone", "the device is unplugged, or its plug-in no longer answers",
     "plug it in again, or check its plug-in"},
    {"miscounted", "the device was not read for so long that its counters may have wrapped around",
     "wait until palpate has homed the arm; if it cannot, start the program again"},
    {"temperature", "the device is too hot", "let it cool"},
    {"power", "the device's motors have no power or are switched off", "switch them on"},
    {"switch", "the device's safety switch is open", "close the switch"},
    {"heartbeat", "the application has sent no heartbeat in time", "find out why it hangs"},
    {"unguarded", "the guardian process does not respond", "start the program again"},
    {"stopped", "the force was switched off", "switch it on again when the hand is ready"},
    {"volume", "the source of a volume is no longer available",
     "restore its folder, or check the network"},
}};

const FaultWords& wordsOf(Fault fault) noexcept {
  return kFaultWords[std::min(static_cast<std::size_t>(fault), kFaults - 1)];
}

}  // namespace

const char* wordsFor(Fault fault) noexcept {
  return wordsOf(fault).words;
}
const char* remedyFor(Fault fault) noexcept {
  return wordsOf(fault).remedy;
}
const char* wordFor(Fault fault) noexcept {
  return wordsOf(fault).word;
}

Fault HandWatch::look(HandState& hand, double now) noexcept {
  if (hand.fault != Fault::kNone) return hand.fault;
  if (!hand.position.allFinite() || !std::isfinite(hand.age)) return Fault::kNotFinite;
  if (hand.age > limits_.stale) return Fault::kStale;
  const double measured = now - std::max(0.0, hand.age);
  if (!known_) {
    known_ = true;
    time_ = measured;
    position_ = hand.position;
    velocity_.setZero();
  }

  const double since = measured - time_;
  const Vec3 step = hand.position - position_;
  if (step.norm() > std::max(kLeastJump, kJumpSpeed * since)) return Fault::kJump;
  constexpr double kNew = 1e-5;  // [s]: a shorter interval does not change the velocity
  if (since >= kNew) {
    velocity_ += (1.0 - std::exp(-since / kSmooth)) * (step / since - velocity_);
    time_ = measured;
    position_ = hand.position;
  }
  hand.velocity = velocity_;
  hand.max_speed = limits_.max_speed;
  hand.too_fast = velocity_.norm() > limits_.max_speed;
  if (!hand.too_fast) {
    fast_since_ = -1.0;
  } else if (fast_since_ < 0.0) {
    fast_since_ = now;
  } else if (now - fast_since_ > kBraked) {
    return Fault::kOverSpeed;
  }
  return Fault::kNone;
}

double StillFade::pass(double force, double still, double friction, double dt) noexcept {
  const double step = dt > 0.0 ? dt / kFade : 0.0;
  const bool fades = still > kStill && force > friction;
  left_ = std::clamp(left_ + (fades ? -step : step), 0.0, 1.0);
  return left_;
}

bool Reengagement::look(Fault latched, Fault wrong, double now) noexcept {
  // `wrong` is the fault of the last tick, so a pause before this tick needs its own check.
  const bool paused = now - std::exchange(last_, now) > kPause;
  others_ = paused || (others_ && latched != Fault::kNone);
  if (latched == Fault::kNone || wrong != Fault::kNone) good_since_ = now;
  const auto late = [](Fault f) { return f == Fault::kLate || f == Fault::kNone; };
  others_ = others_ || !late(latched) || !late(wrong);
  if (!(after_ > 0.0) || others_ || now - good_since_ < after_) return false;
  if (now - returned_[next_] < kWithin) return false;
  returned_[next_] = now;
  next_ = (next_ + 1) % kMost;
  return true;
}

bool NewReadings::look(const HandState& hand) noexcept {
  const bool again = known_ && hand.position == position_ && hand.age > age_;
  known_ = true;
  position_ = hand.position;
  age_ = hand.age;
  return !again;
}

Vec3 DataFade::pass(const Vec3& wanted, double step, const Vec3& eased, double dt) noexcept {
  if (known_ && (wanted - wanted_).squaredNorm() > step * step) left_ = kEnd;
  left_ = dt > 0.0 ? left_ - dt : 0.0;
  wanted_ = wanted;
  known_ = true;
  if (left_ > 0.0) {
    const Vec3 held = out_ - wanted;
    const double most = held.norm();
    const double share = std::exp(-dt * kEnd / (kBegin * left_));
    const double follows = most > 0.0 ? std::max(0.0, eased.dot(held)) / most : 0.0;
    const double keeps = std::min(share * most, most - follows);
    out_ = keeps > 0.0 ? Vec3(wanted + (keeps / most) * held) : wanted;
  } else {
    out_ = wanted;
  }
  return out_;
}

Vec3 brake(const Vec3& force, const Vec3& velocity, double max_speed) noexcept {
  const double speed = velocity.norm();
  if (!(speed > max_speed) || !std::isfinite(speed)) return force;
  const Vec3 ahead = velocity / speed;
  const double drives = std::max(0.0, force.dot(ahead));
  return force - (drives + kBrake * (speed - max_speed)) * ahead;
}

}  // namespace palpate
