/// Private to the scene guess: statistics of samples.
#pragma once

#include <vector>

namespace palpate::guess {

/// Returns a percentile of values that are in ascending order; 0 for an empty list.
[[nodiscard]] double percentile(const std::vector<float>& sorted, double percent);

/// Rounds to a thousandth of the power of ten of `range`, so that four digits of the variation
/// remain. The result is finite.
[[nodiscard]] double rounded(double value, double range);

/// Returns the evenness of a distribution: 1 if all values between the 1st and the 99th percentile
/// are equally frequent, 0 if all are equal. The values must be in ascending order.
[[nodiscard]] double entropyOf(const std::vector<float>& sorted);

/// Returns the magnitude of Pearson's correlation, 0 to 1. Returns 0 if there are less than 8 pairs
/// or if one list is constant. Both lists must have the same length.
[[nodiscard]] double correlation(const std::vector<double>& a, const std::vector<double>& b);

}  // namespace palpate::guess
