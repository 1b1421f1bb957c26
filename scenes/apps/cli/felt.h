/// Accumulates the results of a run for its summary, one tick at a time.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/engine/loop/mailbox.h"
#include "palpate/engine/loop/telemetry.h"
#include "palpate/engine/safety/safety.h"
#include "palpate/engine/scene/scene.h"
#include "palpate/engine/tick/step.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {

inline constexpr double kStrong = 0.2;  ///< Force above which a tick counts as strong [N].

/// Histogram of durations. Bins are 1 ns wide below 65,536 ns, and 2 % wide above.
class Durations {
 public:
  Durations() : counts_(kExact + kCoarse) {}
  void add(std::int64_t ns);
  /// Returns the least duration [ns] that at least the fraction `share` of the durations does not
  /// exceed, to within a bin; 0 without durations.
  [[nodiscard]] std::int64_t percentile(double share) const;
  [[nodiscard]] std::int64_t count() const noexcept { return count_; }
  [[nodiscard]] std::int64_t max() const noexcept { return max_; }

 private:
  static constexpr std::size_t kExact = 65536;
  static constexpr std::size_t kCoarse = 2048;
  std::vector<std::int64_t> counts_;
  std::int64_t count_ = 0;
  std::int64_t max_ = 0;
};

/// The tick with the strongest force among the ticks in which a mode gave a force. A force counts
/// half if the hand moves over 0.1 m/s.
struct Most {
  double force = 0.0;         ///< Force sent to the device [N]; 0 if no mode gave a force.
  double time = 0.0;          ///< Time since the start of the run [s].
  Vec3 probe = Vec3::Zero();  ///< Position of the probe [m].
  Vec3 proxy = Vec3::Zero();  ///< Position of the proxy [m].
  double stiffness = 0.0;     ///< Stiffness of the coupling [N/m].
  double wanted = 0.0;        ///< Magnitude of StepReport::wanted, before the limiter [N].
  std::string mode;           ///< Name of the mode with the largest force in this tick.
  MotionPtr motion;           ///< Motion of the mode's volume; null: at rest, or a mode of a part.
  Pose pose;                  ///< Pose by `motion` at `time`.
};

/// Magnitude of the force of each mode of the run's first scene, then of all parts together [N].
using Loads = std::array<double, kMaxModes + 1>;

/// Accumulates the results of a run. Only the loop's thread calls add().
// Padding is intended: the mailbox keeps the data of its two threads on separate cache lines.
class Felt {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  Felt(const Scene& scene, double rate);

  /// Adds a tick, after its force was sent to the device. RT: no allocation.
  void add(const Telemetry& tick, const ProxyState& state) noexcept;
  /// Announces the next scene. Call expect() before you publish the scene, on the thread that
  /// publishes the scene.
  void expect(const Scene& scene);

  /// Returns the names for loads(): the modes of the first scene, then "parts" if it has parts.
  [[nodiscard]] const std::vector<std::string>& carriers() const noexcept { return carriers_; }
  /// Returns the force of each carrier in the last tick [N]. In a later scene, a carrier is the
  /// mode of the same name; without such a mode, the carrier's force is 0. Modes with equal names
  /// are matched in order.
  [[nodiscard]] std::span<const double> loads() const noexcept {
    return {loads_.data(), carriers_.size()};
  }
  [[nodiscard]] Fault fault() const noexcept { return fault_; }
  /// Returns true if the device got at least 1 mN, and a mode gave at least 1 mN, or hands at other
  /// sites more than 1 mN, in any tick.
  [[nodiscard]] bool anything() const;
  /// Returns true if modes or other hands gave a force, but the device never got 1 mN, for example
  /// because its dead-man switch was released.
  [[nodiscard]] bool withheld() const;
  /// Returns the name of the first mode that began with the proxy inside its solid (its Side went
  /// from kUnknown to kInside); an empty text if there is none.
  [[nodiscard]] std::string inside() const;
  [[nodiscard]] Most most() const;
  /// Returns the number of scenes of the run.
  [[nodiscard]] std::size_t scenes() const { return scenes_.size(); }
  /// Returns the time integral of each mode's force by name [N s]. Modes of equal names are summed.
  [[nodiscard]] std::map<std::string, double> impulses() const;
  /// Returns the content of the summary file, without the fields that callers add.
  [[nodiscard]] OrderedJson summary() const;
  [[nodiscard]] Legible words() const;

