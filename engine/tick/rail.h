/// Streamline tracking: the proxy follows a curve of the stream to the place nearest to the hand.
#pragma once

#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/tick/felt.h"
#include "palpate/engine/tick/tick.h"
#include "palpate/engine/tick/trial.h"
#include "palpate/engine/types.h"

namespace palpate {

/// The line of a stream after layRail has traced its curve. The balances of the following readings
/// use it.
struct Rail {
  bool laid = false;  ///< True if the curve was traced for the last balance.
  bool any = false;   ///< True if a stream has a line.
  /// Memory of the mode that added the line; null if no line holds the proxy.
  const ModeMemory* of = nullptr;
  int motion = -1;                  ///< Motion of the line's volume; -1 if the volume stands still.
  Vec3 along_rest = Vec3::UnitX();  ///< Direction of the line in the resting frame of its volume.
  Primitive line;                   ///< Tangent at the end of the traced curve.
  /// Shift of the probe [m] that balances the line at `line.position`. It is the negative of the
  /// pull that is left along the stream, or zero if that pull exceeds the tolerance.
  Vec3 waiting = Vec3::Zero();
};

/// Re-anchors the line to its material point after a reading at `at` [m] has sampled the warp
/// again. That point is the end of the curve, in the resting frame. RT: no allocation.
void keepRail(const Tick& tick, const Vec3& at, Rail& rail) noexcept PALPATE_NONBLOCKING;

/// Traces the curve of the first line and moves the trial step to its end. This is the place
/// nearest to the hand, as far as the last reading is valid. `balance` [m] is the last balance. See
/// docs/tick.md, rail. RT: no allocation. Cost: VectorField::trace.
void layRail(Tick& tick, const Vec3& balance, Rail& rail,
             Trial& trial) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
