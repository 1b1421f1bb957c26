/// What comes up from the tick: plain data, one tick. The log of the loop.
#pragma once

#include <cstdint>

#include "palpate/engine/step.h"
#include "palpate/engine/types.h"

namespace palpate {

/// One row of a trace. The fields of StepReport are those of that tick.
struct Telemetry {
  std::int64_t tick = 0;        ///< From 1; 0: there has been none.
  double time = 0.0;            ///< [s] since the start.
  Vec3 probe = Vec3::Zero();    ///< [m]
  std::int64_t tick_ns = 0;     ///< What hapticStep took [ns].
  std::int64_t wake_ns = 0;     ///< How long after its time the tick began [ns]; 0 in virtual time.
  bool missed = false;          ///< After the next one's time.
  std::int64_t late_ticks = 0;  ///< Such ticks so far.
  Fault fault = Fault::kNone;   ///< Why the force is cut.
  std::uint64_t scene = 0;      ///< Scene::id; 0: none.
  StepReport report;
};

}  // namespace palpate