 private:
  struct ModeFelt {
    std::int64_t active = 0;  ///< Ticks in which the mode gave force.
    std::int64_t last_active = -1;
    bool inside = false;       ///< The mode began with the proxy inside its solid.
    std::int64_t touches = 0;  ///< Contacts; a pause of 50 ms without force separates them.
    std::int64_t yields = 0;   ///< Number of times the proxy was pushed through a surface.
    double impulse = 0.0;      ///< Sum of the force's magnitude over all ticks [N].
    double held = 0.0;         ///< Largest force of the mode [N].
    Vec3 at = Vec3::Zero();    ///< Proxy in the tick with the largest force [m].
  };
  /// For each mode of a graph: the side of its surface on which the proxy was in the last tick.
  struct Contacts {
    std::size_t part = NearPart::kNone;
    std::array<Side, kMaxModes> of{};
  };
  struct SceneFelt {
    std::uint64_t id = 0;
    std::vector<std::string> names;
    std::vector<MotionPtr> motions;
    std::vector<int> motion_of;  ///< Graph::mode_motions of the scene.
    std::size_t volumes = 0;
    std::vector<ModeFelt> modes;
    std::size_t own = 0;       ///< Number of modes outside parts; the modes of parts follow them.
    std::vector<int> load_of;  ///< Index of each mode's carrier; -1: no carrier.
    std::vector<std::size_t> modes_of_part;  ///< First mode of each part.
  };
  /// The data of Most, in a form that a tick can store without allocation.
  struct Moment {
    double worth = 0.0;  ///< Force, halved if the hand is fast [N].
    double force = 0.0;
    double time = 0.0;
    Vec3 probe = Vec3::Zero();
    Vec3 proxy = Vec3::Zero();
    double stiffness = 0.0;
    double wanted = 0.0;
    std::uint64_t scene = 0;
    std::size_t mode = 0;
    Pose pose;
  };
  struct TickForces {
    std::span<const Vec3> left;  ///< Forces of the primitives of all later modes.
    double most = 0.0;           ///< Largest force of any mode [N].
    std::size_t main = 0;
    Vec3 of_parts = Vec3::Zero();  ///< Sum of the forces of all parts' modes [N].
  };
  struct ModeTick {
    const Vec3& proxy;
    const ModeMemory& memory;
    Side& last;
  };
  void countTick(const Telemetry& tick) noexcept;
  void addTank(const StepReport& r, const ProxyState& state) noexcept;
  /// Returns the results for a tick's scene; null if the scene was not announced.
  [[nodiscard]] SceneFelt* enterScene(std::uint64_t id) noexcept;
  TickForces addForces(SceneFelt& felt, const StepReport& r, const ProxyState& state) noexcept;
  void addMode(SceneFelt& felt, std::size_t index, const ModeTick& tick,
               TickForces& forces) noexcept;
  void countMode(ModeFelt& mode, double held, const ModeTick& tick) const noexcept;
  /// Lists how often and how long faults cut the force, and the numbers of ticks with a status
  /// other than "converged" and "fault". Empty if all ticks converged without a fault.
  [[nodiscard]] std::string troublesOf(const OrderedJson& statuses) const;
  [[nodiscard]] Legible partsWords(const OrderedJson& parts) const;
  [[nodiscard]] Legible tankWords(const OrderedJson& tank, double ticks) const;
  [[nodiscard]] static std::shared_ptr<SceneFelt> startOf(const Scene& scene);
  [[nodiscard]] std::vector<int> loadsOf(std::span<const std::string> modes) const;

  double rate_;
  std::vector<std::string> carriers_;
  bool parts_ = false;
  Loads loads_{};
  std::vector<std::shared_ptr<SceneFelt>> scenes_;  ///< Used only on expect()'s thread.
  /// Passes scenes from expect() to the loop's thread.
  Mailbox<std::shared_ptr<SceneFelt>> expected_;
  Durations durations_;
  Durations wakes_;
  std::int64_t late_ = 0;
  double last_time_ = 0.0;
  Fault fault_ = Fault::kNone;
  std::array<std::int64_t, kFaults> faults_{};  ///< Number of times that each fault cut the force.
  std::int64_t cut_ = 0;                        ///< Ticks in which a fault cut the force.
  std::array<std::int64_t, kStepStatuses> statuses_{};
  std::int64_t closed_form_ = 0;
  std::int64_t limited_ = 0;
  std::int64_t samples_ = 0;
  std::int64_t coarse_ = 0;  ///< Coarse ticks (docs/glossary.md).
  std::int64_t traced_ = 0;
  std::int64_t walked_ = 0;
  std::int64_t substeps_ = 0;
  std::int64_t primitives_ = 0;
  std::int64_t iterations_ = 0;
  double force_max_ = 0.0;
  double bound_max_ = 0.0;
  double net_energy_ = 0.0;
  std::int64_t still_ = 0;    ///< Ticks with less force because the arm did not move.
  std::int64_t drained_ = 0;  ///< Ticks in which the energy tank reduced the force.
  double lost_ = 0.0;         ///< Sum of the force that the tank removed [N].
  double asked_ = 0.0;        ///< Sum of the force before the tank's reduction [N].
  double least_energy_ = 0.0;
  double debt_ = 0.0;
  double refilled_ = 0.0;
  TankUse tank_ = TankUse::kOff;
  double injected_ = 0.0;
  std::int64_t near_ = 0;  ///< Sum over all ticks of the number of parts near the hand.
  std::int64_t most_near_ = 0;
  std::int64_t crowded_ = 0;  ///< Ticks in which some of the near parts did not fit.
  double missing_ = 0.0;      ///< Largest StepReport::missing [N].
  std::uint64_t scene_ = 0;   ///< Scene::id that own_ and slots_ belong to.
  Contacts own_;
  std::array<Contacts, kMaxNearParts> slots_;
  Moment most_;
  std::int64_t strong_ = 0;                    ///< Ticks with a force above kStrong.
  static constexpr double kLeastForce = 1e-3;  // [N]
  [[nodiscard]] bool acted() const;

  std::int64_t pulled_ = 0;  ///< Ticks in which a hand at another site pulled this hand.
  Vec3 last_probe_ = Vec3::Zero();
  Vec3 last_force_ = Vec3::Zero();
};

}  // namespace palpate::cli
