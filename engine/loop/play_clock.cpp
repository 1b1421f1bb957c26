#include "palpate/engine/loop/play_clock.h"

#include <cmath>

namespace palpate {

void PlayClock::steer(const PlayParams& params) noexcept {
  setSpeed(params.speed);
  pause(params.paused);
  from_.store(params.from, std::memory_order_relaxed);
  to_.store(params.to, std::memory_order_relaxed);
  repeat(params.repeat);
  begin_.store(params.begin, std::memory_order_relaxed);
}

PlayParams PlayClock::params() const noexcept {
  return {speed_.load(std::memory_order_relaxed),  paused_.load(std::memory_order_relaxed),
          from_.load(std::memory_order_relaxed),   to_.load(std::memory_order_relaxed),
          repeat_.load(std::memory_order_relaxed), begin_.load(std::memory_order_relaxed)};
}

void PlayClock::setSpeed(double speed) noexcept {
  if (std::isfinite(speed)) speed_.store(speed, std::memory_order_relaxed);
}

void PlayClock::seek(double time) noexcept {
  if (!std::isfinite(time)) return;
  sought_.store(time, std::memory_order_relaxed);
  seeks_.fetch_add(1, std::memory_order_release);
}

void PlayClock::nudge(double by) noexcept {
  if (!std::isfinite(by)) return;
  double all = nudged_.load(std::memory_order_relaxed);
  while (std::isfinite(all + by) &&
         !nudged_.compare_exchange_weak(all, all + by, std::memory_order_relaxed)) {
  }
}

double PlayClock::position() const noexcept {
  return reached_.load(std::memory_order_relaxed) + nudged_.load(std::memory_order_relaxed);
}

namespace {

double within(double time, const PlayParams& ends) noexcept {
  return time > ends.to ? ends.to : time < ends.from ? ends.from : time;
}

}  // namespace

double PlayClock::next(PlayHead& head, double dt) const noexcept {
  const PlayParams now = params();
  const double nudged = nudged_.load(std::memory_order_relaxed);
  const std::uint32_t seeks = seeks_.load(std::memory_order_acquire);
  const bool goes = head.begun && dt > 0.0 && std::isfinite(dt) && !now.paused;
  if (!head.begun) head = {now.begin, 0.0, 0.0, 0, true};
  // If the ends have moved, play may be beyond an end. Play then jumps to that end.
  if (!now.repeat) head.time = within(head.time, now);
  double next = goes ? head.time + now.speed * dt : head.time;
  if (!now.repeat) next = within(next, now);
  head.rate = goes ? (next - head.time) / dt : 0.0;
  head.time = next + nudged - head.nudged;
  head.nudged = nudged;
  if (seeks != head.seeks) {
    head.time = sought_.load(std::memory_order_relaxed);
    head.seeks = seeks;
  }
  if (!(head.time >= now.from && head.time <= now.to)) {
    const double length = now.to - now.from;
    if (now.repeat && length > 0.0 && std::isfinite(length)) {
      const double over = std::fmod(head.time - now.from, length);
      head.time = now.from + (over < 0.0 ? over + length : over);
    } else {
      head.time = within(head.time, now);
    }
  }
  if (!std::isfinite(head.time)) head.time = std::isfinite(now.begin) ? now.begin : 0.0;
  if (!std::isfinite(head.rate)) head.rate = 0.0;
  reached_.store(head.time - head.nudged, std::memory_order_relaxed);
  return head.time;
}

}  // namespace palpate
