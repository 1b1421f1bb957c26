/// The sweep: finds surfaces on the proxy's path, so that the proxy does not pass through them.
#pragma once

#include <cstdint>

#include "palpate/engine/tick/iteration.h"
#include "palpate/engine/tick/tick.h"
#include "palpate/engine/tick/trial.h"

namespace palpate {

/// Ends a trial step at the first surface that it passes from the free side. The path is swept in
/// the resting frame of each surface's volume. For a surface in contact, the path is lifted by a
/// quarter of its length, at most a quarter of a voxel. If this path is shorter than a tenth of a
/// voxel, the last reading suffices. For any other surface, the path has the common lift of the
/// planes that bear load. A surface that yields or has no strength does not end the step. RT: no
/// allocation. Cost: ScalarField::firstFall for each surface near the path.
void sweep(Tick& tick, const Iteration& now, Trial& trial) noexcept PALPATE_NONBLOCKING;

/// Returns true if no surface with a field in `fields` stops the proxy. The proxy must be in front
/// of all these surfaces without contact, and the straight path to the hand must pass none. Bit i
/// of `fields` is Graph::scalar_fields[i]. Requires a scene without parts and motions. RT: no
/// allocation. Cost: ScalarField::firstFall for each of these surfaces.
[[nodiscard]] bool isPathClear(Tick& tick, std::uint64_t fields) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
