/// Accumulates the results of a run for its summary, tick by tick.
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

inline constexpr double kStrong = 0.2;  ///< [N]: a hand certainly feels a larger force.

/// Histogram of durations, exact below 65,536 ns and to 2 % above. Its size does not grow with the
/// run.
class Durations {
 public:
  Durations() : counts_(kExact + kCoarse) {}
  void add(std::int64_t ns);
  /// Returns the duration at or below which this share of all durations lies; 0 if empty.
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

/// The moment with the strongest force while the hand was nearly at rest.
struct Most {
  double force = 0.0;         ///< [N]; 0: no force was felt.
  double time = 0.0;          ///< Since the start [s].
  Vec3 probe = Vec3::Zero();  ///< [m]
  Vec3 proxy = Vec3::Zero();  ///< [m]
  double stiffness = 0.0;     ///< [N/m]
  std::string mode;           ///< The mode with the largest load.
  std::uint64_t scene = 0;    ///< Scene::id.
  MotionPtr motion;           ///< Motion that carries the mode; null: at rest.
  Pose pose;                  ///< Pose of this motion at `time`.
};

/// Forces of the modes of a run's first scene, and of all its parts together [N].
using Loads = std::array<double, kMaxModes + 1>;

/// Accumulates a run, on the thread of its ticks.
// The mailbox keeps its sides on separate cache lines.
class Felt {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  Felt(const Scene& scene, double rate);

  /// Adds one tick after it was sent. Does not allocate memory.
  void add(const Telemetry& tick, const ProxyState& state) noexcept;
  /// Announces the scene of coming ticks. Call it from another thread, before the scene is
  /// published.
  void expect(const Scene& scene);

  /// Returns the names for loads(): the modes of the run's first scene, then "parts" if it has
  /// some.
  [[nodiscard]] const std::vector<std::string>& carriers() const noexcept { return carriers_; }
  /// Returns the force of each carrier's primitives together in the last tick [N]. In a later scene
  /// a mode is the one with the same name; if several share the name, their order decides. A mode
  /// that is absent has 0.
  [[nodiscard]] std::span<const double> loads() const noexcept {
    return {loads_.data(), carriers_.size()};
  }
  /// Returns the fault that cut the force in the last tick.
  [[nodiscard]] Fault fault() const noexcept { return fault_; }
  /// Returns false if no mode ever contributed to a force.
  [[nodiscard]] bool anything() const;
  /// Returns the moment with the strongest force.
  [[nodiscard]] Most most() const;
  /// Returns the impulse of each mode over the run, by its name [N s]; parts of one kind are
  /// summed.
  [[nodiscard]] std::map<std::string, double> impulses() const;
  /// Returns the content of the summary file, without the fields that the caller adds.
  [[nodiscard]] OrderedJson summary() const;
  /// Returns the same as text.
  [[nodiscard]] Legible words() const;

