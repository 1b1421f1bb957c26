/// The tick: reads properties, balances primitives, and computes and limits the force.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "palpate/engine/balance/coupling.h"
#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/balance/solver.h"
#include "palpate/engine/field/placement.h"
#include "palpate/engine/modes/mode.h"
#include "palpate/engine/safety/device.h"
#include "palpate/engine/safety/limit_force.h"
#include "palpate/engine/scene/scene.h"
#include "palpate/engine/tick/near_parts.h"
#include "palpate/engine/tick/step_report.h"
#include "palpate/engine/tick/step_trace.h"
#include "palpate/engine/tick/tick.h"

namespace palpate {

/// The state of the proxy from tick to tick, and the working memory of the tick.
class ProxyState {
 public:
  /// Allocates all memory that ticks need. `limits` are those of the device that receives the
  /// force. The motors are assumed to be as hot as allowed.
  explicit ProxyState(const ForceLimits& limits = {}) : gate_(limits) {}

  /// Cuts the force from the next tick on. If called several times, the first cause counts.
  void cut(Fault fault) noexcept {
    if (gate_.fault == Fault::kNone) gate_.fault = fault;
  }
  /// Clears the fault: force returns through an engagement, if ForceLimits::engage is above 0. The
  /// proxy restarts at the hand without contacts. The scene's time has continued during the fault.
  void clearFault() noexcept {
    gate_.fault = Fault::kNone;
    proxy_.placed = false;
    engage();
  }
  /// Restarts the proxy at the hand, and begins an engagement. Call this function if no force is
  /// sent.
  void release() noexcept {
    gate_.limiter.forget();
    proxy_.placed = false;
    engage();
  }
  /// Reports to the tank the largest share, 0 to 1, of the last force that the motors could give.
  void weaken(double share) noexcept PALPATE_NONBLOCKING {
    const TankParams& tank = gate_.limits.tank;
    if (tank.use != TankUse::kOff) gate_.limiter.tank.weaken(share, tank.arm);
  }
  /// Begins an engagement, if ForceLimits::engage is above 0: the force is zero until the wanted
  /// force is small or kEngageWait has passed; then it ramps up.
  void engage() noexcept { gate_.engage(); }
  /// Sets the play position of sequences [s] from the next tick on, and its rate [s/s] since the
  /// last tick. A difference that the rate does not explain is a jump. Volumes move by time()
  /// instead.
  void playAt(double play, double rate) noexcept {
    play_ = play;
    play_rate_ = rate;
  }
  /// Adds this force [N], projected by HandState::drives, to the spring's force from the next tick
  /// on. See hand_links.h.
  void pullBy(const Vec3& force) noexcept { pull_ = force; }
  /// Returns the play position set by playAt() [s].
  [[nodiscard]] double play() const noexcept { return play_; }
  /// Returns the rate set by playAt() [s/s].
  [[nodiscard]] double playRate() const noexcept { return play_rate_; }
  /// Returns true from a fault until clearFault(). Until then every tick sends zero.
  [[nodiscard]] bool faulted() const noexcept { return gate_.fault != Fault::kNone; }
  /// Returns the first cause of a cut since clearFault(); kNone if the force is not cut.
  [[nodiscard]] Fault fault() const noexcept { return gate_.fault; }
  /// Returns the limits of the device.
  [[nodiscard]] const ForceLimits& limits() const noexcept { return gate_.limits; }
  /// Returns the memory of limitForce.
  [[nodiscard]] const LimiterState& limiter() const noexcept { return gate_.limiter; }
  /// Returns the position of the proxy [m]; after release(), the old position until the
  /// next tick.
  [[nodiscard]] const Vec3& proxy() const noexcept { return proxy_.position; }
  /// Returns the sum of the ticks' dt since this proxy entered the scene [s]: the time of motions.
  [[nodiscard]] double time() const noexcept { return met_.time; }
  /// Returns the properties of the last reading for the scene's own graph. NearPart::properties has
  /// those of a part.
  [[nodiscard]] const Properties& properties() const noexcept { return around_.properties; }
  /// Returns the primitives of the last sub-step, in the order of the modes.
  [[nodiscard]] const PrimitiveSet& primitives() const noexcept { return balance_.primitives; }
  /// Returns the force of each of primitives() on the proxy [N]; meaningless after a fault.
  [[nodiscard]] std::span<const Vec3> forces() const noexcept {
    return {balance_.forces.data(), balance_.primitives.size()};
  }
  /// Returns the bodies of Graph::motions in the last sub-step.
  [[nodiscard]] std::span<const Body> bodies() const noexcept { return around_.bodies.items(); }
  /// Returns the memory of mode i of the scene's own graph, i < kMaxModes.
  [[nodiscard]] const ModeMemory& memory(std::size_t i) const noexcept {
    return around_.memories[i];
  }
  /// Returns the parts that the last tick sampled and balanced.
  [[nodiscard]] const NearParts& near() const noexcept { return around_.near; }

