/// Corrections to the plane of one surface, for other solids and for the walls of a groove.
#pragma once

#include <optional>

#include "palpate/engine/modes/contact.h"
#include "palpate/engine/tick/felt.h"
#include "palpate/engine/tick/tick.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Returns the terms that other solids add to the gradient of a mode's surface, and the loads of
/// the walls of a groove. x [m] is the place of the last reading.
///
/// The gradient g of surface i is a difference of V over the steps a of FieldFrame::reach. Beside
/// another solid j, some of the samples are inside j, and the plane of i would tilt away from the
/// common surface. So the samples at y = x +- a are filled from j. Let v be the signed value,
/// positive on the free side, c_i the slope of the cell of i at x, and v_j be in the unit of i:
///
///     v~(y) = min( v_i(y), max( v_j(y), v_i(x) + c_i.(y - x) ) )
///     g~    = g + S^-T d,    d_a = [ (v~ - v_i)(x + a) - (v~ - v_i)(x - a) ] / 2
///
/// The columns of S are the steps. Beyond an edge of i, j continues the surface of i, at most up to
/// the tangent plane of i. Row a of dd/dx is the sum of +-(slope of the chosen branch at y - slope
/// of v_i at y) / 2.
///
/// Returns no value in these cases: the mode is not an isosurface, or has no strength; no other
/// isosurface that holds is within two steps, and the surface has no grooves; the surface yields,
/// or the hand has pushed through it; the proxy is free and does not touch it; the gradient is not
/// a difference of values (splines, formulas); the reading is coarse, or shows no surface within
/// two voxels. At most eight other surfaces count. Surfaces of the same field do not fill each
/// other's samples. For moving volumes the samples are taken in each resting frame; a warp counts
/// as linear about x. RT: no allocation. Cost: a check of each other surface. Beside another
/// surface, seven values of this surface, at most six of each other one, and their slopes. With
/// SurfaceSource::grooves, the Jacobian of the gradient, and nine values in a groove.
[[nodiscard]] std::optional<Seam> seamOf(const Tick& tick, const Mode& mode, ModeMemory& memory,
                                         const Felt& felt,
                                         const Vec3& x) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
