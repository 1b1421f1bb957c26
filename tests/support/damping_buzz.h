/// Measures the effect of encoder steps on the force, for a hand that presses on a wall through a
/// damped coupling.
#pragma once

#include "palpate/engine/balance/coupling.h"

namespace palpate::bench {

struct DampedPress {
  double rate = 1000.0;          ///< Rate of the loop [Hz].
  double encoder = 30e-6;        ///< Encoder step [m].
  double damping = 0.5;          ///< Damping of the coupling [N s/m].
  double rate_time = kRateTime;  ///< Time over which LengthRate measures [s].
};

/// Returns the RMS force above 100 Hz [N]. For 4 s a grip (GripParams' defaults) pulls the hand to
/// a target 6 mm deep in a wall of 500 N/m. The target moves in and out at up to 10 mm/s, and has a
/// tremor of 0.1 mm at 9 Hz. The arm is SimulatedDevice's without an energy tank and without
/// Coulomb friction, which would hide the encoder steps. The first 500 ticks do not count.
[[nodiscard]] double buzzOf(const DampedPress& press);

}  // namespace palpate::bench
