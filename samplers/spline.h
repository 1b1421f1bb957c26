/// Private to samplers: B-spline coefficients of a grid. Include it in .cpp files only.
#pragma once

#include <openvdb/openvdb.h>

namespace palpate {

/// The coefficients with which a B-spline of degree 2 or 3 passes through the grid's values: each
/// axis filtered by the inverse of the spline's own samples (Unser, Aldroubi, Eden 1993), cut where
/// it falls below 1e-9. Topology and active states are the grid's, with inactive leaves around:
/// the filter reaches 8 voxels beyond the leaves. Active tiles of 8^3 become leaves; on the faces
/// of larger ones that border on no leaf the spline smooths instead of passing through. Parallel
/// over leaves. Takes about twice the grid's memory while it works.
template <class GridT>
[[nodiscard]] typename GridT::Ptr splineCoefficients(const GridT& grid, int degree);

}  // namespace palpate
