/// Private to samplers: B-spline coefficients of a grid. Include it in .cpp files only.
#pragma once

#include <vector>

#include "palpate/samplers/volume_grid.h"

namespace palpate {

/// The coefficients with which a B-spline of degree 2 or 3 passes through a volume's values, part
/// by part: each axis filtered by the inverse of the spline's own samples, forward and back with
/// one pole (Unser, Aldroubi, Eden 1993). Made at the first call for a degree and kept with the
/// volume; calls from several threads wait for the first. Topology and active states are the
/// grid's, with inactive leaves around: the filter reaches 8 voxels beyond the leaves, where it has
/// fallen below 1e-4. Active tiles of 8^3 become leaves, larger ones get leaves along their faces;
/// on the faces of 4096^3 tiles that border on no leaf the spline smooths instead of passing
/// through. Parallel, in place.
[[nodiscard]] const std::vector<GridData>& splineCoefficients(const Volume& volume, int degree);

}  // namespace palpate
