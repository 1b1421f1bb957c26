/// Measures the lateness of the machine itself.
#pragma once

#include <atomic>
#include <optional>
#include <thread>

namespace palpate::cli {

/// A real-time thread of 1 kHz without work, for a limited time. Its delays come from the machine
/// and from other programs.
class BareLoop {
 public:
  /// Result of the measurement.
  struct Seen {
    double worst = 0.0;  ///< The largest delay [s].
    int late = 0;        ///< Delays of more than WatchLimits::late.
  };

  /// Starts the thread. `priority` has to be below that of the loops. Throws std::system_error if
  /// the system gives no thread.
  BareLoop(double seconds, int priority);
  ~BareLoop();
  BareLoop(const BareLoop&) = delete;
  BareLoop& operator=(const BareLoop&) = delete;

  /// Returns the result once, after the thread has ended; otherwise unset.
  [[nodiscard]] std::optional<Seen> take();

 private:
  void run(double seconds, int priority) noexcept;

  Seen seen_;
  std::atomic<bool> quit_{false};
  std::atomic<bool> done_{false};
  std::thread thread_;
};

}  // namespace palpate::cli
