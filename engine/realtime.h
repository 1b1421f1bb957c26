/// What a thread asks of the system before it ticks: priority, a core, memory that stays. All are
/// asked for once, reported, never required.
#pragma once

#include <cstdint>
#include <string>

namespace palpate {

/// Highest priority of a loop; a guardian is above every loop.
inline constexpr int kMostPriority = 90;

/// What becomeRealtime asks for. What is refused the thread does without.
struct RealtimeRequest {
  int priority = 80;  ///< Priority of SCHED_FIFO, 1 to kMostPriority; 0: do not ask.
  int core = -1;  ///< Core to stay on; -1, or where a priority is refused, any: one may be free.
  bool lock_memory = true;  ///< Lock all memory of the process, also later; no huge pages then.
  bool awake = true;  ///< Cores do not sleep meanwhile: in a virtual machine a core that does may
                      ///< be woken a millisecond late. Costs power.
};

/// What was granted; for what was not, the reason and the remedy.
struct RealtimeReport {
  bool priority = false;  ///< SCHED_FIFO, at the priority asked for (at most kMostPriority).
  bool core = false;      ///< The thread stays on the core asked for.
  bool memory = false;    ///< The memory of the process is locked (mlockall).
  bool awake = false;     ///< The caller's StayAwake::granted.
  std::string refused;  ///< "priority 80: not permitted: ...", several joined by "; "; else empty.
};

/// Keeps the machine's cores from sleeping as long as it lives, where that is permitted
/// (/dev/cpu_dma_latency).
class StayAwake {
 public:
  /// Asks, if `wanted`, for cores that wake up at once: a latency of 0 us.
  explicit StayAwake(bool wanted) noexcept;
  ~StayAwake();
  StayAwake(const StayAwake&) = delete;
  StayAwake& operator=(const StayAwake&) = delete;
  /// True if it was wanted and permitted; until this is destroyed.
  [[nodiscard]] bool granted() const noexcept { return descriptor_ >= 0; }
  [[nodiscard]] int error() const noexcept { return error_; }  ///< errno, or 0.

 private:
  int descriptor_ = -1;
  int error_ = 0;
};

/// Asks for the calling thread, and for memory on behalf of the process. The caller keeps `awake`;
/// the report repeats whether that was granted. Touches the stack that ticks need.
/// Slow: to be called before the first tick.
[[nodiscard]] RealtimeReport becomeRealtime(const RealtimeRequest& request, const StayAwake& awake);

/// Time of the clock that deadlines are in [ns]; it goes on while the machine is suspended.
/// Signal-safe.
[[nodiscard]] std::int64_t nowNs() noexcept;
/// Sleeps until nowNs() reaches `ns` [ns], whatever signals come. RT: a system call.
void sleepUntil(std::int64_t ns) noexcept;

/// Page faults of the calling thread so far: minor and major. RT: a system call.
[[nodiscard]] std::int64_t pageFaults() noexcept;

}  // namespace palpate
