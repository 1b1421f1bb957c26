/// The loop with a clock: one hand, on time.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <thread>

#include "palpate/engine/haptic_loop.h"
#include "palpate/engine/realtime.h"

namespace palpate {

inline constexpr double kEarly = 1e-4;  ///< Usual LoopParams::early [s].

/// What a HapticThread runs by: its clock, what it watches, what it asks of the system.
struct LoopParams {
  double rate = 1000.0;    ///< Ticks a second, 500 to 20,000 [Hz].
  double heartbeat = 0.0;  ///< The application's longest pause between beats [s]; 0: none asked.
  /// The thread wakes so long before a tick's time [s], rehearses it (rehearsal.h), and waits
  /// awake: a wake-up comes 25 us late and more, and then the caches are cold. 0: it sleeps until
  /// then; at most a quarter of a period. None: kEarly where priority is granted and that is no
  /// more than a tenth of a period, else 0. Costs so much of a core, and at each tick a second one.
  std::optional<double> early;
  RealtimeRequest realtime;          ///< Asked for by the thread itself, before its first tick.
  LoopWatch watch;                   ///< Words shared with a guardian (devices/guardian.h).
  const PlayClock* clock = nullptr;  ///< As HapticLoop::playBy.
  HandLinks* links = nullptr;        ///< As HapticLoop::linkBy.
  double reengage = 0.0;             ///< As HapticLoop::reengageAfter [s].
};

/// Renders scenes on one device, in a thread of its own, until destroyed. The smallest use:
///
///     HapticThread hand(device);
///     hand.publish(scene);
///     draw(hand.latest());
///
/// Two hands need two of these, over one shared scene. publish and latest are for one thread each.
// The loop's mailboxes have cache lines of their own.
class HapticThread {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  /// Starts the thread; the force is zero until there is a scene. The device and the sink must
  /// outlive it. Throws DeviceError for a rate out of range or where the system gives no thread.
  explicit HapticThread(Device& device, const LoopParams& params = {}, TickSink* sink = nullptr);
  /// Writes zero force and ends the thread.
  ~HapticThread() { stop(); }
  HapticThread(const HapticThread&) = delete;
  HapticThread& operator=(const HapticThread&) = delete;

  /// Publishes the scene of the next ticks.
  void publish(std::shared_ptr<const Scene> scene) noexcept { loop_.publish(std::move(scene)); }
  /// The newest tick, valid until the next call.
  [[nodiscard]] const Telemetry& latest() noexcept { return loop_.latest(); }

  /// Cuts the force with the next tick. From any thread, and from a signal handler.
  void cut() noexcept { loop_.cut(); }
  /// Lets force out again, after a fault as well, by an engagement.
  void clear() noexcept { loop_.clear(); }
  /// Tells the loop that the application lives, where LoopParams::heartbeat asks for it.
  void beat() noexcept { loop_.beat(); }

  /// Writes zero force and ends the thread. Further calls do nothing.
  void stop() noexcept;
  /// False once the thread has ended by itself, with the device (Device::ended), or by stop().
  [[nodiscard]] bool running() const noexcept { return running_.load(std::memory_order_acquire); }

  /// What the system granted of LoopParams::realtime.
  [[nodiscard]] const RealtimeReport& realtime() const noexcept { return realtime_; }
  /// LoopParams::early as it came to be [s].
  [[nodiscard]] double early() const noexcept { return early_; }
  /// Page faults of the thread since its first tick.
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
  std::atomic<bool> ready_{false};  ///< These two are written.
  std::atomic<bool> quit_{false};
  std::atomic<bool> running_{true};
  std::atomic<std::int64_t> faults_{0};
  std::thread thread_;
};

}  // namespace palpate
