/// Moves the proxy to the balance by Newton's method, slice by slice of a tick.
#pragma once

#include "palpate/engine/tick/tick.h"

namespace palpate {

/// Moves the volumes to their poses at `time` [s], and the proxy to the balance for this tick's
/// hand. Ends when the primitives that were read at the proxy balance there, or when the readings
/// or iterations of the tick are used up. The status in the report states which. Returns false if a
/// sample that is not finite made the balance invalid. See docs/tick.md. RT: no allocation.
[[nodiscard]] bool moveProxy(Tick& tick, double time) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
