/// Private to the scene guess: the steps of analyseScalar (analysis.h).
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <vector>

#include "palpate/scenes/guess/analysis.h"

namespace palpate::guess {

struct ScalarSample {
  float value = 0.0F;
  /// Values of the neighbours with the lower index on each axis; 0 if unknown.
  std::array<float, 3> before{};
  std::array<float, 3> after{};  ///< The same for the higher index.
  std::array<bool, 3> known{};   ///< True for an axis on which both neighbours are known.
  /// True if a neighbour is in the surroundings: inactive in an image, or with the common value.
  bool at_edge = false;
};

/// Number of levels, evenly spaced from ScalarAnalysis::low to ScalarAnalysis::high.
constexpr std::size_t kBins = 256;
using Bins = std::array<double, kBins>;

/// Integrals over the isosurface of each level, up to a common factor: of 1, and of the gradient
/// magnitude. If a level is between a voxel's neighbours on axis a, the voxel adds the area
/// volume / edge_a * |g_a| / |g|, where g is the gradient. The sum over the axes is proportional to
/// the area of the isosurface in the voxel.
struct LevelIntegrals {
  Bins area{};
  Bins gradient{};
  /// Number of voxels with a value in the bin. In the bin of the surroundings, also the voxels
  /// beside them.
  Bins count{};
};

/// Computes the integrals for the levels of `scalar`, whose range must be above 0. `edges` are a
/// voxel's edges [units of the file].
[[nodiscard]] LevelIntegrals integrateLevels(const std::vector<ScalarSample>& samples,
                                             const ScalarAnalysis& scalar,
                                             const std::array<double, 3>& edges);

/// Applies a Gaussian with a deviation of 2 bins. The first and last bins continue beyond the ends.
[[nodiscard]] Bins smoothed(const Bins& in);

/// Returns at most three boundaries, in ascending order (suggest.h). `edge` is a voxel's mean edge,
/// and `image` is SuggestInput::inactive_is_data.
[[nodiscard]] std::vector<Boundary> findBoundaries(const LevelIntegrals& levels,
                                                   const ScalarAnalysis& scalar, double edge,
                                                   bool image);

/// Returns the boundary at a front, such as a shock: nearly all of its isosurface is within a few
/// voxels of a jump, whose size may vary along the front. Returns no value without a front.
[[nodiscard]] std::optional<Boundary> findFront(const SuggestInput& input,
                                                const ScalarAnalysis& scalar);

/// Sets the members of `scalar` from which labels are recognized: whole, distinct, alike, skips.
void analyseLabels(const std::vector<ScalarSample>& samples, ScalarAnalysis& scalar);

/// Returns the value that marks missing data: it occurs `least` times or more, far from all others.
/// Returns no value if no data are missing, or if the values may be labels. `sorted` ascends and is
/// not empty.
[[nodiscard]] std::optional<float> noDataOf(const std::vector<float>& sorted, double least);

/// Sets `distance` and `positive_inside` if the values are the signed distance to a surface: the
/// gradient has the same length everywhere (eikonal equation), and both signs occur. Ignores voxels
/// beside constant regions and inactive voxels, where distances are often cut off.
///
/// - kFull: the values change by 1 per unit or per voxel. Also, the directions vary, or the values
///   are cut off on both sides of 0; otherwise a linear ramp would count.
/// - kTruncated: the values are as for kFull, but noisy, and cut off on both sides of 0. Or they
///   have any unit, and are cut off at the same distance on both sides, which is at least a voxel.
///   Values divided by this distance end at -1 and 1, and may be cut off at one end only (Curless
///   and Levoy, A volumetric method for building complex models from range images, 1996).
///
/// If the active values come to within one voxel's change of the background, the background counts
/// as cut off. A distance is positive inside bodies if more than three quarters of the values on
/// the faces of the box are negative. Usually a distance is negative inside.
void analyseDistance(const std::vector<ScalarSample>& samples, const SuggestInput& input,
                     ScalarAnalysis& scalar);

}  // namespace palpate::guess
