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
/// Where they are not it is read at the finest level that is there. Towards the face of a brick
/// whose neighbour is missing the next coarser level that is there takes over, over 4 voxels, so
/// that values and gradients are continuous; a brick that arrives takes over by a share that grows
/// by at most 1/50 a tick and as the proxy goes, likewise over 4 voxels. The coarsest level is
/// always there: what is felt has neither holes nor walls that its data do not have at some level.
/// What is read so is told as coarse (ScalarSample::coarse).
///
/// RT: no lock, no allocation; a cell that is not the last one read is copied, 64 values a level.
[[nodiscard]] FieldPtr makeBrickField(std::shared_ptr<const BrickWindow> window,
                                      const Placement& placement);

}  // namespace palpate
