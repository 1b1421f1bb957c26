#include <algorithm>
#include <cmath>

#include "palpate/scenes/guess/sampling.h"
#include "palpate/scenes/guess/scalar_parts.h"

namespace palpate::guess {
namespace {

double backgroundOf(const openvdb::GridBase& grid) {
  return grid.isType<openvdb::DoubleGrid>()
             ? static_cast<const openvdb::DoubleGrid&>(grid).background()
             : static_cast<const openvdb::FloatGrid&>(grid).background();
}

/// Returns a sample of the active voxels; leaves out values that are not finite.
std::vector<ScalarSample> sampleScalar(const SuggestInput& input) {
  auto samples =
      withScalars(input, [&]<class R, class G>(std::type_identity<R>, std::type_identity<G>) {
        return gather<ScalarSample, R, G>(
            input, kSuggestSamples, [&input](const R& reader, const openvdb::Coord& c) {
              ScalarSample sample;
              sample.value = reader.getValue(c);
              for (int axis = 0; axis < 3; ++axis) {
                const auto near = neighboursOf(reader, c, axis, input);
                if (!near.known || !std::isfinite(near.before) || !std::isfinite(near.after))
                  continue;
                const auto a = static_cast<std::size_t>(axis);
                sample.before[a] = near.before;
                sample.after[a] = near.after;
                sample.known[a] = true;
                sample.at_edge = sample.at_edge || near.at_edge;
              }
              return sample;
            });
      });
  samples.erase(std::remove_if(samples.begin(), samples.end(),
                               [](const ScalarSample& s) { return !std::isfinite(s.value); }),
                samples.end());
  return samples;
}

/// Finds a value that marks missing data, and removes it from the values and the samples. A sample
/// with such a neighbour along an axis has unknown neighbours along this axis.
void removeNoData(std::vector<ScalarSample>& samples, ScalarAnalysis& scalar) {
  const std::optional<float> no_data = noDataOf(scalar.values);
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

/// Sets the range between the 0.2nd and the 99.8th percentile, and the value of an image's
/// surroundings. If a sample touches the surroundings, the range includes their value.
void setRange(const std::vector<ScalarSample>& samples, const SuggestInput& input,
              ScalarAnalysis& scalar) {
  scalar.low = percentile(scalar.values, 0.2);
  scalar.high = percentile(scalar.values, 99.8);
  const double background = backgroundOf(*input.grid);
  if (!input.inactive_is_data || !std::isfinite(background) ||
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

}  // namespace

double ScalarAnalysis::shareAbove(double value) const {
  if (values.empty()) return 0.0;
  const auto at = std::upper_bound(values.begin(), values.end(), static_cast<float>(value));
  return static_cast<double>(values.end() - at) / static_cast<double>(values.size());
}

ScalarAnalysis analyseScalar(const SuggestInput& input) {
  constexpr double kRounding =
      1e-6;  // share of the largest value; a smaller range is due to rounding
  std::vector<ScalarSample> samples = sampleScalar(input);
  ScalarAnalysis scalar;
  if (samples.empty()) return scalar;
  scalar.values.reserve(samples.size());
  for (const ScalarSample& sample : samples) scalar.values.push_back(sample.value);
  std::sort(scalar.values.begin(), scalar.values.end());
  removeNoData(samples, scalar);
  setRange(samples, input, scalar);
  if (!(scalar.range() > kRounding * std::max(std::abs(scalar.low), std::abs(scalar.high)))) {
    scalar.low = scalar.high;
    return scalar;
  }
  analyseLabels(samples, scalar);
  scalar.entropy = entropyOf(scalar.values);
  const std::array<double, 3> edges = edgesOf(*input.grid);
  const double edge = std::cbrt(edges[0] * edges[1] * edges[2]);
  scalar.distance = isDistance(samples, edges, edge);
  const LevelIntegrals levels = integrateLevels(samples, scalar, edges);
  scalar.boundaries = findBoundaries(levels, scalar, edge, input.inactive_is_data);
  if (scalar.boundaries.empty()) {
    if (const auto front = findFront(levels, scalar)) scalar.boundaries.push_back(*front);
  }
  return scalar;
}

}  // namespace palpate::guess
