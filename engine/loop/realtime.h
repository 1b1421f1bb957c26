/// Requests of a thread to the system before it ticks: priority, a core, memory that stays. Each is
/// requested once and reported, and is never required.
#pragma once

#include <cstdint>
#include <string>

namespace palpate {

/// Highest priority of a loop; a guardian is above every loop.
inline constexpr int kMostPriority = 90;

/// Requests of becomeRealtime. The thread does without those that are refused.
struct RealtimeRequest {
  int priority = 80;  ///< Priority of SCHED_FIFO, 1 to kMostPriority; 0: no request.
  int core = -1;      ///< Core to stay on; -1, or a refused priority: any core, because one may be
                      ///< free.
  bool lock_memory = true;  ///< Lock all memory of the process, also later; then no huge pages.
  bool awake = true;  ///< Keep the cores awake meanwhile: in a virtual machine a sleeping core may
                      ///< wake a millisecond late. Costs power.
};

/// The granted requests; for those refused, the reason and the remedy.
struct RealtimeReport {
  bool priority = false;  ///< SCHED_FIFO, at the priority asked for (at most kMostPriority).
  bool core = false;      ///< The thread stays on the core asked for.
  bool memory = false;    ///< The memory of the process is locked (mlockall).
  bool awake = false;     ///< The caller's StayAwake::granted.
  std::string refused;  ///< "priority 80: not permitted: ...", several joined by "; "; else empty.
};

/// Keeps the machine's cores from sleeping during its lifetime, if that is permitted
/// (/dev/cpu_dma_latency).
class StayAwake {
 public:
  /// If `wanted`, requests cores that wake up at once: a latency of 0 us.
  explicit StayAwake(bool wanted) noexcept;
  ~StayAwake();
  StayAwake(const StayAwake&) = delete;
  StayAwake& operator=(const StayAwake&) = delete;
  /// Returns true if that was wanted and permitted; valid until destruction.
  [[nodiscard]] bool granted() const noexcept { return descriptor_ >= 0; }
  [[nodiscard]] int error() const noexcept { return error_; }  ///< errno, or 0.

 private:
  int descriptor_ = -1;
  int error_ = 0;
};

/// Makes the requests for the calling thread, and for memory on behalf of the process. The caller
/// keeps `awake`; the report repeats whether that was granted. Touches the stack that ticks need.
/// Slow: call it before the first tick.
[[nodiscard]] RealtimeReport becomeRealtime(const RealtimeRequest& request, const StayAwake& awake);

/// Returns the time of the clock that deadlines are in [ns]; it continues while the machine is
/// suspended. Signal-safe.
[[nodiscard]] std::int64_t nowNs() noexcept;
/// Sleeps until nowNs() reaches `ns` [ns], even if signals come. RT: a system call.
void sleepUntil(std::int64_t ns) noexcept;

/// Returns the page faults of the calling thread so far: minor and major. RT: a system call.
[[nodiscard]] std::int64_t pageFaults() noexcept;

}  // namespace palpate
