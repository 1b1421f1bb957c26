/// A trial step: how far the proxy may go at once on its way to a target.
#pragma once

#include "palpate/engine/tick.h"
#include "palpate/engine/types.h"

namespace palpate {

struct Iteration;

struct Trial {
  Vec3 end;                  ///< [m]
  bool complete = true;      ///< It is the target.
  bool cut = false;          ///< Else: only as far as the data can be trusted,
  bool trusted = false;      ///< or as Newton's step is.
  bool near = true;          ///< To where properties were read last.
  bool met = false;          ///< It met a surface.
  bool strays = false;       ///< It led beyond the parts that were chosen.
  bool swept = true;         ///< All of it, for the surfaces on it.
  Vec3 lift = Vec3::Zero();  ///< What met a surface went so far above the proxy's own way [m].
};

/// Towards the target of an iteration: at most a voxel where there is data, at most as far as
/// Newton's step is trusted, along the curve that holds the proxy, and until it first falls through
/// a surface. `unread`: nothing is to be read on the way. RT: no allocation.
[[nodiscard]] Trial advance(Tick& tick, Iteration& now, bool unread) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
