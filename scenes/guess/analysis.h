/// Private to the scene guess: analysis of a grid's values, boundaries and flow.
#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include "palpate/scenes/guess/statistics.h"
#include "palpate/scenes/guess/suggest.h"

namespace palpate::guess {

/// A boundary between two materials, or of a material with an open range of values.
struct Boundary {
  double value = 0.0;
  double foot = 0.0;   ///< Value at which its lower flank has risen.
  double lower = 0.0;  ///< Values of the materials, or the ends of the range.
  double upper = 0.0;
  double slope = 0.0;  ///< Mean gradient magnitude over it.
  double share = 0.0;  ///< Its gradient integral, relative to the greatest of the grid.
  bool lower_known = false;
  bool upper_known = false;
  bool front = false;  ///< Found by its steepness, not between materials.
};

/// Analysis of a scalar grid.
struct ScalarAnalysis {
  std::vector<float> values;  ///< Samples, ascending.
  double low = 0.0;           ///< Nearly all values, also the surroundings', are between these.
  double high = 0.0;
  std::optional<double> outside;  ///< Value of an image's surroundings.
  std::vector<Boundary> boundaries;
  double entropy = 0.0;  ///< 0 to 1: how evenly the values use their range.
  double whole = 0.0;    ///< Share of the values that are whole numbers.
  double alike = 0.0;    ///< Share of equal neighbours, without pairs that have the commonest
                         ///< value.
  double skips = 0.0;    ///< Share of unequal neighbours with another value between them.
  std::vector<float> distinct;    ///< All values that occur; empty: more than kMostDistinct.
  std::optional<double> no_data;  ///< Marks missing data; left out of the analysis.
  bool distance = false;          ///< The grid is a signed distance, in units of the file or in
                                  ///< voxels.

  [[nodiscard]] double range() const { return high - low; }
  [[nodiscard]] double round(double value) const { return rounded(value, range()); }
  [[nodiscard]] double shareAbove(double value) const;
  [[nodiscard]] double shareWithin(double from, double to) const {
    return shareAbove(from) - shareAbove(to);
  }
};

/// A grid with more different values than this has no labels.
constexpr std::size_t kMostDistinct = 1024;

/// Analysis of a vector grid.
struct VectorAnalysis {
  bool constant = true;
  std::vector<float> speed;  ///< Speeds of the moving voxels, ascending.
  std::vector<float> curl;   ///< Curl of moving voxels whose neighbours are all known, ascending.
  double turning = 0.0;      ///< |O|^2 / |J|^2: 0 without curl, 0.5 in shear, 1 in a rotation.
  double unit = 0.0;         ///< Share of the moving voxels that have length 1.
};

/// Analyse a sample of the grid's active voxels, at most about kSuggestSamples. The criteria are in
/// suggest.h.
[[nodiscard]] ScalarAnalysis analyseScalar(const SuggestInput& input);
[[nodiscard]] VectorAnalysis analyseVector(const SuggestInput& input);

/// Returns true if a scalar matches another grid, one of its components or their magnitude, up to
/// scale and offset.
[[nodiscard]] bool isLike(const SuggestInput& scalar, const SuggestInput& other);

/// Analysis of several scalars together.
struct SumAnalysis {
  bool is_one = false;               ///< All are within 0 and 1, and add up to 1 nearly everywhere,
  std::optional<std::size_t> other;  ///< except for this one, which is unrelated to the others.
  bool apart = false;                ///< Most places hold one of them alone; else they are mixed.
  std::vector<double> at_faces;      ///< Mean of each at the faces of the box about all scalars.
  std::vector<double> throughout;    ///< Mean of each in the whole box.
};
[[nodiscard]] SumAnalysis analyseSum(const std::vector<const SuggestInput*>& scalars);

}  // namespace palpate::guess
