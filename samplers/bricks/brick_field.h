/// A volume in bricks, placed in the hand's world, as a field of the engine.
#pragma once

#include <memory>

#include "palpate/engine/field/field.h"
#include "palpate/samplers/bricks/brick_window.h"
#include "palpate/samplers/grid/vdb_field.h"

namespace palpate {

/// Makes a trilinear field over a window of bricks. Where all bricks around a point are loaded and
/// faded in at the finest level, it equals makeVdbField of the whole volume to the last bit.
///
/// Elsewhere the field blends levels, from the finest on: B_l = s_l L_l + (1 - s_l) B_(l+1). The
/// share s_l of a level is 0 where its brick is missing. It is 1 where every missing brick is at
/// least 4 voxels of that level away. When a brick arrives at a proxy, the share of its level grows
/// within 10 ms. So values and gradients are continuous in space, and in time while bricks arrive.
/// They depend on place and time alone, not on the reader. The coarsest level is always loaded: the
/// hand feels neither holes nor walls that the data do not have at some level. Readings that use a
/// coarser level are marked (ScalarSample::coarse).
///
/// `slope_reach`: see Sampling. RT: no lock, no allocation. A reading in another cell than the
/// previous reading copies 64 values per level.
[[nodiscard]] FieldPtr makeBrickField(std::shared_ptr<const BrickWindow> window,
                                      const Placement& placement, double slope_reach = 0.5);

}  // namespace palpate
