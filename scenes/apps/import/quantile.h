#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace palpate::importer {

/// Returns the value at the fraction `share` (0 to 1) of the sorted values; 0 without values.
/// Between two values, returns the nearer one, or the upper one if both are equally near. Changes
/// the order of `values`.
template <class T>
[[nodiscard]] T quantile(std::vector<T>& values, double share) {
  if (values.empty()) return T(0);
  const auto last = static_cast<double>(values.size() - 1);
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(std::lround(share * last));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

}  // namespace palpate::importer
