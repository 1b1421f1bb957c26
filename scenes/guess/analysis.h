/// Private to the scene guess: analysis of a grid for its kind, its boundaries and its flow.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "palpate/scenes/guess/statistics.h"
#include "palpate/scenes/guess/suggest.h"

namespace palpate::guess {

/// A boundary between two materials, or between a material and values of no known material.
struct Boundary {
  double value = 0.0;
  /// Value at which the mean gradient magnitude has risen by two thirds, coming from `lower`.
  double foot = 0.0;
  /// Values of the two materials; for an unknown material, the end of the range.
  double lower = 0.0;
  double upper = 0.0;
  double slope = 0.0;  ///< Mean gradient magnitude over the boundary [values per unit of the file].
  /// Integral of the gradient over the boundary, relative to the greatest one in the grid.
  double share = 0.0;
  bool lower_known = false;
  bool upper_known = false;
  /// True if found by its steepness (findFront).
  bool front = false;
};

/// Whether a grid is a signed distance, in units of the file or in voxels.
enum class Distance : std::uint8_t {
  kNone,
  kFull,       ///< The values change by 1 per unit or per voxel.
  kTruncated,  ///< Cut off at a distance from the surface, and noisy or divided by this distance.
};

struct ScalarAnalysis {
  std::vector<float> values;
  /// Range of nearly all values, including the value of the surroundings.
  double low = 0.0;
  double high = 0.0;
  std::optional<double> outside;  ///< Value of the surroundings of an image; no value for a mesh.
  std::vector<Boundary> boundaries;
  bool has_object = false;  ///< True if the analysis of all voxels found a boundary.
  /// Evenness of the distribution: 0 if all values are equal, 1 if all are equally frequent.
  double entropy = 0.0;
  double whole = 0.0;  ///< Fraction of whole numbers.
  /// Fraction of equal neighbours, without pairs that contain the most frequent value.
  double alike = 0.0;
  double skips = 0.0;  ///< Fraction of unequal neighbours with another grid value in between.
  /// All values that occur; empty if there are more than kMostDistinct.
  std::vector<float> distinct;
  std::optional<double> no_data;  ///< Value that marks missing data; the analysis ignores it.
  Distance distance = Distance::kNone;
  bool positive_inside = false;  ///< True for a distance that is positive inside of the bodies.
  /// Value of most voxels, if only the few others were analysed; otherwise no value.
  std::optional<double> common;

  [[nodiscard]] double range() const { return high - low; }
  [[nodiscard]] double round(double value) const { return rounded(value, range()); }
  [[nodiscard]] double shareAbove(double value) const;
  [[nodiscard]] double shareWithin(double from, double to) const {
    return shareAbove(from) - shareAbove(to);
  }
};

/// Returns true if a mode can use the values: they have a boundary or a spread, or are a distance.
[[nodiscard]] bool varies(const ScalarAnalysis& scalar);

/// A grid with more than this number of different values does not contain labels.
constexpr std::size_t kMostDistinct = 1024;

struct VectorAnalysis {
  bool constant = true;
  std::vector<float> speed;  ///< Magnitudes of the vectors that are part of the flow, ascending.
  /// Magnitudes of the curl at vectors of the flow with known neighbours, ascending.
  std::vector<float> curl;
  /// |O|^2 / |J|^2, with O the antisymmetric part of the Jacobian J: 0.5 in shear, 1 in a rotation.
  double turning = 0.0;
  /// `turning` where the curl is in its highest 5 percent: near 1 in the core of a vortex.
  double core = 0.0;
  double unit = 0.0;  ///< Fraction of the flow's vectors with length 1.
};

/// Analyse about kSuggestSamples active voxels (see suggest.h). If nearly all voxels of a scalar
/// have one value, analyseScalar() treats this value as the background of the others.
[[nodiscard]] ScalarAnalysis analyseScalar(const SuggestInput& input);
[[nodiscard]] VectorAnalysis analyseVector(const SuggestInput& input);

/// Returns true if a scalar is a linear function of another grid, its component or its magnitude.
[[nodiscard]] bool isLike(const SuggestInput& scalar, const SuggestInput& other);

/// Results of analysing several scalars together. Fractions are scalars within 0 and 1.
struct SumAnalysis {
  /// True if the scalars are fractions with a sum of at most 1 nearly everywhere.
  bool is_at_most_one = false;
  /// True if the scalars, apart from `other`, are fractions with the sum 1 nearly everywhere.
  bool is_one = false;
  /// Index of the scalar that does not belong to the sum; no value: all belong to it.
  std::optional<std::size_t> other;
  /// True if most voxels contain at most one material; false if the materials are mixed.
  bool apart = false;
  std::vector<double> at_faces;  ///< Mean of each scalar on the faces of the box about all scalars.
  std::vector<double> throughout;  ///< Mean of each scalar in the whole box.
};
[[nodiscard]] SumAnalysis analyseSum(const std::vector<const SuggestInput*>& scalars);

}  // namespace palpate::guess
