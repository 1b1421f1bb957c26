/// Private to samplers: the requested bricks, the most urgent first. Include it in .cpp files only.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>
#include <set>
#include <utility>
#include <vector>

#include "palpate/samplers/bricks/bricks.h"

namespace palpate {

/// The list of BrickSource::want(), and the fetches in progress. Not thread-safe.
class RequestQueue {
 public:
  /// Reserves memory, so that begin() does not allocate for this many fetches at a time.
  explicit RequestQueue(std::size_t at_once = 64) { begun_.reserve(at_once); }

  /// Replaces the list, except for fetches in progress.
  void set(std::vector<BrickWish> wishes) {
    // NaN gets the lowest priority, so that the order is defined.
    for (BrickWish& wish : wishes) {
      if (std::isnan(wish.priority)) wish.priority = -std::numeric_limits<double>::infinity();
    }
    std::stable_sort(wishes.begin(), wishes.end(), [](const BrickWish& a, const BrickWish& b) {
      return a.priority > b.priority;
    });
    // Keep each brick once, with its highest priority.
    std::set<BrickId> seen(begun_.begin(), begun_.end());
    std::erase_if(wishes, [&](const BrickWish& wish) { return !seen.insert(wish.id).second; });
    std::reverse(wishes.begin(), wishes.end());
    wishes_ = std::move(wishes);
  }
  [[nodiscard]] bool empty() const noexcept { return wishes_.empty(); }
  /// Returns the most urgent brick and marks its fetch as begun. The list must not be empty.
  [[nodiscard]] BrickId begin() {
    const BrickId id = wishes_.back().id;
    wishes_.pop_back();
    begun_.push_back(id);
    return id;
  }
  /// The fetch of a brick is over, with or without success.
  void end(const BrickId& id) { std::erase(begun_, id); }

 private:
  std::vector<BrickWish> wishes_;  ///< The most urgent last.
  std::vector<BrickId> begun_;
};

}  // namespace palpate
