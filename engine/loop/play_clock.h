/// The play position of sequences: any thread steers it, the loops read it.
#pragma once

#include <atomic>
#include <cstdint>
#include <limits>

namespace palpate {

/// How sequences are played.
struct PlayParams {
  double speed = 1.0;   ///< Seconds of play per second; below 0: backwards.
  bool paused = false;  ///< Play stands still.
  double from = 0.0;    ///< Lower end of play [s]; may be infinite.
  double to = std::numeric_limits<double>::infinity();  ///< Upper end of play [s]; may be infinite.
  bool repeat = false;  ///< From one end, play continues at the other; needs two finite ends.
  double begin = 0.0;   ///< Start of play [s].

  [[nodiscard]] bool operator==(const PlayParams&) const = default;  ///< True for the same play.
};

/// The play position of one loop. A new PlayHead is before the first tick.
struct PlayHead {
  double time = 0.0;        ///< [s]
  double rate = 0.0;        ///< Rate of play in the last tick, except for jumps [s/s].
  double nudged = 0.0;      ///< The part of PlayClock::nudge that it has followed [s].
  std::uint32_t seeks = 0;  ///< Number of PlayClock::seek calls that it has followed.
  bool begun = false;       ///< There was a tick.
};

/// Steers play. Each loop has its own head, and advances by its own ticks. Loops that begin
/// together differ by their start times, some milliseconds.
class PlayClock {
 public:
  /// Begins at the params' `begin`.
  explicit PlayClock(const PlayParams& params = {}) { steer(params); }

  // For any thread.
  /// Plays by these parameters from the next ticks on, from the present position. Play that has not
  /// begun starts at `begin`.
  void steer(const PlayParams& params) noexcept;
  /// Returns the parameters set last.
  [[nodiscard]] PlayParams params() const noexcept;
  /// Pauses or continues.
  void pause(bool paused) noexcept { paused_.store(paused, std::memory_order_relaxed); }
  /// Sets the speed, in seconds of play per second; ignores a number that is not finite.
  void setSpeed(double speed) noexcept;
  /// Sets whether play continues at the other end or stands when it reaches an end.
  void repeat(bool repeat) noexcept { repeat_.store(repeat, std::memory_order_relaxed); }
  /// Goes to a position in the play [s]; ignores a number that is not finite.
  void seek(double time) noexcept;
  /// Moves play on or back by `by` [s]; ignores a number that is not finite.
  void nudge(double by) noexcept;

  // For a loop.
  /// Returns the play position in a tick, `dt` [s] after the last one. RT: no allocation, no lock;
  /// loads.
  [[nodiscard]] double next(PlayHead& head, double dt) const noexcept;

 private:
  std::atomic<double> speed_{1.0};
  std::atomic<bool> paused_{false};
  std::atomic<double> from_{0.0};
  std::atomic<double> to_{std::numeric_limits<double>::infinity()};
  std::atomic<bool> repeat_{false};
  std::atomic<double> begin_{0.0};
  std::atomic<double> nudged_{0.0};      ///< Sum of all nudges [s].
  std::atomic<double> sought_{0.0};      ///< Last place sought [s]; written before `seeks_`.
  std::atomic<std::uint32_t> seeks_{0};  ///< Number of seeks.
};

}  // namespace palpate
