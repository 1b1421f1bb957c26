/// One hand's loop without its clock. HapticThread runs its ticks in real time.
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

/// Receives the telemetry of every tick on the haptic thread, for a log or counters.
class TickSink {
 public:
  TickSink() = default;
  TickSink(const TickSink&) = delete;
  TickSink& operator=(const TickSink&) = delete;
  virtual ~TickSink() = default;
  /// Receives one tick. RT: an implementation must not allocate, lock or wait.
  virtual void take(const Telemetry& tick,
                    const ProxyState& state) noexcept PALPATE_NONBLOCKING = 0;
};

/// Atomic words that a loop shares with its guardian, which may be in another process. A null
/// pointer disables its function.
struct LoopWatch {
  /// Counter that the loop increments in every tick. After kWrite, kGone or kMiscounted the counter
  /// stops until clear().
  std::atomic<std::uint64_t>* heart = nullptr;
  /// Counter of stop orders. Each order cuts the force, as HapticLoop::cut does.
  const std::atomic<std::uint32_t>* stops = nullptr;
  /// Counter that the guardian increments. If it stays the same for patience(), the loop cuts the
  /// force.
  const std::atomic<std::uint64_t>* guard = nullptr;
  /// Counter of the cuts by the guardian because the loop was late.
  const std::atomic<std::uint32_t>* cuts = nullptr;
  /// True if the guardian runs with real-time priority.
  const std::atomic<bool>* punctual = nullptr;

  /// Returns the longest permitted pause of the guardian [s].
  [[nodiscard]] double patience() const noexcept;
};

inline constexpr double kUnguardedTime = 0.05;   ///< LoopWatch::patience() if punctual [s].
inline constexpr double kUnguardedUsual = 0.25;  ///< LoopWatch::patience() otherwise [s].

/// A counter, and the time of its last change.
struct Pulse {
  std::uint64_t count = 0;  ///< Value at the last call of still().
  double since = 0.0;       ///< Time of the last change [s].

  /// Returns how long the counter has not changed [s]. `seen` is its value at the time `now` [s].
  [[nodiscard]] double still(std::uint64_t seen, double now) noexcept {
    if (seen != count) *this = {seen, now};
    return now - since;
  }
};

/// Timing of a tick.
struct TickTime {
  double now = 0.0;  ///< Time since the start [s].
  double dt = 1e-3;  ///< Time since the last tick [s].
  /// Delay of the tick's start [s]. It counts from the deadline that follows that of the last tick,
  /// or from one period after the start of the last tick if that is later.
  double late = 0.0;
  bool missed = false;       ///< True for a late tick: `late` is a period or more.
  std::int64_t wake_ns = 0;  ///< Time from the tick's own deadline to its start, for the log [ns].
  bool real = false;  ///< True for a real clock: the durations of a tick and of a write then count.

  /// Sets `late` and `missed` from the delay and from the period of the loop [s].
  void setLate(double delay, double period) noexcept {
    late = delay;
    missed = delay >= period;
  }
};

/// Returns the limits of a device in a loop of this rate [Hz]. If DeviceInfo::hand is true, an
/// engagement lasts at least kEngage. Throws DeviceError if a limit is not a usable number, or if
/// the energy tank cannot store the delayed forces at this rate.
[[nodiscard]] ForceLimits limitsInLoop(const DeviceInfo& info, double rate);

/// Throws DeviceError if a scene's coupling can have more stiffness or damping than the device
/// renders stably (DeviceInfo::max_stiffness, max_damping). Accepts null.
void checkCoupling(const DeviceInfo& info, const Scene* scene);

/// The loop of one device: its proxy, its reader and the newest scene.
///
/// Two threads use the loop: the haptic thread and the scene thread. Any thread and any signal
/// handler may call cut(), clear() and beat(). Each other function belongs to one of the two
/// threads.
// The padding in the mailboxes keeps the data of each side on separate cache lines.
class HapticLoop {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  /// Allocates all memory that ticks need. The device and the sink must outlive the loop.
  ///
  /// @param rate       Nominal rate of the ticks [Hz].
  /// @param heartbeat  Longest permitted pause between beats of the application [s]; 0: no limit.
  /// Throws DeviceError as limitsInLoop does, or if the heartbeat is not a usable number.
  HapticLoop(Device& device, double rate, TickSink* sink = nullptr, double heartbeat = 0.0,
             const LoopWatch& watch = {});

