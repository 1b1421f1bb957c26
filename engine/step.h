/// The tick: read the hand, sample, balance, couple, limit. No clock, no thread, no device.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "engine/bodies.h"
#include "engine/coupling.h"
#include "engine/device.h"
#include "engine/felt.h"
#include "engine/friction.h"
#include "engine/limit_force.h"
#include "engine/mode.h"
#include "engine/near_parts.h"
#include "engine/placement.h"
#include "engine/primitive.h"
#include "engine/scene.h"
#include "engine/solver.h"
#include "engine/step_report.h"

namespace palpate {

/// What the proxy remembers from tick to tick, and the memory that the tick works in.
class ProxyState {
 public:
  /// `limits`: of the device that the force goes to. Allocates; the tick does not. What the device
  /// did before nobody knows: it begins as hot as it may be.
  explicit ProxyState(const ForceLimits& limits = {})
      : limits_(limits),
        memories_(kMaxModes),
        felt_(1 + kMaxNearParts),
        forces_(kMaxPrimitives, Vec3::Zero()),
        turning_(kMaxPrimitives) {
    limiter_.heat = limits.continuous * limits.continuous;
  }

  /// Cuts the force at the next tick, for the first cause that is given.
  void cut(Fault fault) noexcept {
    if (fault_ == Fault::kNone) fault_ = fault;
  }
  /// Lets force out again after a fault, by an engagement; the proxy starts anew at the hand,
  /// contacts forgotten. The scene's time has gone on meanwhile.
  void clearFault() noexcept {
    fault_ = Fault::kNone;
    placed_ = false;
    engage();
  }
  /// Nothing is felt: what was sent is forgotten, the proxy starts anew at the hand, and the next
  /// force is an engagement's.
  void release() noexcept {
    limiter_.forget();
    placed_ = false;
    engage();
  }
  /// Of the last force the motors could give no more than this share.
  void weaken(double share) noexcept PALPATE_NONBLOCKING {
    if (limits_.tank.use != TankUse::kOff) limiter_.tank.weaken(share, limits_.tank.arm);
  }
  /// Begins an engagement: zero force until little is wanted, then more and more.
  void engage() noexcept {
    if (limits_.engage > 0.0) limiter_.engage(limits_.engage);
  }
  [[nodiscard]] bool faulted() const noexcept { return fault_ != Fault::kNone; }
  [[nodiscard]] Fault fault() const noexcept { return fault_; }
  /// Of the device.
  [[nodiscard]] const ForceLimits& limits() const noexcept { return limits_; }
  /// What the last gate remembers.
  [[nodiscard]] const LimiterState& limiter() const noexcept { return limiter_; }
  [[nodiscard]] const Vec3& proxy() const noexcept { return proxy_; }
  /// Since this proxy met the scene, by the ticks' dt [s]: moving volumes are where they are then.
  [[nodiscard]] double time() const noexcept { return time_; }
  [[nodiscard]] const Properties& properties() const noexcept { return properties_; }
  /// Of the last sub-step, in the order of the modes; ModeMemory::emitted says how many each.
  [[nodiscard]] const PrimitiveSet& primitives() const noexcept { return primitives_; }
  /// What each of these did to the proxy [N]; with the spring's pull they add up to zero. Means
  /// nothing after a fault.
  [[nodiscard]] std::span<const Vec3> forces() const noexcept {
    return {forces_.data(), primitives_.size()};
  }
  /// Graph::motions as the last sub-step saw them.
  [[nodiscard]] std::span<const Body> bodies() const noexcept { return bodies_.items(); }
  /// What mode i of the scene's own graph remembers, i < kMaxModes.
  [[nodiscard]] const ModeMemory& memory(std::size_t i) const noexcept { return memories_[i]; }
  /// The parts that are felt.
  [[nodiscard]] const NearParts& near() const noexcept { return near_; }

 private:
  /// A new scene engages; where only numbers have changed, soon.
  void meet(std::uint64_t shape) noexcept {
    const bool edit = shape == scene_shape_;
    scene_shape_ = shape;
    if (!(limits_.engage > 0.0)) return;
    if (edit) {
      limiter_.gentle = kEngageEdit;
    } else {
      engage();
    }
  }

  friend StepReport hapticStep(const Scene&, Reader&, const HandState&, ProxyState&,
                               double) noexcept PALPATE_NONBLOCKING;
  friend class Tick;

  ForceLimits limits_;
  std::vector<ModeMemory> memories_;
  std::vector<Felt> felt_;  ///< This tick's: the scene's own graph, then near parts.
  NearParts near_;
  Bodies bodies_;
  PrimitiveSet primitives_;
  std::vector<Vec3> forces_;
  std::vector<TurningPlane> turning_;  ///< Of those.
  WarmStart warm_;
  FrictionStart friction_;
  Properties properties_;
  std::uint64_t scene_id_ = 0;
  std::uint64_t scene_shape_ = 0;
  double time_ = 0.0;  ///< [s]
  VaryingStiffness stiffness_;
  bool placed_ = false;
  bool known_ = false;  ///< Properties have been read in this scene.
  bool lost_ = false;   ///< The proxy came to the hand by a way that was not looked at: contacts
                        ///< are forgotten at the next tick.
  Fault fault_ = Fault::kNone;
  Vec3 proxy_ = Vec3::Zero();
  Vec3 offset_ = Vec3::Zero();  ///< proxy - probe of the last tick [m].
  LengthRate length_rate_;      ///< Of that.
  StillFade still_;
  LimiterState limiter_;
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
/// RT: no allocation, no lock, no system call, no exception. Cost: a microsecond or
/// so for a few primitives without friction; every sub-step, at most 64, takes up to a balance
/// (solver.h), or several where frictions meet (friction.h).
[[nodiscard]] StepReport hapticStep(const Scene& scene, Reader& reader, const HandState& hand,
                                    ProxyState& state, double dt) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
