/// Private to samplers, for .cpp files only: a queue of requested bricks, ordered by priority.
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

/// Requests of the last BrickSource::want(), and fetches in progress. Not thread-safe.
class RequestQueue {
 public:
  /// Reserves memory for this many fetches, so that begin() does not allocate.
  explicit RequestQueue(std::size_t at_once = 64) { begun_.reserve(at_once); }

  /// Replaces all requests by new ones, except for bricks with a fetch in progress.
  void set(std::vector<BrickWish> wishes) {
    for (BrickWish& wish : wishes) {
      if (std::isnan(wish.priority)) wish.priority = -std::numeric_limits<double>::infinity();
    }
    std::stable_sort(wishes.begin(), wishes.end(), [](const BrickWish& a, const BrickWish& b) {
      return a.priority > b.priority;
    });
    std::set<BrickId> seen(begun_.begin(), begun_.end());
    std::erase_if(wishes, [&](const BrickWish& wish) { return !seen.insert(wish.id).second; });
    std::reverse(wishes.begin(), wishes.end());
    wishes_ = std::move(wishes);
  }
  [[nodiscard]] bool empty() const noexcept { return wishes_.empty(); }
  /// Moves the request of the highest priority to the fetches in progress. The queue must not be
  /// empty.
  [[nodiscard]] BrickId begin() {
    const BrickId id = wishes_.back().id;
    wishes_.pop_back();
    begun_.push_back(id);
    return id;
  }
  void end(const BrickId& id) { std::erase(begun_, id); }

 private:
  std::vector<BrickWish> wishes_;  ///< Requests in the order of their priorities, the highest last.
  std::vector<BrickId> begun_;
};

}  // namespace palpate
