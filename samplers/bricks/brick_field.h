/// A volume in bricks, placed in W, as a field of the engine.
#pragma once

#include <memory>

#include "palpate/engine/field/field.h"
#include "palpate/samplers/bricks/brick_window.h"
#include "palpate/samplers/grid/vdb_field.h"

namespace palpate {

/// Makes a trilinear field over a window of bricks. Where all finest bricks around a point are
/// loaded and have faded in, it equals makeVdbField of the volume that loadBricks makes of level 0.
///
/// Elsewhere the field blends levels, finest first: B_l = s_l L_l + (1 - s_l) B_(l+1), where L_l is
/// the trilinear value of level l alone, and B_0 is the value of the field. The share s_l is 0
/// where the brick of level l is missing. It is 1 where every missing brick of the level is at
/// least 4 voxels of the level away. When a brick arrives near a proxy, the share grows to 1 within
/// 10 ms. So values and gradients are continuous in space and, while bricks arrive, in time. The
/// coarsest level is always loaded. If a coarser level contributes to a sample, its `coarse` is
/// true.
///
/// `slope_reach`: see Sampling. RT: no allocation; no lock, except in attend() if
/// WindowParams::waits is true. A reading in a new cell reads 64 voxels per level.
[[nodiscard]] FieldPtr makeBrickField(std::shared_ptr<const BrickWindow> window,
                                      const Placement& placement, double slope_reach = 0.5);

}  // namespace palpate
