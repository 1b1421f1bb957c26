#include <algorithm>
#include <cmath>
#include <numeric>

#include "palpate/scenes/guess/scalar_parts.h"

namespace palpate::guess {

Bins smoothed(const Bins& in) {
  constexpr int kReach = 6;
  Bins out{};
  for (int i = 0; i < static_cast<int>(kBins); ++i) {
    double sum = 0.0;
    double weights = 0.0;
    for (int d = -kReach; d <= kReach; ++d) {
      const int j = std::clamp(i + d, 0, static_cast<int>(kBins) - 1);
      const double weight = std::exp(-0.125 * d * d);
      sum += weight * in[static_cast<std::size_t>(j)];
      weights += weight;
    }
    out[static_cast<std::size_t>(i)] = sum / weights;
  }
  return out;
}

LevelIntegrals integrateLevels(const std::vector<ScalarSample>& samples,
                               const ScalarAnalysis& scalar, const std::array<double, 3>& edges) {
  // A sample adds the same amount to all levels between its neighbours, so only the differences at
  // the two ends are stored.
  std::array<double, kBins + 1> area{};
  std::array<double, kBins + 1> gradient{};
  LevelIntegrals levels;
  const double volume = edges[0] * edges[1] * edges[2];
  const double bins = static_cast<double>(kBins);
  // A level is the value in the middle of its bin.
  const auto level_from = [&](double value) {
    const double bin = std::ceil((value - scalar.low) / scalar.range() * bins - 0.5);
    return static_cast<std::size_t>(std::clamp(bin, 0.0, bins));
  };
  const auto bin_of = [&](double value) {
    const double bin = std::floor((value - scalar.low) / scalar.range() * bins);
    return static_cast<std::size_t>(std::clamp(bin, 0.0, bins - 1.0));
  };
  for (const ScalarSample& sample : samples) {
    std::array<double, 3> slope{};
    for (std::size_t axis = 0; axis < 3; ++axis) {
      slope[axis] = std::abs(static_cast<double>(sample.after[axis]) - sample.before[axis]) /
                    (2.0 * edges[axis]);
    }
    const double whole = std::hypot(slope[0], slope[1], slope[2]);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      if (!(slope[axis] > 0.0)) continue;
      const auto [lower, upper] = std::minmax(sample.before[axis], sample.after[axis]);
      const double seen = volume / edges[axis];
      const std::size_t from = level_from(lower);
      const std::size_t to = level_from(upper);
      area[from] += seen * slope[axis] / whole;
      area[to] -= seen * slope[axis] / whole;
      gradient[from] += seen * slope[axis];
      gradient[to] -= seen * slope[axis];
    }
    if (sample.value >= scalar.low && sample.value <= scalar.high) {
      levels.count[bin_of(sample.value)] += 1.0;
    }
    // The surroundings count as a material at the edge of an image's active voxels.
    if (sample.at_edge && scalar.outside) levels.count[bin_of(*scalar.outside)] += 1.0;
  }
  std::partial_sum(area.begin(), area.end() - 1, levels.area.begin());
  std::partial_sum(gradient.begin(), gradient.end() - 1, levels.gradient.begin());
  // Smaller areas are rounding errors of the running sum.
  const double least = 1e-9 * *std::max_element(levels.area.begin(), levels.area.end());
  for (std::size_t i = 0; i < kBins; ++i) {
    if (levels.area[i] <= least) levels.area[i] = levels.gradient[i] = 0.0;
  }
  return levels;
}

}  // namespace palpate::guess
