/// Private to the scene guess: the steps of analyseScalar (analysis.h).
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <vector>

#include "palpate/scenes/guess/analysis.h"

namespace palpate::guess {

/// A sampled voxel with its neighbours.
struct ScalarSample {
  float value = 0.0F;
  /// Values of the previous neighbours along the three axes; 0 where the neighbours are unknown.
  std::array<float, 3> before{};
  std::array<float, 3> after{};
  std::array<bool, 3> known{};
  bool at_edge = false;  ///< True if a neighbour is in the surroundings of an image.
};

/// Number of levels, evenly spaced from ScalarAnalysis::low to ScalarAnalysis::high.
constexpr std::size_t kBins = 256;
using Bins = std::array<double, kBins>;

/// For each level, integrals over its isosurface: of 1, which is its area, and of the gradient
/// magnitude. An isosurface crosses a voxel along an axis if its level lies between the voxel's
/// neighbours on this axis. It then has the area volume / edge in projection along the axis. Its
/// true area is larger by the factor |gradient| / |component of the gradient along the axis|.
struct LevelIntegrals {
  Bins area{};
  Bins gradient{};
  Bins count{};  ///< Number of voxels with a value in the bin.
};

/// Computes the integrals for the levels of `scalar`, whose range must be above 0. `edges` are the
/// edges of a voxel, in units of the file.
[[nodiscard]] LevelIntegrals integrateLevels(const std::vector<ScalarSample>& samples,
                                             const ScalarAnalysis& scalar,
                                             const std::array<double, 3>& edges);

/// Applies a Gaussian filter with a standard deviation of 2 bins. Beyond the ends, the first and
/// the last bin are repeated.
[[nodiscard]] Bins smoothed(const Bins& in);

/// Returns at most three boundaries, in ascending order of their values: the arches of the mean
/// gradient magnitude (see suggest.h). `edge` is the mean edge of a voxel. `image` is
/// SuggestInput::inactive_is_data.
[[nodiscard]] std::vector<Boundary> findBoundaries(const LevelIntegrals& levels,
                                                   const ScalarAnalysis& scalar, double edge,
                                                   bool image);

/// Returns the boundary at a front, such as a shock. Nearly the whole isosurface at its value is
/// within a few voxels of a jump. The jump may vary along the front, and so may the values on both
/// sides. The value is that whose isosurface is nearest to the steepest places. Returns no value
/// without a front.
[[nodiscard]] std::optional<Boundary> findFront(const SuggestInput& input,
                                                const ScalarAnalysis& scalar);

/// Sets the members of `scalar` from which labels are recognized: the fraction of whole numbers,
/// the distinct values, and the fractions of neighbours that are equal or skip a value.
void analyseLabels(const std::vector<ScalarSample>& samples, ScalarAnalysis& scalar);

/// Returns a value that marks missing data: it occurs at `least` places or more, and is far from
/// all other values. Returns no value if the grid has so few different values that they may be
/// labels. `sorted` is ascending and not empty.
[[nodiscard]] std::optional<float> noDataOf(const std::vector<float>& sorted, double least);

/// Returns whether the values are the signed distance to a surface. Their gradient then has the
/// same length everywhere (the eikonal equation), and they have both signs. Voxels beside a
/// constant region or beside inactive voxels do not count, because distances are often cut off
/// there.
///
/// - kFull: the values change by 1 per unit or per voxel. Either the directions vary, or the values
///   are cut off on both sides of 0; else a linear ramp would be a distance.
/// - kTruncated: as kFull, but noisy and cut off on both sides of 0, or divided by the distance at
///   which they are cut off. They then end at -1 or 1, and the slope has any size (Curless and
///   Levoy, A volumetric method for building complex models from range images, 1996).
[[nodiscard]] Distance distanceOf(const std::vector<ScalarSample>& samples,
                                  const std::array<double, 3>& edges, double edge);

/// Returns true if a distance is positive inside of the bodies: nearly all values on the faces of
/// the box of its data are negative. If neither side has nearly all values, the distance is
/// negative inside, as is usual.
[[nodiscard]] bool isPositiveInside(const SuggestInput& input);

}  // namespace palpate::guess
