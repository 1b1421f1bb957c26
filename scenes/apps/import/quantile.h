/// Finds the value below which a given share of values lies.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace palpate::importer {

/// Returns the quantile of the values, or 0 if there are no values. Reorders `values`.
/// @param share  0 (the lowest) to 1. 0.5 gives the median; for an even count, the upper one.
template <class T>
[[nodiscard]] T quantile(std::vector<T>& values, double share) {
  if (values.empty()) return T(0);
  const auto last = static_cast<double>(values.size() - 1);
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(std::lround(share * last));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

}  // namespace palpate::importer
