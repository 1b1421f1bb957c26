/// The tick: read the hand, sample, balance, couple, limit. No clock, no thread, no device.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "engine/coupling.h"
#include "engine/device.h"
#include "engine/friction.h"
#include "engine/limit_force.h"
#include "engine/mode.h"
#include "engine/placement.h"
#include "engine/primitive.h"
#include "engine/scene.h"
#include "engine/solver.h"

namespace palpate {

/// How a tick ended, in the order of severity, the best first. Each is safe to send.
enum class StepStatus : std::uint8_t {
  kConverged,     ///< All is well.
  kHairpin,       ///< A stream turns about a place that is nearer than the hand: which place on it
                  ///< is nearest is not one, and the proxy may jump, by no more force than the
                  ///< mode's strength beside what the hand's own move stretches. Use a mode of less
                  ///< strength or a hand nearer the stream.
  kSubstepLimit,  ///< The readings, or 16 steps along a stream for each, were used up before the
                  ///< proxy had arrived: a hand too fast, a stream that winds too much, walls or
                  ///< frictions that take turns. The rest waits where something holds the proxy;
                  ///< where nothing does it is at the hand, and what is farther off than the
                  ///< fields' firstFall looks can have been passed unfelt, as by a volume that
                  ///< moved so far. Raise max_substeps or the rate if it happens often.
  kIterationLimit,  ///< A balance stopped early; error_bound says how far off it can be.
  kDropped,         ///< More primitives than kMaxPrimitives: some were left out. Use fewer modes;
                    ///< 204 of the richest, two walls with friction and a drag, fit.
  kFault,           ///< A non-finite hand, sample or force came in, now or earlier: the force is
                    ///< zero until ProxyState::clearFault(). Find the device's or volume's fault.
};
inline constexpr std::size_t kStepStatuses = 6;

/// What one tick did.
struct StepReport {
  Vec3 force = Vec3::Zero();    ///< For the device, after limitForce [N].
  Vec3 wanted = Vec3::Zero();   ///< Before it [N].
  Vec3 proxy = Vec3::Zero();    ///< [m]
  double stiffness = 0.0;       ///< k of this tick's balance and force [N/m].
  double error_bound = 0.0;     ///< Of the last balance [m].
  Vec3 waiting = Vec3::Zero();  ///< What the balance leaves for the next tick [m]: a proxy that
                                ///< went along a curved stream is off the balance on its tangent by
                                ///< this; with the probe so much farther on it is the balance.
  double injected = 0.0;  ///< Work that primitives did on the proxy [J], the sum over its moves
                          ///< of max(0, -k (h - p_new).(p_new - p_old)), h where the hand then
                          ///< was: at least what bounds the work on the hand (docs/tick.md,
                          ///< Energy).
  int iterations = 0;     ///< Of the solver (SolveResult), all sub-steps.
  int substeps = 0;
  int samples = 0;     ///< Field reads, all sub-steps.
  int traced = 0;      ///< Reads of vectors along streams.
  int walked = 0;      ///< Cells looked at for a surface on the way.
  int primitives = 0;  ///< Balanced in the last sub-step.
  int parts = 0;       ///< Of the scene's, that were asked: their data are near, or were when they
                       ///< were chosen.
  int left_out = 0;    ///< Parts that were there and for which there was no room: the weakest.
  double missing = 0.0;  ///< By so much at most the force is off for that [N].
  SolverKind solver = SolverKind::kClosedForm;  ///< Of the last sub-step.
  StepStatus status = StepStatus::kConverged;
  bool limited = false;  ///< limitForce changed the force.
  double moving = 1.0;   ///< Of the force, that is left since the arm does not move (StillFade).
  double share = 1.0;    ///< Of the force, that the energy tank can pay for (passivity.h),
  double energy = 0.0;   ///< and what is in it [J].
};

/// What the proxy remembers from tick to tick, and the memory that the tick works in.
class ProxyState {
 public:
  /// `limits`: of the device that the force goes to. Allocates; the tick does not.
  explicit ProxyState(const ForceLimits& limits = {})
      : limits_(limits),
        memories_(kMaxModes),
        slots_(kMaxNearParts),
        felt_(1 + kMaxNearParts),
        awake_(NearBoxes::kMost),
        free_(NearBoxes::kMost),
        bodies_(kMaxMotions),
        forces_(kMaxPrimitives, Vec3::Zero()) {}

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
  /// Graph::motions as the last sub-step saw them; the scene's come first, others mean nothing.
  [[nodiscard]] std::span<const Body> bodies() const noexcept { return bodies_; }
  /// What mode i of the scene's own graph remembers, i < kMaxModes.
  [[nodiscard]] const ModeMemory& memory(std::size_t i) const noexcept { return memories_[i]; }
  /// A part that is felt.
  struct NearPart {
    std::size_t part = kNoPart;  ///< Index into Scene::parts; kNoPart: none.
    std::size_t modes = 0;       ///< How many it has.
    Properties properties;
    std::array<ModeMemory, kMaxPartModes> memories;
  };
  static constexpr std::size_t kNoPart = static_cast<std::size_t>(-1);
  /// Those of the last tick are the first `StepReport::parts` of nearOrder().
  [[nodiscard]] const NearPart& nearPart(std::size_t slot) const noexcept { return slots_[slot]; }
  /// Slots in the order of their parts.
  [[nodiscard]] std::span<const std::uint8_t> nearOrder() const noexcept {
    return {order_.data(), near_count_};
  }

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

  /// A graph that is felt in a tick, and what is remembered of it.
  struct Felt {
    BoundGraph bound;
    Properties* properties = nullptr;
    ModeMemory* memories = nullptr;

    [[nodiscard]] const Graph& graph() const noexcept { return *bound.graph; }
  };

  friend StepReport hapticStep(const Scene&, Reader&, const HandState&, ProxyState&,
                               double) noexcept PALPATE_NONBLOCKING;
  friend class Tick;

  ForceLimits limits_;
  std::vector<ModeMemory> memories_;
  std::vector<NearPart> slots_;
  std::vector<Felt> felt_;  ///< This tick's: the scene's own graph, then near parts.
  std::array<std::uint8_t, kMaxNearParts> order_{};
  std::size_t near_count_ = 0;
  NearBoxes near_;
  std::vector<std::uint32_t> awake_;  ///< The tick's own: parts that the proxy can come to.
  Vec3 chosen_at_ = Vec3::Zero();     ///< Where these were chosen last [m];
  double chosen_for_ = 0.0;           ///< within so much of there no other has data [m].
  bool crowded_ = false;              ///< There was no room for some.
  std::vector<double> free_;          ///< Scratch: of each part that is near.
  std::vector<Body> bodies_;
  PrimitiveSet primitives_;
  std::vector<Vec3> forces_;
  WarmStart warm_;
  FrictionStart friction_;
  Properties properties_;
  std::uint64_t scene_id_ = 0;
  std::uint64_t scene_shape_ = 0;
  double time_ = 0.0;      ///< [s]
  double posed_at_ = 0.0;  ///< Time of the bodies' poses [s].
  VaryingStiffness stiffness_;
  int stuck_ = 0;  ///< Ticks in a row that ended where they began: their ways led behind a surface.
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

/// The word for traces.
[[nodiscard]] const char* wordFor(StepStatus status) noexcept;

}  // namespace palpate
