/// Spaces forces evenly, for an arm that accepts so many forces a second.
#pragma once

#include <algorithm>
#include <cstdint>

namespace palpate {

/// Computes when the next force may go: one period after the last force was allowed to go. If the
/// last force went a period late, the next may go at once. So in a time T at most T rate + 2 forces
/// go. Forces that come once a period or less often never wait, if each is late by less than the
/// time to the next: a late force delays no other.
class Pace {
 public:
  /// @param rate  [Hz], > 0.
  /// @param now   [ns], as everywhere here.
  Pace(double rate, std::int64_t now) noexcept
      : period_(static_cast<std::int64_t>(1e9 / rate)), from_(now) {}

  /// Returns the time from which the next force may go.
  [[nodiscard]] std::int64_t from() const noexcept { return from_; }
  /// Records that a force goes.
  void go(std::int64_t now) noexcept { from_ = std::max(from_ + period_, now); }

 private:
  std::int64_t period_;
  std::int64_t from_;
};

}  // namespace palpate
