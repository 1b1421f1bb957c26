/// A grid, placed in the hand's world, as a field of the engine.
#pragma once

#include <memory>

#include "engine/field.h"
#include "samplers/volume.h"

namespace palpate {

/// Where a volume stands in W: p_W = translate + rotation * scale * p_F, p_F in the file's own
/// world space. The only place where anything is scaled.
struct Placement {
  double scale = 1.0;  ///< Metres of hand travel per unit of the file, > 0.
  Mat3 rotation = Mat3::Identity();
  Vec3 translate = Vec3::Zero();  ///< [m]

  [[nodiscard]] Vec3 operator()(const Vec3& p_F) const noexcept {
    return translate + rotation * (scale * p_F);
  }
};

/// Centred in W, the longest side of the active bounds `size` metres long. Throws VolumeError where
/// the bounds have no extent.
[[nodiscard]] Placement fitInto(const Box& bounds_F, double size);

/// A scalar or vector field over a volume, by its type.
///
/// Value: trilinear. Gradient and Jacobian: trilinearly interpolated central differences, hence
/// continuous, from the cell that the value comes from and its neighbours; all per unit of the
/// file, directions turned into W. `cell_gradient`: of the trilinear polynomial itself.
/// `inside`: for a level set all eight voxels of the cell are active (beyond its band the value is
/// a clamp), otherwise at least one (the edge of fog is real). Staggered grids are read as if their
/// values stood at the voxels' centres.
/// Values are always those stored, inactive voxels and background included; beyond 1e9 voxels from
/// the origin, the background with zero derivatives.
/// RT: sample() reads at most eight leaves when the cell changes, none otherwise; no allocation.
[[nodiscard]] FieldPtr makeVdbField(std::shared_ptr<const Volume> volume,
                                    const Placement& placement);

}  // namespace palpate
