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

/// Samples the finite active voxels, except those with the value `common`.
std::vector<ScalarSample> sampleScalar(const SuggestInput& input, std::optional<float> common) {
  const auto is_common = [common](float value) { return common && value == *common; };
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

/// Finds and removes a value that marks missing data. Neighbours with it count as unknown.
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

/// `common`: the value of most voxels, if these are not among the samples.
ScalarAnalysis analyseSamples(std::vector<ScalarSample> samples, const SuggestInput& input,
                              std::optional<float> common) {
  constexpr double kRounding = 1e-6;  // of the largest value; a smaller range is rounding
  ScalarAnalysis scalar;
  if (samples.empty()) return scalar;
  if (common) scalar.common = *common;
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

std::optional<float> commonOf(const std::vector<float>& sorted) {
  if (sorted.empty()) return std::nullopt;
  const float middle = sorted[sorted.size() / 2];
  const auto [from, to] = std::equal_range(sorted.begin(), sorted.end(), middle);
  return 2 * static_cast<std::size_t>(to - from) > sorted.size() ? std::optional(middle)
                                                                 : std::nullopt;
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
  ScalarAnalysis all = analyseSamples(sampleScalar(input, std::nullopt), input, std::nullopt);
  if (all.distance != Distance::kNone || hasSpread(all)) return all;
  const std::optional<float> common = commonOf(all.values);
  if (!common) return all;
  std::vector<ScalarSample> others = sampleScalar(input, common);
  if (others.size() < kLeast) return all;
  ScalarAnalysis few = analyseSamples(std::move(others), input, common);
  if (!varies(few)) return all;
  // A scalar that varies in few voxels must rank below others.
  few.entropy = all.entropy;
  few.has_object = all.has_object;
  return few;
}

}  // namespace palpate::guess