 private:
  struct ModeFelt {
    std::int64_t active = 0;  ///< Ticks in which the mode contributed to the force.
    std::int64_t last_active = -1;
    std::int64_t touches = 0;  ///< Times it began to, after at least 50 ms without force.
    std::int64_t yields = 0;   ///< Times a surface was pushed through.
    double impulse = 0.0;      ///< Sum of the magnitudes of its force over all ticks [N].
    double held = 0.0;         ///< Largest force of its primitives [N],
    Vec3 at = Vec3::Zero();    ///< and the proxy's position at that tick [m].
  };
  /// Contacts of a graph's modes after the last tick.
  struct Contacts {
    std::size_t part = NearPart::kNone;
    std::array<Side, kMaxModes> of{};
  };
  /// Results for one scene.
  struct SceneFelt {
    std::uint64_t id = 0;  ///< Scene::id. The scene itself may be freed.
    std::vector<std::string> names;
    std::vector<MotionPtr> motions;  ///< Graph::motions
    std::vector<int> motion_of;      ///< and Graph::mode_motions.
    std::size_t volumes = 0;         ///< Number of volumes that are read.
    std::vector<ModeFelt> modes;
    std::size_t own = 0;       ///< Number of the scene's own modes; those of parts follow.
    std::vector<int> load_of;  ///< For own modes: index of the load; -1: no load.
    std::vector<std::size_t> modes_of_part;  ///< First mode of each part; equal parts share it.
  };
  /// Same as Most, during ticks.
  struct Moment {
    double worth = 0.0;  ///< [N]
    double force = 0.0;  ///< [N]
    double time = 0.0;
    Vec3 probe = Vec3::Zero();
    Vec3 proxy = Vec3::Zero();
    double stiffness = 0.0;
    std::uint64_t scene = 0;
    std::size_t mode = 0;
    Pose pose;
  };
  /// Forces of a tick's modes while they are added.
  struct TickForces {
    std::span<const Vec3> left;    ///< Forces of the primitives of modes that are yet to come.
    double most = 0.0;             ///< Largest force of a mode [N],
    std::size_t main = 0;          ///< and the mode's index.
    Vec3 of_parts = Vec3::Zero();  ///< Sum of the forces of all parts' modes [N].
  };
  /// State of a mode in one tick.
  struct ModeTick {
    const Vec3& proxy;         ///< Position of the proxy [m].
    const ModeMemory& memory;  ///< State after the tick.
    Side& last;                ///< Side after the previous tick; countMode() updates it.
  };
  void countTick(const Telemetry& tick) noexcept;
  void addTank(const StepReport& r, const ProxyState& state) noexcept;
  /// Returns the results for the scene of a tick; null if it was not announced.
  [[nodiscard]] SceneFelt* enterScene(std::uint64_t id) noexcept;
  TickForces addForces(SceneFelt& felt, const StepReport& r, const ProxyState& state) noexcept;
  void addMode(SceneFelt& felt, std::size_t index, const ModeTick& tick,
               TickForces& forces) noexcept;
  void countMode(ModeFelt& mode, double held, const ModeTick& tick) const noexcept;
  [[nodiscard]] Legible partsWords(const OrderedJson& parts) const;
  [[nodiscard]] Legible tankWords(const OrderedJson& tank, double ticks) const;
  [[nodiscard]] static std::shared_ptr<SceneFelt> startOf(const Scene& scene);
  [[nodiscard]] std::vector<int> loadsOf(std::span<const std::string> modes) const;

  double rate_;
  std::vector<std::string> carriers_;
  bool parts_ = false;  ///< The last carrier is "parts".
  Loads loads_{};
  /// All scenes, for the thread that calls expect.
  std::vector<std::shared_ptr<SceneFelt>> scenes_;
  Mailbox<std::shared_ptr<SceneFelt>> expected_;  ///< From there to the ticks' thread.
  Durations durations_;
  Durations wakes_;
  std::int64_t late_ = 0;
  double last_time_ = 0.0;
  Fault fault_ = Fault::kNone;
  std::array<std::int64_t, kFaults> faults_{};  ///< Number of times that each cut the force.
  std::array<std::int64_t, kStepStatuses> statuses_{};
  std::int64_t closed_form_ = 0;
  std::int64_t limited_ = 0;
  std::int64_t samples_ = 0;
  std::int64_t coarse_ = 0;  ///< Ticks that read coarser data, because finer data were missing.
  std::int64_t traced_ = 0;
  std::int64_t walked_ = 0;
  std::int64_t substeps_ = 0;
  std::int64_t primitives_ = 0;
  std::int64_t iterations_ = 0;
  double force_max_ = 0.0;
  double bound_max_ = 0.0;
  double net_energy_ = 0.0;
  // Energy tank.
  std::int64_t still_ = 0;    ///< Ticks in which the force faded because the arm did not move.
  std::int64_t drained_ = 0;  ///< Ticks that the tank could not pay for.
  double lost_ = 0.0;         ///< Sum of the force that it could not pay for [N],
  double asked_ = 0.0;        ///< and of all force [N].
  double least_energy_ = 0.0;
  double debt_ = 0.0;
  double refilled_ = 0.0;
  TankUse tank_ = TankUse::kOff;
  double injected_ = 0.0;
  // Parts.
  std::int64_t near_ = 0;  ///< Sum of the numbers of near parts.
  std::int64_t most_near_ = 0;
  std::int64_t crowded_ = 0;  ///< Ticks without room for some parts.
  double missing_ = 0.0;      ///< Largest force error from missing parts [N].
  std::uint64_t scene_ = 0;   ///< Scene of the contacts below.
  Contacts own_;
  std::array<Contacts, kMaxNearParts> slots_;
  Moment most_;
  std::int64_t strong_ = 0;  ///< Ticks with more than kStrong.
  std::int64_t pulled_ = 0;  ///< Ticks with a pull from remote hands.
  Vec3 last_probe_ = Vec3::Zero();
  Vec3 last_force_ = Vec3::Zero();
};

}  // namespace palpate::cli
