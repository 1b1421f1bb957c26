/// Makes a smooth volume of the structures that labels mark.
#pragma once

#include <memory>
#include <string>
#include <variant>
#include <vector>

#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Reference to a label: its value, or its name in GridInfo::labels.
using LabelKey = std::variant<double, std::string>;

/// Largest magnitude of a label's value: floats hold all whole numbers up to it.
inline constexpr double kMostLabel = 16777216.0;

/// Default standard deviation of a mask's Gaussian [voxels].
inline constexpr double kMaskSigma = 1.0;

/// Returns a label as users write it, such as 7 or liver.
[[nodiscard]] std::string textOf(const LabelKey& label);

/// Returns labels as the name of their mask shows them, such as liver+7.
[[nodiscard]] std::string textOf(const std::vector<LabelKey>& labels);

/// Makes a volume that is 1 in the voxels with one of the labels and 0 elsewhere, smoothed by a
/// Gaussian. The structures' surface is the isosurface at 0.5.
///
/// Without smoothing, this trilinear isosurface is within half a voxel of the voxels' faces, and
/// its normals are up to 55 degrees off. Where a boundary is flat and along the lattice, the
/// isosurface is exactly on the voxels' faces, for every sigma. A ball of radius R shrinks by about
/// sigma^2 / R. A slab thinner than about 1.35 sigma, or a cylinder thinner than 2.4 sigma,
/// vanishes.
///
/// @param volume  Scalar grid of whole numbers, in one part.
/// @param labels  At least one. If the value of the background is among them, it is 1 in the mask.
/// @param sigma   Standard deviation, 0 to kMostSmooth [voxels, along each axis of the lattice].
/// @return        Mask with 32 bits per voxel, and the colour of the first label.
///
/// Throws VolumeError for a vector or a level set, for a name of two labels, for an invalid
/// `sigma`, and if all voxels have one of the labels. Also throws it for a label without a voxel,
/// with a list of the grid's labels. Slow: reads every value, in parallel.
[[nodiscard]] std::shared_ptr<const Volume> makeLabelMask(
    const std::shared_ptr<const Volume>& volume, const std::vector<LabelKey>& labels,
    double sigma = kMaskSigma);

}  // namespace palpate
