/// A stream's line that holds the proxy: the balance gives the arc length by which the proxy goes
/// along the curve.
#pragma once

#include "palpate/engine/felt.h"
#include "palpate/engine/primitive.h"
#include "palpate/engine/tick.h"
#include "palpate/engine/trial.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Where layRail has laid the line of a stream, for the balances of the readings that follow.
struct Rail {
  bool laid = false;                ///< The curve has been traced on the path from this proxy.
  const ModeMemory* of = nullptr;   ///< Memory of the line's mode; null: no line holds.
  int motion = -1;                  ///< That of the line's volume; -1: it stands still.
  Vec3 along_rest = Vec3::UnitX();  ///< Direction of the line where its volume rests.
  Primitive line;                   ///< The tangent at the place to which the curve led.
  /// How much farther on the probe would have to be for the end of the trial step to be the balance
  /// [m]: the curve left the tangent, and what the tangent held is not all across the new tangent.
  Vec3 waiting = Vec3::Zero();
};

/// A reading at `at` [m] has said anew how volumes deform: a line stays on its matter, where
/// the curve led at rest. RT: no allocation.
void keepRail(const Tick& tick, const Vec3& at, Rail& rail) noexcept PALPATE_NONBLOCKING;

/// Lays the first line that holds the proxy, whose balance is `balance` [m], along its curve, and
/// moves the trial step there. See docs/tick.md, rail. RT: no allocation. Cost: VectorField::trace.
void layRail(Tick& tick, const Vec3& balance, Rail& rail,
             Trial& trial) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
