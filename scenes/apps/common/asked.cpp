#include "palpate/scenes/apps/common/asked.h"

#include <algorithm>
#include <cmath>

namespace palpate::cli {
namespace {

constexpr double kFarthest = 10.0;  ///< Largest coordinate of the hand [m].
constexpr double kFollow = 0.02;    ///< Time constant with which the hand follows the mouse [s].
/// Greatest speed of the hand [m/s]. The simulated arm moves up to a third faster, and must stay
/// below 3 m/s. At that speed the loop brakes an arm.
constexpr double kFastest = 2.0;

}  // namespace

Asked asked(const LiveWishes& before, const LiveWishes& now) {
  Asked asked;
  asked.cut = now.cuts != before.cuts;
  asked.clear = now.clears != before.clears && !asked.cut;
  asked.closed = now.closed != 0;
  if (now.dialled == before.dialled) return asked;
  asked.dialled = now.dialled;
  const auto count = std::min<std::size_t>(now.dial_count, now.dials.size());
  for (std::size_t i = 0; i < count; ++i) {
    const LiveDial& dial = now.dials[i];
    if (!std::isfinite(dial.factor)) continue;
    asked.dials.push_back({dial.mode, std::clamp(dial.factor, 0.0F, kMostDial)});
  }
  return asked;
}

HandTarget behindMouse(const Published<LiveHand>& mouse, const Vec3& start) {
  const auto follow = [&mouse, aim = start, at = start, time = 0.0](double now) mutable -> Vec3 {
    LiveHand hand;
    if (mouse.read(hand)) {
      const Vec3 told(hand.target[0], hand.target[1], hand.target[2]);
      if (told.allFinite()) aim = told.cwiseMax(-kFarthest).cwiseMin(kFarthest);
    }
    const double since = std::max(0.0, now - time);
    time = now;
    const Vec3 way = aim - at;
    const double share =
        std::min(-std::expm1(-since / kFollow), kFastest * since / std::max(1e-12, way.norm()));
    at += share * way;
    return at;
  };
  constexpr double kForEver = 1e9;  // [s]: longer than any run
  return {follow, kForEver};
}

}  // namespace palpate::cli
