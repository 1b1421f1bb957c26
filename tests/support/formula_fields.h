/// Fields that are computed from formulas: a half-space and a vortex.
#pragma once

#include <memory>

#include "palpate/engine/field/field.h"

namespace palpate {

/// Makes a scalar field: the height [m] above the plane through `point` with this normal.
[[nodiscard]] std::shared_ptr<const ScalarField> makeHalfSpace(const Vec3& point,
                                                               const Vec3& normal,
                                                               double voxel = 1e-3);

/// Makes a rigid vortex about an axis through `centre`, with a flow along the axis:
/// v = omega x r + axial e. curl v = 2 omega, div v = 0. The field has data within `radius` [m] of
/// `centre`.
[[nodiscard]] std::shared_ptr<const VectorField> makeVortex(const Vec3& centre, const Vec3& omega,
                                                            double axial, double radius,
                                                            double voxel = 1e-3);

}  // namespace palpate
