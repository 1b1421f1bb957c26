/// Measures how an encoder's steps appear in the force on a hand that presses on a wall through a
/// damped coupling.
#pragma once

#include "palpate/engine/balance/coupling.h"

namespace palpate::bench {

struct DampedPress {
  double rate = 1000.0;          ///< [Hz]
  double encoder = 30e-6;        ///< [m]
  double damping = 0.5;          ///< Damping of the coupling [N s/m].
  double rate_time = kRateTime;  ///< Time constant of LengthRate [s].
};

/// Returns the RMS of the force above 100 Hz [N]. The hand spends four seconds on a wall of 500
/// N/m, 4 mm deep. It moves to and fro at 10 mm/s with a tremor of 0.1 mm at 9 Hz. The arm is
/// SimulatedDevice's without Coulomb friction, which would hide the steps. The hand's grip is
/// relaxed.
[[nodiscard]] double buzzOf(const DampedPress& press);

}  // namespace palpate::bench
