/// A child process that takes the force off a hand when its program cannot: killed, stopped, hung,
/// in a debugger. It holds descriptors of its own and looks whether the loops go on.
#pragma once

#include <array>
#include <atomic>
#include <csignal>
#include <cstddef>
#include <cstdint>
#include <span>

#include "palpate/engine/haptic_loop.h"

namespace palpate {

/// Writes zero force within kGuardTime of a loop's last tick, or at once where the process has
/// died, for every loop that it watches, until the device has taken it, and again as long as the
/// loop stands still; one process a device, so that one that hangs holds up no other. A loop whose
/// force was taken off knows it (Fault::kLate), and one whose guardian shows no life is cut
/// (Fault::kUnguarded).
///
/// Make it first of all: the child is a copy of the process as it is then, and before there are
/// threads. Its way is one of fork(), so it is a program's business, not a library's: an embedder
/// makes one in main().
class Guardian {
 public:
  static constexpr double kGuardTime = 0.015;   ///< [s]: zero force by 20 ms
  static constexpr std::size_t kMostLoops = 8;  ///< Watched at a time, each by a process.

  /// Throws DeviceError where the system gives no process.
  Guardian();
  /// Zero force, and the child's end.
  ~Guardian();
  Guardian(const Guardian&) = delete;
  Guardian& operator=(const Guardian&) = delete;

  /// What a loop is to be given (LoopParams::watch) so that it is looked after from its first tick
  /// on. The guardian outlives it, and the descriptor stays open. Throws DeviceError for more than
  /// kMostLoops, or for a zero force that is empty or too long.
  [[nodiscard]] LoopWatch watch(const ZeroForce& zero);

  /// The device of a loop that is watched has another descriptor, being another one or plugged in
  /// anew. Before its force is let out again. Throws DeviceError as watch().
  void renew(const LoopWatch& loop, const ZeroForce& zero);

  /// A loop that has ended; its place is free.
  void forget(const LoopWatch& loop);

  /// Cuts every loop's force and has zero force written, within 2 ms. From any thread, and from
  /// signal handlers.
  void zero() noexcept;

  /// Has signals that end the process call zero() first, and exit() as well. Those that a program
  /// may live through (SIGINT, SIGTERM, SIGHUP, SIGQUIT) set the flag instead of ending it, where
  /// one is given. One guardian at a time.
  void catchSignals(volatile std::sig_atomic_t* interrupted = nullptr);

  /// The child, for tests.
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
  int maker_;  ///< The process that is guarded.
  std::array<bool, kMostLoops> used_{};
};

}  // namespace palpate
