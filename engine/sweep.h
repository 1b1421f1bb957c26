/// The sweep: a proxy never passes a surface without having reached it.
#pragma once

#include "palpate/engine/iteration.h"
#include "palpate/engine/tick.h"
#include "palpate/engine/trial.h"

namespace palpate {

/// Ends a trial step where it first falls through a surface from the free side. Its path is swept
/// in the resting frame of each surface's volume: above a surface in contact, by a quarter of its
/// length. There a path below a tenth of a voxel is not swept but judged by the last reading. A
/// surface that yields does not end the step. RT: no allocation. Cost: ScalarField::firstFall.
void sweep(Tick& tick, const Iteration& now, Trial& trial) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
