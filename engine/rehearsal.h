/// A tick that nobody feels, shortly before the one that counts: it brings back what the tick needs
/// into the caches of the processor, which others have used meanwhile. A tick after a millisecond
/// of sleep else takes several times as long as one after another: its code lies in some 600 lines
/// with 360 taken branches, which a busy neighbour makes the processor forget.
#pragma once

#include <cstdint>

#include "palpate/engine/limit_force.h"
#include "palpate/engine/scene.h"
#include "palpate/engine/step.h"

namespace palpate {

/// A twin of a proxy, which goes where the hand is about to be. Nothing of the real one is touched:
/// not its time, memory, tank or reader.
class Rehearsal {
 public:
  /// `limits`: those of the device. Allocates what a ProxyState and a Reader do.
  explicit Rehearsal(const ForceLimits& limits) : twin_(limits) {}

  /// To be called after every tick: where the hand was in it, and what became of it.
  void look(const HandState& hand, const StepReport& report) noexcept;

  /// A tick of the twin, at the hand's last place and as far on as it came in the tick before.
  /// Where the twin has strayed from the proxy it takes over all that `real` remembers first. Not
  /// where the scene has modes of the user's, which would be called twice, where the force is cut,
  /// or before two ticks were looked at.
  ///
  /// RT: no allocation. Cost: a tick; where the twin has strayed also a copy of a ProxyState.
  /// @return  True if there was one.
  bool run(const Scene& scene, const ProxyState& real, double dt) noexcept PALPATE_NONBLOCKING;

  /// What the twin's last tick came to.
  [[nodiscard]] const StepReport& rehearsed() const noexcept { return rehearsed_; }

 private:
  /// True if the twin's last tick was not about what the real one was.
  [[nodiscard]] bool strayed() const noexcept;

  ProxyState twin_;
  Reader reader_;
  std::uint64_t scene_ = 0;     ///< Scene::id of the last run,
  bool user_ = false;           ///< and whether it has modes of the user's.
  HandState hand_;              ///< Of the last tick,
  Vec3 before_ = Vec3::Zero();  ///< where it was in the one before [m],
  int seen_ = 0;                ///< and how many have been looked at: at most 2.
  StepReport real_;             ///< Of the last tick.
  StepReport rehearsed_;        ///< Of the twin's.
  bool fresh_ = false;          ///< That was the same tick.
};

}  // namespace palpate
