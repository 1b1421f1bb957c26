#include "palpate/engine/loop/cache_warmup.h"

#include <algorithm>
#include <variant>

namespace palpate {
namespace {

bool hasUserModes(const Scene& scene) noexcept {
  const auto is_users = [](const Mode& mode) { return std::holds_alternative<UserMode>(mode); };
  const auto has = [&](const Graph& graph) {
    return std::any_of(graph.modes.begin(), graph.modes.end(), is_users);
  };
  return has(scene.graph) || std::any_of(scene.parts.begin(), scene.parts.end(),
                                         [&](const Part& part) { return has(part.graph); });
}

}  // namespace

void CacheWarmup::look(const HandState& hand, const StepReport& report) noexcept {
  before_ = hand_.position;
  hand_ = hand;
  real_ = report;
  seen_ = report.status == StepStatus::kFault ? 0 : std::min(seen_ + 1, 2);
}

bool CacheWarmup::strayed() const noexcept {
  // Proxies farther apart than this may be on two sides of an object.
  constexpr double kApart = 2e-4;  // [m]
  return !fresh_ || warmed_.primitives != real_.primitives ||
         !((warmed_.proxy - real_.proxy).norm() < kApart);
}

bool CacheWarmup::run(const Scene& scene, const ProxyState& real, double dt) noexcept {
  if (scene_ != scene.id) user_ = hasUserModes(scene);
  fresh_ = fresh_ && scene_ == scene.id && seen_ == 2;
  scene_ = scene.id;
  if (seen_ < 2 || real.faulted() || user_) return false;
  if (strayed()) twin_ = real;
  HandState hand = hand_;
  hand.position += hand_.position - before_;
  twin_.playAt(real.play() + real.playRate() * dt, real.playRate());
  warmed_ = hapticStep(scene, reader_, hand, twin_, dt);
  fresh_ = true;
  return true;
}

}  // namespace palpate
