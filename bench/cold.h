/// Ticks as a hand has them: of a loop that sleeps in between, on a core that others use meanwhile.
/// The haptic thread, a bare loop to compare it with, and a neighbour that is always the same.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "palpate/engine/haptic_thread.h"

namespace palpate::bench {

/// Of the runs of a loop.
struct LoopTimes {
  std::vector<double> tick;  ///< Times of single ticks [us]; of a bare loop, of reading the clock.
  std::vector<double> wake;  ///< How long after its time each began [us].
  long late = 0;             ///< Ticks that began after the next one's time.
  std::int64_t faults = 0;   ///< Page faults of the loop's thread,
  double cpu = 0.0;          ///< its time on a core [s],
  double seconds = 0.0;      ///< of so much.
  bool priority = true;      ///< It had real-time priority.

  void add(const LoopTimes& other);
};

/// A loop that only sleeps until each tick's time, and reads the clock twice.
[[nodiscard]] LoopTimes runBare(double rate, double seconds, const RealtimeRequest& request);

/// The haptic thread, for so long [s] or until the device ends.
[[nodiscard]] LoopTimes runHaptic(Device& device, const std::shared_ptr<const Scene>& scene,
                                  const LoopParams& params, double seconds);

/// A table of loops: ticks, wake-ups, late ones, and the loop's share of a core.
void printHead();
void printRow(const std::string& loop, const LoopTimes& times);

/// Where a Neighbour is: on the loop's own core, another, or nowhere.
inline constexpr std::array kNeighbours{"own", "other", "none"};

/// The core that a loop beside a Neighbour is to stay on: the last.
[[nodiscard]] int loopCore();

/// Other work, always the same, while this lives: a thread that goes through 4,096 pieces of code
/// and 8 MB of memory at random, with branches that nobody foresees. On the loop's own core it goes
/// before whatever else runs there without real-time priority, so that each of the loop's ticks
/// comes after the same.
class Neighbour {
 public:
  /// `where`: one of kNeighbours.
  explicit Neighbour(const std::string& where);
  Neighbour(const Neighbour&) = delete;
  Neighbour& operator=(const Neighbour&) = delete;
  ~Neighbour();

 private:
  std::atomic<bool> done_{false};
  std::thread thread_;
};

}  // namespace palpate::bench
