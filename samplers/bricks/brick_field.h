/// A volume in bricks, placed in W, as a field of the engine.
#pragma once

#include <memory>

#include "palpate/engine/field/field.h"
#include "palpate/samplers/bricks/brick_window.h"
#include "palpate/samplers/grid/vdb_field.h"

namespace palpate {

/// Makes a trilinear field over a window of bricks. Where all finest bricks around a point are
/// loaded and have faded in, it equals makeVdbField of the whole volume to the last bit.
///
/// Elsewhere the field blends levels, finest first: B_l = s_l L_l + (1 - s_l) B_(l+1), where L_l is
/// the trilinear value of level l alone, and B_0 is the value of the field. The share s_l is 0
/// where the brick of level l is missing. It is 1 where every missing brick of the level is at
/// least 4 voxels of the level away. When a brick arrives near a proxy, the share grows to 1 within
/// 10 ms. So values and gradients are continuous in space and, while bricks arrive, in time. All
/// readers get the same values and gradients. The coarsest level is always loaded. If a coarser
/// level contributes to a reading, ScalarSample::coarse is true.
///
/// `slope_reach`: see Sampling. RT: no lock, no allocation. A reading in a new cell copies 64
/// values per level.
[[nodiscard]] FieldPtr makeBrickField(std::shared_ptr<const BrickWindow> window,
                                      const Placement& placement, double slope_reach = 0.5);

}  // namespace palpate
