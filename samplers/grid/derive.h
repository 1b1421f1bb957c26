/// Grids that are computed from other grids when a scene is loaded.
#pragma once

#include <memory>

#include "palpate/engine/scene/graph.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Makes a volume of a property derived from `volume`, with the same voxels and precision. The
/// property is the magnitude, unit, curl, divergence, q or lambda2 of a vector, or the gradient of
/// a scalar.
///
/// Derivatives are central differences at the voxels, per unit of the file, as makeVdbField
/// interpolates them. Active states are kept. Inactive voxels and the background are 0. Where the
/// data end (data_ends.h), the derivative of a vector is one-sided, and the gradient of a scalar is
/// a difference to the stored values beyond. Active tiles stay tiles, except that for derivatives
/// voxels at their faces become leaves. The derivative of a tile of more than 128 voxels along an
/// edge is 0, also at the tile's faces. docs/decisions/0017 states how far results differ from
/// properties of interpolated values.
///
/// A vector of three grids is read trilinearly at the voxels of the first grid. Voxels where one of
/// the three has no data become inactive. All active tiles of the first grid become leaves, except
/// tiles of more than 128 voxels along an edge, which become 0.
///
/// Throws VolumeError if the type of the volume does not suit `what`, if a value exceeds the range
/// of the grid's type, or if the result has no active voxel. Parallel over leaves. Slow: computes
/// every active voxel.
[[nodiscard]] std::shared_ptr<const Volume> deriveVolume(
    const std::shared_ptr<const Volume>& volume, Derivation what);

}  // namespace palpate
