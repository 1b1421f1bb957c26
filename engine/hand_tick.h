/// One hand's tick without its device: what goes in decides what comes out, bit for bit. HapticLoop
/// is given it by a device and a clock, a replay by a recording.
#pragma once

#include "palpate/engine/limit_force.h"
#include "palpate/engine/safety.h"
#include "palpate/engine/scene.h"
#include "palpate/engine/step.h"

namespace palpate {

/// All that a tick is given besides the scene. With the scenes, and the inputs of all ticks before,
/// it decides the tick's report to the last bit.
struct TickInput {
  HandState hand;               ///< As it was read, and HandWatch has filled it in.
  double dt = 1e-3;             ///< Time since the last tick [s].
  bool cleared = false;         ///< A fault was cleared before the tick.
  Fault wrong = Fault::kNone;   ///< Why the force is cut in this tick; kNone: it is not.
  Fault order = Fault::kNone;   ///< Why the force that the tick computed was not sent.
  double play = 0.0;            ///< Where sequences are in their play [s],
  double play_rate = 0.0;       ///< and how fast it has gone on, but for jumps [s/s].
  Vec3 pull = Vec3::Zero();     ///< Of hands elsewhere on this one [N], beside the spring's.
  double given = 1.0;           ///< The share of the force that the motors' limits left.
  Fault unsent = Fault::kNone;  ///< Why the force is cut after the write.
};

/// The proxy, the reader and the gate of one hand.
class HandTick {
 public:
  /// Allocates; ticks do not. `limits`: those of the device that the force goes to.
  explicit HandTick(const ForceLimits& limits) : state_(limits) {}

  /// Begins a tick: by `hand`, `dt`, `cleared` and `wrong`. Null: there is no scene yet, and no
  /// force. RT: as hapticStep.
  [[nodiscard]] StepReport step(const Scene* scene,
                                const TickInput& in) noexcept PALPATE_NONBLOCKING;
  /// Goes on by `order`: takes the force off the report, and lets go of the hand. RT: no
  /// allocation.
  void withhold(const TickInput& in, StepReport& report) noexcept PALPATE_NONBLOCKING;
  /// Ends the tick by `given` and `unsent`, once the force is written. RT: no allocation.
  void sent(const TickInput& in) noexcept PALPATE_NONBLOCKING;

  /// What the hand's proxy remembers after the last tick.
  [[nodiscard]] const ProxyState& state() const noexcept { return state_; }
  /// The last tick's hand was ready (HandState::ready), and no fault is latched.
  [[nodiscard]] bool mayPull() const noexcept { return ready_ && !state_.faulted(); }

 private:
  Reader reader_;
  ProxyState state_;
  bool ready_ = true;
};

}  // namespace palpate
