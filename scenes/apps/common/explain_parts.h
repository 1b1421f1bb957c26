/// Parts of the report of `palpate explain`: fields, properties and modes of one tick.
#pragma once

#include <algorithm>
#include <cstddef>
#include <string>
#include <vector>

#include "palpate/scenes/apps/common/touch.h"

namespace palpate::cli {

/// A tick with the data that explain it.
struct ExplainedTick {
  const Opened& opened;     ///< The scene with its description.
  const Scene& scene;       ///< `opened.built.scene`.
  Vec3 at;                  ///< Position at which the proxy was put [m].
  Vec3 hand;                ///< Position of the hand in the tick [m].
  Rest rest;                ///< State before the tick.
  StepReport report;        ///< Result of the tick.
  LimitedForce limited;     ///< Result of the limiter.
  ForceLimits limits;       ///< Limits of the limiter.
  double dt = 0.0;          ///< Duration of the tick [s].
  const StepTrace& trace;   ///< Sub-steps of the tick.
  const ProxyState& state;  ///< State after the tick.

  /// Returns the last place where properties were read [m]. After a fault before any reading,
  /// returns the proxy's last place.
  [[nodiscard]] const Vec3& place() const {
    const auto steps = trace.steps();
    const auto last = std::find_if(steps.rbegin(), steps.rend(),
                                   [](const StepTrace::Step& step) { return !step.foreseen; });
    return last == steps.rend() ? rest.report.proxy : last->at;
  }
  /// Returns the proxy before its last move [m]; guides are evaluated from there.
  [[nodiscard]] const Vec3& proxy() const {
    return trace.count == 0 ? rest.report.proxy : trace.steps().back().proxy;
  }
  [[nodiscard]] const Graph& graph() const { return scene.graph; }
  /// Returns the properties at the last place().
  [[nodiscard]] const Properties& properties() const { return state.properties(); }
  /// Returns the number of modes.
  [[nodiscard]] std::size_t modes() const { return scene.graph.modes.size(); }
};

/// Returns the scalar property with index i.
[[nodiscard]] inline const Properties::Scalar& scalarAt(const ExplainedTick& tick, int i) {
  return tick.properties().scalars[static_cast<std::size_t>(i)];
}
/// Returns the vector property with index i.
[[nodiscard]] inline const Properties::Vector& vectorAt(const ExplainedTick& tick, int i) {
  return tick.properties().vectors[static_cast<std::size_t>(i)];
}

/// Returns the fields with bounds that hold the proxy.
[[nodiscard]] FieldSet fieldsAround(const ExplainedTick& tick);

/// Reports of each field whether it was read, and why.
[[nodiscard]] OrderedJson fieldsReport(const ExplainedTick& tick);

/// Reports the value of each property.
[[nodiscard]] OrderedJson propertiesReport(const ExplainedTick& tick);

/// Reports a material property, factor by factor.
/// @param own  Input of the factors that read no property.
[[nodiscard]] OrderedJson transferReport(const ExplainedTick& tick, const Transfer& transfer,
                                         double own);

/// Returns text such as "bone holds with 1.2 of 3 N along its normal, its friction sticks with 0.2
/// of 0.36 N"; empty if the mode carries no load.
[[nodiscard]] std::string loadsInWords(const std::string& name, const Mode& mode,
                                       const std::vector<Load>& loads);

/// Reports the state, the primitives and the loads of mode i, and why.
[[nodiscard]] OrderedJson modeReport(const ExplainedTick& tick, std::size_t i);

}  // namespace palpate::cli
