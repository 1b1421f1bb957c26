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
  /// Values of the previous neighbours along the axes; 0 if unknown.
  std::array<float, 3> before{};
  std::array<float, 3> after{};
  std::array<bool, 3> known{};
  bool at_edge = false;  ///< True if a neighbour is in the surroundings of an image.
};

/// Number of levels, evenly spaced from ScalarAnalysis::low to ScalarAnalysis::high.
constexpr std::size_t kBins = 256;
using Bins = std::array<double, kBins>;

/// Integrals over the isosurface of each level: its area, and the gradient magnitude. A level
/// between a voxel's neighbours on an axis adds volume / edge, in projection along the axis, times
/// |gradient| / |component of the gradient along the axis|.
struct LevelIntegrals {
  Bins area{};
  Bins gradient{};
  Bins count{};  ///< Number of voxels with a value in the bin.
};

/// Computes the integrals for the levels of `scalar`, with a range above 0. `edges` are those of a
/// voxel, in units of the file.
[[nodiscard]] LevelIntegrals integrateLevels(const std::vector<ScalarSample>& samples,
                                             const ScalarAnalysis& scalar,
                                             const std::array<double, 3>& edges);

/// Applies a Gaussian with a deviation of 2 bins. Repeats the first and last bin at the ends.
[[nodiscard]] Bins smoothed(const Bins& in);

/// Returns at most three boundaries, in ascending order (see suggest.h). `edge` is the mean edge of
/// a voxel, and `image` is SuggestInput::inactive_is_data.
[[nodiscard]] std::vector<Boundary> findBoundaries(const LevelIntegrals& levels,
                                                   const ScalarAnalysis& scalar, double edge,
                                                   bool image);

/// Returns the boundary at a front, such as a shock: nearly its whole isosurface is within a few
/// voxels of a jump, which may vary along the front. Returns no value without a front.
[[nodiscard]] std::optional<Boundary> findFront(const SuggestInput& input,
                                                const ScalarAnalysis& scalar);

/// Sets the members of `scalar` from which labels are recognized: whole, distinct, alike, skips.
void analyseLabels(const std::vector<ScalarSample>& samples, ScalarAnalysis& scalar);

/// Returns a value that marks missing data: at `least` places or more, and far from all others.
/// Returns no value if the values may be labels. `sorted` is ascending and not empty.
[[nodiscard]] std::optional<float> noDataOf(const std::vector<float>& sorted, double least);

/// Returns whether the values are the signed distance to a surface: their gradient has the same
/// length everywhere (eikonal equation), and both signs occur. Voxels beside constant regions or
/// inactive voxels do not count, because distances are often cut off there.
///
/// - kFull: the values change by 1 per unit or per voxel. Either the directions vary, or the values
///   are cut off on both sides of 0; else a linear ramp would be a distance.
/// - kTruncated: as kFull, but noisy and cut off on both sides of 0, or divided by the distance at
///   which they are cut off. They then end at -1 or 1, and the slope has any size (Curless and
///   Levoy, A volumetric method for building complex models from range images, 1996).
[[nodiscard]] Distance distanceOf(const std::vector<ScalarSample>& samples,
                                  const std::array<double, 3>& edges, double edge);

/// Returns true if a distance is positive inside of the bodies: nearly all values on the faces of
/// the box are negative. Otherwise it is negative inside, as is usual.
[[nodiscard]] bool isPositiveInside(const SuggestInput& input);

}  // namespace palpate::guess
