/// The play position of sequences. Any thread may control it, and the loops read it.
#pragma once

#include <atomic>
#include <cstdint>
#include <limits>

namespace palpate {

/// Speed, range and start of play.
struct PlayParams {
  double speed = 1.0;   ///< Seconds of play per second of time; below 0 for backwards.
  bool paused = false;  ///< True while play is paused.
  double from = 0.0;    ///< Lower end of the range [s]; may be infinite.
  double to =
      std::numeric_limits<double>::infinity();  ///< Upper end of the range [s]; may be infinite.
  bool repeat = false;  ///< If true, play continues at the other end. Needs finite ends.
  double begin = 0.0;   ///< First play position [s].

  /// Returns true if all parameters are equal.
  [[nodiscard]] bool operator==(const PlayParams&) const = default;
};

/// The play position of one loop.
struct PlayHead {
  double time = 0.0;    ///< Play position [s].
  double rate = 0.0;    ///< Seconds of play per second in the last tick, without jumps.
  double nudged = 0.0;  ///< Sum of the nudges (PlayClock::nudge) that this head has followed [s].
  std::uint32_t seeks = 0;  ///< Number of seeks (PlayClock::seek) that this head has followed.
  bool begun = false;       ///< True after the first tick.
};

/// Controls play. Each loop advances its own PlayHead; heads differ by the loops' start times.
class PlayClock {
 public:
  /// Begins at `params.begin`.
  explicit PlayClock(const PlayParams& params = {}) : reached_(params.begin) { steer(params); }

  // Functions for any thread.
  /// Sets the parameters from the next ticks on. Play continues from its position; before the first
  /// tick, it begins at `begin`. Keeps the speed if the new one is not finite.
  void steer(const PlayParams& params) noexcept;
  /// Returns the parameters set last.
  [[nodiscard]] PlayParams params() const noexcept;
  /// Pauses or continues play.
  void pause(bool paused) noexcept { paused_.store(paused, std::memory_order_relaxed); }
  /// Sets the speed, in seconds of play per second. Ignores a number that is not finite.
  void setSpeed(double speed) noexcept;
  /// If `repeat` is true, play that reaches an end continues at the other end; else it stops at the
  /// end.
  void repeat(bool repeat) noexcept { repeat_.store(repeat, std::memory_order_relaxed); }
  /// Moves play to a position [s]. Ignores a number that is not finite.
  void seek(double time) noexcept;
  /// Moves play forwards or backwards by `by` [s]. Ignores a number that is not finite.
  void nudge(double by) noexcept;
  /// Returns the play position of the last tick of any loop, moved by the nudges since then [s].
  /// Before the first tick, this is the `begin` of the constructor, moved by the nudges. The
  /// position may be beyond an end of the range by these nudges.
  [[nodiscard]] double position() const noexcept;

  // Function for a loop.
  /// Advances `head` to a tick, `dt` [s] after the last tick, and returns its play position [s].
  /// RT: no allocation, no lock.
  [[nodiscard]] double next(PlayHead& head, double dt) const noexcept;

 private:
  std::atomic<double> speed_{1.0};
  std::atomic<bool> paused_{false};
  std::atomic<double> from_{0.0};
  std::atomic<double> to_{std::numeric_limits<double>::infinity()};
  std::atomic<bool> repeat_{false};
  std::atomic<double> begin_{0.0};
  std::atomic<double> nudged_{0.0};
  std::atomic<double> sought_{0.0};  ///< Position of the last seek [s]; written before `seeks_`.
  std::atomic<std::uint32_t> seeks_{0};
  /// Position of the last tick minus the nudges that it has followed [s].
  mutable std::atomic<double> reached_{0.0};
};

}  // namespace palpate
