/// The tick: read the hand, sample, balance, couple, limit. No clock, no thread, no device.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "palpate/engine/coupling.h"
#include "palpate/engine/device.h"
#include "palpate/engine/limit_force.h"
#include "palpate/engine/mode.h"
#include "palpate/engine/near_parts.h"
#include "palpate/engine/placement.h"
#include "palpate/engine/primitive.h"
#include "palpate/engine/scene.h"
#include "palpate/engine/solver.h"
#include "palpate/engine/step_report.h"
#include "palpate/engine/step_trace.h"
#include "palpate/engine/tick.h"

namespace palpate {

/// What the proxy remembers from tick to tick, and the memory that the tick works in.
class ProxyState {
 public:
  /// `limits`: of the device that the force goes to. Allocates; the tick does not. What the device
  /// did before nobody knows: it begins as hot as it may be.
  explicit ProxyState(const ForceLimits& limits = {}) : gate_(limits) {}

  /// Cuts the force at the next tick, for the first cause that is given.
  void cut(Fault fault) noexcept {
    if (gate_.fault == Fault::kNone) gate_.fault = fault;
  }
  /// Lets force out again after a fault, by an engagement; the proxy starts anew at the hand,
  /// contacts forgotten. The scene's time has gone on meanwhile.
  void clearFault() noexcept {
    gate_.fault = Fault::kNone;
    proxy_.placed = false;
    engage();
  }
  /// Nothing is felt: what was sent is forgotten, the proxy starts anew at the hand, and the next
  /// force is an engagement's.
  void release() noexcept {
    gate_.limiter.forget();
    proxy_.placed = false;
    engage();
  }
  /// Of the last force the motors could give no more than this share.
  void weaken(double share) noexcept PALPATE_NONBLOCKING {
    const TankParams& tank = gate_.limits.tank;
    if (tank.use != TankUse::kOff) gate_.limiter.tank.weaken(share, tank.arm);
  }
  /// Begins an engagement: zero force until little is wanted, then more and more.
  void engage() noexcept { gate_.engage(); }
  [[nodiscard]] bool faulted() const noexcept { return gate_.fault != Fault::kNone; }
  [[nodiscard]] Fault fault() const noexcept { return gate_.fault; }
  /// Of the device.
  [[nodiscard]] const ForceLimits& limits() const noexcept { return gate_.limits; }
  /// What the last gate remembers.
  [[nodiscard]] const LimiterState& limiter() const noexcept { return gate_.limiter; }
  [[nodiscard]] const Vec3& proxy() const noexcept { return proxy_.position; }
  /// Since this proxy met the scene, by the ticks' dt [s]: moving volumes are where they are then.
  [[nodiscard]] double time() const noexcept { return met_.time; }
  [[nodiscard]] const Properties& properties() const noexcept { return around_.properties; }
  /// Of the last sub-step, in the order of the modes; ModeMemory::emitted says how many each.
  [[nodiscard]] const PrimitiveSet& primitives() const noexcept { return balance_.primitives; }
  /// What each of these did to the proxy [N]; with the spring's pull they add up to zero. Means
  /// nothing after a fault.
  [[nodiscard]] std::span<const Vec3> forces() const noexcept {
    return {balance_.forces.data(), balance_.primitives.size()};
  }
  /// Graph::motions as the last sub-step saw them.
  [[nodiscard]] std::span<const Body> bodies() const noexcept { return around_.bodies.items(); }
  /// What mode i of the scene's own graph remembers, i < kMaxModes.
  [[nodiscard]] const ModeMemory& memory(std::size_t i) const noexcept {
    return around_.memories[i];
  }
  /// The parts that are felt.
  [[nodiscard]] const NearParts& near() const noexcept { return around_.near; }

 private:
  /// The last thing between the tick and the hand.
  struct Gate {
    explicit Gate(const ForceLimits& of) : limits(of) {
      limiter.heat = of.continuous * of.continuous;
    }
    void engage() noexcept {
      if (limits.engage > 0.0) limiter.engage(limits.engage);
    }

    ForceLimits limits;
    LimiterState limiter;
    StillFade still;
    Fault fault = Fault::kNone;
  };
  /// Which scene it is in.
  struct Met {
    std::uint64_t id = 0;
    std::uint64_t shape = 0;
    double time = 0.0;  ///< [s]
  };

  friend StepReport hapticStep(const Scene&, Reader&, const HandState&, ProxyState&, double,
                               StepTrace*) noexcept PALPATE_NONBLOCKING;

  void meet(const Scene& scene, const Vec3& hand) noexcept;
  void gateOut(const HandState& hand, bool good, double dt, StepReport& report) noexcept;

  Gate gate_;
  Met met_;
  Proxy proxy_;
  Surroundings around_;
  BalanceMemory balance_;
  VaryingStiffness stiffness_;
  LengthRate length_rate_;  ///< Of Proxy::offset.
};

/// One tick of the engine: steps 1 to 3 of the paper's figure 1.
///
/// The proxy starts at the first probe position. Where there is data it moves at most one voxel
/// before properties are read again. A scene that differs from the last tick's keeps the proxy
/// where it is, forgets contacts and begins at time zero.
///
/// A moving volume carries along what is in it before the balance: its own fields are read at, and
/// its own modes' primitives stand at, the old proxy as the volume saw it last. One that comes
/// farther than half a voxel in a tick does so in several sub-steps.
///
/// @param reader  This thread's; bound to the scene as needed.
/// @param hand    Position [m]; NaN or farther than 1e6 m is a fault: zero force, latched.
/// @param dt      Time since the last tick [s], > 0; else the force may not grow and volumes stand.
/// @param trace   Where not null, told what the tick did.
/// RT: no allocation, no lock, no system call, no exception. Cost: a microsecond or
/// so for a few primitives without friction; every sub-step, at most 64, takes up to a balance
/// (solver.h), or several where frictions meet (friction.h).
[[nodiscard]] StepReport hapticStep(const Scene& scene, Reader& reader, const HandState& hand,
                                    ProxyState& state, double dt,
                                    StepTrace* trace = nullptr) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
