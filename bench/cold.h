/// Times ticks as a hand has them: in a loop that sleeps in between, on a core that other work
/// uses. Provides the haptic thread, a bare loop for comparison, and a neighbour that is always the
/// same.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "palpate/engine/loop/haptic_thread.h"

namespace palpate::bench {

/// Times of a loop's runs.
struct LoopTimes {
  std::vector<double> tick;  ///< Times of single ticks [us]; of a bare loop, of reading the clock.
  std::vector<double> wake;  ///< Delay of the start of each tick [us].
  long late = 0;             ///< Ticks that began after the next tick's time.
  std::int64_t faults = 0;   ///< Page faults of the loop's thread.
  double cpu = 0.0;          ///< Time of the loop's thread on a core [s].
  double seconds = 0.0;      ///< Time over which `cpu` was counted [s].
  bool priority = true;      ///< The thread had real-time priority.

  void add(const LoopTimes& other);
};

/// Runs a loop that only sleeps until each tick's time, and reads the clock twice.
[[nodiscard]] LoopTimes runBare(double rate, double seconds, const RealtimeRequest& request);

/// Runs the haptic thread for `seconds` [s] or until the device ends.
[[nodiscard]] LoopTimes runHaptic(Device& device, const std::shared_ptr<const Scene>& scene,
                                  const LoopParams& params, double seconds);

/// Prints a table of loops: ticks, wake-ups, late ticks, and the loop's share of a core.
void printHead();
void printRow(const std::string& loop, const LoopTimes& times);

/// Places of a Neighbour: "own" core of the loop, "other" core, or "none".
inline constexpr std::array kNeighbours{"own", "other", "none"};

/// Returns the core for a loop beside a Neighbour: the last core.
[[nodiscard]] int loopCore();

/// Other work, always the same, during the object's lifetime. A thread goes through 4,096 pieces of
/// code and 8 MB of memory at random, with branches that cannot be predicted. On the loop's own
/// core it goes before all other work without real-time priority. Each of the loop's ticks thus
/// comes after the same work.
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
