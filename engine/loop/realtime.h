/// Requests of a thread to the operating system before its first tick: priority, a core and locked
/// memory. Each is requested once, and the result is reported. None is required.
#pragma once

#include <cstdint>
#include <string>

namespace palpate {

/// Highest priority of a loop. The priority of a guardian is above that of every loop.
inline constexpr int kMostPriority = 90;

/// Requests for becomeRealtime(). If the system refuses one, the thread continues without it.
struct RealtimeRequest {
  int priority = 80;  ///< SCHED_FIFO priority, 1 to kMostPriority; 0 if not requested.
  int core = -1;  ///< Core on which to stay. -1 means any core. A thread without priority uses any
                  ///< core, because one may be free.
  /// Lock the present and future memory of the process. This prevents huge pages.
  bool lock_memory = true;
  bool awake = true;  ///< Keep the cores awake meanwhile, at the cost of power. In a virtual
                      ///< machine a sleeping core may wake up a millisecond late.
};

/// The requests that were granted, and the reasons and remedies for those that were refused.
struct RealtimeReport {
  /// True if the thread has the requested SCHED_FIFO priority (at most kMostPriority).
  bool priority = false;
  bool core = false;    ///< True if the thread stays on the requested core.
  bool memory = false;  ///< True if the memory of the process is locked (mlockall).
  bool awake = false;   ///< Copy of StayAwake::granted().
  /// Refused requests, such as "priority 80: not permitted: ...", joined by "; ".
  std::string refused;
};

/// Keeps the machine's cores from sleeping while the object lives, if the system permits
/// (/dev/cpu_dma_latency).
class StayAwake {
 public:
  /// If `wanted`, requests a wake-up latency of 0 us from all cores.
  explicit StayAwake(bool wanted) noexcept;
  ~StayAwake();
  StayAwake(const StayAwake&) = delete;
  StayAwake& operator=(const StayAwake&) = delete;
  /// Returns true if the request was made and granted.
  [[nodiscard]] bool granted() const noexcept { return descriptor_ >= 0; }
  /// Returns errno of the request, or 0.
  [[nodiscard]] int error() const noexcept { return error_; }

 private:
  int descriptor_ = -1;
  int error_ = 0;
};

/// Makes the requests for the calling thread, and the memory request for the process. The caller
/// owns `awake`; the report repeats its result. Also touches the stack that ticks need. Slow: call
/// it before the first tick.
[[nodiscard]] RealtimeReport becomeRealtime(const RealtimeRequest& request, const StayAwake& awake);

/// Returns the time of the clock of all deadlines [ns]. The clock continues while the machine is
/// suspended. Signal-safe.
[[nodiscard]] std::int64_t nowNs() noexcept;
/// Sleeps until nowNs() reaches `ns` [ns], even if signals interrupt. RT: a system call.
void sleepUntil(std::int64_t ns) noexcept;

/// Returns the number of page faults of the calling thread so far, minor and major. RT: a system
/// call.
[[nodiscard]] std::int64_t pageFaults() noexcept;

}  // namespace palpate
