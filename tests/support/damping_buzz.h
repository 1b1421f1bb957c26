/// Measures the effect of encoder steps on the force, for a hand that presses on a wall through a
/// damped coupling.
#pragma once

#include "palpate/engine/balance/coupling.h"

namespace palpate::bench {

struct DampedPress {
  double rate = 1000.0;          ///< [Hz]
  double encoder = 30e-6;        ///< [m]
  double damping = 0.5;          ///< Damping of the coupling [N s/m].
  double rate_time = kRateTime;  ///< Time over which LengthRate measures [s].
};

/// Returns the RMS force above 100 Hz [N]. For 4 s the hand is 4 mm deep in a wall of 500 N/m,
/// moves back and forth at 10 mm/s, and has a tremor of 0.1 mm at 9 Hz. The arm is
/// SimulatedDevice's without Coulomb friction, which would hide the steps. The grip is relaxed.
[[nodiscard]] double buzzOf(const DampedPress& press);

}  // namespace palpate::bench
