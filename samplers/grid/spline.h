/// Private to samplers, for .cpp files only: computes the B-spline coefficients of a grid.
#pragma once

#include <vector>

#include "palpate/samplers/grid/volume_grid.h"

namespace palpate {

/// Returns, for each part, the coefficients with which a B-spline of degree 2 or 3 passes through a
/// volume's values. Along each axis, a recursive filter with one pole runs forward and back (Unser,
/// Aldroubi, Eden 1993). The volume keeps the result. Callers that request it during the
/// computation wait.
///
/// The tree and the active states are those of the grid, with inactive leaves added around it. The
/// filter reaches 8 voxels beyond the leaves, where its weight is below 1e-4. In a level set, the
/// corners of cells that hold the surface (band_cell.h) are active too. Active tiles of 8^3 and of
/// 128^3 voxels get leaves along faces with a different neighbour. At faces of 4096^3 tiles that
/// are not next to a leaf, the spline only smooths the values. If inactive voxels have no data
/// (DataEnds), the filter reads values that are extrapolated into them, except in level sets.
/// Throws VolumeError if tiles need more than kMostAdded leaves and ten for each leaf. Parallel.
[[nodiscard]] const std::vector<GridData>& splineCoefficients(const Volume& volume, int degree);

}  // namespace palpate
