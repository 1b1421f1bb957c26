/// What was felt in a run, and how well: counted tick by tick for the summary.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/engine/mailbox.h"
#include "palpate/engine/safety.h"
#include "palpate/engine/scene.h"
#include "palpate/engine/step.h"
#include "palpate/engine/telemetry.h"
#include "palpate/scenes/cli/common.h"

namespace palpate::cli {

inline constexpr double kStrong = 0.2;  ///< [N]: more than this is surely felt.

/// Counts of durations, exact below 65,536 ns and to 2 % above: a run may be long.
class Durations {
 public:
  Durations() : counts_(kExact + kCoarse) {}
  void add(std::int64_t ns);
  /// The duration below or at which a share of all lies; 0 where there is none.
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

/// The moment at which most was felt, of those in which the hand was about still.
struct Most {
  double force = 0.0;         ///< [N]; 0: nothing was felt.
  double time = 0.0;          ///< Since the start [s].
  Vec3 probe = Vec3::Zero();  ///< [m]
  Vec3 proxy = Vec3::Zero();  ///< [m]
  double stiffness = 0.0;     ///< [N/m]
  std::string mode;           ///< The one that bore most.
  std::uint64_t scene = 0;    ///< Scene::id.
  MotionPtr motion;           ///< Carries the mode; null: it stands.
  Pose pose;                  ///< Of that motion then.
};

/// A force each: of the modes of a run's first scene, and of its parts together [N].
using Loads = std::array<double, kMaxModes + 1>;

/// Adds up a run, on the thread of its ticks.
// The mailbox keeps its sides on cache lines of their own.
class Felt {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  Felt(const Scene& scene, double rate);

  /// One tick, after it was sent. Takes no memory.
  void add(const Telemetry& tick, const ProxyState& state) noexcept;
  /// The scene that ticks will be of soon, from another thread than theirs: before it is published.
  void expect(const Scene& scene);

  /// What loads() are of: the modes of the scene that the run begins with, by their names, then
  /// "parts" where it has some.
  [[nodiscard]] const std::vector<std::string>& carriers() const noexcept { return carriers_; }
  /// The force that each carrier's primitives held together in the last tick [N]. A mode of a scene
  /// that came later is who has its name, of several the one at its place among them; of one that
  /// is not there it is 0.
  [[nodiscard]] std::span<const double> loads() const noexcept {
    return {loads_.data(), carriers_.size()};
  }
  /// Why the force was cut, by the last tick.
  [[nodiscard]] Fault fault() const noexcept { return fault_; }
  /// False if no mode ever took part in a force.
  [[nodiscard]] bool anything() const;
  /// Where most was felt.
  [[nodiscard]] Most most() const;
  /// How much force of each mode there was over the run, by its name [N s]; of parts that are alike
  /// together.
  [[nodiscard]] std::map<std::string, double> impulses() const;
  /// The summary file's content, less what the caller knows better.
  [[nodiscard]] OrderedJson summary() const;
  /// The same in words.
  [[nodiscard]] Legible words() const;

 private:
  struct ModeFelt {
    std::int64_t active = 0;  ///< Ticks in which it took part in the force.
    std::int64_t last_active = -1;
    std::int64_t touches = 0;  ///< Times it began to, after at least 50 ms without.
    std::int64_t yields = 0;   ///< Times a surface was pushed through.
    double impulse = 0.0;      ///< Sum of the sizes of its primitives' force, tick by tick [N].
    double held = 0.0;         ///< Largest force of its primitives [N],
    Vec3 at = Vec3::Zero();    ///< and where the proxy was then [m].
  };
  /// The contacts of a graph's modes, as the last tick left them.
  struct Contacts {
    std::size_t part = NearPart::kNone;
    std::array<Side, kMaxModes> of{};
  };
  /// What was felt of one scene.
  struct SceneFelt {
    std::uint64_t id = 0;  ///< Scene::id. The scene itself may go.
    std::vector<std::string> names;
    std::vector<MotionPtr> motions;  ///< Graph::motions
    std::vector<int> motion_of;      ///< and Graph::mode_motions.
    std::size_t volumes = 0;         ///< That are read.
    std::vector<ModeFelt> modes;
    std::size_t own = 0;                     ///< Of these, the scene's own; then those of parts.
    std::vector<int> load_of;                ///< Of its own: which of the loads; -1: none.
    std::vector<std::size_t> modes_of_part;  ///< The first of each part's; alike ones share theirs.
  };
  /// As Most, in a tick.
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
  void addMode(ModeFelt& mode, double held, const Vec3& proxy, const ModeMemory& memory,
               Side& last) const noexcept;
  [[nodiscard]] static std::shared_ptr<SceneFelt> startOf(const Scene& scene);
  [[nodiscard]] std::vector<int> loadsOf(std::span<const std::string> modes) const;

  double rate_;
  std::vector<std::string> carriers_;
  bool parts_ = false;  ///< The last of them.
  Loads loads_{};
  std::vector<std::shared_ptr<SceneFelt>> scenes_;  ///< All, by the thread that expects.
  Mailbox<std::shared_ptr<SceneFelt>> expected_;    ///< From there to the ticks' thread.
  Durations durations_;
  Durations wakes_;
  std::int64_t late_ = 0;
  double last_time_ = 0.0;
  Fault fault_ = Fault::kNone;
  std::array<std::int64_t, kFaults> faults_{};  ///< Times each cut the force.
  std::array<std::int64_t, kStepStatuses> statuses_{};
  std::int64_t closed_form_ = 0;
  std::int64_t limited_ = 0;
  std::int64_t samples_ = 0;
  std::int64_t coarse_ = 0;  ///< Ticks that read coarser data, for want of finer ones.
  std::int64_t traced_ = 0;
  std::int64_t walked_ = 0;
  std::int64_t substeps_ = 0;
  std::int64_t primitives_ = 0;
  std::int64_t iterations_ = 0;
  double force_max_ = 0.0;
  double bound_max_ = 0.0;
  double net_energy_ = 0.0;
  // Of the energy tank.
  std::int64_t still_ = 0;    ///< Ticks in which the force faded under an arm that does not move.
  std::int64_t drained_ = 0;  ///< Ticks that it could not pay for.
  double lost_ = 0.0;         ///< Sum of force that it could not [N],
  double asked_ = 0.0;        ///< and of all [N].
  double least_energy_ = 0.0;
  double debt_ = 0.0;
  double refilled_ = 0.0;
  TankUse tank_ = TankUse::kOff;
  double injected_ = 0.0;
  // Of the parts.
  std::int64_t near_ = 0;  ///< Sum of those that were near.
  std::int64_t most_near_ = 0;
  std::int64_t crowded_ = 0;  ///< Ticks in which there was no room for some.
  double missing_ = 0.0;      ///< Most that the force was off for that [N].
  std::uint64_t scene_ = 0;   ///< Whose contacts these are.
  Contacts own_;
  std::array<Contacts, kMaxNearParts> slots_;
  Moment most_;
  std::int64_t strong_ = 0;  ///< Ticks of more than kStrong.
  std::int64_t pulled_ = 0;  ///< By hands elsewhere.
  Vec3 last_probe_ = Vec3::Zero();
  Vec3 last_force_ = Vec3::Zero();
};

}  // namespace palpate::cli
