/// Private to samplers: B-spline coefficients of a grid. Include it in .cpp files only.
#pragma once

#include <vector>

#include "palpate/samplers/grid/volume_grid.h"

namespace palpate {

/// Returns the coefficients with which a B-spline of degree 2 or 3 passes through a volume's
/// values, part by part. Each axis is filtered by the inverse of the spline's own samples, forward
/// and back with one pole (Unser, Aldroubi, Eden 1993). The first call for a degree makes the
/// coefficients, and the volume keeps them; calls from several threads wait for the first.
///
/// Topology and active states are those of the grid, plus inactive leaves around it. The filter
/// reaches 8 voxels beyond the leaves, where it has fallen below 1e-4. Active tiles of 8^3 become
/// leaves; larger tiles get leaves along their faces. On the faces of 4096^3 tiles that border on
/// no leaf, the spline smooths instead of passing through. Parallel, in place.
[[nodiscard]] const std::vector<GridData>& splineCoefficients(const Volume& volume, int degree);

}  // namespace palpate
