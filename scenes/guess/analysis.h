/// Private to the scene guess: analysis of a grid for its kind, its boundaries and its flow.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "palpate/scenes/guess/statistics.h"
#include "palpate/scenes/guess/suggest.h"

namespace palpate::guess {

/// A boundary between two materials, or between a material and a range of values without a further
/// material.
struct Boundary {
  double value = 0.0;
  /// Value at which the mean gradient magnitude has risen by two thirds, coming from `lower`.
  double foot = 0.0;
  /// Values of the two materials; for an unknown material, the end of the range.
  double lower = 0.0;
  double upper = 0.0;
  double slope = 0.0;  ///< Mean gradient magnitude over the boundary [values per unit of the file].
  /// Integral of the gradient over the boundary, relative to the greatest such integral in the
  /// grid.
  double share = 0.0;
  bool lower_known = false;
  bool upper_known = false;
  /// True if the boundary was found by its steepness, not as a boundary between two materials.
  bool front = false;
};

/// Whether a grid is a signed distance, in units of the file or in voxels.
enum class Distance : std::uint8_t {
  kNone,
  kFull,       ///< The values change by 1 per unit or per voxel.
  kTruncated,  ///< Cut off at a distance from the surface, and noisy or divided by this distance.
};

/// Results of analysing a scalar grid.
struct ScalarAnalysis {
  std::vector<float> values;  ///< Sampled values, ascending.
  /// Nearly all values lie between `low` and `high`, including the value of the surroundings.
  double low = 0.0;
  double high = 0.0;
  std::optional<double> outside;  ///< Value of the surroundings of an image; no value for a mesh.
  std::vector<Boundary> boundaries;
  bool has_object = false;  ///< True if the analysis of all voxels found a boundary.
  /// Evenness of the distribution of the values: 0 if all are equal, 1 if all are equally frequent.
  double entropy = 0.0;
  double whole = 0.0;  ///< Fraction of the values that are whole numbers.
  /// Fraction of neighbours that are equal. Pairs that contain the most frequent value do not
  /// count.
  double alike = 0.0;
  double skips = 0.0;  ///< Among neighbours that differ, fraction of those with another value of
                       ///< the grid in between.
  /// All values that occur; empty if there are more than kMostDistinct.
  std::vector<float> distinct;
  std::optional<double> no_data;  ///< Value that marks missing data; the analysis ignores it.
  Distance distance = Distance::kNone;
  bool positive_inside = false;  ///< True for a distance that is positive inside of the bodies.
  /// Value of most voxels, if the others were analysed alone because they are few; else no value.
  std::optional<double> common;

  [[nodiscard]] double range() const { return high - low; }
  [[nodiscard]] double round(double value) const { return rounded(value, range()); }
  [[nodiscard]] double shareAbove(double value) const;
  [[nodiscard]] double shareWithin(double from, double to) const {
    return shareAbove(from) - shareAbove(to);
  }
};

/// Returns true if the values vary enough for a mode: they have a boundary or are a distance, or
/// their 5th and their 95th percentile differ after rounding.
[[nodiscard]] bool varies(const ScalarAnalysis& scalar);

/// A grid with more than this number of different values does not contain labels.
constexpr std::size_t kMostDistinct = 1024;

/// Results of analysing a vector grid.
struct VectorAnalysis {
  bool constant = true;
  std::vector<float> speed;  ///< Magnitudes of the vectors that are part of the flow, ascending.
  /// Magnitudes of the curl at vectors of the flow whose neighbours are all known, ascending.
  std::vector<float> curl;
  /// |O|^2 / |J|^2 with J the Jacobian and O its antisymmetric part: 0 without curl, 0.5 in shear,
  /// 1 in a rotation.
  double turning = 0.0;
  /// The same where the curl is in its highest 5 percent: near 1 in the core of a vortex.
  double core = 0.0;
  double unit = 0.0;  ///< Among the vectors of the flow, fraction of those with length 1.
};

/// Analyse a sample of a grid's active voxels, of about kSuggestSamples at most. suggest.h
/// describes the criteria. If nearly all voxels of a scalar have the same value, analyseScalar()
/// analyses the other voxels alone, as if this value were the background of a sparse grid.
[[nodiscard]] ScalarAnalysis analyseScalar(const SuggestInput& input);
[[nodiscard]] VectorAnalysis analyseVector(const SuggestInput& input);

/// Returns true if the values of a scalar are a linear function of another grid: of its values, of
/// one of its components or of its magnitude.
[[nodiscard]] bool isLike(const SuggestInput& scalar, const SuggestInput& other);

/// Results of analysing several scalars together.
struct SumAnalysis {
  /// True if the scalars are within 0 and 1 and their sum is at most 1 nearly everywhere. The rest
  /// is then empty space.
  bool is_at_most_one = false;
  /// True if the scalars are within 0 and 1 and their sum is 1 nearly everywhere,
  bool is_one = false;
  /// except for the scalar with this index, which does not belong to the sum; no value: none.
  std::optional<std::size_t> other;
  /// True if most voxels contain at most one material; false if the materials are mixed.
  bool apart = false;
  std::vector<double> at_faces;  ///< Mean of each scalar on the faces of the box about all scalars.
  std::vector<double> throughout;  ///< Mean of each scalar in the whole box.
};
[[nodiscard]] SumAnalysis analyseSum(const std::vector<const SuggestInput*>& scalars);

}  // namespace palpate::guess
