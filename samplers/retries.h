/// Private to samplers: decides when the caller may retry a failed load.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <map>

namespace palpate::detail {

/// Schedules retries by id: after 1 s, then after twice the previous delay, up to 32 s.
template <class Id>
class Retries {
 public:
  using Clock = std::chrono::steady_clock;

  /// Records a failure of `id`. Returns true for the first failure of `id` since had(id) or
  /// forget().
  bool failed(const Id& id, Clock::time_point now) {
    const auto [of, first] = of_.try_emplace(id);
    if (!first) of->second.wait = std::min(2 * of->second.wait, kRarest);
    of->second.again = now + of->second.wait;
    return first;
  }
  void had(const Id& id) { of_.erase(id); }
  void forget() { of_.clear(); }
  /// Returns false if `id` has failed and it is too early for a retry.
  [[nodiscard]] bool may(const Id& id, Clock::time_point now) const {
    const auto of = of_.find(id);
    return of == of_.end() || of->second.again <= now;
  }
  /// Returns true if it is time to retry any of the ids for which `wanted(id)` is true.
  template <class Wanted>
  [[nodiscard]] bool due(Clock::time_point now, const Wanted& wanted) const {
    return std::any_of(of_.begin(), of_.end(),
                       [&](const auto& of) { return of.second.again <= now && wanted(of.first); });
  }
  [[nodiscard]] std::size_t size() const noexcept { return of_.size(); }

 private:
  static constexpr std::chrono::seconds kAgain{1};
  static constexpr std::chrono::seconds kRarest{32};
  struct Failing {
    Clock::time_point again;
    std::chrono::seconds wait = kAgain;
  };
  std::map<Id, Failing> of_;
};

}  // namespace palpate::detail
