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
  /// `limits`: those of the device that the force goes to. Allocates; the tick does not. Nobody
  /// knows what the device did before: its motors begin as hot as they may be.
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
  /// To be called where no force goes out: what was sent is forgotten, the proxy starts anew at the
  /// hand, and the next force is an engagement's.
  void release() noexcept {
    gate_.limiter.forget();
    proxy_.placed = false;
    engage();
  }
  /// Tells the tank that the motors could give no more than this share of the last force, 0 to 1.
  void weaken(double share) noexcept PALPATE_NONBLOCKING {
    const TankParams& tank = gate_.limits.tank;
    if (tank.use != TankUse::kOff) gate_.limiter.tank.weaken(share, tank.arm);
  }
  /// Begins an engagement: zero force until little is wanted, then more and more.
  void engage() noexcept { gate_.engage(); }
  /// Sequences are so far in their play [s] from the next tick on, after they have gone on at such
  /// a rate [s/s] since the one before; from elsewhere they have jumped. Theirs alone: what moves
  /// goes by time().
  void playAt(double play, double rate) noexcept {
    play_ = play;
    play_rate_ = rate;
  }
  /// Such a force [N] acts on the hand beside the spring's, from the next tick on (hand_links.h).
  void pullBy(const Vec3& force) noexcept { pull_ = force; }
  [[nodiscard]] double play() const noexcept { return play_; }           ///< As told last.
  [[nodiscard]] double playRate() const noexcept { return play_rate_; }  ///< As told last.
  /// True from a fault on until clearFault(): every tick sends zero.
  [[nodiscard]] bool faulted() const noexcept { return gate_.fault != Fault::kNone; }
  /// The first cause that was given since clearFault(); kNone: the force is not cut.
  [[nodiscard]] Fault fault() const noexcept { return gate_.fault; }
  /// Limits of the device.
  [[nodiscard]] const ForceLimits& limits() const noexcept { return gate_.limits; }
  /// What the last gate remembers.
  [[nodiscard]] const LimiterState& limiter() const noexcept { return gate_.limiter; }
  /// Position of the proxy [m]; after release() the old one, until a tick begins at the hand.
  [[nodiscard]] const Vec3& proxy() const noexcept { return proxy_.position; }
  /// Time since this proxy entered the scene, by the ticks' dt [s]; volumes move by this time.
  [[nodiscard]] double time() const noexcept { return met_.time; }
  /// What was read last for the scene's own graph; those of near parts: NearPart::properties.
  [[nodiscard]] const Properties& properties() const noexcept { return around_.properties; }
  /// The last sub-step's, in the order of the modes; each mode has ModeMemory::emitted of them.
  [[nodiscard]] const PrimitiveSet& primitives() const noexcept { return balance_.primitives; }
  /// What each of primitives() did to the proxy [N]; with the spring's pull they add up to zero.
  /// They mean nothing after a fault.
  [[nodiscard]] std::span<const Vec3> forces() const noexcept {
    return {balance_.forces.data(), balance_.primitives.size()};
  }
  /// Graph::motions as the last sub-step saw them.
  [[nodiscard]] std::span<const Body> bodies() const noexcept { return around_.bodies.items(); }
  /// What mode i of the scene's own graph remembers, i < kMaxModes.
  [[nodiscard]] const ModeMemory& memory(std::size_t i) const noexcept {
    return around_.memories[i];
  }
  /// The parts that the last tick sampled and balanced.
  [[nodiscard]] const NearParts& near() const noexcept { return around_.near; }

 private:
  /// The last thing between the tick and the hand.
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
  void gateOut(const HandState& hand, bool good, double dt, StepReport& report) noexcept;

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

/// One tick of the engine: steps 1 to 3 of the paper's figure 1.
///
/// The proxy starts at the first probe position. Where there is data it moves at most one voxel
/// before properties are read again. A scene that differs from the last tick's keeps the proxy
/// where it is, forgets contacts and begins at time zero.
///
/// A moving volume carries along what is in it before the balance: its own fields are read at, and
/// its own modes' primitives stand at, the old proxy as the volume saw it last. A volume that moves
/// farther than half a voxel in a tick does so in several sub-steps.
///
/// @param reader  This thread's reader; bound to the scene as needed.
/// @param hand    Position [m]; NaN or farther than 1e6 m is a fault: zero force, latched.
/// @param dt      Time since the last tick [s], > 0; else the force may not grow and volumes stand.
/// @param trace   Where not null, filled with what the tick did.
/// RT: no allocation, no lock, no system call, no exception. Cost: a microsecond or
/// so for a few primitives without friction; every sub-step, at most 64, takes up to a balance
/// (solver.h, friction.h), all together what StepParams::max_iterations says.
[[nodiscard]] StepReport hapticStep(const Scene& scene, Reader& reader, const HandState& hand,
                                    ProxyState& state, double dt,
                                    StepTrace* trace = nullptr) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
