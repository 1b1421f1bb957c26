/// The sweep: a proxy never passes a surface that it has not met.
#pragma once

#include "palpate/engine/iteration.h"
#include "palpate/engine/tick.h"
#include "palpate/engine/trial.h"

namespace palpate {

/// Ends a trial step where it first falls through a surface from the free side. Swept is the way in
/// the resting frame of each surface's volume, as far above a surface that the proxy is on as a
/// quarter of its length; a shorter one than a tenth of a voxel is seen from where was read, and a
/// surface that yields is not met. RT: no allocation. Cost: ScalarField::firstFall.
void sweep(Tick& tick, const Iteration& now, Trial& trial) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
