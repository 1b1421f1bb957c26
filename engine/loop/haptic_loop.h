/// One hand's loop without its clock: the work of every tick. HapticThread calls it by the real
/// clock; tests and virtual time call it as fast as they can.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>

#include "palpate/engine/loop/cache_warmup.h"
#include "palpate/engine/loop/hand_links.h"
#include "palpate/engine/loop/hand_tick.h"
#include "palpate/engine/loop/mailbox.h"
#include "palpate/engine/loop/play_clock.h"
#include "palpate/engine/loop/telemetry.h"
#include "palpate/engine/safety/device.h"
#include "palpate/engine/safety/safety.h"
#include "palpate/engine/scene/scene.h"
#include "palpate/engine/tick/step.h"

namespace palpate {

/// Receives every tick, on the haptic thread: a log or counters. A sink that needs a ring has its
/// own.
class TickSink {
 public:
  TickSink() = default;
  TickSink(const TickSink&) = delete;
  TickSink& operator=(const TickSink&) = delete;
  virtual ~TickSink() = default;
  /// Receives one tick. RT: must not allocate, lock or wait.
  virtual void take(const Telemetry& tick,
                    const ProxyState& state) noexcept PALPATE_NONBLOCKING = 0;
};

/// Words that a loop shares with the guardian that looks after it, perhaps in another process.
struct LoopWatch {
  std::atomic<std::uint64_t>* heart = nullptr;        ///< Counts ticks, except while writes fail.
  const std::atomic<std::uint32_t>* stops = nullptr;  ///< Counts stop orders: each cuts the force,
                                                      ///< as HapticLoop::cut does.
  const std::atomic<std::uint64_t>* guard = nullptr;  ///< Counts while the guardian watches. If it
                                                      ///< stands still for patience(), the force is
                                                      ///< cut.
  const std::atomic<std::uint32_t>* cuts = nullptr;   ///< Counts how often the guardian has cut the
                                                      ///< force because the loop was late.
  const std::atomic<bool>* punctual = nullptr;  ///< The guardian runs with real-time priority.

  /// Returns the longest permitted pause of the guardian [s].
  [[nodiscard]] double patience() const noexcept;
};

inline constexpr double kUnguardedTime = 0.05;   ///< LoopWatch::patience if punctual [s].
inline constexpr double kUnguardedUsual = 0.25;  ///< LoopWatch::patience otherwise [s].

/// A counter, and the time since when it has stood still.
struct Pulse {
  std::uint64_t count = 0;  ///< Count at the last look.
  double since = 0.0;       ///< Time of its last change [s].

  /// Returns how long the counter, which shows `seen` at the time `now` [s], has stood still [s].
  [[nodiscard]] double still(std::uint64_t seen, double now) noexcept {
    if (seen != count) *this = {seen, now};
    return now - since;
  }
};

/// The time of a tick.
struct TickTime {
  double now = 0.0;          ///< Time since the start [s].
  double dt = 1e-3;          ///< Time since the last tick [s].
  double late = 0.0;         ///< Delay of the tick's start after its time [s].
  bool missed = false;       ///< The tick began after the next tick's time.
  std::int64_t wake_ns = 0;  ///< Delay after the deadline that was slept for, for the log [ns].
  bool real = false;         ///< By a real clock: the durations of a tick and of a write count.
};

/// Returns the limits of a device in a loop of this rate [Hz]. At a hand a force is ramped in over
/// at least kEngage, whatever the device's maker allows. Throws DeviceError if a limit is not a
/// usable number.
[[nodiscard]] ForceLimits limitsInLoop(const DeviceInfo& info, double rate);

/// A proxy, a reader and the gate of one device, over the newest scene.
///
/// Two threads use it, each with its own functions: the haptic thread and the scene thread. Stop
/// orders may come from any thread and from signal handlers. They are atomic flags, because a
/// mailbox has only one writer.
// In the mailboxes, the data that each side writes are on cache lines of their own.
class HapticLoop {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  /// Allocates the memory that ticks need. The device and the sink must outlive the loop.
  ///
  /// @param rate       Nominal rate of the ticks [Hz].
  /// @param heartbeat  The application's longest pause between beats [s]; 0: not required.
  /// Throws DeviceError if a limit of the device, or the heartbeat, is not a usable number.
  HapticLoop(Device& device, double rate, TickSink* sink = nullptr, double heartbeat = 0.0,
             const LoopWatch& watch = {});

