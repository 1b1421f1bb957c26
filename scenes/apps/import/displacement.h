/// Makes the field of a scene's "warp" from the displacement field of a registration.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "palpate/scenes/apps/import/grids.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Direction in which the vectors of a displacement field point.
enum class Direction : std::uint8_t {
  /// From the fixed image, which shows the present, to the moving image, which shows the resting
  /// place. This is the transform of ITK, ANTs and elastix, and the direction of a "warp".
  kBackward,
  kForward,  ///< From the resting place to the present one.
};

/// Checks a displacement field, and replaces a forward field by its inverse on the same voxels.
///
/// The check is that of a scene's "warp" (makeWarp), so a scene accepts the field. The inverse u at
/// the place y solves u + v(y + u) = 0, where v is the spline of the given field. Newton's
/// iteration u -= (I + dv/dx)^-1 (u + v) has this u as its fixed point. The notes state the
/// residual |u + v| at the voxels and between them. Beyond the faces of the given field, v is
/// constant. The notes state the share of the voxels whose place y + u is more than 1e-4 voxel
/// beyond a face.
///
/// Throws VolumeError or SceneError, which name `file`: voxels have no data; the field or its
/// inverse folds space or changes lengths tenfold; the iteration does not converge; or the field is
/// too large for a "warp".
/// @param made         Grid of vectors in its world space, all of whose voxels are active. Its name
///                     becomes "displacement".
/// @param length_unit  Unit of the world space; "" and unknown units count as "mm".
void takeDisplacement(Gridded& made, Direction direction, const std::string& length_unit,
                      const std::string& file, const Progress& progress,
                      std::vector<std::string>& notes);

}  // namespace palpate::importer
