/// Private to the scene guess: the steps of analyseScalar (analysis.h).
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <vector>

#include "palpate/scenes/guess/analysis.h"

namespace palpate::guess {

/// A voxel of the sample.
struct ScalarSample {
  float value = 0.0F;
  std::array<float, 3> before{};  ///< Neighbours along the axes; 0 where they are not known.
  std::array<float, 3> after{};
  std::array<bool, 3> known{};
  bool at_edge = false;  ///< A neighbour is in the surroundings.
};

/// Number of levels, from ScalarAnalysis::low to high.
constexpr std::size_t kBins = 256;
using Bins = std::array<double, kBins>;

/// Values change by this part of their range from one voxel to the next: a steep place. A shock
/// that a solver has smeared over three cells of two voxels each reaches this; a field that is
/// smooth over 20 voxels does not.
constexpr double kSteep = 0.08;

/// Integrals over the isosurface of each level: of 1 (its area) and of the gradient magnitude. A
/// level between the neighbours of a voxel along an axis passes the voxel once. Seen along the
/// axis, this is an area of volume / edge; the true area is larger by |gradient| / |component|.
struct LevelIntegrals {
  Bins area{};
  Bins gradient{};
  Bins steep{};              ///< Area where values change by kSteep or more in a voxel.
  Bins count{};              ///< Voxels by value.
  double steep_share = 0.0;  ///< Share of the voxels that are steep.
};

/// Returns the integrals for the levels of `scalar`; its range is above 0. `edges` are those of a
/// voxel, in units of the file.
[[nodiscard]] LevelIntegrals integrateLevels(const std::vector<ScalarSample>& samples,
                                             const ScalarAnalysis& scalar,
                                             const std::array<double, 3>& edges);

/// Applies a Gaussian of 2 bins; the end values continue beyond the ends.
[[nodiscard]] Bins smoothed(const Bins& in);

/// Returns the arches of the mean gradient magnitude (see suggest.h): at most three boundaries,
/// ascending by value. `edge` is the mean edge of a voxel. `image` is SuggestInput's
/// `inactive_is_data`.
[[nodiscard]] std::vector<Boundary> findBoundaries(const LevelIntegrals& levels,
                                                   const ScalarAnalysis& scalar, double edge,
                                                   bool image);

/// Returns the steepest place if it is a surface: the value whose isosurface is steep nearly
/// wherever it runs, like a shock. One side may have any values.
[[nodiscard]] std::optional<Boundary> findFront(const LevelIntegrals& levels,
                                                const ScalarAnalysis& scalar);

/// Sets the share of whole values, the distinct values, and the shares of neighbours that are
/// equal or skip a value.
void analyseLabels(const std::vector<ScalarSample>& samples, ScalarAnalysis& scalar);

/// Returns the value that marks missing data: a single value at many places, far beyond all others.
/// The others are more values than labels have. `sorted` is ascending and not empty.
[[nodiscard]] std::optional<float> noDataOf(const std::vector<float>& sorted);

/// Returns true for the distance to a surface. Values then change by 1 per unit or voxel nearly
/// everywhere, without a common direction, and have both signs.
[[nodiscard]] bool isDistance(const std::vector<ScalarSample>& samples,
                              const std::array<double, 3>& edges, double edge);

}  // namespace palpate::guess
