/// The haptic loop with its clock: runs the ticks of one hand on time.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <thread>

#include "palpate/engine/loop/haptic_loop.h"
#include "palpate/engine/loop/realtime.h"

namespace palpate {

inline constexpr double kEarly = 1e-4;  ///< Usual LoopParams::early [s].

/// Parameters of a HapticThread: its clock, its watch words and its system requests.
struct LoopParams {
  double rate = 1000.0;    ///< Ticks a second, 500 to 20,000 [Hz].
  double heartbeat = 0.0;  ///< The application's longest pause between beats [s]; 0: not required.
  /// The thread wakes this long before a tick's time [s], warms up the caches (cache_warmup.h) and
  /// waits awake. Otherwise a wake-up comes 25 us late and more, with cold caches. At most a
  /// quarter of a period; 0: the thread sleeps until the tick's time. None: kEarly if priority is
  /// granted and kEarly is at most a tenth of a period, else 0. Each tick costs this time on a
  /// core, and a second tick.
  std::optional<double> early;
  RealtimeRequest realtime;          ///< Requested by the thread itself, before its first tick.
  LoopWatch watch;                   ///< Words shared with a guardian (devices/arm/guardian.h).
  const PlayClock* clock = nullptr;  ///< See HapticLoop::playBy.
  HandLinks* links = nullptr;        ///< See HapticLoop::linkBy.
  double reengage = 0.0;             ///< See HapticLoop::reengageAfter [s].
};

/// Renders scenes on one device, in a thread of its own, until destroyed. The smallest use:
///
///     HapticThread hand(device);
///     hand.publish(scene);
///     draw(hand.latest());
///
/// Two hands need two HapticThreads over one shared scene. Only one thread may call publish, and
/// only one may call latest.
// The loop's mailboxes have cache lines of their own.
class HapticThread {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  /// Starts the thread. The force is zero until there is a scene. The device and the sink must
  /// outlive the HapticThread. Throws DeviceError for a rate out of range, or if the system gives
  /// no thread.
  explicit HapticThread(Device& device, const LoopParams& params = {}, TickSink* sink = nullptr);
  /// Writes zero force and ends the thread.
  ~HapticThread() { stop(); }
  HapticThread(const HapticThread&) = delete;
  HapticThread& operator=(const HapticThread&) = delete;

  /// Publishes the scene of the next ticks.
  void publish(std::shared_ptr<const Scene> scene) noexcept { loop_.publish(std::move(scene)); }
  /// Returns the newest tick, valid until the next call.
  [[nodiscard]] const Telemetry& latest() noexcept { return loop_.latest(); }

  /// Cuts the force with the next tick. Safe in any thread and in a signal handler.
  void cut() noexcept { loop_.cut(); }
  /// Lets force out again through an engagement, also after a fault.
  void clear() noexcept { loop_.clear(); }
  /// Signals that the application is alive, if LoopParams::heartbeat requires it.
  void beat() noexcept { loop_.beat(); }

  /// Writes zero force and ends the thread. Further calls do nothing.
  void stop() noexcept;
  /// Returns false once the thread has ended: by itself, with the device (Device::ended), or by
  /// stop().
  [[nodiscard]] bool running() const noexcept { return running_.load(std::memory_order_acquire); }

  /// Returns the part of LoopParams::realtime that the system granted.
  [[nodiscard]] const RealtimeReport& realtime() const noexcept { return realtime_; }
  /// Returns the value in use of LoopParams::early [s].
  [[nodiscard]] double early() const noexcept { return early_; }
  /// Returns the page faults of the thread since its first tick.
  [[nodiscard]] std::int64_t pageFaultsSinceStart() const noexcept {
    return faults_.load(std::memory_order_relaxed);
  }

 private:
  void run() noexcept;
  void waitFor(std::int64_t due) noexcept;

  Device& device_;
  LoopParams params_;
  HapticLoop loop_;
  RealtimeReport realtime_;
  double early_ = 0.0;
  std::atomic<bool> ready_{false};  ///< `realtime_` and `early_` are written.
  std::atomic<bool> quit_{false};
  std::atomic<bool> running_{true};
  std::atomic<std::int64_t> faults_{0};
  std::thread thread_;
};

}  // namespace palpate
