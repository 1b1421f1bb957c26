/// A trial step: how far the proxy may move at once towards a target.
#pragma once

#include "palpate/engine/tick/tick.h"
#include "palpate/engine/types.h"

namespace palpate {

struct Iteration;

/// A step that the proxy may take, and the limits that ended it.
struct Trial {
  Vec3 end;              ///< End of the step [m].
  bool complete = true;  ///< True if the step reaches its target.
  bool cut = false;      ///< True if the proxy moves to `end`: the reading is valid no farther, the
                         ///< chosen parts end there, or a surface without a plane is there.
  bool trusted = false;  ///< True if the trust radius of Newton's step ended the step.
  bool near = true;  ///< True if the reading at the start of the step is still valid at the target.
  bool met = false;  ///< True if the step reached a surface.
  bool strays = false;  ///< True if the step led beyond the chosen parts.
  bool swept = true;    ///< True if the whole step was searched for surfaces.
  double reach = 0.0;   ///< Distance to which the reading at the start of the step is valid [m].
  /// Offset from the proxy's path to the swept path that met a surface [m].
  Vec3 lift = Vec3::Zero();
};

/// Returns the trial step towards the target of an iteration. Within data the step is at most one
/// voxel long (along a single stream 16), and at most the trust radius. The step follows the curve
/// that holds the proxy, and ends at the first surface. If `unread` is true, properties will not be
/// read on the path, and the voxel does not limit the step. RT: no allocation.
[[nodiscard]] Trial advance(Tick& tick, Iteration& now, bool unread) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
