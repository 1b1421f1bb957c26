/// Private to what knows OpenVDB: what the values of a grid are like, where they have boundaries,
/// how a flow runs.
#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include "palpate/scenes/suggest.h"

namespace palpate::guess {

/// Of values that ascend; 0 of none.
[[nodiscard]] double percentile(const std::vector<float>& sorted, double percent);

/// To a thousandth of the decade of `range`: 4 digits of what varies. Finite.
[[nodiscard]] double rounded(double value, double range);

/// A boundary between two materials, or of one that has no end.
struct Boundary {
  double value = 0.0;
  double foot = 0.0;   ///< Where its lower flank has risen.
  double lower = 0.0;  ///< Values of the materials, or the ends of the range.
  double upper = 0.0;
  double slope = 0.0;  ///< Mean gradient magnitude over it.
  double share = 0.0;  ///< Its gradient integral, in parts of the grid's greatest.
  bool lower_known = false;
  bool upper_known = false;
  bool front = false;  ///< Found where it is steepest, not between materials.
};

/// What a scalar grid holds.
struct ScalarLook {
  std::vector<float> values;  ///< Sampled, ascending.
  double low = 0.0;           ///< Nearly all lie between; the surroundings too.
  double high = 0.0;
  std::optional<double> outside;  ///< The value of an image's surroundings.
  std::vector<Boundary> boundaries;
  double entropy = 0.0;  ///< 0 to 1: how evenly the values use their range.
  double whole = 0.0;    ///< The share of the values that are whole numbers,
  double alike = 0.0;    ///< and of neighbours that are equal, but for the commonest value's.
  double skips = 0.0;    ///< Of those that differ the share between which there is another value.
  std::vector<float> distinct;    ///< The values that there are; empty: more than kMostDistinct.
  std::optional<double> nothing;  ///< The value that stands where there is no data: left out.
  bool distance = false;          ///< A signed distance, in units of the file or in voxels.

  [[nodiscard]] double range() const { return high - low; }
  [[nodiscard]] double round(double value) const { return rounded(value, range()); }
  [[nodiscard]] double shareAbove(double value) const;
  [[nodiscard]] double shareWithin(double from, double to) const {
    return shareAbove(from) - shareAbove(to);
  }
};

/// More values than labels have.
constexpr std::size_t kMostDistinct = 1024;

/// What a vector grid holds.
struct VectorLook {
  bool constant = true;
  std::vector<float> speed;  ///< Of the voxels that move, ascending.
  std::vector<float> curl;   ///< Of these, where all neighbours are known, ascending.
  double turning = 0.0;      ///< |O|^2 / |J|^2: 0 without curl, 0.5 in shear, 1 in a rotation.
  double unit = 0.0;         ///< The share of these that have length 1.
};

/// Look at a sample of the grid's active voxels, as suggest.h says.
[[nodiscard]] ScalarLook lookAtScalar(const SuggestInput& input);
[[nodiscard]] VectorLook lookAtVector(const SuggestInput& input);

/// Whether a scalar says what the other does, or one of its components or their magnitude, up to
/// scale and offset.
[[nodiscard]] bool isLike(const SuggestInput& scalar, const SuggestInput& other);

/// What several scalars come to together.
struct SumLook {
  bool is_one = false;               ///< All lie within 0 and 1, and add up to 1 nearly everywhere,
  std::optional<std::size_t> other;  ///< but for this one, which has nothing to do with the others.
  bool apart = false;                ///< Most places are of one of them alone; else they are mixed.
  std::vector<double> at_faces;    ///< Of each the mean at the faces of the box about all of them.
  std::vector<double> throughout;  ///< And in all of it.
};
[[nodiscard]] SumLook lookAtSum(const std::vector<const SuggestInput*>& scalars);

}  // namespace palpate::guess
