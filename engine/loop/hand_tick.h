/// One hand's tick without its device: the inputs decide the outputs, bit for bit. HapticLoop gets
/// the inputs from a device and a clock, a replay gets them from a recording.
#pragma once

#include "palpate/engine/safety/limit_force.h"
#include "palpate/engine/safety/safety.h"
#include "palpate/engine/scene/scene.h"
#include "palpate/engine/tick/step.h"

namespace palpate {

/// All inputs of a tick besides the scene. With the scenes, and the inputs of all ticks before,
/// they decide the tick's report to the last bit.
struct TickInput {
  HandState hand;               ///< The hand as read, filled in by HandWatch.
  double dt = 1e-3;             ///< Time since the last tick [s].
  bool cleared = false;         ///< A fault was cleared before the tick.
  Fault wrong = Fault::kNone;   ///< Why the force is cut in this tick; kNone: it is not cut.
  Fault order = Fault::kNone;   ///< Why the force that the tick computed was not sent.
  double play = 0.0;            ///< Play position of sequences [s].
  double play_rate = 0.0;       ///< Rate at which play advanced, except for jumps [s/s].
  Vec3 pull = Vec3::Zero();     ///< Force of remote hands on this one [N], beside the spring's.
  double given = 1.0;           ///< Share of the force that the motors' limits left.
  Fault unsent = Fault::kNone;  ///< Why the force is cut after the write.
};

/// The proxy, the reader and the gate of one hand.
class HandTick {
 public:
  /// Allocates; ticks do not. `limits` are those of the device that receives the force.
  explicit HandTick(const ForceLimits& limits) : state_(limits) {}

  /// Begins a tick with `hand`, `dt`, `cleared` and `wrong`. If `scene` is null there is no force.
  /// RT: as hapticStep.
  [[nodiscard]] StepReport step(const Scene* scene,
                                const TickInput& in) noexcept PALPATE_NONBLOCKING;
  /// Applies `order`, if it is set: takes the force off the report, and releases the hand. RT: no
  /// allocation.
  void withhold(const TickInput& in, StepReport& report) noexcept PALPATE_NONBLOCKING;
  /// Ends the tick with `given` and `unsent`, once the force is written. RT: no allocation.
  void sent(const TickInput& in) noexcept PALPATE_NONBLOCKING;

  /// Returns the state of the hand's proxy after the last tick.
  [[nodiscard]] const ProxyState& state() const noexcept { return state_; }
  /// Returns true if the last tick's hand was ready (HandState::ready) and no fault is latched.
  [[nodiscard]] bool mayPull() const noexcept { return ready_ && !state_.faulted(); }

 private:
  Reader reader_;
  ProxyState state_;
  bool ready_ = true;
};

}  // namespace palpate
