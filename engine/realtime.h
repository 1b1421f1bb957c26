/// What a thread asks of the system before it ticks: priority, a core, memory that stays. Asked for
/// once, reported, never required.
#pragma once

#include <cstdint>
#include <string>

namespace palpate {

/// A guardian is above every loop.
inline constexpr int kMostPriority = 90;

struct RealtimeRequest {
  int priority = 80;        ///< Of SCHED_FIFO, 1 to kMostPriority; 0: do not ask.
  int core = -1;            ///< To stay on; -1: any.
  bool lock_memory = true;  ///< Of the whole process, also what it takes later: no huge pages then.
  bool awake = true;  ///< Cores do not sleep meanwhile: in a virtual machine one that does may
                      ///< be woken a millisecond late. Costs power.
};

/// What was granted; a reason where it was not, with what to do about it.
struct RealtimeReport {
  bool priority = false;
  bool core = false;
  bool memory = false;
  bool awake = false;
  std::string refused;  ///< "priority 80: not permitted: ...", several joined by "; "; or empty.
};

/// Keeps the machine's cores from sleeping as long as it lives, where that is permitted
/// (/dev/cpu_dma_latency).
class StayAwake {
 public:
  explicit StayAwake(bool wanted) noexcept;
  ~StayAwake();
  StayAwake(const StayAwake&) = delete;
  StayAwake& operator=(const StayAwake&) = delete;
  [[nodiscard]] bool granted() const noexcept { return descriptor_ >= 0; }
  [[nodiscard]] int error() const noexcept { return error_; }  ///< errno

 private:
  int descriptor_ = -1;
  int error_ = 0;
};

/// For the calling thread (memory: for the process; `awake`: by a StayAwake that the caller keeps,
/// of which the report is told). Touches the stack that ticks need.
/// Slow: before the first tick.
[[nodiscard]] RealtimeReport becomeRealtime(const RealtimeRequest& request, const StayAwake& awake);

/// Of the clock that deadlines are in; goes on while the machine is suspended [ns].
/// Signal-safe.
[[nodiscard]] std::int64_t nowNs() noexcept;
/// Sleeps until then, whatever signals come [ns]. RT: a system call.
void sleepUntil(std::int64_t ns) noexcept;

/// Page faults of the calling thread so far: minor and major. RT: a system call.
[[nodiscard]] std::int64_t pageFaults() noexcept;

}  // namespace palpate
