/// How far sequences are in their play: steered by whoever holds the keys, read by the loops.
#pragma once

#include <atomic>
#include <cstdint>
#include <limits>

namespace palpate {

/// How sequences are played.
struct PlayParams {
  double speed = 1.0;   ///< Seconds of play a second; below 0: backwards.
  bool paused = false;  ///< It stands.
  double from = 0.0;    ///< Play goes from there [s], or without a bound,
  double to = std::numeric_limits<double>::infinity();  ///< to there, forwards or backwards.
  bool repeat = false;  ///< From one end it goes on at the other; needs both.
  double begin = 0.0;   ///< It begins there [s].

  [[nodiscard]] bool operator==(const PlayParams&) const = default;  ///< For the same play.
};

/// Where one loop is in its play. As made: before it.
struct PlayHead {
  double time = 0.0;        ///< [s]
  double rate = 0.0;        ///< How fast it has gone on in the last tick, but for jumps [s/s].
  double nudged = 0.0;      ///< What it has taken of PlayClock::nudge [s].
  std::uint32_t seeks = 0;  ///< What it has taken of PlayClock::seek.
  bool begun = false;       ///< There was a tick.
};

/// Steers play. Each loop has its own head, and goes on by its own ticks: several that begin
/// together are apart by what their beginnings are, some milliseconds.
class PlayClock {
 public:
  /// Begins at the params' `begin`.
  explicit PlayClock(const PlayParams& params = {}) { steer(params); }

  // For any thread.
  /// Plays so from the next ticks on, from where play is; what has not begun does so at `begin`.
  void steer(const PlayParams& params) noexcept;
  /// As steered last.
  [[nodiscard]] PlayParams params() const noexcept;
  /// Pauses or goes on.
  void pause(bool paused) noexcept { paused_.store(paused, std::memory_order_relaxed); }
  /// Seconds of play a second; not finite: as it was.
  void setSpeed(double speed) noexcept;
  /// At one end it goes on at the other, or stands.
  void repeat(bool repeat) noexcept { repeat_.store(repeat, std::memory_order_relaxed); }
  /// Goes to a place in the play [s]; not finite: nowhere.
  void seek(double time) noexcept;
  /// Goes on or back by so much [s]; not finite: not at all.
  void nudge(double by) noexcept;

  // For a loop.
  /// Where play is in a tick, `dt` [s] after the last one. RT: no allocation, no lock; loads.
  [[nodiscard]] double next(PlayHead& head, double dt) const noexcept;

 private:
  std::atomic<double> speed_{1.0};
  std::atomic<bool> paused_{false};
  std::atomic<double> from_{0.0};
  std::atomic<double> to_{std::numeric_limits<double>::infinity()};
  std::atomic<bool> repeat_{false};
  std::atomic<double> begin_{0.0};
  std::atomic<double> nudged_{0.0};      ///< All that was ever nudged [s].
  std::atomic<double> sought_{0.0};      ///< The last place that was sought [s], written before
  std::atomic<std::uint32_t> seeks_{0};  ///< how many were.
};

}  // namespace palpate
