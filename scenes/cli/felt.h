/// What was felt in a run, and how well: counted tick by tick for the summary.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "engine/scene.h"
#include "engine/step.h"
#include "engine/telemetry.h"
#include "scenes/cli/common.h"

namespace palpate::cli {

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

/// Adds up a run. Not for the tick: it may allocate.
class Felt {
 public:
  Felt(const Scene& scene, double rate);

  /// One tick, after it was sent.
  void add(const Telemetry& tick, const ProxyState& state);

  /// False if no mode ever took part in a force.
  [[nodiscard]] bool anything() const;
  /// The summary file's content, less what the caller knows better.
  [[nodiscard]] OrderedJson summary() const;
  /// The same in words.
  [[nodiscard]] std::string words() const;

 private:
  struct ModeFelt {
    std::int64_t active = 0;  ///< Ticks in which it took part in the force.
    std::int64_t last_active = -1;
    std::int64_t touches = 0;  ///< Times it began to, after at least 50 ms without.
    std::int64_t yields = 0;   ///< Times a surface was pushed through.
    double held = 0.0;         ///< Largest force of its primitives [N].
    ModeMemory::Contact contact = ModeMemory::Contact::kUnknown;
  };
  void addMode(std::size_t i, double held, const ModeMemory& memory);

  const Scene& scene_;
  double rate_;
  std::vector<ModeFelt> modes_;
  Durations durations_;
  std::array<std::int64_t, kStepStatuses> statuses_{};
  std::int64_t closed_form_ = 0;
  std::int64_t limited_ = 0;
  std::int64_t samples_ = 0;
  std::int64_t traced_ = 0;
  std::int64_t walked_ = 0;
  std::int64_t substeps_ = 0;
  std::int64_t primitives_ = 0;
  std::int64_t iterations_ = 0;
  double force_max_ = 0.0;
  double bound_max_ = 0.0;
  double net_energy_ = 0.0;
  double injected_ = 0.0;
  Vec3 last_probe_ = Vec3::Zero();
  Vec3 last_force_ = Vec3::Zero();
};

}  // namespace palpate::cli
