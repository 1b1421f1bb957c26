#include "palpate/engine/error.h"

#include <algorithm>
#include <numeric>

namespace palpate {

std::string nearestName(const std::string& name, const std::vector<std::string>& candidates) {
  // The cost of the Levenshtein distance is the product of both lengths. So the function skips
  // names longer than kLongest.
  constexpr std::size_t kLongest = 200;
  if (name.size() > kLongest) return {};
  std::string best;
  std::size_t best_distance = name.size() / 3 + 1;
  for (const std::string& candidate : candidates) {
    if (candidate.size() > 2 * kLongest) continue;
    std::vector<std::size_t> row(candidate.size() + 1);
    std::iota(row.begin(), row.end(), std::size_t{0});
    for (std::size_t i = 1; i <= name.size(); ++i) {
      std::size_t diagonal = row[0];
      row[0] = i;
      for (std::size_t j = 1; j <= candidate.size(); ++j) {
        const std::size_t change = diagonal + (name[i - 1] == candidate[j - 1] ? 0 : 1);
        diagonal = row[j];
        row[j] = std::min({row[j] + 1, row[j - 1] + 1, change});
      }
    }
    if (row.back() <= best_distance) {
      if (row.back() < best_distance || best.empty()) best = candidate;
      best_distance = row.back();
    }
  }
  return best;
}

}  // namespace palpate