  // For the scene thread.
  /// Publishes the scene of the next ticks. Frees old scenes here, never in a tick.
  void publish(std::shared_ptr<const Scene> scene) noexcept;
  /// Returns the newest tick, valid until the next call. Only one thread may read.
  [[nodiscard]] const Telemetry& latest() noexcept {
    telemetry_.refresh();
    return telemetry_.current();
  }

  // For any thread, and signal handlers.
  /// Cuts the force with the next tick, until clear(): for Esc, or when a window closes.
  void cut() noexcept { stop_.store(true, std::memory_order_relaxed); }
  /// Clears any fault with the next tick; an engagement lets force out again.
  void clear() noexcept {
    stop_.store(false, std::memory_order_relaxed);
    // Orders given up to now are taken back. Orders between now and the tick stay.
    if (watch_by_.stops != nullptr) stops_cleared_ = watch_by_.stops->load();
    if (watch_by_.cuts != nullptr) cuts_cleared_ = watch_by_.cuts->load();
    clear_.store(true, std::memory_order_release);
  }
  /// Signals that the application is alive.
  void beat() noexcept { beats_.fetch_add(1, std::memory_order_relaxed); }

  /// Sets the clock that gives the play position of sequences. Call it before the first tick. The
  /// clock must outlive the loop. Without a clock, sequences stand at 0.
  void playBy(const PlayClock* clock) noexcept { clock_ = clock; }

  /// Sets how long after the last late tick the force returns by itself [s], 0 (never) to 60. Call
  /// it before the first tick. Throws DeviceError for another number.
  void reengageAfter(double seconds);

  /// Sets the links to remote hands. Call it before the first tick. They must outlive the loop.
  void linkBy(HandLinks* links) noexcept { links_ = links; }

  // For the haptic thread.
  /// Runs one tick: newest scene, hand, checks, hapticStep, force to the device, telemetry. RT: no
  /// allocation, no lock, no system call but the device's own.
  void tick(const TickTime& time) noexcept PALPATE_NONBLOCKING;
  /// Allocates the memory for warmUp(). Call it before the first warmUp().
  void prepareWarmup() { warmup_ = std::make_unique<CacheWarmup>(hand_.state().limits()); }
  /// Warms up the caches for the tick that comes in `lead` [s], about `dt` after the last one
  /// (cache_warmup.h). Does not run if the last tick took more than a quarter of `lead`: the
  /// warm-up would end too late. Sends, reports and remembers no result. Returns true if the
  /// warm-up ran. RT: no allocation, no lock, no system call but the clock's.
  bool warmUp(double dt, double lead) noexcept PALPATE_NONBLOCKING;
  /// Writes zero force, after the last tick.
  void end() noexcept PALPATE_NONBLOCKING;

 private:
  [[nodiscard]] Fault whatIsWrong(HandState& hand, const TickTime& time) noexcept;
  /// Returns the fault that withholds the force of a tick that took `took` [s]; kNone: the force is
  /// sent.
  [[nodiscard]] Fault withheld(double took, const TickTime& time) noexcept;
  /// Returns kStopped after a stop order, kLate (once) after the guardian has cut the force, else
  /// kNone.
  [[nodiscard]] Fault ordered() noexcept;
  void send(const Vec3& force, bool timed, TickInput& in) noexcept;

  Device& device_;
  TickSink* sink_;
  double late_;  ///< Lateness that is a fault [s]; less is only counted.
  double heartbeat_;
  LoopWatch watch_by_;
  Mailbox<std::shared_ptr<const Scene>> scenes_;
  Mailbox<Telemetry> telemetry_;
  std::atomic<bool> stop_{false};
  std::atomic<bool> clear_{false};
  std::atomic<std::uint32_t> stops_cleared_{0};
  std::atomic<std::uint32_t> cuts_cleared_{0};
  std::atomic<std::uint32_t> beats_{0};

  const PlayClock* clock_ = nullptr;
  PlayHead head_;
  HandLinks* links_ = nullptr;

  HandWatch watch_;
  HandTick hand_;
  Reengagement reengagement_{0.0};
  std::unique_ptr<CacheWarmup> warmup_;  ///< Null: ticks have no warm-up.
  Telemetry told_;
  std::uint32_t stops_seen_ = 0;  ///< Count of LoopWatch::stops that is taken back.
  std::uint32_t cuts_seen_ = 0;   ///< Count of LoopWatch::cuts that the loop has followed.
  bool deaf_ = false;             ///< The device takes no writes: it is left to the guardian.
  bool jumped_ = false;           ///< The position jumped while no force went out.

  Pulse beat_;
  Pulse guard_;
};

}  // namespace palpate
