/// Cache warm-up: a tick without output, shortly before the real tick. The warm-up loads the code
/// and the data of the tick into the processor's caches. Other programs may have replaced them
/// since the last tick. Without a warm-up, a tick after a millisecond of sleep can take several
/// times as long as a tick that follows another at once.
#pragma once

#include <cstdint>

#include "palpate/engine/safety/limit_force.h"
#include "palpate/engine/scene/scene.h"
#include "palpate/engine/tick/step.h"

namespace palpate {

/// Runs ticks on a twin: a copy of the proxy that follows the expected position of the hand.
class CacheWarmup {
 public:
  /// Allocates the memory of a ProxyState and a Reader. `limits` are those of the device.
  explicit CacheWarmup(const ForceLimits& limits) : twin_(limits) {}

  /// Records the hand and the report of a tick. Call this function after every tick.
  void look(const HandState& hand, const StepReport& report) noexcept;

  /// Runs a tick of the twin. The expected position of the hand is its last position plus its last
  /// displacement. If the last tick of the twin differed too much from the real tick, first copies
  /// the whole state of `real`. No tick runs if the force is cut, or before look() has recorded two
  /// successive ticks without a fault. Scenes with user-defined modes have no warm-up, because a
  /// warm-up would call these modes twice. Returns true if a tick ran.
  ///
  /// RT: no allocation. Cost: a tick, and the copy if the twin differed.
  bool run(const Scene& scene, const ProxyState& real, double dt) noexcept PALPATE_NONBLOCKING;

  /// Returns the report of the twin's last tick.
  [[nodiscard]] const StepReport& warmed() const noexcept { return warmed_; }

 private:
  [[nodiscard]] bool strayed() const noexcept;

  ProxyState twin_;
  Reader reader_;
  std::uint64_t scene_ = 0;  ///< Scene::id of the last run.
  bool user_ = false;        ///< True if that scene has user-defined modes.
  HandState hand_;
  Vec3 before_ = Vec3::Zero();  ///< Position of the hand in the second-last tick [m].
  int seen_ = 0;                ///< Number of recorded ticks since the last fault, at most 2.
  StepReport real_;
  StepReport warmed_;
  bool fresh_ = false;  ///< True if both reports are of the same tick.
};

}  // namespace palpate
