/// Private to samplers: which bricks are wanted, the most urgent first. Include it in .cpp files
/// only.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>
#include <set>
#include <utility>
#include <vector>

#include "palpate/samplers/bricks.h"

namespace palpate {

/// The list that BrickSource::want() gives, and what of it has been begun. Not for several threads
/// at once.
class Wishes {
 public:
  /// begin() takes no memory for so many at a time.
  explicit Wishes(std::size_t at_once = 64) { begun_.reserve(at_once); }

  /// In place of the list before; less what has been begun.
  void set(std::vector<BrickWish> wishes) {
    // What is no number is the least urgent, and in an order all the same.
    for (BrickWish& wish : wishes) {
      if (std::isnan(wish.priority)) wish.priority = -std::numeric_limits<double>::infinity();
    }
    std::stable_sort(wishes.begin(), wishes.end(), [](const BrickWish& a, const BrickWish& b) {
      return a.priority > b.priority;
    });
    // Once each, where it is the most urgent.
    std::set<BrickId> seen(begun_.begin(), begun_.end());
    std::erase_if(wishes, [&](const BrickWish& wish) { return !seen.insert(wish.id).second; });
    std::reverse(wishes.begin(), wishes.end());
    wishes_ = std::move(wishes);
  }
  [[nodiscard]] bool empty() const noexcept { return wishes_.empty(); }
  /// The most urgent one, begun now; there is one.
  [[nodiscard]] BrickId begin() {
    const BrickId id = wishes_.back().id;
    wishes_.pop_back();
    begun_.push_back(id);
    return id;
  }
  /// Its fetch is over, however.
  void end(const BrickId& id) { std::erase(begun_, id); }

 private:
  std::vector<BrickWish> wishes_;  ///< The most urgent last.
  std::vector<BrickId> begun_;
};

}  // namespace palpate
