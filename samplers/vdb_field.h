/// A grid, placed in the hand's world, as a field of the engine.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "palpate/engine/field.h"
#include "palpate/samplers/volume.h"

namespace palpate {

/// Where a volume stands in W: p_W = translate + rotation * scale * p_F, p_F in the file's own
/// world space. The only place where anything is scaled.
struct Placement {
  double scale = 1.0;                ///< Metres of hand travel per unit of the file, > 0.
  Mat3 rotation = Mat3::Identity();  ///< Orthonormal: turns the file's axes into W's.
  Vec3 translate = Vec3::Zero();     ///< [m]

  [[nodiscard]] Vec3 operator()(const Vec3& p_F) const noexcept {
    return translate + rotation * (scale * p_F);
  }  ///< Where a place p_F of the file stands: p_W [m].
  [[nodiscard]] bool operator==(const Placement& other) const noexcept {
    return scale == other.scale && rotation == other.rotation && translate == other.translate;
  }  ///< Exact: places that differ by a rounding differ.
};

/// Centred in W, the longest side of the active bounds `size` metres long. Throws VolumeError where
/// the bounds have no extent.
[[nodiscard]] Placement fitInto(const Box& bounds_F, double size);

/// How values between voxels come about.
enum class Interpolation : std::uint8_t {
  kTrilinear,  ///< Trilinear value; trilinearly interpolated central differences, continuous.
  kNearest,    ///< The nearest voxel's value, no derivative: for labels.
  kQuadratic,  ///< B-spline of degree 2 through the voxels' values: value, and its own derivative,
               ///< continuous.
  kCubic,      ///< B-spline of degree 3: the derivative is smooth.
};

/// "trilinear", "nearest", "quadratic" or "cubic".
[[nodiscard]] const char* wordFor(Interpolation interpolation) noexcept;
/// The one of that word; none where there is none.
[[nodiscard]] std::optional<Interpolation> interpolationNamed(const std::string& word) noexcept;

/// How a volume is read.
struct Sampling {
  Interpolation interpolation = Interpolation::kTrilinear;  ///< Trilinear where nobody asks.
  bool axial = false;  ///< A vector without a sign, as a fibre's direction: in each cell the signs
                       ///< of the voxels are aligned before they are blended. Trilinear only.

  [[nodiscard]] bool operator==(const Sampling&) const = default;  ///< Equal ones read alike.
};

/// A scalar or vector field over a volume, by its type.
///
/// By default the value is trilinear. Gradient and Jacobian: trilinearly interpolated central
/// differences, hence continuous, from the cell that the value comes from and its neighbours; all
/// per unit of the file, directions turned into W. cellGradient(): of the trilinear polynomial
/// itself. `inside`: for a level set all eight voxels of the cell are active (beyond its band the
/// value is a clamp), otherwise at least one (the edge of fog is real); for the nearest voxel that
/// it is active; for a vector of three grids all three. Values are always those stored, inactive
/// voxels and background included; beyond 1e9 voxels from the origin, the background with zero
/// derivatives.
///
/// Staggered grids, and three scalars read as one vector: each component at its own place, at about
/// the cost of three scalars.
///
/// B-splines: coefficients are made at the first call for a volume and degree, in parallel, and
/// kept with the volume for all its placements (about once its memory more, and the leaves around
/// it). Value and derivatives are the spline's own, through the stored values to a rounding of the
/// grid's type. Near the edge of a narrow band the clamped values beyond it enter: a jump rings by
/// a fourth of it a voxel on, a fifteenth two voxels on.
///
/// Axial: the sign of a value means nothing, may change from cell to cell, and the derivatives go
/// with it. Where the eight directions of a cell span more than 90 degrees there is none to follow.
///
/// Throws VolumeError for `axial` where the volume is no vector in one grid, or not trilinear. RT:
/// sample() reads at most eight leaves of each grid when the cell changes, none otherwise; no
/// allocation.
[[nodiscard]] FieldPtr makeVdbField(const std::shared_ptr<const Volume>& volume,
                                    const Placement& placement, const Sampling& sampling = {});

}  // namespace palpate
