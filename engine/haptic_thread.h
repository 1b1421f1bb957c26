/// The loop with a clock: one hand, on time.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <thread>

#include "palpate/engine/haptic_loop.h"
#include "palpate/engine/realtime.h"

namespace palpate {

struct LoopParams {
  double rate = 1000.0;    ///< Ticks a second, 500 to 20,000 [Hz].
  double heartbeat = 0.0;  ///< The application's longest pause between beats [s]; 0: none asked.
  RealtimeRequest realtime;
  LoopWatch watch;  ///< Of a guardian (devices/guardian.h).
};

/// Feels scenes on one device, in a thread of its own, until it is destroyed. The smallest use:
///
///     HapticThread hand(device);
///     hand.publish(scene);
///     draw(hand.latest());
///
/// Two hands are two of them, over one shared scene. publish and latest are for one thread each.
class HapticThread {
 public:
  /// Starts; the force is zero until there is a scene. The device and the sink outlive it. Throws
  /// DeviceError for a rate out of range or where the system gives no thread.
  explicit HapticThread(Device& device, const LoopParams& params = {}, TickSink* sink = nullptr);
  /// Writes zero force and ends.
  ~HapticThread() { stop(); }
  HapticThread(const HapticThread&) = delete;
  HapticThread& operator=(const HapticThread&) = delete;

  /// The scene from the next tick on.
  void publish(std::shared_ptr<const Scene> scene) noexcept { loop_.publish(std::move(scene)); }
  /// The newest tick.
  [[nodiscard]] const Telemetry& latest() noexcept { return loop_.latest(); }

  /// Cuts the force. From any thread, and from a signal handler.
  void cut() noexcept { loop_.cut(); }
  /// Lets it out again, after a fault as well, by an engagement.
  void clear() noexcept { loop_.clear(); }
  /// The application lives: where LoopParams::heartbeat asks for it.
  void beat() noexcept { loop_.beat(); }

  /// Zero force and the end of the thread. Once.
  void stop() noexcept;
  /// False once it has ended by itself, with the device (Device::ended) or by stop().
  [[nodiscard]] bool running() const noexcept { return running_.load(std::memory_order_acquire); }

  /// What the system granted.
  [[nodiscard]] const RealtimeReport& realtime() const noexcept { return realtime_; }
  /// Page faults of the thread since its first tick.
  [[nodiscard]] std::int64_t pageFaultsSinceStart() const noexcept {
    return faults_.load(std::memory_order_relaxed);
  }

 private:
  void run() noexcept;

  Device& device_;
  LoopParams params_;
  HapticLoop loop_;
  RealtimeReport realtime_;
  std::atomic<bool> ready_{false};  ///< realtime_ is written.
  std::atomic<bool> quit_{false};
  std::atomic<bool> running_{true};
  std::atomic<std::int64_t> faults_{0};
  std::thread thread_;
};

}  // namespace palpate
