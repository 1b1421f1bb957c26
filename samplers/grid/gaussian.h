/// Private to samplers and scenes: weights of the Gaussian filters.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace palpate {

/// Returns the number of points that a Gaussian reads on each side: three standard deviations,
/// rounded down, but at most `most`.
/// @param deviation  Standard deviation [points], >= 0.
[[nodiscard]] inline std::size_t gaussianReach(double deviation, std::size_t most) {
  return static_cast<std::size_t>(std::min(3.0 * deviation, static_cast<double>(most)));
}

/// Returns the weights of a Gaussian from its middle to its reach. The middle has the weight 1, so
/// the caller divides by the sum of the weights of both sides.
/// @param deviation  Standard deviation [points], >= 0.
/// @param most       Largest reach [points].
[[nodiscard]] inline std::vector<double> gaussianWeights(double deviation, std::size_t most) {
  std::vector<double> weights(gaussianReach(deviation, most) + 1);
  for (std::size_t n = 0; n < weights.size(); ++n) {
    const double x = static_cast<double>(n) / std::max(deviation, 1e-12);
    weights[n] = std::exp(-0.5 * x * x);
  }
  return weights;
}

}  // namespace palpate
