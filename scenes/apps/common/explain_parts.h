/// Parts of the report of `palpate explain`: fields, properties and modes of one tick.
#pragma once

#include <algorithm>
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "palpate/scenes/apps/common/touch.h"

namespace palpate::cli {

/// A tick with all data that explain its force.
struct ExplainedTick {
  const Opened& opened;
  const Scene& scene;  ///< The built scene: `opened.built.scene`.
  Vec3 at;             ///< Position of the hand before the tick [m].
  Vec3 hand;           ///< Position of the hand in the tick [m].
  Rest rest;           ///< Result of the ticks before.
  StepReport report;
  LimitedForce limited;
  ForceLimits limits;
  double dt = 0.0;             ///< Duration of the tick [s].
  std::optional<double> time;  ///< Time in the run [s]; unset: the hand came from rest at `at`.
  const StepTrace& trace;
  const ProxyState& state;  ///< State after the tick.

  /// Returns the position of the last reading of properties [m]; without a reading, as after a
  /// fault, the proxy before the tick.
  [[nodiscard]] const Vec3& place() const {
    const auto steps = trace.steps();
    const auto last = std::find_if(steps.rbegin(), steps.rend(),
                                   [](const StepTrace::Step& step) { return !step.foreseen; });
    return last == steps.rend() ? rest.report.proxy : last->at;
  }
  /// Returns the proxy before its last move [m]. Guides measure their distances from this position.
  [[nodiscard]] const Vec3& proxy() const {
    return trace.count == 0 ? rest.report.proxy : trace.steps().back().proxy;
  }
  [[nodiscard]] const Graph& graph() const { return scene.graph; }
  [[nodiscard]] const Properties& properties() const { return state.properties(); }
  [[nodiscard]] std::size_t modes() const { return scene.graph.modes.size(); }
};

[[nodiscard]] inline const Properties::Scalar& scalarAt(const ExplainedTick& tick, int i) {
  return tick.properties().scalars[static_cast<std::size_t>(i)];
}
[[nodiscard]] inline const Properties::Vector& vectorAt(const ExplainedTick& tick, int i) {
  return tick.properties().vectors[static_cast<std::size_t>(i)];
}

/// Returns the fields whose bounds contain place(), moved to the rest pose of each field.
[[nodiscard]] FieldSet fieldsAround(const ExplainedTick& tick);

[[nodiscard]] OrderedJson fieldsReport(const ExplainedTick& tick);

[[nodiscard]] OrderedJson propertiesReport(const ExplainedTick& tick);

/// Reports the factors of a transfer function. `own`: input of factors that read no property.
[[nodiscard]] OrderedJson transferReport(const ExplainedTick& tick, const Transfer& transfer,
                                         double own);

/// Describes the loads of a mode, for example: "bone holds with 1.2 of 3 N along its normal, its
/// friction sticks with 0.2 of 0.36 N". Returns an empty text if the mode carries no load.
[[nodiscard]] std::string loadsInWords(const std::string& name, const Mode& mode,
                                       const std::vector<Load>& loads);

[[nodiscard]] OrderedJson modeReport(const ExplainedTick& tick, std::size_t i);

}  // namespace palpate::cli
