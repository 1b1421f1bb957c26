/// Moves the proxy to the balance: Newton's method on the balance, slice by slice of a tick.
#pragma once

#include "palpate/engine/tick/tick.h"

namespace palpate {

/// Moves the proxy, the volumes and their remembered state on to this tick's hand. It ends when the
/// properties read at the proxy balance there, or when the tick's readings are used up; the report
/// shows which. Returns false if a sample that is not finite spoilt the balance. See docs/tick.md.
/// RT: no allocation.
[[nodiscard]] bool moveProxy(Tick& tick, double time) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
