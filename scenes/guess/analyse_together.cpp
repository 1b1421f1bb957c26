#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "palpate/scenes/guess/analysis.h"
#include "palpate/scenes/guess/sampling.h"

namespace palpate::guess {
namespace {

constexpr std::size_t kPlaces = 20'000;

std::vector<openvdb::Coord> spreadIn(const openvdb::CoordBBox& box) {
  const std::uint64_t step = box.volume() / kPlaces + 1;
  std::vector<openvdb::Coord> at;
  for (std::uint64_t n = 0; n < box.volume(); n += step) {
    at.push_back(voxelOf(box, n + hashOf(n) % std::min(step, box.volume() - n)));
  }
  return at;
}

/// Statistics of several scalars at the same voxels. ones() and alone() omit the scalar with the
/// index `without`; an index beyond the last scalar omits none.
class Sums {
 public:
  Sums(const std::vector<const SuggestInput*>& scalars, const std::vector<openvdb::Coord>& at) {
    readings_.reserve(scalars.size());
    for (const SuggestInput* scalar : scalars) readings_.push_back(readAt(*scalar, at));
    const bool image = scalars.front()->inactive_is_data;
    for (std::size_t i = 0; i < at.size(); ++i) {
      const auto active = [i](const Readings& read) { return bool{read.active[i]}; };
      if (image || std::any_of(readings_.begin(), readings_.end(), active)) data_.push_back(i);
    }
  }

  /// Returns the fraction of voxels where the scalars are from 0 to 1 and their sum is 1.
  [[nodiscard]] double ones(std::size_t without) {
    if (totals_.empty()) addUp();
    std::size_t count = 0;
    for (std::size_t n = 0; n < data_.size(); ++n) {
      Total total = totals_[n];
      if (without < readings_.size()) {
        const double value = readings_[without].values[data_[n]];
        total.sum -= value;
        total.beyond -= isFraction(value) ? 0 : 1;
      }
      count += total.beyond == 0 && std::abs(total.sum - 1.0) <= kNear ? 1 : 0;
    }
    return share(count);
  }
  /// Returns the fraction of voxels where the scalars are from 0 to 1 and their sum is at most 1.
  [[nodiscard]] double atMostOnes() {
    if (totals_.empty()) addUp();
    const auto fits = [](const Total& t) { return t.beyond == 0 && t.sum <= 1.0 + kNear; };
    return share(static_cast<std::size_t>(std::count_if(totals_.begin(), totals_.end(), fits)));
  }
  /// Returns the fraction of voxels where one scalar is nearly 1 or all are nearly 0.
  [[nodiscard]] double alone(std::size_t without) const {
    // a material with a greater fraction of a voxel fills the voxel nearly alone
    constexpr double kAlone = 0.95;
    std::size_t count = 0;
    for (const std::size_t i : data_) {
      bool found = false;
      double sum = 0.0;
      for (std::size_t m = 0; m < readings_.size(); ++m) {
        if (m == without) continue;
        const double value = readings_[m].values[i];
        found = found || value > kAlone;
        sum += value;
      }
      count += found || sum < 1.0 - kAlone ? 1 : 0;
    }
    return share(count);
  }
  [[nodiscard]] std::vector<double> means() const {
    std::vector<double> means;
    means.reserve(readings_.size());
    for (const Readings& read : readings_) {
      double sum = 0.0;
      for (const std::size_t i : data_) sum += read.values[i];
      means.push_back(sum / std::max(1.0, static_cast<double>(data_.size())));
    }
    return means;
  }

 private:
  struct Total {
    double sum = 0.0;
    int beyond = 0;
  };
  static constexpr double kNear = 0.01;  // tolerance for the limits 0 and 1, and for the sum
  static bool isFraction(double value) { return value >= -kNear && value <= 1.0 + kNear; }
  [[nodiscard]] double share(std::size_t count) const {
    return static_cast<double>(count) / std::max(1.0, static_cast<double>(data_.size()));
  }
  void addUp() {
    totals_.resize(data_.size());
    for (const Readings& read : readings_) {
      for (std::size_t n = 0; n < data_.size(); ++n) {
        const double value = read.values[data_[n]];
        totals_[n].sum += value;
        totals_[n].beyond += isFraction(value) ? 0 : 1;
      }
    }
  }

