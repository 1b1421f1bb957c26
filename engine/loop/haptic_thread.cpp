#include "palpate/engine/loop/haptic_thread.h"

#include <algorithm>
#include <cmath>
#include <csignal>
#include <string>
#include <system_error>

#include "palpate/engine/error.h"

namespace palpate {

namespace {

constexpr double kSlowest = 500.0;
constexpr double kFastest = 20000.0;

double checked(const LoopParams& params) {
  const double rate = params.rate;
  if (!(rate >= kSlowest && rate <= kFastest)) {
    throw DeviceError("rate", std::to_string(rate) + " Hz is out of range", "give 500 to 20000 Hz");
  }
  if (params.early && !(*params.early >= 0.0 && *params.early <= 0.25 / rate)) {
    throw DeviceError("early", std::to_string(*params.early) + " s is out of range",
                      "give 0 s to a quarter of the period, " + std::to_string(0.25 / rate) + " s");
  }
  return rate;
}

}  // namespace

HapticThread::HapticThread(Device& device, const LoopParams& params, TickSink* sink)
    : device_(device),
      params_(params),
      loop_(device, checked(params), sink, params.heartbeat, params.watch) {
  loop_.playBy(params.clock);
  loop_.linkBy(params.links);
  loop_.reengageAfter(params.reengage);
  try {
    thread_ = std::thread([this] { run(); });
  } catch (const std::system_error& e) {
    throw DeviceError("loop", std::string("its thread cannot start (") + e.what() + ")",
                      "end other programs, or raise the limit of processes (ulimit -u)");
  }
  ready_.wait(false, std::memory_order_acquire);
}

void HapticThread::stop() noexcept {
  quit_.store(true, std::memory_order_relaxed);
  if (thread_.joinable()) thread_.join();
}

bool HapticThread::stopWithin(double seconds) noexcept {
  quit_.store(true, std::memory_order_relaxed);
  // Counts waits instead of time, because a time in which the whole process is stopped must not
  // count.
  constexpr std::int64_t kLook = 1'000'000;  // [ns]
  for (auto looks = std::llround(1e9 * seconds / kLook); running() && looks > 0; --looks) {
    sleepUntil(nowNs() + kLook);
  }
  if (running()) return false;
  stop();
  return true;
}

void HapticThread::waitFor(std::int64_t due) noexcept {
  if (!(early_ > 0.0)) return sleepUntil(due);
  const auto lead = static_cast<std::int64_t>(std::llround(1e9 * early_));
  sleepUntil(due - lead);
  // If the thread wakes up too late for a warm-up, it skips the warm-up.
  if (due - nowNs() > lead / 2) (void)loop_.warmUp(1.0 / params_.rate, early_);
  while (nowNs() < due) continue;
}

void HapticThread::run() noexcept {
  // Blocks all signals except those of errors in this thread.
  sigset_t others;
  sigfillset(&others);
  for (const int own : {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT}) sigdelset(&others, own);
  pthread_sigmask(SIG_BLOCK, &others, nullptr);
  const StayAwake awake(params_.realtime.awake);
  realtime_ = becomeRealtime(params_.realtime, awake);
  early_ =
      params_.early.value_or(realtime_.priority && kEarly * params_.rate <= 0.1 ? kEarly : 0.0);
  if (early_ > 0.0) loop_.prepareWarmup();
  ready_.store(true, std::memory_order_release);
  ready_.notify_one();

  // Deadlines are whole periods after the start, so that errors do not add up.
  const double period = 1e9 / params_.rate;
  const std::int64_t begin = nowNs();
  const std::int64_t faults_before = pageFaults();
  std::int64_t count = 0;                                             // number of the next deadline
  std::int64_t last = -1;                                             // deadline of the last tick
  std::int64_t last_now = begin - static_cast<std::int64_t>(period);  // start of the last tick
  while (!quit_.load(std::memory_order_relaxed) && !device_.ended()) {
    const auto due =
        begin + static_cast<std::int64_t>(std::llround(static_cast<double>(count) * period));
    waitFor(due);
    const std::int64_t now = nowNs();
    TickTime time;
    time.real = true;
    time.now = 1e-9 * static_cast<double>(now - begin);
    time.dt = 1e-9 * static_cast<double>(now - last_now);
    time.wake_ns = now - due;
    // The delay counts from the deadline that follows the deadline of the last tick, but at least a
    // period after the last tick began.
    const double asked =
        std::max(static_cast<double>(due) - static_cast<double>(count - last - 1) * period,
                 static_cast<double>(last_now) + period);
    time.setLate(1e-9 * std::max(0.0, static_cast<double>(now) - asked), 1.0 / params_.rate);
    last = count;
    last_now = now;
    loop_.tick(time);

    const auto passed = static_cast<std::int64_t>(static_cast<double>(nowNs() - begin) / period);
    count = std::max(count, passed) + 1;
    if ((count & 1023) == 0) {
      faults_.store(pageFaults() - faults_before, std::memory_order_relaxed);
    }
  }
  loop_.end();
  faults_.store(pageFaults() - faults_before, std::memory_order_relaxed);
  running_.store(false, std::memory_order_release);
}

}  // namespace palpate