 private:
  struct Gate {
    explicit Gate(const ForceLimits& of) : limits(of) {
      limiter.heat = of.continuous * of.continuous;
    }
    void engage() noexcept {
      data.forget();
      if (limits.engage > 0.0) limiter.engage(limits.engage);
    }

    ForceLimits limits;
    LimiterState limiter;
    NewReadings readings;
    StillFade still;
    DataFade data;
    Fault fault = Fault::kNone;
  };
  struct Met {
    std::uint64_t id = 0;
    std::uint64_t shape = 0;
    double time = 0.0;  ///< Time since the proxy entered this scene [s].
  };

  friend StepReport hapticStep(const Scene& scene, Reader& reader, const HandState& hand,
                               ProxyState& state, double dt,
                               StepTrace* trace) noexcept PALPATE_NONBLOCKING;

  void meet(const Scene& scene, const Vec3& hand) noexcept;
  void limitOutput(const HandState& hand, bool good, double dt, StepReport& report) noexcept;

  Gate gate_;
  Met met_;
  double play_ = 0.0;
  double play_rate_ = 0.0;
  Vec3 pull_ = Vec3::Zero();
  Proxy proxy_;
  Surroundings around_;
  BalanceMemory balance_;
  VaryingStiffness stiffness_;
  LengthRate length_rate_;
};

/// Runs one tick of the engine: steps 1 to 3 of the paper's figure 1.
///
/// The proxy starts at the first probe position. Within data, the tick reads properties again at
/// the latest after each voxel of the proxy's path (along a single stream, after 16 voxels), as
/// long as readings are left. If the scene is new, the proxy keeps its place, contacts are
/// forgotten and time begins at zero.
///
/// Before the balance, a moving volume carries its contents along. The tick reads the volume's
/// fields at the place to which the volume has carried the old proxy, and places the volume's
/// primitives there. If a volume near the hand moves farther than half a voxel in a tick, it moves
/// in several slices (iteration.h).
///
/// @param reader  This thread's reader; bound to the scene as needed.
/// @param hand    Reading. If a coordinate is not finite, or its magnitude is 1e6 m or more, the
///                tick latches a fault and sends zero force.
/// @param dt      Time since the last tick [s], finite and > 0. For other values the force does not
///                grow and volumes do not move.
/// @param trace   If not null, filled with the steps of the tick.
///
/// RT: no allocation, no lock, no system call, no exception. Cost: there are at most about 64
/// sub-steps with a balance each (solver.h, friction.h), and one more balance in each slice. If the
/// sum of their iterations has reached StepParams::max_iterations, each slice has at most one more
/// reading.
[[nodiscard]] StepReport hapticStep(const Scene& scene, Reader& reader, const HandState& hand,
                                    ProxyState& state, double dt,
                                    StepTrace* trace = nullptr) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
