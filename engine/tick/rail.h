/// The line of a stream that holds the proxy: the proxy follows the curve to the place nearest to
/// the hand.
#pragma once

#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/tick/felt.h"
#include "palpate/engine/tick/tick.h"
#include "palpate/engine/tick/trial.h"
#include "palpate/engine/types.h"

namespace palpate {

/// The line of a stream as layRail has laid it, for the balances of the readings that follow.
struct Rail {
  bool laid = false;                ///< The curve has been traced for the last balance.
  bool any = false;                 ///< A stream had a line to lay.
  const ModeMemory* of = nullptr;   ///< Memory of the line's mode; null: no line holds.
  int motion = -1;                  ///< Motion of the line's volume; -1: it stands still.
  Vec3 along_rest = Vec3::UnitX();  ///< Direction of the line where its volume rests.
  Primitive line;                   ///< The tangent at the end of the traced curve.
  /// Shift of the probe [m] that balances the line at `line.position`: minus the pull that is left
  /// along the stream. Zero if that pull is above the tolerance.
  Vec3 waiting = Vec3::Zero();
};

/// Re-anchors the line to its material point after a reading at `at` [m] has sampled the warp
/// again. That point is where the curve led at rest. RT: no allocation.
void keepRail(const Tick& tick, const Vec3& at, Rail& rail) noexcept PALPATE_NONBLOCKING;

/// Lays the first line along its curve and moves the trial step there: to the place nearest to the
/// hand, as far as the last reading holds. `balance` [m] is the last balance. See docs/tick.md,
/// rail. RT: no allocation. Cost: VectorField::trace.
void layRail(Tick& tick, const Vec3& balance, Rail& rail,
             Trial& trial) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
