/// Spaces the forces sent to an arm that accepts only a limited number per second.
#pragma once

#include <algorithm>
#include <cstdint>

namespace palpate {

/// Keeps an average rate. A late force does not delay the next one, but at most one period is made
/// up. So at most T rate + 2 forces are sent in any time T.
class Pace {
 public:
  /// @param rate  Largest number of forces per second [Hz], > 0.
  /// @param now  Current time [ns]; all calls must use the same clock.
  Pace(double rate, std::int64_t now) noexcept
      : period_(static_cast<std::int64_t>(1e9 / rate)), from_(now) {}

  /// Returns the time from which the next force may be sent [ns].
  [[nodiscard]] std::int64_t from() const noexcept { return from_; }
  /// Records that a force is sent at `now` [ns].
  void go(std::int64_t now) noexcept { from_ = std::max(from_ + period_, now); }

 private:
  std::int64_t period_;
  std::int64_t from_;
};

}  // namespace palpate
