/// Times ticks as with a real hand: in a loop that sleeps between ticks, on a core that other work
/// uses. Provides the haptic thread, a bare loop, and reproducible other work (Neighbour).
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

/// Times of the ticks of one or more runs of a loop.
struct LoopTimes {
  /// Times of single ticks [us]. For a bare loop: times of reading the clock.
  std::vector<double> tick;
  std::vector<double> wake;  ///< Delay of the start of each tick [us].
  long late = 0;             ///< Number of ticks that began after the time of the next tick.
  std::int64_t faults = 0;   ///< Page faults of the loop's thread.
  double cpu = 0.0;          ///< Processor time of the loop's thread [s].
  double seconds = 0.0;      ///< Duration over which `cpu` was counted [s].
  bool priority = true;      ///< True if the thread had real-time priority.

  void add(const LoopTimes& other);  ///< Appends the ticks of other runs.
};

/// Runs a loop for `seconds` [s] at `rate` [Hz] that only sleeps until each tick's time, and reads
/// the clock twice.
[[nodiscard]] LoopTimes runBare(double rate, double seconds, const RealtimeRequest& request);

/// Runs the haptic thread over a scene for `seconds` [s] of real time, or until the device ends.
[[nodiscard]] LoopTimes runHaptic(Device& device, const std::shared_ptr<const Scene>& scene,
                                  const LoopParams& params, double seconds);

/// Prints the heading of a table: ticks, wake-ups, late ticks, used share of a core.
void printHead();
/// Prints one row of the table.
void printRow(const std::string& loop, const LoopTimes& times);

/// Values of Neighbour's parameter: the loop's own core, the first core, or no thread.
inline constexpr std::array kNeighbours{"own", "other", "none"};

/// Returns the number of the last core that this process may use. A loop beside a Neighbour runs
/// there.
[[nodiscard]] int loopCore();

/// Reproducible other work: a thread runs through 4,096 pieces of code and 8 MB of memory in random
/// order, with unpredictable branches. If the system permits it, the thread has the highest
/// priority below real-time priority. So on the loop's core, each tick follows the same kind of
/// work.
class Neighbour {
 public:
  /// @param where  One of kNeighbours.
  explicit Neighbour(const std::string& where);
  Neighbour(const Neighbour&) = delete;
  Neighbour& operator=(const Neighbour&) = delete;
  ~Neighbour();

 private:
  std::atomic<bool> done_{false};
  std::thread thread_;
};

}  // namespace palpate::bench
