/// A trial step: how far the proxy may go at once on its path to a target.
#pragma once

#include "palpate/engine/tick/tick.h"
#include "palpate/engine/types.h"

namespace palpate {

struct Iteration;

/// A step that the proxy may take, and its limit.
struct Trial {
  Vec3 end;                  ///< End of the step [m].
  bool complete = true;      ///< The step reaches its target.
  bool cut = false;          ///< The proxy moves to `end`: the data can be trusted no farther.
  bool trusted = false;      ///< The trust radius of Newton's step ended the step.
  bool near = true;          ///< The reading at the step's start still holds at the target.
  bool met = false;          ///< The step reached a surface.
  bool strays = false;       ///< The step led beyond the chosen parts.
  bool swept = true;         ///< All of the step was searched for surfaces.
  double reach = 0.0;        ///< The reading at the step's start holds this far [m].
  Vec3 lift = Vec3::Zero();  ///< Offset of the path that met a surface from the proxy's own [m].
};

/// Returns the trial step towards the target of an iteration. The step is at most one voxel long
/// where there is data, and at most as long as the trust radius of Newton's step. It follows the
/// curve that holds the proxy, and ends where it first falls through a surface. `unread`:
/// properties will not be read on the path. RT: no allocation.
[[nodiscard]] Trial advance(Tick& tick, Iteration& now, bool unread) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
