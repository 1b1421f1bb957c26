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
/// Elsewhere the field blends levels, finest first: B_l = s_l L_l + (1 - s_l) B_(l+1). The share
/// s_l is 0 where the brick of level l is missing. It is 1 where every missing brick of the level
/// is at least 4 voxels of the level away. When a brick arrives near a proxy, the share grows to 1
/// within 10 ms. So values and gradients are continuous in space and, while bricks arrive, in time.
/// They do not depend on the reader. The coarsest level is always loaded. Readings with a share of
/// a coarser level are marked (ScalarSample::coarse).
///
/// `slope_reach`: see Sampling. RT: no lock, no allocation. A reading in a new cell copies 64
/// values per level.
[[nodiscard]] FieldPtr makeBrickField(std::shared_ptr<const BrickWindow> window,
                                      const Placement& placement, double slope_reach = 0.5);

}  // namespace palpate
