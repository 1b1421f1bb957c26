/// A volume in bricks, placed in the hand's world, as a field of the engine.
#pragma once

#include <memory>

#include "palpate/engine/field.h"
#include "palpate/samplers/brick_window.h"
#include "palpate/samplers/vdb_field.h"

namespace palpate {

/// A field over a window of bricks; trilinear, as makeVdbField reads the whole volume, and to the
/// last bit the same wherever all bricks about a place are there at the finest level.
///
/// Elsewhere levels are blended, from the finest on: B_l = s_l L_l + (1 - s_l) B_(l+1). A level's
/// share s_l is 0 where its brick is missing, and 1 at 4 voxels of it from any that is; that of a
/// brick that arrives where a proxy is grows within 10 ms. So values and gradients are continuous
/// in space, and in time while bricks come; they are what a place and a moment say, whoever reads.
/// The coarsest level is always there: what is felt has neither holes nor walls that its data do
/// not have at some level. What is read so is told as coarse (ScalarSample::coarse).
///
/// RT: no lock, no allocation; a cell that is not the last one read is copied, 64 values a level.
[[nodiscard]] FieldPtr makeBrickField(std::shared_ptr<const BrickWindow> window,
                                      const Placement& placement);

}  // namespace palpate
