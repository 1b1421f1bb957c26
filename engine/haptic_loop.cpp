#include "engine/haptic_loop.h"

#include <algorithm>
#include <chrono>
#include <utility>

namespace palpate {

namespace {

/// At a hand a force comes in gently, whatever the device's maker says.
ForceLimits gently(ForceLimits limits, bool hand) noexcept {
  if (hand) limits.engage = std::max(limits.engage, kEngage);
  return limits;
}

}  // namespace

HapticLoop::HapticLoop(Device& device, double rate, TickSink* sink, double heartbeat,
                       const LoopWatch& watch)
    : device_(device),
      sink_(sink),
      rate_(rate),
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

Fault HapticLoop::whatIsWrong(HandState& hand, const TickTime& time) noexcept {
  if (stop_.load(std::memory_order_relaxed)) return Fault::kStopped;
  if (watch_by_.stop != nullptr && watch_by_.stop->load(std::memory_order_relaxed)) {
    return Fault::kStopped;
  }
  if (heartbeat_ > 0.0) {
    const std::uint32_t beats = beats_.load(std::memory_order_relaxed);
    if (beats != beat_) {
      beat_ = beats;
      beat_at_ = time.now;
    }
    if (time.now - beat_at_ > heartbeat_) return Fault::kHeartbeat;
  }
  if (time.late > std::max(device_.info().watch.late, 3.0 / rate_)) return Fault::kLate;
  // A recorded path may do what no hand can, and hurts none.
  return device_.info().hand ? watch_.look(hand, time.now) : hand.fault;
}

void HapticLoop::tick(const TickTime& time) noexcept {
  scenes_.refresh();
  const Scene* scene = scenes_.current().get();
  if (clear_.exchange(false, std::memory_order_relaxed)) {
    watch_.forget();
    beat_at_ = time.now;
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
  // Nothing comes between the gate and the device; where there is no scene there is no force.
  device_.write(told_.report.force);

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
  if (watch_by_.heart != nullptr) watch_by_.heart->fetch_add(1, std::memory_order_relaxed);
  if (sink_ != nullptr) sink_->take(told_, state_);
}

void HapticLoop::end() noexcept {
  device_.write(Vec3::Zero());
}

}  // namespace palpate
