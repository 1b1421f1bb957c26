/// A child process that takes the force off a hand when its program cannot: killed, stopped, hung,
/// in a debugger. It holds descriptors of its own and looks whether the loops go on.
#pragma once

#include <array>
#include <atomic>
#include <csignal>
#include <cstddef>
#include <cstdint>
#include <span>

#include "engine/haptic_loop.h"

namespace palpate {

/// Writes zero force within kGuardTime of a loop's last tick, or at once where the process has
/// died, for every loop that it watches. A loop whose guardian shows no life itself is cut
/// (Fault::kUnguarded). Make it first of all: the child is a copy of the process
/// as it is then, and before there are threads. Its way is one of fork(), so it is a program's
/// business, not a library's: an embedder makes one in main().
class Guardian {
 public:
  static constexpr double kGuardTime = 0.015;  ///< [s]: zero force by 20 ms
  static constexpr std::size_t kMostLoops = 8;

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

  /// Cuts every loop's force and writes zero force. From any thread, and from signal handlers.
  void zero() noexcept;

  /// Has signals that end the process call zero() first, and exit() as well. Those that a program
  /// may live through (SIGINT, SIGTERM, SIGHUP, SIGQUIT) set the flag instead of ending it, where
  /// one is given. One guardian at a time.
  void catchSignals(volatile std::sig_atomic_t* interrupted = nullptr);

  /// The child, for tests.
  [[nodiscard]] int child() const noexcept { return child_; }

 private:
  struct Shared;
  struct Watched {
    int descriptor = -1;
    std::size_t size = 0;
    std::array<std::byte, ZeroForce::kMostBytes> bytes;
  };
  [[noreturn]] void guard(int socket) noexcept;
  void tell(std::size_t slot, const ZeroForce& zero);

  Shared* shared_ = nullptr;
  int socket_ = -1;
  int child_ = -1;
  int maker_;  ///< The process that is guarded.
  std::array<Watched, kMostLoops> watched_;
  std::atomic<std::size_t> count_{0};
};

}  // namespace palpate
