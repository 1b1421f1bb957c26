/// Optional requests of a thread to the operating system: priority, a core and locked memory.
#pragma once

#include <cstdint>
#include <string>

namespace palpate {

/// Highest priority of a loop. A guardian requests a higher priority.
inline constexpr int kMostPriority = 90;

/// Requests for becomeRealtime(). If the system refuses one, the thread continues without it.
struct RealtimeRequest {
  int priority = 80;  ///< SCHED_FIFO priority, 1 to kMostPriority; 0 if not requested.
  int core = -1;  ///< Core on which to stay; -1 for any core. If a requested priority is refused,
                  ///< the thread uses any core.
  /// True to lock the present and future memory of the process, and to disable its transparent huge
  /// pages.
  bool lock_memory = true;
  bool awake = true;  ///< True to keep all cores awake: costs power, but sleeping cores wake late.
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

/// Keeps the cores from sleeping while the object lives, if permitted (/dev/cpu_dma_latency).
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

/// Makes the requests for the calling thread, and the memory request for the process. Touches the
/// stack that ticks need. The report includes the result of `awake`. Slow: call this function
/// before the first tick.
[[nodiscard]] RealtimeReport becomeRealtime(const RealtimeRequest& request, const StayAwake& awake);

/// Returns the time of the clock of all deadlines [ns]. The clock also runs while the machine is
/// suspended. Signal-safe.
[[nodiscard]] std::int64_t nowNs() noexcept;
/// Sleeps until nowNs() reaches `ns` [ns], even if signals interrupt. RT: a system call.
void sleepUntil(std::int64_t ns) noexcept;

/// Returns the number of the calling thread's page faults so far. RT: a system call.
[[nodiscard]] std::int64_t pageFaults() noexcept;

}  // namespace palpate
