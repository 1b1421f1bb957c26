/// An even pace, for an arm that takes so many forces a second.
#pragma once

#include <algorithm>
#include <cstdint>

namespace palpate {

/// When the next one may go: a period after the last one could, and where that went later, at once.
/// So in a time T at most T rate + 2 go; and what comes once a period or less often, whichever of
/// them late by less than the way to the next, never waits: one that was late delays none.
class Pace {
 public:
  /// @param rate  [Hz], > 0.
  /// @param now   [ns], as everywhere here.
  Pace(double rate, std::int64_t now) noexcept
      : period_(static_cast<std::int64_t>(1e9 / rate)), from_(now) {}

  /// From then on the next one may go.
  [[nodiscard]] std::int64_t from() const noexcept { return from_; }
  /// One goes.
  void go(std::int64_t now) noexcept { from_ = std::max(from_ + period_, now); }

 private:
  std::int64_t period_;
  std::int64_t from_;
};

}  // namespace palpate