  std::vector<Readings> readings_;
  std::vector<std::size_t> data_;  ///< Indices of the voxels with data.
  std::vector<Total> totals_;
};

}  // namespace

bool isLike(const SuggestInput& scalar, const SuggestInput& other, Likeness likeness) {
  constexpr double kAlike = 0.97;  // least correlation of grids with the same content
  if (scalar.grid->transform() != other.grid->transform()) return false;
  const std::vector<openvdb::Coord> at = placesOf(scalar, kPlaces);
  const std::vector<float> own = readAt(scalar, at).values;
  std::array<std::vector<double>, 4> theirs;
  std::vector<double> ours;
  if (other.isVector()) {
    withVectors(other, [&]<class R, class G>(std::type_identity<R>, std::type_identity<G>) {
      const R reader(other);
      for (std::size_t i = 0; i < at.size(); ++i) {
        const openvdb::Vec3d v(reader.getValue(at[i]));
        if (!std::isfinite(v.length()) || !std::isfinite(own[i])) continue;
        for (int axis = 0; axis < 3; ++axis) {
          theirs[static_cast<std::size_t>(axis)].push_back(v[axis]);
        }
        theirs[3].push_back(v.length());
        ours.push_back(own[i]);
      }
    });
  } else {
    const std::vector<float> values = readAt(other, at).values;
    for (std::size_t i = 0; i < at.size(); ++i) {
      if (!std::isfinite(values[i]) || !std::isfinite(own[i])) continue;
      theirs[0].push_back(values[i]);
      ours.push_back(own[i]);
    }
  }
  const auto alike = likeness == Likeness::kMultiple ? proportionality : correlation;
  return std::any_of(theirs.begin(), theirs.end(), [&](const std::vector<double>& their) {
    return their.size() == ours.size() && alike(ours, their) > kAlike;
  });
}

SumAnalysis analyseSum(const std::vector<const SuggestInput*>& scalars) {
  SumAnalysis sum;
  if (scalars.size() < 2) return sum;
  openvdb::CoordBBox box;
  std::vector<openvdb::Coord> within;
  for (const SuggestInput* scalar : scalars) {
    if (scalar->grid->transform() != scalars.front()->grid->transform()) return sum;
    const auto some = placesOf(*scalar, std::max<std::size_t>(1, kPlaces / scalars.size()));
    within.insert(within.end(), some.begin(), some.end());
    box.expand(scalar->extent.empty() ? scalar->grid->evalActiveVoxelBoundingBox()
                                      : scalar->extent);
  }
  constexpr double kNearlyEverywhere = 0.98;  // fraction of the voxels
  constexpr double kMost = 0.5;  // fraction of the voxels; up to it, the materials are mixed
  Sums sums(scalars, within);
  // If there are only two scalars, both must belong to the sum.
  const std::size_t most = scalars.size() > 2 ? scalars.size() : 0;
  std::size_t without = scalars.size();
  sum.is_one = sums.ones(without) >= kNearlyEverywhere;
  for (std::size_t i = 0; !sum.is_one && i < most; ++i) {
    sum.is_one = sums.ones(i) >= kNearlyEverywhere;
    if (sum.is_one) without = i;
  }
  sum.is_at_most_one = sum.is_one || sums.atMostOnes() >= kNearlyEverywhere;
  if (!sum.is_at_most_one) return sum;
  if (without < scalars.size()) sum.other = without;
  sum.at_faces = Sums(scalars, facesOf(box)).means();
  const Sums throughout(scalars, spreadIn(box));
  sum.throughout = throughout.means();
  sum.apart = throughout.alone(without) > kMost;
  return sum;
}

}  // namespace palpate::guess
