/// Makes a field of the engine from a grid that is placed in the hand's world.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "palpate/engine/field/field.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Place of a volume in W: p_W = translate + rotation * scale * p_F, with p_F in the file's own
/// world space. Scaling takes place only here.
struct Placement {
  double scale = 1.0;                ///< Metres of hand travel per unit of the file, > 0.
  Mat3 rotation = Mat3::Identity();  ///< Orthonormal: turns the file's axes into W's axes.
  Vec3 translate = Vec3::Zero();     ///< [m]

  [[nodiscard]] Vec3 operator()(const Vec3& p_F) const noexcept {
    return translate + rotation * (scale * p_F);
  }  ///< Maps a place p_F of the file to p_W [m].
  [[nodiscard]] bool operator==(const Placement& other) const noexcept {
    return scale == other.scale && rotation == other.rotation && translate == other.translate;
  }  ///< True for exactly equal placements.
};

/// Returns a placement centred in W, with the longest side of the active bounds `size` metres long.
/// Throws VolumeError if the bounds have no extent.
[[nodiscard]] Placement fitInto(const Box& bounds_F, double size);

/// How values between voxels are computed.
enum class Interpolation : std::uint8_t {
  kTrilinear,  ///< Trilinear value; derivatives are differences of values, continuous.
  kNearest,    ///< The nearest voxel's value, no derivative: for labels.
  kQuadratic,  ///< B-spline of degree 2 through the voxels' values: value, and its own derivative,
               ///< continuous.
  kCubic,      ///< B-spline of degree 3: the derivative is smooth.
};

/// Returns "trilinear", "nearest", "quadratic" or "cubic".
[[nodiscard]] const char* wordFor(Interpolation interpolation) noexcept;
/// Returns the interpolation with this word, if there is one.
[[nodiscard]] std::optional<Interpolation> interpolationNamed(const std::string& word) noexcept;

/// How a volume is read.
struct Sampling {
  Interpolation interpolation = Interpolation::kTrilinear;  ///< Trilinear by default.
  bool axial = false;  ///< A vector without a sign, such as a fibre's direction: in each cell the
                       ///< signs of the voxels are aligned before blending. Trilinear only.
  double slope_reach = 0.5;  ///< Distance to each side over which a trilinear scalar's gradient
                             ///< takes its differences [voxels], > 0 to 1. Only 1/2 and 1 are
                             ///< exact for quadratics. For vectors it is always 1.

  [[nodiscard]] bool operator==(const Sampling&) const = default;  ///< True for equal reading.
};

/// Makes a scalar or a vector field over a volume, depending on its type.
///
/// The default value V is trilinear. A scalar's gradient, with r = Sampling::slope_reach and e_a a
/// step along axis a of the lattice, is g_a(x) = (V(x + r e_a) - V(x - r e_a)) / 2r. A vector's
/// Jacobian is trilinearly interpolated central differences. Both are continuous. They use the cell
/// of the value and its neighbours, and are per unit of the file, with directions turned into W.
/// cellGradient() is the slope of the trilinear polynomial itself.
///
/// `inside` in a level set: all eight voxels of the cell are active (beyond its band the value is a
/// clamp). In other grids: at least one is active (the edge of fog is real). For the nearest voxel:
/// the voxel is active. For a vector of three grids: all three are inside. Values are always the
/// stored ones, inactive voxels and background included. Beyond 1e9 voxels from the origin, the
/// value is the background with zero derivatives.
///
/// Staggered grids, and three scalars read as one vector: each component is read at its own place,
/// at about the cost of three scalars.
///
/// B-splines: the first call for a volume and degree makes the coefficients, in parallel. The
/// volume keeps them for all its placements. They take about as much memory as the volume, plus the
/// leaves around it. Value and derivatives are the spline's own; it passes through the stored
/// values within a rounding error of the grid's type. Near the edge of a narrow band the clamped
/// values beyond the band also count: a jump causes ripples of a fourth of its height one voxel
/// away, and of a fifteenth two voxels away.
///
/// Axial: the sign of a value has no meaning. It may change from cell to cell, and the derivatives
/// change with it. If the eight directions of a cell span more than 90 degrees, they have no common
/// direction.
///
/// Throws VolumeError for `axial` unless the volume is a vector in one grid and is read
/// trilinearly. RT: sample() reads at most eight leaves of each grid, and only when the cell
/// changes; no allocation.
[[nodiscard]] FieldPtr makeVdbField(const std::shared_ptr<const Volume>& volume,
                                    const Placement& placement, const Sampling& sampling = {});

}  // namespace palpate
