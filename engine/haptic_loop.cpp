#include "engine/haptic_loop.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <string>
#include <utility>

#include "engine/error.h"

namespace palpate {

namespace {

constexpr double kWriteTime = 0.020;  ///< [s]: a write that takes longer is blocked.

/// At a hand a force comes in gently, whatever the device's maker says.
ForceLimits gently(ForceLimits limits, bool hand) noexcept {
  if (hand && !(limits.engage >= kEngage)) limits.engage = kEngage;
  return limits;
}

const DeviceInfo& checked(const DeviceInfo& info) {
  const WatchLimits& watch = info.watch;
  for (const double limit : {watch.stale, watch.max_speed, watch.late}) {
    if (limit > 0.0 && std::isfinite(limit)) continue;
    throw DeviceError(info.name, "a limit of its hand is " + std::to_string(limit),
                      "give positive numbers for stale, max_speed and late");
  }
  return info;
}

}  // namespace

HapticLoop::HapticLoop(Device& device, double rate, TickSink* sink, double heartbeat,
                       const LoopWatch& watch)
    : device_(device),
      sink_(sink),
      late_(std::max(checked(device.info()).watch.late, 3.0 / rate)),
      heartbeat_(heartbeat),
      watch_by_(watch),
      watch_(device.info().watch),
      state_(gently(device.info().limits, device.info().hand)) {}

void HapticLoop::publish(std::shared_ptr<const Scene> scene) noexcept {
  scenes_.draft() = std::move(scene);
  scenes_.publish();
  // What comes back was never taken, or is done with.
  scenes_.draft().reset();
}

bool HapticLoop::stopped() const noexcept {
  return stop_.load(std::memory_order_relaxed) ||
         (watch_by_.stops != nullptr &&
          watch_by_.stops->load(std::memory_order_relaxed) != stops_seen_);
}

Fault HapticLoop::whatIsWrong(HandState& hand, const TickTime& time) noexcept {
  if (stopped()) return Fault::kStopped;
  if (heartbeat_ > 0.0 &&
      beat_.still(beats_.load(std::memory_order_relaxed), time.now) > heartbeat_) {
    return Fault::kHeartbeat;
  }
  if (watch_by_.guard != nullptr &&
      guard_.still(watch_by_.guard->load(std::memory_order_relaxed), time.now) > kUnguardedTime) {
    return Fault::kUnguarded;
  }
  if (time.late > late_) return Fault::kLate;
  // A recorded path may do what no hand can, and hurts none; an arm that is being homed jumps.
  if (device_.info().hand && hand.ready) return watch_.look(hand, time.now);
  watch_.forget();
  return hand.fault;
}

void HapticLoop::tick(const TickTime& time) noexcept {
  scenes_.refresh();
  const Scene* scene = scenes_.current().get();
  if (clear_.exchange(false, std::memory_order_acquire)) {
    if (watch_by_.stops != nullptr) stops_seen_ = watch_by_.stops->load(std::memory_order_relaxed);
    watch_.forget();
    beat_.since = guard_.since = time.now;
    state_.clearFault();
  }

  HandState hand = device_.read();
  const Fault wrong = whatIsWrong(hand, time);
  if (wrong != Fault::kNone) state_.cut(wrong);
  if (hand.ready && !ready_) state_.engage();
  ready_ = hand.ready;

  const auto start = std::chrono::steady_clock::now();
  told_.report = {};
  if (scene != nullptr) {
    told_.report = hapticStep(*scene, reader_, hand, state_, time.dt);
  } else {
    state_.release();
  }
  const auto end = std::chrono::steady_clock::now();
  // A tick that hung, in a user's mode or a stopped process, is not answered with what was right
  // before: others have taken the force off meanwhile.
  const double took = std::chrono::duration<double>(end - start).count();
  const bool hung = time.real && took > late_;
  if (device_.info().hand && (hung || stopped())) {
    state_.cut(hung ? Fault::kLate : Fault::kStopped);
    state_.release();
    told_.report.force.setZero();
    told_.report.status = StepStatus::kFault;
  }
  send(told_.report.force, time.real);

  ++told_.tick;
  told_.time = time.now;
  told_.probe = hand.position;
  told_.tick_ns = std::chrono::nanoseconds(end - start).count();
  told_.wake_ns = time.wake_ns;
  told_.missed = time.missed;
  told_.late_ticks += time.missed ? 1 : 0;
  told_.fault = state_.fault();
  told_.scene = scene == nullptr ? 0 : scene->id;
  telemetry_.draft() = told_;
  telemetry_.publish();
  if (sink_ != nullptr) sink_->take(told_, state_);
}

/// Nothing comes between the gate and here; where there is no scene there is no force.
void HapticLoop::send(const Vec3& force, bool timed) noexcept {
  // A device that takes no writes is left to the guardian, which has another way to it.
  const Fault fault = state_.fault();
  const bool deaf = fault == Fault::kWrite || fault == Fault::kGone;
  if (watch_by_.heart != nullptr && !deaf) {
    watch_by_.heart->fetch_add(1, std::memory_order_release);
  }
  const auto start = std::chrono::steady_clock::now();
  device_.write(force);
  const std::chrono::duration<double> took = std::chrono::steady_clock::now() - start;
  if (timed && device_.info().hand && took.count() > kWriteTime) state_.cut(Fault::kWrite);
}

void HapticLoop::end() noexcept {
  device_.write(Vec3::Zero());
}

}  // namespace palpate
