/// Private to samplers: when to try again what could not be had.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <map>

namespace palpate::detail {

/// What could not be had, by its id: tried again after 1 s, then after twice as long, up to 32 s.
template <class Id>
class Retries {
 public:
  using Clock = std::chrono::steady_clock;

  /// True: for the first time since had() or forget().
  bool failed(const Id& id, Clock::time_point now) {
    const auto [of, first] = of_.try_emplace(id);
    if (!first) of->second.wait = std::min(2 * of->second.wait, kRarest);
    of->second.again = now + of->second.wait;
    return first;
  }
  void had(const Id& id) { of_.erase(id); }
  void forget() { of_.clear(); }
  /// False: it failed, and it is not yet time to try again.
  [[nodiscard]] bool may(const Id& id, Clock::time_point now) const {
    const auto of = of_.find(id);
    return of == of_.end() || of->second.again <= now;
  }
  /// True if it is time to try one again of which `wanted(id)` says so.
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
