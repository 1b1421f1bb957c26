#include "palpate/scenes/apps/cli/bare_loop.h"

#include <algorithm>
#include <cstdint>

#include "palpate/engine/loop/realtime.h"
#include "palpate/engine/safety/safety.h"

namespace palpate::cli {

BareLoop::BareLoop(double seconds, int priority)
    : thread_([this, seconds, priority] { run(seconds, priority); }) {}

BareLoop::~BareLoop() {
  quit_ = true;
  if (thread_.joinable()) thread_.join();
}

std::optional<BareLoop::Seen> BareLoop::take() {
  if (!done_.load(std::memory_order_acquire) || !thread_.joinable()) return std::nullopt;
  thread_.join();
  return seen_;
}

void BareLoop::run(double seconds, int priority) noexcept {
  RealtimeRequest request;
  request.priority = priority;
  request.lock_memory = false;
  (void)becomeRealtime(request, StayAwake(false));
  constexpr std::int64_t kPeriod = 1000000;  // [ns]
  std::int64_t due = nowNs();
  const std::int64_t end = due + static_cast<std::int64_t>(1e9 * seconds);
  while (due < end && !quit_) {
    due += kPeriod;
    sleepUntil(due);
    const double late = 1e-9 * static_cast<double>(nowNs() - due);
    // Such a delay does not count: the program was stopped or the machine slept.
    if (late > Reengagement::kPause) {
      due = nowNs();
      continue;
    }
    seen_.worst = std::max(seen_.worst, late);
    if (late > WatchLimits{}.late) ++seen_.late;
    due = std::max(due, nowNs() - kPeriod);
  }
  done_.store(true, std::memory_order_release);
}

}  // namespace palpate::cli
