/// Percentiles and means of samples, for benchmarks.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <span>
#include <vector>

namespace palpate::bench {

/// Returns the sample at the share p of the sorted samples' ranks: p = 0 gives the smallest sample,
/// p = 1 the largest. Returns 0.0 without samples.
[[nodiscard]] inline double percentileOfSorted(const std::vector<double>& sorted, double p) {
  if (sorted.empty()) return 0.0;
  return sorted[static_cast<std::size_t>(std::lround(p * static_cast<double>(sorted.size() - 1)))];
}

/// Like percentileOfSorted(), for samples in any order.
[[nodiscard]] inline double percentile(std::vector<double> samples, double p) {
  std::sort(samples.begin(), samples.end());
  return percentileOfSorted(samples, p);
}

/// Sorts the samples. Returns the mean of their middle half: robust like a median, but finer than
/// the clock's resolution.
[[nodiscard]] inline double middleHalf(std::vector<double>& samples) {
  std::sort(samples.begin(), samples.end());
  const auto skip = static_cast<std::ptrdiff_t>(samples.size() / 4);
  return std::accumulate(samples.begin() + skip, samples.end() - skip, 0.0) /
         static_cast<double>(samples.size() - 2 * static_cast<std::size_t>(skip));
}

/// Returns the time per call. `timed` returns the time of a batch of 500 calls. Takes middleHalf()
/// of the batches, so a few batches that another program delayed do not count. Leaves out a last,
/// shorter batch. Returns NaN for fewer than 500 calls.
template <class T, class Timed>
[[nodiscard]] double middleOfBatches(std::span<const T> calls, Timed timed) {
  constexpr std::size_t kBatch = 500;
  std::vector<double> means;
  for (std::size_t i = 0; i + kBatch <= calls.size(); i += kBatch) {
    means.push_back(timed(calls.subspan(i, kBatch)) / static_cast<double>(kBatch));
  }
  return middleHalf(means);
}

}  // namespace palpate::bench
