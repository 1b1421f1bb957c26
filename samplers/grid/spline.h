/// Private to samplers: computes the B-spline coefficients of a grid. Include it in .cpp files
/// only.
#pragma once

#include <vector>

#include "palpate/samplers/grid/volume_grid.h"

namespace palpate {

/// Returns the coefficients with which a B-spline of degree 2 or 3 passes through the values of a
/// volume, for each part. Along each axis, a recursive filter with one pole runs forward and back
/// (Unser, Aldroubi, Eden 1993). The first call for a degree computes the coefficients, and the
/// volume keeps them. Other threads that call it meanwhile wait for that result.
///
/// The tree and the active states are those of the grid, with inactive leaves added around it. In a
/// level set, the corners of cells that hold the surface (band_cell.h) are active too. The
/// filter reaches 8 voxels beyond the leaves. There its weight has fallen below 1e-4. Active tiles
/// of 8^3 voxels become leaves. Larger tiles get leaves along their faces. Exception: at faces of
/// tiles of 4096^3 voxels that are not next to a leaf, the spline smooths the values and does not
/// pass through them. Parallel, in place.
[[nodiscard]] const std::vector<GridData>& splineCoefficients(const Volume& volume, int degree);

}  // namespace palpate
