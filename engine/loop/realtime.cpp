#include "palpate/engine/loop/realtime.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstddef>
#include <cstring>
#include <ctime>
#include <fcntl.h>
#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <unistd.h>

namespace palpate {

namespace {

constexpr std::int64_t kSecond = 1000000000;  // [ns]
// This clock runs while the machine is suspended, so the first tick afterwards counts as late.
constexpr clockid_t kSystemClock = CLOCK_BOOTTIME;

/// Touches more stack than a tick uses, so that ticks cause no page faults.
[[gnu::noinline]] void touchStack() noexcept {
  std::array<std::byte, std::size_t{256} * 1024> stack;
  volatile std::byte* at = stack.data();
  constexpr std::size_t kPage = 4096;
  for (std::size_t i = 0; i < stack.size(); i += kPage) at[i] = std::byte{1};
}

void refuse(RealtimeReport& report, const std::string& what, int error, const char* remedy) {
  if (!report.refused.empty()) report.refused += "; ";
  std::array<char, 128> text{};
  report.refused += what + ": " + strerror_r(error, text.data(), text.size()) + ": " + remedy;
}

}  // namespace

StayAwake::StayAwake(bool wanted) noexcept {
  if (!wanted) return;
  descriptor_ = open("/dev/cpu_dma_latency", O_WRONLY | O_CLOEXEC);
  const std::int32_t latency = 0;  // [us]
  if (descriptor_ >= 0 && write(descriptor_, &latency, sizeof(latency)) == sizeof(latency)) return;
  error_ = errno;
  if (descriptor_ >= 0) close(descriptor_);
  descriptor_ = -1;
}

StayAwake::~StayAwake() {
  if (descriptor_ >= 0) close(descriptor_);
}

RealtimeReport becomeRealtime(const RealtimeRequest& request, const StayAwake& awake) {
  RealtimeReport report;
  report.awake = awake.granted();
  if (request.awake && !awake.granted()) {
    refuse(report, "cores that stay awake", awake.error(),
           awake.error() == ENOENT
               ? "pass /dev/cpu_dma_latency to the container, or use a kernel that has it"
               : "join the group realtime of the package palpate and log in again, or give your "
                 "group write access to /dev/cpu_dma_latency");
  }
  if (request.lock_memory) {
    report.memory = mlockall(MCL_CURRENT | MCL_FUTURE) == 0;
    if (!report.memory) {
      refuse(report, "locked memory", errno,
             "join the group realtime of the package palpate, or raise memlock in "
             "/etc/security/limits.d, then log in again");
    }
    // The kernel may still merge locked pages into a huge page, which can delay a thread by a tick.
    (void)prctl(PR_SET_THP_DISABLE, 1, 0, 0, 0);
  }
  if (request.priority > 0) {
    sched_param wanted{};
    wanted.sched_priority = std::min(request.priority, kMostPriority);
    const int error = pthread_setschedparam(pthread_self(), SCHED_FIFO, &wanted);
    report.priority = error == 0;
    if (error != 0) {
      refuse(report, "priority " + std::to_string(wanted.sched_priority), error,
             "join the group realtime of the package palpate, or raise rtprio in "
             "/etc/security/limits.d, then log in again");
    }
  }
  if (request.core >= 0 && (report.priority || request.priority <= 0)) {
    cpu_set_t cores;
    CPU_ZERO(&cores);
    CPU_SET(static_cast<std::size_t>(request.core), &cores);
    const int error = pthread_setaffinity_np(pthread_self(), sizeof(cores), &cores);
    report.core = error == 0;
    if (error != 0) {
      refuse(report, "core " + std::to_string(request.core), error,
             "choose a core that this process may use: taskset -cp $$ lists them");
    }
  }
  touchStack();
  return report;
}

std::int64_t nowNs() noexcept {
  timespec t{};
  clock_gettime(kSystemClock, &t);
  return t.tv_sec * kSecond + t.tv_nsec;
}

void sleepUntil(std::int64_t ns) noexcept {
  const timespec t{static_cast<time_t>(ns / kSecond), static_cast<long>(ns % kSecond)};
  while (clock_nanosleep(kSystemClock, TIMER_ABSTIME, &t, nullptr) == EINTR) {
  }
}

std::int64_t pageFaults() noexcept {
  rusage usage{};
  getrusage(RUSAGE_THREAD, &usage);
  return usage.ru_minflt + usage.ru_majflt;
}

}  // namespace palpate
