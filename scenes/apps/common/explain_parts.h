/// Parts of the report of `palpate explain`: fields, properties and modes of one tick.
#pragma once

#include <algorithm>
#include <cstddef>
#include <string>
#include <vector>

#include "palpate/scenes/apps/common/touch.h"

namespace palpate::cli {

/// A tick with all data from which its force is explained.
struct ExplainedTick {
  const Opened& opened;     ///< The scene and its description.
  const Scene& scene;       ///< The built scene: `opened.built.scene`.
  Vec3 at;                  ///< Position at which the hand and the proxy rest before the tick [m].
  Vec3 hand;                ///< Position of the hand in the tick [m].
  Rest rest;                ///< State before the tick.
  StepReport report;        ///< Result of the tick.
  LimitedForce limited;     ///< Result of the limiter.
  ForceLimits limits;       ///< Limits that the limiter applied.
  double dt = 0.0;          ///< Duration of the tick [s].
  const StepTrace& trace;   ///< Sub-steps of the tick.
  const ProxyState& state;  ///< State after the tick.

  /// Returns the position of the last reading of properties in the tick [m]. If a fault occurred
  /// before any reading, returns the position of the proxy.
  [[nodiscard]] const Vec3& place() const {
    const auto steps = trace.steps();
    const auto last = std::find_if(steps.rbegin(), steps.rend(),
                                   [](const StepTrace::Step& step) { return !step.foreseen; });
    return last == steps.rend() ? rest.report.proxy : last->at;
  }
  /// Returns the proxy before its last move [m]. The distances of guides are measured from this
  /// position.
  [[nodiscard]] const Vec3& proxy() const {
    return trace.count == 0 ? rest.report.proxy : trace.steps().back().proxy;
  }
  [[nodiscard]] const Graph& graph() const { return scene.graph; }
  /// Returns the properties that were read at place().
  [[nodiscard]] const Properties& properties() const { return state.properties(); }
  [[nodiscard]] std::size_t modes() const { return scene.graph.modes.size(); }
};

[[nodiscard]] inline const Properties::Scalar& scalarAt(const ExplainedTick& tick, int i) {
  return tick.properties().scalars[static_cast<std::size_t>(i)];
}
[[nodiscard]] inline const Properties::Vector& vectorAt(const ExplainedTick& tick, int i) {
  return tick.properties().vectors[static_cast<std::size_t>(i)];
}

/// Returns the fields whose bounds contain the proxy.
[[nodiscard]] FieldSet fieldsAround(const ExplainedTick& tick);

/// Reports for each field whether it was read, and the reason.
[[nodiscard]] OrderedJson fieldsReport(const ExplainedTick& tick);

/// Reports the value of each property.
[[nodiscard]] OrderedJson propertiesReport(const ExplainedTick& tick);

/// Reports a transfer function, factor by factor.
/// @param own  Input of the factors that read no property.
[[nodiscard]] OrderedJson transferReport(const ExplainedTick& tick, const Transfer& transfer,
                                         double own);

/// Describes the loads of a mode, for example "bone holds with 1.2 of 3 N along its normal, its
/// friction sticks with 0.2 of 0.36 N". Returns an empty text if the mode carries no load.
[[nodiscard]] std::string loadsInWords(const std::string& name, const Mode& mode,
                                       const std::vector<Load>& loads);

/// Reports the state, the primitives and the loads of mode i, and the reasons.
[[nodiscard]] OrderedJson modeReport(const ExplainedTick& tick, std::size_t i);

}  // namespace palpate::cli