  // Functions for the scene thread.
  /// Publishes the scene for the next ticks. If its shape differs from the present scene's
  /// (Scene::shape), and ForceLimits::engage is above 0, the force becomes zero and an engagement
  /// begins. Frees old scenes in this call, never in a tick. Does not call checkCoupling().
  void publish(std::shared_ptr<const Scene> scene) noexcept;
  /// Returns the newest tick, valid until the next call. Only one thread may read.
  [[nodiscard]] const Telemetry& latest() noexcept {
    telemetry_.refresh();
    return telemetry_.current();
  }

  // Functions for any thread and for signal handlers.
  /// Cuts the force from the next tick until clear().
  void cut() noexcept { stop_.store(true, std::memory_order_relaxed); }
  /// Clears any fault in the next tick. The force returns through an engagement.
  void clear() noexcept {
    stop_.store(false, std::memory_order_relaxed);
    // Withdraws the stop orders so far. An order between this call and the next tick stays valid.
    if (watch_by_.stops != nullptr) stops_cleared_ = watch_by_.stops->load();
    if (watch_by_.cuts != nullptr) cuts_cleared_ = watch_by_.cuts->load();
    clear_.store(true, std::memory_order_release);
  }
  /// Signals that the application is alive.
  void beat() noexcept { beats_.fetch_add(1, std::memory_order_relaxed); }

  /// Sets the clock of sequences. Call this function before the first tick. The clock must outlive
  /// the loop. Without a clock, sequences stay at position 0.
  void playBy(const PlayClock* clock) noexcept { clock_ = clock; }

  /// Sets the time after the last late tick at which the force returns by itself (Reengagement): 0
  /// (never) to 60 [s]. Call this function before the first tick. Throws DeviceError for other
  /// numbers.
  void reengageAfter(double seconds);

  /// Sets the links to remote hands. Call this function before the first tick. The links must
  /// outlive the loop.
  void linkBy(HandLinks* links) noexcept { links_ = links; }

  // Functions for the haptic thread.
  /// Runs one tick: takes the newest scene, reads and checks the hand, calls hapticStep, writes the
  /// force and publishes the telemetry. RT: no allocation, no lock; no system calls except those of
  /// the device, the sink and the clock.
  void tick(const TickTime& time) noexcept PALPATE_NONBLOCKING;
  /// Allocates the memory for warmUp(). Call this function before the first warmUp().
  void prepareWarmup() { warmup_ = std::make_unique<CacheWarmup>(hand_.state().limits()); }
  /// Warms up the caches (cache_warmup.h) for the tick that comes in `lead` [s], about `dt` [s]
  /// after the last tick. Returns true if a warm-up ran. None runs if the last tick took more than
  /// a quarter of `lead`, without a scene or prepareWarmup(), or if CacheWarmup::run() runs none.
  /// Does not change the state of the loop's own tick. RT: no allocation, no lock, no system call.
  bool warmUp(double dt, double lead) noexcept PALPATE_NONBLOCKING;
  /// Writes zero force. Call this function after the last tick.
  void end() noexcept PALPATE_NONBLOCKING;

 private:
  [[nodiscard]] Fault whatIsWrong(HandState& hand, const TickTime& time) noexcept;
  /// Returns the fault that withholds the force of a tick that took `took` [s]; else kNone.
  [[nodiscard]] Fault withheld(double took, const TickTime& time) noexcept;
  /// Returns kStopped after a stop order, kLate (once) after a cut by the guardian, else kNone.
  [[nodiscard]] Fault ordered() noexcept;
  void send(const Vec3& force, bool timed, TickInput& in) noexcept;

  Device& device_;
  TickSink* sink_;
  double late_;  ///< Delay above which a late tick is a fault [s]. Smaller delays are only counted.
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
  std::unique_ptr<CacheWarmup> warmup_;
  Telemetry told_;
  std::uint32_t stops_seen_ = 0;  ///< Number of withdrawn orders in LoopWatch::stops.
  std::uint32_t cuts_seen_ = 0;   ///< Number of processed cuts in LoopWatch::cuts.
  /// True after kWrite, kGone or kMiscounted: the loop stops `heart`, and the guardian acts.
  bool deaf_ = false;
  bool jumped_ = false;  ///< True if the position jumped while no force was sent.

  Pulse beat_;
  Pulse guard_;
};

}  // namespace palpate
