/// How late the machine itself is.
#pragma once

#include <atomic>
#include <optional>
#include <thread>

namespace palpate::cli {

/// A real-time thread of 1 kHz that does nothing, for a while. What it is late by is the machine's
/// own lateness, and that of other programs.
class BareLoop {
 public:
  /// What it has seen.
  struct Seen {
    double worst = 0.0;  ///< The largest delay [s].
    int late = 0;        ///< Delays of more than WatchLimits::late.
  };

  /// Begins. `priority`: below that of the loops beside it. Throws std::system_error where the
  /// system gives no thread.
  BareLoop(double seconds, int priority);
  ~BareLoop();
  BareLoop(const BareLoop&) = delete;
  BareLoop& operator=(const BareLoop&) = delete;

  /// Once, when it has come to its end; before and after that nothing.
  [[nodiscard]] std::optional<Seen> take();

 private:
  void run(double seconds, int priority) noexcept;

  Seen seen_;
  std::atomic<bool> quit_{false};
  std::atomic<bool> done_{false};
  std::thread thread_;
};

}  // namespace palpate::cli
