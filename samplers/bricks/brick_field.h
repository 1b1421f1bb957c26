/// A volume in bricks, placed in the hand's world, as a field of the engine.
#pragma once

#include <memory>

#include "palpate/engine/field/field.h"
#include "palpate/samplers/bricks/brick_window.h"
#include "palpate/samplers/grid/vdb_field.h"

namespace palpate {

/// Makes a trilinear field over a window of bricks. Where all bricks of the finest level around a
/// point are loaded and have faded in, the field equals makeVdbField of the whole volume to the
/// last bit.
///
/// Elsewhere the field blends levels, beginning with the finest: B_l = s_l L_l + (1 - s_l) B_(l+1).
/// The share s_l of a level is 0 where its brick is missing, and 1 where every missing brick of the
/// level is at least 4 voxels of that level away. When a brick arrives near a proxy, the share of
/// its level grows to 1 within 10 ms. So values and gradients are continuous in space, and also in
/// time while bricks arrive. They depend only on place and time, not on the reader. Because the
/// coarsest level is always loaded, the hand feels no hole and no wall that is absent from all
/// levels. Readings to which a coarser level contributes are marked (ScalarSample::coarse).
///
/// `slope_reach`: see Sampling. RT: no lock, no allocation. A reading in a new cell copies 64
/// values per level.
[[nodiscard]] FieldPtr makeBrickField(std::shared_ptr<const BrickWindow> window,
                                      const Placement& placement, double slope_reach = 0.5);

}  // namespace palpate
