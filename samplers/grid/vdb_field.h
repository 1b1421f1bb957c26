/// Makes a field of the engine from a grid that is placed in W.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "palpate/engine/field/field.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Placement in W: p_W = translate + rotation * scale * p_F, with p_F in the file's world space.
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
  }  ///< Returns true if all numbers of both placements are equal.
};

/// Returns a placement that puts the centre of a volume's bounds at W's origin and makes their
/// longest side `size` metres long, `size` > 0. Throws VolumeError, with the volume's name, if the
/// bounds have no extent or are not finite.
[[nodiscard]] Placement fitInto(const GridInfo& volume, double size);

/// Methods to compute values between voxels.
enum class Interpolation : std::uint8_t {
  kTrilinear,  ///< Trilinear value. The derivatives are differences of values, and are continuous.
  kNearest,    ///< Value of the nearest voxel, without derivatives; for labels.
  /// B-spline of degree 2 through the voxels' values. Its first derivatives are continuous.
  kQuadratic,
  /// B-spline of degree 3 through the voxels' values. First and second derivatives are continuous.
  kCubic,
};

/// Returns the word for an interpolation: "trilinear", "nearest", "quadratic" or "cubic".
[[nodiscard]] const char* wordFor(Interpolation interpolation) noexcept;
/// Returns the interpolation for a word; std::nullopt for any other text.
[[nodiscard]] std::optional<Interpolation> interpolationNamed(const std::string& word) noexcept;

/// Options for reading a volume.
struct Sampling {
  Interpolation interpolation = Interpolation::kTrilinear;  ///< Method for values between voxels.
  /// True if vectors have no sign, such as fibre directions. Their signs are aligned in each cell
  /// before the interpolation. Only for trilinear interpolation.
  bool axial = false;
  /// Distance to each side over which the gradient of a trilinear scalar is a difference [voxels],
  /// > 0 and at most 1. Only 1/2 and 1 are exact for quadratics. Also applies to each component of
  /// a vector of three grids. For vectors in one grid the distance is always 1.
  double slope_reach = 0.5;

  /// Returns true if all options are equal.
  [[nodiscard]] bool operator==(const Sampling&) const = default;
};

/// Makes a scalar or a vector field over a volume, as the volume's type requires.
///
/// By default the value V is trilinear. With r = Sampling::slope_reach and a step e_a along lattice
/// axis a, the gradient of a scalar is g_a(x) = (V(x + r e_a) - V(x - r e_a)) / 2r. The Jacobian of
/// a vector in one grid consists of trilinearly interpolated central differences; that of a vector
/// of three grids consists of the gradients of its components. Where the data end (data_ends.h),
/// the Jacobian uses only data, and the gradient of a scalar is a difference to the stored values
/// beyond, mostly the background. The gradient and the Jacobian are continuous, except for axial
/// vectors. They are per unit of the file, in the axes of W. cellGradient() is the gradient of the
/// cell's polynomial.
///
/// `inside`: In a level set, all eight voxels of the cell are active, or one is active and the cell
/// holds the surface (band_cell.h). Values beyond the band are not distances. In other grids at
/// least one voxel is active; with Inactive::kMissing, also every voxel in the box of active voxels
/// that the trilinear value reads.
/// For kNearest the nearest voxel is active. For a vector of three grids, all three are inside.
/// Trilinear and nearest values use the stored values of inactive voxels too. Where an index is 1e9
/// or more in magnitude, the value is the background, with zero derivatives.
///
/// Components of staggered grids and of three scalars are read at their own positions: 3 readings,
/// or up to 6 at the end of the data.
///
/// B-splines: the first call for a volume and a degree computes the coefficients, in parallel. The
/// volume keeps them. They take about as much memory as the volume and the leaves added around it.
/// The spline passes through the stored values to within rounding (spline.h states exceptions).
/// Near the edge of a narrow band, the jump to the constant values beyond causes ripples. With each
/// voxel of distance, their height falls by a factor of 5.8 for degree 2, and of 3.7 for degree 3.
///
/// Axial vectors: signs have no meaning, and may change from cell to cell, also in derivatives.
/// Directions that span more than 90 degrees in a cell have no common direction.
///
/// Throws VolumeError for an invalid `slope_reach`, and for `axial` unless the volume is a
/// trilinear vector in one grid. RT: each reading reads at most eight leaves, and only in a new
/// cell; no allocation.
[[nodiscard]] FieldPtr makeVdbField(const std::shared_ptr<const Volume>& volume,
                                    const Placement& placement, const Sampling& sampling = {});

}  // namespace palpate
