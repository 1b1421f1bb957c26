/// Private to the scene guess: statistics of samples.
#pragma once

#include <vector>

namespace palpate::guess {

/// Returns a percentile of values that are in ascending order; 0 for an empty list.
[[nodiscard]] double percentile(const std::vector<float>& sorted, double percent);

/// Rounds to a thousandth of the largest power of ten that is at most `range`, which keeps four
/// digits of the range. If `range` is not above 0, returns the value unchanged. Returns 0 for a
/// value that is not finite.
[[nodiscard]] double rounded(double value, double range);

/// Returns the evenness of ascending values: 0 if all are equal, 1 if all from the 1st to the 99th
/// percentile are equally frequent.
[[nodiscard]] double entropyOf(const std::vector<float>& sorted);

/// Returns the magnitude of Pearson's correlation of two lists of equal length; 0 for fewer than 8
/// pairs, or if a list is constant.
[[nodiscard]] double correlation(const std::vector<double>& a, const std::vector<double>& b);

/// Returns how well `a` is a multiple of `b`, without an offset: the correlation that would leave
/// the same residuals; 0 for fewer than 8 pairs, or if `a` is constant or `b` is 0.
[[nodiscard]] double proportionality(const std::vector<double>& a, const std::vector<double>& b);

}  // namespace palpate::guess
