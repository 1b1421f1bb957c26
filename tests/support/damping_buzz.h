/// A hand that presses on a wall through a damped coupling and an encoder: what the encoder's steps
/// become in the force.
#pragma once

#include "palpate/engine/coupling.h"

namespace palpate::bench {

struct DampedPress {
  double rate = 1000.0;          ///< [Hz]
  double encoder = 30e-6;        ///< [m]
  double damping = 0.5;          ///< Of the coupling [N s/m].
  double rate_time = kRateTime;  ///< Of LengthRate [s].
};

/// Force above 100 Hz, rms [N]: four seconds on a wall of 500 N/m, 4 mm deep, to and fro at 10 mm/s
/// with a tremor of 0.1 mm at 9 Hz; the arm is SimulatedDevice's without Coulomb's friction, which
/// would swallow steps, the hand relaxed.
[[nodiscard]] double buzzOf(const DampedPress& press);

}  // namespace palpate::bench
