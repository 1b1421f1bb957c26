/// What comes up from the tick: plain data, one tick. The log of the loop.
#pragma once

#include <cstdint>

#include "engine/step.h"
#include "engine/types.h"

namespace palpate {

/// One row of a trace. The fields of StepReport are those of that tick.
struct Telemetry {
  double time = 0.0;          ///< [s] since the start.
  Vec3 probe = Vec3::Zero();  ///< [m]
  std::int64_t tick_ns = 0;   ///< What hapticStep took [ns].
  StepReport report;
};

}  // namespace palpate
