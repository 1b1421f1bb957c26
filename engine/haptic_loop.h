/// One hand's loop without its clock: what is done every tick, by whoever has the time of day. The
/// real clock is HapticThread's; tests and virtual time call it as fast as they can.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>

#include "palpate/engine/device.h"
#include "palpate/engine/mailbox.h"
#include "palpate/engine/safety.h"
#include "palpate/engine/scene.h"
#include "palpate/engine/step.h"
#include "palpate/engine/telemetry.h"

namespace palpate {

/// Takes every tick, on the haptic thread: a log, counts. Its ring, if it needs one, is its own.
class TickSink {
 public:
  TickSink() = default;
  TickSink(const TickSink&) = delete;
  TickSink& operator=(const TickSink&) = delete;
  virtual ~TickSink() = default;
  /// RT: must not allocate, lock or wait.
  virtual void take(const Telemetry& tick,
                    const ProxyState& state) noexcept PALPATE_NONBLOCKING = 0;
};

/// Words that a loop shares with whoever looks after it, perhaps another process.
struct LoopWatch {
  std::atomic<std::uint64_t>* heart = nullptr;        ///< Counts ticks.
  const std::atomic<std::uint32_t>* stops = nullptr;  ///< Counts stop orders: each is as
                                                      ///< HapticLoop::cut.
  const std::atomic<std::uint64_t>* guard = nullptr;  ///< Counts while somebody looks: where it
                                                      ///< stands still for kUnguardedTime the
                                                      ///< force is cut.
  const std::atomic<std::uint32_t>* cuts = nullptr;   ///< Counts the times that somebody has
                                                      ///< taken the force off: the loop was late.
};

inline constexpr double kUnguardedTime = 0.25;  ///< [s]

/// A word that somebody counts up, and since when it has stood still.
struct Pulse {
  std::uint64_t count = 0;
  double since = 0.0;  ///< [s]

  [[nodiscard]] double still(std::uint64_t seen, double now) noexcept {
    if (seen != count) *this = {seen, now};
    return now - since;
  }
};

/// When a tick is.
struct TickTime {
  double now = 0.0;          ///< [s] since the start.
  double dt = 1e-3;          ///< Since the last tick [s].
  double late = 0.0;         ///< How long after its time it began [s].
  bool missed = false;       ///< So late that the next one's time had come.
  std::int64_t wake_ns = 0;  ///< After the deadline that was slept for, for the log [ns].
  bool real = false;         ///< By a clock: then what a tick and a write take counts as well.
};

/// A proxy, a reader and the gate of one device, over the newest scene.
///
/// Two threads use it, each its own functions: the haptic one and the one that makes scenes. Stop
/// orders may come from anywhere, signal handlers among them: that is what the mailbox, which has
/// one writer, cannot say, and why there are atomic flags.
// The mailboxes keep their sides on cache lines of their own.
class HapticLoop {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  /// Takes the memory that ticks need. The device and the sink outlive the loop.
  ///
  /// @param rate       Ticks a second that are meant [Hz].
  /// @param heartbeat  The application's longest pause between beats [s]; 0: none is asked for.
  /// Throws DeviceError where a limit of the device, or the heartbeat, is no number that limits.
  HapticLoop(Device& device, double rate, TickSink* sink = nullptr, double heartbeat = 0.0,
             const LoopWatch& watch = {});

  // The scene thread.
  /// From the next tick on. Old scenes are freed here, never in a tick.
  void publish(std::shared_ptr<const Scene> scene) noexcept;
  /// The newest tick; stays until the next call. One reading thread.
  [[nodiscard]] const Telemetry& latest() noexcept {
    telemetry_.refresh();
    return telemetry_.current();
  }

  // Any thread, and signal handlers.
  /// Cuts the force with the next tick, until clear(): Esc, a window that closes.
  void cut() noexcept { stop_.store(true, std::memory_order_relaxed); }
  /// Takes back a fault, whatever it was, with the next tick: an engagement lets force out again.
  void clear() noexcept {
    stop_.store(false, std::memory_order_relaxed);
    // What was ordered up to now, and nothing that comes before the tick.
    if (watch_by_.stops != nullptr) stops_cleared_ = watch_by_.stops->load();
    if (watch_by_.cuts != nullptr) cuts_cleared_ = watch_by_.cuts->load();
    clear_.store(true, std::memory_order_release);
  }
  /// The application lives.
  void beat() noexcept { beats_.fetch_add(1, std::memory_order_relaxed); }

  // The haptic thread.
  /// One tick: newest scene, hand, checks, hapticStep, force to the device, telemetry.
  /// RT: no allocation, no lock, no system call but the device's own.
  void tick(const TickTime& time) noexcept PALPATE_NONBLOCKING;
  /// The force is zero; as the last tick.
  void end() noexcept PALPATE_NONBLOCKING;

 private:
  [[nodiscard]] Fault whatIsWrong(HandState& hand, const TickTime& time) noexcept;
  /// kStopped or kLate where somebody has ordered or done it.
  [[nodiscard]] Fault ordered() const noexcept;
  void send(const Vec3& force, bool timed) noexcept;

  Device& device_;
  TickSink* sink_;
  double late_;  ///< What is a fault [s]; less is counted.
  double heartbeat_;
  LoopWatch watch_by_;
  Mailbox<std::shared_ptr<const Scene>> scenes_;
  Mailbox<Telemetry> telemetry_;
  std::atomic<bool> stop_{false};
  std::atomic<bool> clear_{false};
  std::atomic<std::uint32_t> stops_cleared_{0};
  std::atomic<std::uint32_t> cuts_cleared_{0};
  std::atomic<std::uint32_t> beats_{0};

  HandWatch watch_;
  Reader reader_;
  ProxyState state_;
  Telemetry told_;
  std::uint32_t stops_seen_ = 0;  ///< Of LoopWatch::stops, taken back,
  std::uint32_t cuts_seen_ = 0;   ///< and of LoopWatch::cuts.
  bool deaf_ = false;             ///< The device takes no writes: the guardian has another way.
  bool ready_ = true;             ///< Of the last tick's hand.

  Pulse beat_;
  Pulse guard_;
};

}  // namespace palpate
