/// A child process that sets the force of an arm to zero if the program dies, stops or hangs.
#pragma once

#include <array>
#include <atomic>
#include <csignal>
#include <cstddef>
#include <cstdint>
#include <span>

#include "palpate/engine/loop/haptic_loop.h"

namespace palpate {

/// Writes zero force to a watched loop's device if the loop has not ticked for kGuardTime, or at
/// once if the program has died. Repeats a failed write, and repeats the zero while the loop hangs.
/// Each device has its own watching process, so a device that hangs does not delay another. A loop
/// whose force was zeroed because it did not tick reports Fault::kLate. If the guardian hangs, the
/// loop cuts its force (Fault::kUnguarded).
///
/// The child is a fork() of the process: construct it in main() before any thread is started.
class Guardian {
 public:
  /// Time without a tick after which the guardian writes zero [s]. If the guardian has real-time
  /// priority and the device takes the write at once, the force is zero within 20 ms.
  static constexpr double kGuardTime = 0.015;
  /// Largest number of loops at a time; each has its own watching process.
  static constexpr std::size_t kMostLoops = 8;

  /// Throws DeviceError if the system refuses the shared memory, the sockets or the process.
  Guardian();
  /// Writes zero force and ends the child.
  ~Guardian();
  Guardian(const Guardian&) = delete;
  Guardian& operator=(const Guardian&) = delete;

  /// Starts to watch a loop from its first tick. Returns the value for LoopParams::watch. The
  /// guardian must outlive the loop, and keeps its own copy of the descriptor. Throws DeviceError
  /// for more than kMostLoops loops, for a zero force that is empty or too long, or if the
  /// descriptor cannot be sent to the child, such as after its end.
  [[nodiscard]] LoopWatch watch(const ZeroForce& zero);

  /// Replaces the descriptor and the zero force of a watched loop's device. If the device was
  /// replaced or plugged in again, call this before the loop gives force. Throws DeviceError as
  /// watch() does, or if the guardian does not watch this loop.
  void renew(const LoopWatch& loop, const ZeroForce& zero);

  /// Stops watching a loop that has ended. The guardian can then watch another loop instead. Throws
  /// DeviceError if it does not watch this loop.
  void forget(const LoopWatch& loop);

  /// Cuts every loop's force (Fault::kStopped) and makes the watching processes write zero force,
  /// within 2 ms if they have real-time priority. Callable from any thread and from signal
  /// handlers. In a fork of the program, this does nothing.
  void zero() noexcept;

  /// Makes exit(), SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGTSTP, SIGXCPU and crash signals call zero()
  /// first. If the program ends in another way, such as by SIGKILL, only the child writes zero. The
  /// first SIGINT, SIGTERM, SIGHUP or SIGQUIT sets `interrupted`; another one more than 0.5 s later
  /// ends the process. Without `interrupted`, the first one ends it. Only one guardian at a time
  /// may catch signals.
  void catchSignals(volatile std::sig_atomic_t* interrupted = nullptr);

  /// Returns the child's process id, for tests.
  [[nodiscard]] int child() const noexcept { return child_; }

 private:
  struct Shared;
  [[noreturn]] void guard(int socket) noexcept;
  [[noreturn]] void watchOver(int descriptor, std::size_t slot, const std::byte* bytes,
                              std::size_t size) noexcept;
  void tell(std::size_t slot, const ZeroForce& zero);
  [[nodiscard]] std::size_t slotOf(const LoopWatch& loop) const;

  Shared* shared_ = nullptr;
  int socket_ = -1;
  int child_ = -1;
  int maker_;  ///< Id of the process that constructed the guardian.
  std::array<bool, kMostLoops> used_{};
};

}  // namespace palpate
