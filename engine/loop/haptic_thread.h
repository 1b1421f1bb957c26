/// The haptic loop with its clock: runs the ticks of one hand at their deadlines.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <thread>

#include "palpate/engine/loop/haptic_loop.h"
#include "palpate/engine/loop/realtime.h"

namespace palpate {

inline constexpr double kEarly = 1e-4;  ///< Default of LoopParams::early [s].

/// Parameters of a HapticThread.
struct LoopParams {
  double rate = 1000.0;  ///< Rate of the ticks, 500 to 20,000 [Hz].
  double heartbeat =
      0.0;  ///< Longest permitted pause between beats of the application [s]; 0 for no limit.
  /// The thread wakes this long before a tick's deadline [s], warms up the caches (cache_warmup.h)
  /// and busy-waits. If 0, the thread sleeps until the deadline; the tick then begins later and
  /// with cold caches. The time is at most a quarter of a period. If not set, the time is kEarly if
  /// the priority is granted and kEarly is at most a tenth of a period, else 0. Each tick costs
  /// this time on a core.
  std::optional<double> early;
  RealtimeRequest realtime;          ///< The thread requests these before its first tick.
  LoopWatch watch;                   ///< Words shared with a guardian (devices/arm/guardian.h).
  const PlayClock* clock = nullptr;  ///< See HapticLoop::playBy.
  HandLinks* links = nullptr;        ///< See HapticLoop::linkBy.
  double reengage = 0.0;             ///< See HapticLoop::reengageAfter [s].
};

/// Renders scenes on one device, in its own thread, until destroyed. The simplest use:
///
///     HapticThread hand(device);
///     hand.publish(scene);
///     draw(hand.latest());
///
/// Two hands need two HapticThreads, which may share a scene. Only one thread may call publish(),
/// and only one thread may call latest().
// The loop's mailboxes are on separate cache lines.
class HapticThread {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  /// Starts the thread. The force is zero until a scene is published. The device and the sink must
  /// outlive the HapticThread. Throws DeviceError if `rate`, `early`, `heartbeat` or `reengage` is
  /// out of range, if a limit of the device is not usable (limitsInLoop), or if the system cannot
  /// start a thread.
  explicit HapticThread(Device& device, const LoopParams& params = {}, TickSink* sink = nullptr);
  /// Writes zero force and ends the thread.
  ~HapticThread() { stop(); }
  HapticThread(const HapticThread&) = delete;
  HapticThread& operator=(const HapticThread&) = delete;

  /// Publishes the scene for the next ticks. Throws DeviceError as checkCoupling() does; the
  /// previous scene then stays active.
  void publish(std::shared_ptr<const Scene> scene) {
    checkCoupling(device_.info(), scene.get());
    loop_.publish(std::move(scene));
  }
  /// Returns the newest tick, valid until the next call.
  [[nodiscard]] const Telemetry& latest() noexcept { return loop_.latest(); }

  /// Cuts the force from the next tick on. Safe to call in any thread and in a signal handler.
  void cut() noexcept { loop_.cut(); }
  /// Lets the force return through an engagement, even after a fault.
  void clear() noexcept { loop_.clear(); }
  /// Signals that the application is alive, if LoopParams::heartbeat requires it.
  void beat() noexcept { loop_.beat(); }

  /// Writes zero force and ends the thread. Further calls have no effect.
  void stop() noexcept;
  /// Acts like stop(), but waits at most about `seconds`; 0 only requests the end. Returns false if
  /// the thread has not ended by then. If its device or a mode does not return, it never ends, and
  /// the destructor would wait for it forever.
  [[nodiscard]] bool stopWithin(double seconds) noexcept;
  /// Returns false after the thread has ended: by stop(), or when the device ends (Device::ended).
  [[nodiscard]] bool running() const noexcept { return running_.load(std::memory_order_acquire); }

  /// Returns which requests in LoopParams::realtime the system granted.
  [[nodiscard]] const RealtimeReport& realtime() const noexcept { return realtime_; }
  /// Returns the value of LoopParams::early that is in use [s].
  [[nodiscard]] double early() const noexcept { return early_; }
  /// Returns the thread's page faults since its first tick; updated about every 1,024 ticks.
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
  std::atomic<bool> ready_{false};  ///< True once `realtime_` and `early_` are written.
  std::atomic<bool> quit_{false};
  std::atomic<bool> running_{true};
  std::atomic<std::int64_t> faults_{0};
  std::thread thread_;
};

}  // namespace palpate
