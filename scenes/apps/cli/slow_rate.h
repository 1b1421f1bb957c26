/// Prints a note about tick rates at which the forces differ from those on an arm.
#pragma once

#include <fmt/format.h>

#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {

inline constexpr double kSlowRate = 500.0;  ///< Lowest rate of a run in real time [Hz].

/// Prints a note if `rate` [Hz] is below kSlowRate. `command` is the name of the command.
inline void noteSlowRate(const char* command, double rate) {
  if (!(rate < kSlowRate)) return;
  constexpr double kHandSpeed = 0.1;  // [m/s]
  complain(fmt::format(
      "{}: --rate: at {} Hz a hand at {} m/s moves {} mm between two ticks: the force changes in "
      "steps, and the damper and the limiter act differently than on an arm: use 1000 Hz",
      command, rate, kHandSpeed, rounded(1e3 * kHandSpeed / rate)));
}

}  // namespace palpate::cli
