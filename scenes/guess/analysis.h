/// Private to the scene guess: analysis of a grid for its kind, its boundaries and its flow.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "palpate/scenes/guess/statistics.h"
#include "palpate/scenes/guess/suggest.h"

namespace palpate::guess {

/// A boundary between two materials, or between a material and other values.
struct Boundary {
  double value = 0.0;
  /// First value above `lower` at which the mean gradient has risen by two thirds of the difference
  /// between its value at `lower` and `slope`. At a front, or if `lower` is unknown: `value`.
  double foot = 0.0;
  /// Values of the two materials, `lower` and `upper`. For an unknown material: the end of the
  /// range.
  double lower = 0.0;
  double upper = 0.0;
  double slope = 0.0;  ///< Mean gradient magnitude over the boundary [values per unit of the file].
  /// Integral of the gradient over the boundary, relative to the greatest boundary of the grid.
  double share = 0.0;
  bool lower_known = false;
  bool upper_known = false;
  /// True if the boundary is a front (findFront).
  bool front = false;
};

/// States whether a grid is a signed distance.
enum class Distance : std::uint8_t {
  kNone,
  kFull,       ///< The values change by 1 per unit or per voxel.
  kTruncated,  ///< Cut off at a distance from the surface, and noisy or in another unit.
};

struct ScalarAnalysis {
  std::vector<float> values;
  /// Range of nearly all values; includes the surroundings' value if a sample touches them.
  double low = 0.0;
  double high = 0.0;
  std::optional<double> outside;  ///< Value around an image or, with `common`, around the analysed
                                  ///< voxels. No value if unknown, as for a mesh.
  std::vector<Boundary> boundaries;
  bool has_object = false;  ///< True if the analysis of all voxels found a boundary.
  /// Evenness of the distribution: 0 if all values are equal, 1 if all are equally frequent.
  double entropy = 0.0;
  /// Fraction of whole numbers of at most 2^24 in magnitude; 0 if the range is below 1.
  double whole = 0.0;
  /// Fraction of neighbours with equal values. Ignores pairs with the most frequent value.
  double alike = 0.0;
  /// Fraction of unequal neighbours with a value of `distinct` between their two values.
  double skips = 0.0;
  /// All different values of the samples and of the surroundings that they touch; empty if the
  /// samples have more than kMostDistinct.
  std::vector<float> distinct;
  std::optional<double> no_data;  ///< Value that marks missing data; the analysis ignores it.
  Distance distance = Distance::kNone;
  bool positive_inside = false;  ///< True for a distance that is positive inside bodies.
  /// Value of most voxels, if only the other voxels were analysed.
  std::optional<double> common;

  [[nodiscard]] double range() const { return high - low; }
  [[nodiscard]] double round(double value) const { return rounded(value, range()); }
  [[nodiscard]] double shareAbove(double value) const;
  [[nodiscard]] double shareWithin(double from, double to) const {
    return shareAbove(from) - shareAbove(to);
  }
};

/// Returns the labels in the metadata of a scalar grid that have active voxels, largest first.
/// Omits the value of the background, which surrounds the others. Removes a name that a scene
/// cannot use: of two labels, or not UTF-8. Reads all active voxels if the metadata have labels.
/// Returns no labels of a volume in bricks.
[[nodiscard]] std::vector<Label> segmentsOf(const SuggestInput& input);

/// Returns true if a mode can use the values: they have a boundary, a spread, or are a distance.
[[nodiscard]] bool varies(const ScalarAnalysis& scalar);

/// A grid with more different values than this does not contain labels.
constexpr std::size_t kMostDistinct = 1024;

struct VectorAnalysis {
  bool constant = true;
  /// Magnitudes of the flow's vectors, ascending. A vector belongs to the flow if it is longer than
  /// 1 % of the 99.8th percentile of all lengths.
  std::vector<float> speed;
  /// Magnitudes of the curl at the flow's vectors, where all neighbours are known; ascending.
  std::vector<float> curl;
  /// |O|^2 / |J|^2 with the Jacobian J and its antisymmetric part O: 0.5 in shear, 1 in a rotation.
  double turning = 0.0;
  /// `turning` where the curl is above its percentile `core_percent`: near 1 in the core of a
  /// vortex. The percentile is 95 or 99, whichever gives more; 99 only if enough voxels exceed it.
  double core = 0.0;
  double core_percent = 95.0;
  double unit = 0.0;  ///< Fraction of the flow's vectors with length 1.
};

/// Analyse about kSuggestSamples active voxels (suggest.h). If nearly all voxels of a scalar have
/// one value, or differ from it only by noise, analyseScalar() treats this value as the background.
/// It then analyses the other voxels, if these are enough and vary.
[[nodiscard]] ScalarAnalysis analyseScalar(const SuggestInput& input);
[[nodiscard]] VectorAnalysis analyseVector(const SuggestInput& input);

enum class Likeness : std::uint8_t {
  kLinear,    ///< A linear function.
  kMultiple,  ///< A linear function without an offset, as the same quantity in another unit.
};
/// Returns true if a scalar is nearly a function of this kind of another scalar, or of a component
/// or the magnitude of a vector. False if the transforms of the grids differ.
[[nodiscard]] bool isLike(const SuggestInput& scalar, const SuggestInput& other, Likeness likeness);

/// Results of analysing several scalars together. Fractions are scalars with values from 0 to 1.
struct SumAnalysis {
  /// True if nearly everywhere the scalars are fractions with a sum of at most 1, or if `is_one`.
  bool is_at_most_one = false;
  /// True if nearly everywhere the scalars, except `other`, are fractions with the sum 1.
  bool is_one = false;
  /// Index of the scalar that does not belong to the sum; no value: all belong to it.
  std::optional<std::size_t> other;
  /// True if `is_at_most_one`, and most voxels contain at most one material; else false.
  bool apart = false;
  /// Mean of each scalar on the faces of the box around all scalars.
  std::vector<double> at_faces;
  std::vector<double> throughout;  ///< Mean of each scalar in this box.
};
[[nodiscard]] SumAnalysis analyseSum(const std::vector<const SuggestInput*>& scalars);

}  // namespace palpate::guess
