/// The tick: reads the hand, samples, balances, couples, limits. It uses no clock, thread or
/// device.
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

/// The proxy's state from tick to tick, and the working memory of the tick.
class ProxyState {
 public:
  /// Allocates; the tick does not. `limits` are those of the device that receives the force. The
  /// device's past is unknown, so its motors are assumed to be as hot as allowed.
  explicit ProxyState(const ForceLimits& limits = {}) : gate_(limits) {}

  /// Cuts the force at the next tick. Keeps the first cause that is given.
  void cut(Fault fault) noexcept {
    if (gate_.fault == Fault::kNone) gate_.fault = fault;
  }
  /// Lets force out again after a fault, through an engagement. The proxy restarts at the hand
  /// without contacts. The scene's time has continued during the fault.
  void clearFault() noexcept {
    gate_.fault = Fault::kNone;
    proxy_.placed = false;
    engage();
  }
  /// Call it when no force goes out. Forgets the force that was sent. The proxy restarts at the
  /// hand, and the next force begins with an engagement.
  void release() noexcept {
    gate_.limiter.forget();
    proxy_.placed = false;
    engage();
  }
  /// Reports to the tank that the motors could give at most this share of the last force, 0 to 1.
  void weaken(double share) noexcept PALPATE_NONBLOCKING {
    const TankParams& tank = gate_.limits.tank;
    if (tank.use != TankUse::kOff) gate_.limiter.tank.weaken(share, tank.arm);
  }
  /// Begins an engagement: no force until little is wanted or kEngageWait is over, then a ramp.
  void engage() noexcept { gate_.engage(); }
  /// Sets the play position of sequences [s] from the next tick on, and the rate [s/s] at which
  /// they advanced since the tick before. Any other difference to the last position is a jump.
  /// Applies to sequences only: moving volumes follow time().
  void playAt(double play, double rate) noexcept {
    play_ = play;
    play_rate_ = rate;
  }
  /// Adds this force [N] to the spring's force on the hand, from the next tick on (hand_links.h).
  void pullBy(const Vec3& force) noexcept { pull_ = force; }
  [[nodiscard]] double play() const noexcept { return play_; }           ///< Set last by playAt().
  [[nodiscard]] double playRate() const noexcept { return play_rate_; }  ///< Set last by playAt().
  /// Returns true from a fault on until clearFault(): every tick sends zero.
  [[nodiscard]] bool faulted() const noexcept { return gate_.fault != Fault::kNone; }
  /// Returns the first cause given since clearFault(); kNone: the force is not cut.
  [[nodiscard]] Fault fault() const noexcept { return gate_.fault; }
  /// Returns the limits of the device.
  [[nodiscard]] const ForceLimits& limits() const noexcept { return gate_.limits; }
  /// Returns the memory of the last gate.
  [[nodiscard]] const LimiterState& limiter() const noexcept { return gate_.limiter; }
  /// Returns the position of the proxy [m]; after release() the old one, until a tick begins at the
  /// hand.
  [[nodiscard]] const Vec3& proxy() const noexcept { return proxy_.position; }
  /// Returns the time since this proxy entered the scene [s], the sum of the ticks' dt. Volumes
  /// move by this time.
  [[nodiscard]] double time() const noexcept { return met_.time; }
  /// Returns the properties read last for the scene's own graph. NearPart::properties holds those
  /// of near parts.
  [[nodiscard]] const Properties& properties() const noexcept { return around_.properties; }
  /// Returns the primitives of the last sub-step, in the order of the modes; each mode has
  /// ModeMemory::emitted primitives.
  [[nodiscard]] const PrimitiveSet& primitives() const noexcept { return balance_.primitives; }
  /// Returns the force of each of primitives() on the proxy [N]. With the spring's pull these add
  /// up to zero. After a fault they have no meaning.
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
  /// The last stage between the tick and the hand.
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
  /// The scene that the proxy is in.
  struct Met {
    std::uint64_t id = 0;
    std::uint64_t shape = 0;
    double time = 0.0;  ///< Time since the proxy entered it [s].
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
  LengthRate length_rate_;  ///< Rate of the length of Proxy::offset.
};

/// Runs one tick of the engine: steps 1 to 3 of the paper's figure 1.
///
/// The proxy starts at the first probe position. Where there is data, it moves at most one voxel
/// before properties are read again. If the scene differs from the last tick's, the proxy stays
/// where it is, contacts are forgotten and time begins at zero.
///
/// Before the balance, a moving volume carries its contents along: its own fields are read at the
/// old proxy as the volume saw it last, and its own modes' primitives stand there. A volume that
/// moves farther than half a voxel in a tick does so in several sub-steps.
///
/// @param reader  This thread's reader; bound to the scene as needed.
/// @param hand    Position [m]; NaN or farther than 1e6 m is a fault: zero force, latched.
/// @param dt      Time since the last tick [s], > 0; else the force may not grow and volumes stand.
/// @param trace   If not null, filled with the steps of the tick.
/// RT: no allocation, no lock, no system call, no exception. Cost: about a microsecond for a few
/// primitives without friction. Every sub-step, at most 64, takes up to one balance (solver.h,
/// friction.h); StepParams::max_iterations limits all sub-steps together.
[[nodiscard]] StepReport hapticStep(const Scene& scene, Reader& reader, const HandState& hand,
                                    ProxyState& state, double dt,
                                    StepTrace* trace = nullptr) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
