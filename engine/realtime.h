/// What a thread asks of the system before it ticks: priority, a core, memory that stays. Asked for
/// once, reported, never required.
#pragma once

#include <cstdint>
#include <string>

namespace palpate {

struct RealtimeRequest {
  int priority = 80;        ///< Of SCHED_FIFO, 1 to 99; 0: do not ask.
  int core = -1;            ///< To stay on; -1: any.
  bool lock_memory = true;  ///< Of the whole process, also what it takes later.
};

/// What was granted; a reason where it was not, with what to do about it.
struct RealtimeReport {
  bool priority = false;
  bool core = false;
  bool memory = false;
  std::string refused;  ///< "priority 80: not permitted: ...", several joined by "; "; or empty.
};

/// For the calling thread (memory: for the process). Touches the stack that ticks need.
/// Slow: before the first tick.
[[nodiscard]] RealtimeReport becomeRealtime(const RealtimeRequest& request);

/// Page faults of the calling thread so far: minor and major. RT: a system call.
[[nodiscard]] std::int64_t pageFaults() noexcept;

}  // namespace palpate
