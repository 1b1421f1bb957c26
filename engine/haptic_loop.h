/// One hand's loop without its clock: what is done every tick. HapticThread calls it by the real
/// clock, tests and virtual time as fast as they can.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>

#include "palpate/engine/device.h"
#include "palpate/engine/hand_links.h"
#include "palpate/engine/hand_tick.h"
#include "palpate/engine/mailbox.h"
#include "palpate/engine/play_clock.h"
#include "palpate/engine/rehearsal.h"
#include "palpate/engine/safety.h"
#include "palpate/engine/scene.h"
#include "palpate/engine/step.h"
#include "palpate/engine/telemetry.h"

namespace palpate {

/// Receives every tick, on the haptic thread: a log, counts. A ring, if needed, is the sink's own.
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
  std::atomic<std::uint64_t>* heart = nullptr;        ///< Counts ticks, but while writes fail.
  const std::atomic<std::uint32_t>* stops = nullptr;  ///< Counts stop orders: each cuts the force
                                                      ///< as HapticLoop::cut.
  const std::atomic<std::uint64_t>* guard = nullptr;  ///< Counts while the guardian looks: where it
                                                      ///< stands still for patience() the force
                                                      ///< is cut.
  const std::atomic<std::uint32_t>* cuts = nullptr;   ///< Counts how often the guardian has cut the
                                                      ///< force: the loop was late.
  const std::atomic<bool>* punctual = nullptr;  ///< The guardian runs with real-time priority.

  /// Longest pause of the guardian [s].
  [[nodiscard]] double patience() const noexcept;
};

inline constexpr double kUnguardedTime = 0.05;   ///< LoopWatch::patience if punctual [s],
inline constexpr double kUnguardedUsual = 0.25;  ///< else [s].

/// A counter, and since when it has stood still.
struct Pulse {
  std::uint64_t count = 0;  ///< What the counter showed when it was last looked at.
  double since = 0.0;       ///< Time of its last change [s].

  /// How long the counter, which shows `seen` at the time `now` [s], has stood still [s].
  [[nodiscard]] double still(std::uint64_t seen, double now) noexcept {
    if (seen != count) *this = {seen, now};
    return now - since;
  }
};

/// The time of a tick.
struct TickTime {
  double now = 0.0;          ///< Time since the start [s].
  double dt = 1e-3;          ///< Time since the last tick [s].
  double late = 0.0;         ///< How long after its time the tick began [s].
  bool missed = false;       ///< So late that the next tick's time had come.
  std::int64_t wake_ns = 0;  ///< Wake-up after the deadline that was slept for, for the log [ns].
  bool real = false;         ///< By a real clock: the time that a tick and a write take counts.
};

/// The limits of a device in a loop of this rate [Hz]. At a hand a force is ramped in over at least
/// kEngage, whatever the device's maker says. Throws DeviceError where one is not a usable number.
[[nodiscard]] ForceLimits limitsInLoop(const DeviceInfo& info, double rate);

/// A proxy, a reader and the gate of one device, over the newest scene.
///
/// Two threads use it, each its own functions: the haptic thread and the scene thread. Stop orders
/// may come from anywhere, signal handlers included; a mailbox, which has one writer, cannot carry
/// them, and so there are atomic flags.
// The mailboxes keep what each side writes on cache lines of its own.
class HapticLoop {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  /// Allocates the memory that ticks need. The device and the sink must outlive the loop.
  ///
  /// @param rate       Nominal rate of the ticks [Hz].
  /// @param heartbeat  The application's longest pause between beats [s]; 0: none are asked for.
  /// Throws DeviceError where a limit of the device, or the heartbeat, is not a usable number.
  HapticLoop(Device& device, double rate, TickSink* sink = nullptr, double heartbeat = 0.0,
             const LoopWatch& watch = {});

  // For the scene thread.
  /// Publishes the scene of the next ticks. Old scenes are freed here, never in a tick.
  void publish(std::shared_ptr<const Scene> scene) noexcept;
  /// The newest tick, valid until the next call. For one reading thread.
  [[nodiscard]] const Telemetry& latest() noexcept {
    telemetry_.refresh();
    return telemetry_.current();
  }

  // For any thread, and signal handlers.
  /// Cuts the force with the next tick, until clear(): for Esc, or for a window that closes.
  void cut() noexcept { stop_.store(true, std::memory_order_relaxed); }
  /// Clears a fault, whatever it was, with the next tick: an engagement lets force out again.
  void clear() noexcept {
    stop_.store(false, std::memory_order_relaxed);
    // Orders given up to now are taken back, none that comes between now and the tick.
    if (watch_by_.stops != nullptr) stops_cleared_ = watch_by_.stops->load();
    if (watch_by_.cuts != nullptr) cuts_cleared_ = watch_by_.cuts->load();
    clear_.store(true, std::memory_order_release);
  }
  /// Tells the loop that the application lives.
  void beat() noexcept { beats_.fetch_add(1, std::memory_order_relaxed); }

  /// Before the first tick: who says how far sequences are in their play. It must outlive the loop.
  /// Nobody: they stand at 0.
  void playBy(const PlayClock* clock) noexcept { clock_ = clock; }

  /// Before the first tick: how long after the last late tick the force returns by itself [s], 0
  /// (never) to 60. Throws DeviceError for another number.
  void reengageAfter(double seconds);

  /// Before the first tick: the hands elsewhere that this one feels. It must outlive the loop.
  void linkBy(HandLinks* links) noexcept { links_ = links; }

  // For the haptic thread.
  /// One tick: newest scene, hand, checks, hapticStep, force to the device, telemetry.
  /// RT: no allocation, no lock, no system call but the device's own.
  void tick(const TickTime& time) noexcept PALPATE_NONBLOCKING;
  /// Before the first rehearse(): allocates what it needs.
  void prepareRehearsal() { rehearsal_ = std::make_unique<Rehearsal>(hand_.state().limits()); }
  /// Rehearses the tick that comes in `lead` [s], about `dt` after the last one (rehearsal.h). Not
  /// where the last tick took more than a quarter of `lead`: this one would come too late.
  /// Nothing is sent, told or remembered. True if there was a rehearsal.
  /// RT: no allocation, no lock, no system call but the clock's.
  bool rehearse(double dt, double lead) noexcept PALPATE_NONBLOCKING;
  /// Writes zero force, after the last tick.
  void end() noexcept PALPATE_NONBLOCKING;

 private:
  [[nodiscard]] Fault whatIsWrong(HandState& hand, const TickTime& time) noexcept;
  /// Why a force is not sent whose tick took so long [s].
  [[nodiscard]] Fault withheld(double took, const TickTime& time) noexcept;
  /// kStopped where somebody ordered a stop, kLate (once) where the guardian has cut, else kNone.
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
  std::unique_ptr<Rehearsal> rehearsal_;  ///< Null: ticks are not rehearsed.
  Telemetry told_;
  std::uint32_t stops_seen_ = 0;  ///< The count of LoopWatch::stops that is taken back.
  std::uint32_t cuts_seen_ = 0;   ///< The count of LoopWatch::cuts that was followed.
  bool deaf_ = false;             ///< The device takes no writes: it is left to the guardian.
  bool jumped_ = false;           ///< The position jumped while no force went out.

  Pulse beat_;
  Pulse guard_;
};

}  // namespace palpate
