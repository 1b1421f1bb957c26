/// Grids that are computed from other grids when a scene is loaded.
#pragma once

#include <memory>

#include "palpate/engine/scene/graph.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Makes a volume whose voxels hold a property derived from `volume`, at the same place and with
/// the same precision. The property is the magnitude, unit, curl, divergence, q or lambda2 of a
/// vector, or the gradient of a scalar.
///
/// Derivatives are central differences at the voxels, mapped by the grid's transform, per unit of
/// the file. makeVdbField interpolates the same differences. Active states are kept. Inactive
/// voxels and the background are 0. Neighbours are read as they are stored. Where the data of a
/// vector end (data_ends.h), its derivative is a one-sided difference: the data do not say what is
/// beyond. The gradient of a scalar is a difference to the background there. Active tiles stay
/// tiles, except
/// that voxels at their faces become leaves. For tiles of more than 128 voxels along an edge, the
/// derivative at their own faces is left out. The interpolated result differs from a property that
/// is derived from interpolated values; docs/decisions/0017 states by how much.
///
/// For a vector of three grids, all three are read trilinearly at the voxels of the first grid,
/// where all three have data. In such a vector, a tile of more than 128 voxels along an edge
/// becomes 0.
///
/// Throws VolumeError if the type of the volume does not suit `what`, or if a value exceeds the
/// range of the grid's type. Parallel over leaves. Cost per voxel on one core: 4 ns for a
/// magnitude, 25 ns for a curl, 85 ns for lambda2.
[[nodiscard]] std::shared_ptr<const Volume> deriveVolume(
    const std::shared_ptr<const Volume>& volume, Derivation what);

}  // namespace palpate
