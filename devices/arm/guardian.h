/// A child process that takes the force off a hand when its program cannot: when the program is
/// killed, stopped, hung, or in a debugger. The child has descriptors of its own and checks whether
/// the loops run.
#pragma once

#include <array>
#include <atomic>
#include <csignal>
#include <cstddef>
#include <cstdint>
#include <span>

#include "palpate/engine/loop/haptic_loop.h"

namespace palpate {

/// For each loop that it watches, writes zero force within kGuardTime of the loop's last tick, or
/// at once if the process has died. It tries until the device has taken the zero, and repeats it
/// while the loop stands still. Each device has a watching process of its own, so a device that
/// hangs does not delay another. A loop that has lost its force this way reports Fault::kLate. A
/// loop is cut (Fault::kUnguarded) if its guardian shows no sign of life.
///
/// Make the guardian first of all, before any thread: the child is a copy of the process as it is
/// then. The child is made by fork(), so make a guardian in the main() of a program, not in a
/// library.
class Guardian {
 public:
  static constexpr double kGuardTime = 0.015;   ///< [s]; the force is zero by 20 ms.
  static constexpr std::size_t kMostLoops = 8;  ///< Loops at a time; each has a watching process.

  /// Throws DeviceError if the system cannot start a process.
  Guardian();
  /// Writes zero force and ends the child.
  ~Guardian();
  Guardian(const Guardian&) = delete;
  Guardian& operator=(const Guardian&) = delete;

  /// Starts to watch a loop. Returns the value for LoopParams::watch, so that the loop is watched
  /// from its first tick on. The guardian must outlive the loop, and the descriptor must stay open.
  /// Throws DeviceError for more than kMostLoops, or for a zero force that is empty or too long.
  [[nodiscard]] LoopWatch watch(const ZeroForce& zero);

  /// Replaces the descriptor of a watched loop's device, after another device was chosen or the
  /// same one was plugged in again. Call this before the loop gives force again. Throws
  /// DeviceError as watch().
  void renew(const LoopWatch& loop, const ZeroForce& zero);

  /// Stops watching a loop that has ended; its place is then free.
  void forget(const LoopWatch& loop);

  /// Cuts every loop's force and has zero force written, within 2 ms. From any thread, and from
  /// signal handlers.
  void zero() noexcept;

  /// Makes exit(), SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGTSTP, SIGXCPU and crashes call zero()
  /// first; after any other end the child alone writes zero. If `interrupted` is given, a first
  /// SIGINT, SIGTERM, SIGHUP or SIGQUIT sets it; another one more than 0.5 s later ends the
  /// process. One guardian at a time.
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
  int maker_;  ///< Process id of the guarded process.
  std::array<bool, kMostLoops> used_{};
};

}  // namespace palpate
