/// A stream's line that holds the proxy: its length comes from the balance and is gone along the
/// curve.
#pragma once

#include "palpate/engine/felt.h"
#include "palpate/engine/primitive.h"
#include "palpate/engine/tick.h"
#include "palpate/engine/trial.h"
#include "palpate/engine/types.h"

namespace palpate {

struct Rail {
  bool laid = false;               ///< For the way from this proxy.
  const ModeMemory* of = nullptr;  ///< The mode's; null: no line holds.
  Primitive line;                  ///< The tangent where the curve led.
  /// How much farther on the probe would have to be for that to be the balance [m]: the curve led
  /// aside of the tangent, and what the tangent held is not all across the new one.
  Vec3 waiting = Vec3::Zero();
};

/// Lays the first line that holds the proxy, whose balance is `balance` [m], along its curve, and
/// moves the trial step there. docs/tick.md, stream. RT: no allocation. Cost: VectorField::trace.
void layRail(Tick& tick, const Vec3& balance, Rail& rail,
             Trial& trial) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
