/// Grids computed from grids, once, at load.
#pragma once

#include <memory>

#include "palpate/engine/graph.h"
#include "palpate/samplers/volume.h"

namespace palpate {

/// A volume whose voxels hold what is derived of `volume`'s, in the same place and of the same
/// precision: magnitude, unit, curl, divergence, q or lambda2 of a vector, gradient of a scalar.
///
/// Derivatives are central differences at the voxel through the grid's map, per unit of the file:
/// what makeVdbField interpolates. Active states are kept; inactive voxels and the background are
/// 0; neighbours are read as they are stored, so at the edge of the active voxels a derivative is a
/// difference to the background. Active tiles stay tiles but for their outermost leaves; of those
/// of more than 128 voxels the derivative at their own faces is left out. Interpolating the result
/// is not the same as deriving what was interpolated: decisions/0017 says how far they differ.
///
/// A vector of three grids is read trilinearly at the voxels of the first, where all have data; a
/// tile of more than 128 voxels is 0 there.
///
/// Throws VolumeError where the volume is not of the kind that `what` needs, or a value is beyond
/// the grid's type. In parallel over leaves; 4 ns a voxel and core for a magnitude, 25 for a curl,
/// 85 for lambda2.
[[nodiscard]] std::shared_ptr<const Volume> deriveVolume(
    const std::shared_ptr<const Volume>& volume, Derivation what);

}  // namespace palpate
