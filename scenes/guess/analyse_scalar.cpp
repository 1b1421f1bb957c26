#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "palpate/scenes/guess/sampling.h"
#include "palpate/scenes/guess/scalar_parts.h"

namespace palpate::guess {
namespace {

double backgroundOf(const openvdb::GridBase& grid) {
  return grid.isType<openvdb::DoubleGrid>()
             ? static_cast<const openvdb::DoubleGrid&>(grid).background()
             : static_cast<const openvdb::FloatGrid&>(grid).background();
}

/// The value of most voxels, and the greatest difference from it that is noise.
struct Common {
  float value = 0.0F;
  double noise = 0.0;

  [[nodiscard]] bool contains(float other) const {
    return std::abs(static_cast<double>(other) - value) <= noise;
  }
};

/// Samples the active voxels with finite values, except those with the value `common`, to within
/// its noise.
std::vector<ScalarSample> sampleScalar(const SuggestInput& input, std::optional<Common> common) {
  const auto is_common = [common](float value) { return common && common->contains(value); };
  auto samples =
      withScalars(input, [&]<class R, class G>(std::type_identity<R>, std::type_identity<G>) {
        const auto make = [&](const R& reader, const openvdb::Coord& c) {
          ScalarSample sample;
          sample.value = reader.getValue(c);
          for (int axis = 0; axis < 3; ++axis) {
            const auto near = neighboursOf(reader, c, axis, input);
            if (!near.known || !std::isfinite(near.before) || !std::isfinite(near.after)) continue;
            const auto a = static_cast<std::size_t>(axis);
            sample.before[a] = near.before;
            sample.after[a] = near.after;
            sample.known[a] = true;
            sample.at_edge =
                sample.at_edge || near.at_edge || is_common(near.before) || is_common(near.after);
          }
          return sample;
        };
        if (!common) return gather<ScalarSample, R, G>(input, kSuggestSamples, make);
        return gather<ScalarSample, R, G>(input, kSuggestSamples, make,
                                          [&](float value) { return !is_common(value); });
      });
  samples.erase(std::remove_if(samples.begin(), samples.end(),
                               [](const ScalarSample& s) { return !std::isfinite(s.value); }),
                samples.end());
  return samples;
}

/// Finds and removes a value that marks missing data. Neighbours with this value count as unknown.
void removeNoData(std::vector<ScalarSample>& samples, ScalarAnalysis& scalar) {
  // fraction of the samples; a rarer value is an outlier
  constexpr double kMany = 1e-3;
  const std::optional<float> no_data =
      noDataOf(scalar.values, kMany * static_cast<double>(scalar.values.size()));
  if (!no_data) return;
  scalar.no_data = *no_data;
  std::erase(scalar.values, *no_data);
  std::erase_if(samples, [&](const ScalarSample& s) { return s.value == *no_data; });
  for (ScalarSample& s : samples) {
    for (std::size_t a = 0; a < 3; ++a) {
      if (s.before[a] != *no_data && s.after[a] != *no_data) continue;
      s.known[a] = s.at_edge = false;
      s.before[a] = s.after[a] = 0.0F;
    }
  }
}

/// Sets the value of the surroundings, and the range of nearly all values. If a sample touches the
/// surroundings, the range includes their value.
void setRange(const std::vector<ScalarSample>& samples, const SuggestInput& input,
              ScalarAnalysis& scalar) {
  scalar.low = percentile(scalar.values, 0.2);
  scalar.high = percentile(scalar.values, 99.8);
  const double background = scalar.common.value_or(backgroundOf(*input.grid));
  if ((!input.inactive_is_data && !scalar.common) || !std::isfinite(background) ||
      (scalar.no_data && *scalar.no_data == background)) {
    return;
  }
  scalar.outside = background;
  if (std::any_of(samples.begin(), samples.end(),
                  [](const ScalarSample& s) { return s.at_edge; })) {
    scalar.low = std::min(scalar.low, *scalar.outside);
    scalar.high = std::max(scalar.high, *scalar.outside);
  }
}

/// Moves boundaries that are within the noise of the common value to the end of the noise: they
/// would enclose noise.
void moveOutOfNoise(const Common& common, std::vector<Boundary>& boundaries) {
  for (Boundary& b : boundaries) {
    if (!common.contains(static_cast<float>(b.value))) continue;
    b.value = b.foot = common.value + (b.value < common.value ? -common.noise : common.noise);
  }
}

/// Analyses samples. `common` is the value of most voxels, if the samples exclude these voxels.
ScalarAnalysis analyseSamples(std::vector<ScalarSample> samples, const SuggestInput& input,
                              std::optional<Common> common) {
  constexpr double kRounding = 1e-6;  // of the largest value; a smaller range is rounding
  ScalarAnalysis scalar;
  if (samples.empty()) return scalar;
  if (common) scalar.common = common->value;
  scalar.values.reserve(samples.size());
  for (const ScalarSample& sample : samples) scalar.values.push_back(sample.value);
  std::sort(scalar.values.begin(), scalar.values.end());
  removeNoData(samples, scalar);
  setRange(samples, input, scalar);
  const std::array<double, 3> edges = edgesOf(*input.grid);
  const double edge = std::cbrt(edges[0] * edges[1] * edges[2]);
  analyseDistance(samples, input, scalar);
  if (!(scalar.range() > kRounding * std::max(std::abs(scalar.low), std::abs(scalar.high)))) {
    scalar.low = scalar.high;
    return scalar;
  }
  analyseLabels(samples, scalar);
  scalar.entropy = entropyOf(scalar.values);
  const LevelIntegrals levels = integrateLevels(samples, scalar, edges);
  scalar.boundaries = findBoundaries(levels, scalar, edge, input.inactive_is_data);
  if (common) moveOutOfNoise(*common, scalar.boundaries);
  // Both sides of a front have data, so searches for it only if all voxels were sampled.
  if (scalar.boundaries.empty() && !scalar.common) {
    if (const auto front = findFront(input, scalar)) scalar.boundaries.push_back(*front);
  }
  scalar.has_object = !scalar.boundaries.empty();
  return scalar;
}

bool hasSpread(const ScalarAnalysis& scalar) {
  const auto at = [&](double percent) { return scalar.round(percentile(scalar.values, percent)); };
  return at(95.0) > at(5.0);
}

/// Returns the standard deviation of noise, from the median of the second differences along the
/// axes. In a smooth field these differences are small.
double noiseOf(const std::vector<ScalarSample>& samples) {
  constexpr double kMedian = 0.6745;  // median of |x| for a Gaussian of deviation 1
  std::vector<double> differences;
  for (const ScalarSample& s : samples) {
    for (std::size_t a = 0; a < 3; ++a) {
      if (!s.known[a]) continue;
      differences.push_back(std::abs(double{s.before[a]} + s.after[a] - 2.0 * s.value));
    }
  }
  if (differences.empty()) return 0.0;
  const auto middle = differences.begin() + static_cast<std::ptrdiff_t>(differences.size() / 2);
  std::nth_element(differences.begin(), middle, differences.end());
  return *middle / (kMedian * std::sqrt(6.0));
}

/// Returns the median, if nearly all voxels have this value to within the noise: those at the 5th
/// and the 95th percentile, and more than half of all. `noise` is its standard deviation.
std::optional<Common> commonOf(const ScalarAnalysis& all, double noise) {
  constexpr double kReach = 6.0;  // [standard deviations]: exceeded by 2 of 1e9 noisy voxels
  if (all.values.empty()) return std::nullopt;
  const Common common{all.values[all.values.size() / 2], kReach * noise};
  const auto at = [&](double percent) { return percentile(all.values, percent); };
  const auto within = [&](double percent) {
    return common.contains(static_cast<float>(at(percent)));
  };
  if (hasSpread(all) && !(within(5.0) && within(95.0))) return std::nullopt;
  const auto count = std::count_if(all.values.begin(), all.values.end(),
                                   [&](float value) { return common.contains(value); });
  return 2 * static_cast<std::size_t>(count) > all.values.size() ? std::optional(common)
                                                                 : std::nullopt;
}

/// Returns true if most of the samples have no neighbour that differs from `common`, as in noise.
bool areSpikes(const std::vector<ScalarSample>& samples, const Common& common) {
  const auto is_alone = [&](const ScalarSample& s) {
    for (std::size_t a = 0; a < 3; ++a) {
      const bool same = common.contains(s.before[a]) && common.contains(s.after[a]);
      if (s.known[a] && !same) return false;
    }
    return true;
  };
  const auto alone = std::count_if(samples.begin(), samples.end(), is_alone);
  return 2 * static_cast<std::size_t>(alone) > samples.size();
}

}  // namespace

double ScalarAnalysis::shareAbove(double value) const {
  if (values.empty()) return 0.0;
  const auto at = std::upper_bound(values.begin(), values.end(), static_cast<float>(value));
  return static_cast<double>(values.end() - at) / static_cast<double>(values.size());
}

bool varies(const ScalarAnalysis& scalar) {
  return scalar.distance != Distance::kNone ||
         (scalar.range() > 0.0 && (!scalar.boundaries.empty() || hasSpread(scalar)));
}

ScalarAnalysis analyseScalar(const SuggestInput& input) {
  // A body of fewer than four voxels along each edge has no resolved boundary.
  constexpr std::size_t kLeast = 64;
  std::vector<ScalarSample> samples = sampleScalar(input, std::nullopt);
  const double noise = noiseOf(samples);
  ScalarAnalysis all = analyseSamples(std::move(samples), input, std::nullopt);
  if (all.distance != Distance::kNone) return all;
  const std::optional<Common> common = commonOf(all, noise);
  if (!common) return all;
  std::vector<ScalarSample> others = sampleScalar(input, common);
  if (others.size() < kLeast || (common->noise > 0.0 && areSpikes(others, *common))) return all;
  ScalarAnalysis few = analyseSamples(std::move(others), input, common);
  if (!varies(few)) return all;
  // A scalar that varies in few voxels must rank below others.
  few.entropy = all.entropy;
  few.has_object = all.has_object;
  return few;
}

}  // namespace palpate::guess
