/// Cache warm-up: a tick without output, shortly before the one that counts. It brings the code and
/// the data of the tick back into the processor's caches, which other programs have used meanwhile.
/// Without it, a tick after a millisecond of sleep takes several times as long as one right after
/// another. The tick's code lies in some 600 cache lines with 360 taken branches, which a busy
/// neighbour makes the processor forget.
#pragma once

#include <cstdint>

#include "palpate/engine/safety/limit_force.h"
#include "palpate/engine/scene/scene.h"
#include "palpate/engine/tick/step.h"

namespace palpate {

/// A twin of a proxy, which goes where the hand is about to be. The real proxy stays untouched: its
/// time, memory, tank and reader.
class CacheWarmup {
 public:
  /// `limits` are those of the device. Allocates as a ProxyState and a Reader do.
  explicit CacheWarmup(const ForceLimits& limits) : twin_(limits) {}

  /// Call it after every tick, with the tick's hand and report.
  void look(const HandState& hand, const StepReport& report) noexcept;

  /// Runs a tick of the twin, at the hand's last place plus its displacement in the tick before. If
  /// the twin has strayed from the proxy, it first takes over the whole state of `real`. It does
  /// not run if the force is cut, or before two ticks were looked at. Nor does it run if the scene
  /// has the user's own modes, which would be called twice.
  ///
  /// RT: no allocation. Cost: a tick; if the twin has strayed, also a copy of a ProxyState.
  /// @return  True if a tick ran.
  bool run(const Scene& scene, const ProxyState& real, double dt) noexcept PALPATE_NONBLOCKING;

  /// Returns the report of the twin's last tick.
  [[nodiscard]] const StepReport& warmed() const noexcept { return warmed_; }

 private:
  /// Returns true if the twin's last tick was not in the situation of the real one.
  [[nodiscard]] bool strayed() const noexcept;

  ProxyState twin_;
  Reader reader_;
  std::uint64_t scene_ = 0;     ///< Scene::id of the last run.
  bool user_ = false;           ///< That scene has the user's own modes.
  HandState hand_;              ///< Hand of the last tick.
  Vec3 before_ = Vec3::Zero();  ///< Position of the hand in the tick before [m].
  int seen_ = 0;                ///< Number of ticks looked at: at most 2.
  StepReport real_;             ///< Report of the last tick.
  StepReport warmed_;           ///< Report of the twin's last tick.
  bool fresh_ = false;          ///< The two reports are of the same tick.
};

}  // namespace palpate
