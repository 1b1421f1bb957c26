/// Private to the scene guess: statistics of samples.
#pragma once

#include <vector>

namespace palpate::guess {

/// Returns a percentile of ascending values; 0 for an empty list.
[[nodiscard]] double percentile(const std::vector<float>& sorted, double percent);

/// Rounds to a thousandth of the decade of `range`: 4 digits of the variation. The result is
/// finite.
[[nodiscard]] double rounded(double value, double range);

/// Returns 1 if all values between the 1st and the 99th percentile are equally frequent, 0 if all
/// are equal. The values are ascending.
[[nodiscard]] double entropyOf(const std::vector<float>& sorted);

/// Returns the magnitude of Pearson's correlation of pairs: 0 to 1. Returns 0 for less than 8
/// pairs, or if one list is constant. The lists have equal lengths.
[[nodiscard]] double correlation(const std::vector<double>& a, const std::vector<double>& b);

}  // namespace palpate::guess
