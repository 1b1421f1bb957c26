/// The sweep: a proxy never passes a surface without having reached it.
#pragma once

#include "palpate/engine/tick/iteration.h"
#include "palpate/engine/tick/tick.h"
#include "palpate/engine/tick/trial.h"

namespace palpate {

/// Ends a trial step where it first falls through a surface from the free side. The path is swept
/// in the resting frame of each surface's volume. A surface in contact is swept a quarter of the
/// path's length above it; there the last reading judges a path below a tenth of a voxel. Any other
/// surface is swept at the lift of the planes that bear load. A surface that yields does not end
/// the step. RT: no allocation. Cost: ScalarField::firstFall.
void sweep(Tick& tick, const Iteration& now, Trial& trial) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
