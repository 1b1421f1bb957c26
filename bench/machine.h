/// Where numbers were measured, for the heads of tables and charts.
#pragma once

#include <chrono>
#include <string>

namespace palpate::bench {

using Clock = std::chrono::steady_clock;

struct Machine {
  std::string processor;
  std::string compiler;
  std::string flags;
  std::string commit;       ///< Of the build; "+" where sources had been changed.
  double clock_step = 0.0;  ///< The clock's resolution: the smallest step seen [ns].
  bool pinned = false;      ///< The thread stays on one core.
};

/// Pins the calling thread to the core that it is on, where that is allowed and wanted, and looks
/// about.
[[nodiscard]] Machine takeMachine(bool pin = true);

/// One line of it, for the head of a table.
[[nodiscard]] std::string describe(const Machine& machine);

}  // namespace palpate::bench
