/// A trial step: how far the proxy may go at once on its path to a target.
#pragma once

#include "palpate/engine/tick.h"
#include "palpate/engine/types.h"

namespace palpate {

struct Iteration;

/// A step that the proxy may take, and what ended it.
struct Trial {
  Vec3 end;                  ///< Where the step ends [m].
  bool complete = true;      ///< The step reaches its target.
  bool cut = false;          ///< The proxy moves to `end`: the data can be trusted no farther.
  bool trusted = false;      ///< The trust radius of Newton's step ended the step.
  bool near = true;          ///< What was read where the step starts still holds at the target.
  bool met = false;          ///< The step reached a surface.
  bool strays = false;       ///< The step led beyond the parts that were chosen.
  bool swept = true;         ///< All of the step was searched for surfaces.
  Vec3 lift = Vec3::Zero();  ///< Height of the path that met a surface above the proxy's own [m].
};

/// Goes towards the target of an iteration: at most a voxel where there is data, at most the trust
/// radius of Newton's step, along the curve that holds the proxy, and until the step first falls
/// through a surface. `unread`: nothing is to be read on the path. RT: no allocation.
[[nodiscard]] Trial advance(Tick& tick, Iteration& now, bool unread) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
