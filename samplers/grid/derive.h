/// Grids that are computed from other grids, once, at load.
#pragma once

#include <memory>

#include "palpate/engine/scene/graph.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Makes a volume whose voxels hold a property derived from `volume`, in the same place and of the
/// same precision: magnitude, unit, curl, divergence, q or lambda2 of a vector, gradient of a
/// scalar.
///
/// Derivatives are central differences at the voxel through the grid's map, per unit of the file:
/// makeVdbField interpolates the same differences. Active states are kept; inactive voxels and the
/// background are 0. Neighbours are read as they are stored, so at the edge of the active voxels a
/// derivative is a difference to the background. Active tiles stay tiles except for their outermost
/// leaves. In tiles of more than 128 voxels along an edge, the derivative at their own faces is
/// left out. An interpolated result differs from a derivation of interpolated values:
/// decisions/0017 says by how much.
///
/// A vector of three grids is read trilinearly at the voxels of the first grid, where all three
/// have data; a tile of more than 128 voxels along an edge becomes 0.
///
/// Throws VolumeError if the volume is not of the kind that `what` needs, or if a value is beyond
/// the grid's type. Parallel over leaves. Cost per voxel and core: 4 ns for a magnitude, 25 ns for
/// a curl, 85 ns for lambda2.
[[nodiscard]] std::shared_ptr<const Volume> deriveVolume(
    const std::shared_ptr<const Volume>& volume, Derivation what);

}  // namespace palpate
