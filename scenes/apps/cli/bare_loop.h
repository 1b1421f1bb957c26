/// Measures how late the operating system wakes an idle real-time thread.
#pragma once

#include <atomic>
#include <optional>
#include <thread>

namespace palpate::cli {

/// A real-time thread that wakes 1000 times a second and does no work. So its delays are caused by
/// the operating system and other programs.
class BareLoop {
 public:
  struct Seen {
    double worst = 0.0;  ///< Longest delay of a wake-up [s].
    int late = 0;        ///< Number of delays longer than WatchLimits::late.
  };

  /// Measures for `seconds` [s] in a new thread. `priority` must be below that of the haptic loops.
  /// Throws std::system_error if the system cannot create a thread.
  BareLoop(double seconds, int priority);
  ~BareLoop();
  BareLoop(const BareLoop&) = delete;
  BareLoop& operator=(const BareLoop&) = delete;

  /// Returns the result at the first call after the thread has ended, otherwise no value.
  [[nodiscard]] std::optional<Seen> take();

 private:
  void run(double seconds, int priority) noexcept;

  Seen seen_;
  std::atomic<bool> quit_{false};
  std::atomic<bool> done_{false};
  std::thread thread_;
};

}  // namespace palpate::cli
