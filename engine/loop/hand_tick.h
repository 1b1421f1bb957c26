/// One hand's tick without its device, for HapticLoop and for replays of recordings.
#pragma once

#include "palpate/engine/safety/limit_force.h"
#include "palpate/engine/safety/safety.h"
#include "palpate/engine/scene/scene.h"
#include "palpate/engine/tick/step.h"

namespace palpate {

/// All inputs of a tick except the scene. In the same program, the scenes and the inputs of all
/// ticks so far determine the report of a tick to the last bit. Exceptions are volumes whose data
/// arrive during the ticks (bricks and sequences that do not wait for them), and user-defined modes
/// with a state.
struct TickInput {
  HandState hand;        ///< Reading of the hand, completed by HandWatch.
  double dt = 1e-3;      ///< Time since the last tick [s].
  bool cleared = false;  ///< True if a fault was cleared before the tick.
  /// Cause of a cut of the force in this tick, or kNone.
  Fault wrong = Fault::kNone;
  Fault order = Fault::kNone;   ///< Reason why the force was not sent; kNone if it was sent.
  double play = 0.0;            ///< Play position of sequences [s].
  double play_rate = 0.0;       ///< Rate at which play advanced, except for jumps [s/s].
  Vec3 pull = Vec3::Zero();     ///< Force of remote hands [N], added to the coupling's force.
  double given = 1.0;           ///< Share of the force that the motors could give.
  Fault unsent = Fault::kNone;  ///< Cause of a cut after the write, or kNone.
};

/// The proxy, the reader and the gate of one hand.
class HandTick {
 public:
  /// Allocates all memory that ticks need. `limits` are those of the device.
  explicit HandTick(const ForceLimits& limits) : state_(limits) {}

  /// Begins a tick. Reads all of `in` except `order`, `given` and `unsent`, which withhold() and
  /// sent() read. If `scene` is null, the force is zero. `trace` and RT: see hapticStep.
  [[nodiscard]] StepReport step(const Scene* scene, const TickInput& in,
                                StepTrace* trace = nullptr) noexcept PALPATE_NONBLOCKING;
  /// If in.order is not kNone, latches it as a fault, removes the force from the report and
  /// releases the proxy. RT: no allocation.
  void withhold(const TickInput& in, StepReport& report) noexcept PALPATE_NONBLOCKING;
  /// Ends the tick with `given` and `unsent`, after the force was written. Latches `unsent` as a
  /// fault. RT: no allocation.
  void sent(const TickInput& in) noexcept PALPATE_NONBLOCKING;

  /// Returns the state of the proxy after the last tick.
  [[nodiscard]] const ProxyState& state() const noexcept { return state_; }
  /// Returns true if the last tick's hand was ready (HandState::ready) and no fault is latched.
  [[nodiscard]] bool mayPull() const noexcept { return ready_ && !state_.faulted(); }

 private:
  Reader reader_;
  ProxyState state_;
  bool ready_ = true;
};

}  // namespace palpate
