/// The proxy goes where the balance puts it: Newton on the balance, slice by slice of a tick.
#pragma once

#include "palpate/engine/tick.h"

namespace palpate {

/// Moves the proxy, the volumes and what is remembered on to this tick's hand, until what was read
/// at the proxy balances there, or the tick's readings are used up: the report says which. False
/// where a sample that is not finite spoilt the balance. See docs/tick.md. RT: no allocation.
[[nodiscard]] bool moveProxy(Tick& tick, double time) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
