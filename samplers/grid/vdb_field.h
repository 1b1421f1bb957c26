/// Makes a field of the engine from a grid that is placed in the hand's world.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "palpate/engine/field/field.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Placement of a volume in W: p_W = translate + rotation * scale * p_F, where p_F is a point in
/// the file's own world space. No other code scales volumes.
struct Placement {
  double scale = 1.0;  ///< Metres of hand travel per unit of the file, > 0.
  /// Orthonormal matrix that rotates the file's axes into W's axes.
  Mat3 rotation = Mat3::Identity();
  Vec3 translate = Vec3::Zero();  ///< Position of the file's origin in W [m].

  [[nodiscard]] Vec3 operator()(const Vec3& p_F) const noexcept {
    return translate + rotation * (scale * p_F);
  }  ///< Maps a point p_F of the file's world space to p_W [m].
  [[nodiscard]] bool operator==(const Placement& other) const noexcept {
    return scale == other.scale && rotation == other.rotation && translate == other.translate;
  }  ///< True if all numbers of both placements are equal.
};

/// Returns a placement that puts the centre of the bounds at W's origin and makes their longest
/// side `size` metres long. Throws VolumeError if the bounds have no extent.
[[nodiscard]] Placement fitInto(const Box& bounds_F, double size);

/// Methods to compute values between voxels.
enum class Interpolation : std::uint8_t {
  kTrilinear,  ///< Trilinear value. The derivatives are differences of values, and are continuous.
  kNearest,    ///< Value of the nearest voxel, without derivatives; for labels.
  /// B-spline of degree 2 through the values of the voxels. The derivatives are those of the
  /// spline, and are continuous.
  kQuadratic,
  kCubic,  ///< B-spline of degree 3 through the values of the voxels. The derivatives of the spline
           ///< are smooth.
};

/// Returns the word for an interpolation: "trilinear", "nearest", "quadratic" or "cubic".
[[nodiscard]] const char* wordFor(Interpolation interpolation) noexcept;
/// Returns the interpolation for a word; std::nullopt for any other text.
[[nodiscard]] std::optional<Interpolation> interpolationNamed(const std::string& word) noexcept;

/// Options for reading a volume.
struct Sampling {
  Interpolation interpolation = Interpolation::kTrilinear;  ///< Method for values between voxels.
  /// True if vectors have no sign, such as a fibre's direction. In each cell the signs of the
  /// voxels' vectors are aligned before they are interpolated. Only for trilinear interpolation.
  bool axial = false;
  double slope_reach = 0.5;  ///< Distance to each side over which the gradient of a trilinear
                             ///< scalar takes its differences [voxels], > 0 to 1. Only 1/2 and 1
                             ///< are exact for quadratics. For vectors the distance is always 1.

  /// True if all options are equal.
  [[nodiscard]] bool operator==(const Sampling&) const = default;
};

/// Makes a field over a volume: a scalar or a vector field, as the type of the volume requires.
///
/// By default the value V is trilinear. Let r = Sampling::slope_reach, and e_a a step along axis a
/// of the lattice. The gradient of a scalar is g_a(x) = (V(x + r e_a) - V(x - r e_a)) / 2r. The
/// Jacobian of a vector consists of trilinearly interpolated central differences, one-sided where
/// the data end (data_ends.h). The gradient of a scalar is a difference to the background there,
/// because the surroundings of an image belong to it. Both are continuous, use the cell and its
/// neighbours, and are per unit of the file, rotated into W. cellGradient() is the gradient of the
/// trilinear polynomial itself.
///
/// Meaning of `inside`: In a level set, all eight voxels of the cell are active, because the value
/// beyond its band is not a distance; or the cell holds the surface (band_cell.h), so a band of one
/// voxel is enough. In other grids at least one is active, because the border of a fog is part of
/// the data. For the nearest voxel, that voxel is active. For a vector of three grids, all three
/// are inside. Values are always the stored ones, also in inactive voxels and in the background.
/// Beyond 1e9 voxels from the origin, the value is the background, with zero derivatives.
///
/// In a staggered grid, and in three scalars that are read as one vector, each component is read at
/// its own position. This costs about as much as reading three scalars.
///
/// B-splines: the first call for a volume and a degree computes the coefficients, in parallel. The
/// volume keeps them for all its placements. They take about as much memory as the volume, plus
/// that of the leaves added around it. Value and derivatives are those of the spline, which passes
/// through the stored values to within rounding of the grid's type. Near the edge of a narrow band,
/// the constant values beyond the band also affect the spline. A jump there causes ripples: a
/// fourth of the jump at one voxel's distance, and a fifteenth at two voxels.
///
/// Axial vectors: the sign of a value has no meaning. It may change from cell to cell, and the
/// derivatives change with it. If the eight directions of a cell span more than 90 degrees, they
/// have no common direction.
///
/// Throws VolumeError for `axial` unless the volume is a vector in one grid and the interpolation
/// is trilinear. RT: sample() reads at most eight leaves of each grid, and only if the cell differs
/// from that of the last reading; no allocation.
[[nodiscard]] FieldPtr makeVdbField(const std::shared_ptr<const Volume>& volume,
                                    const Placement& placement, const Sampling& sampling = {});

}  // namespace palpate
