/// Telemetry: the record of one tick as plain data, for logs.
#pragma once

#include <cstdint>

#include "palpate/engine/loop/hand_tick.h"
#include "palpate/engine/types.h"

namespace palpate {

/// One row of a trace. `input` and `report` belong to the same tick.
struct Telemetry {
  std::int64_t tick = 0;      ///< Number of the tick, from 1; 0 before the first tick.
  double time = 0.0;          ///< Time since the start [s].
  Vec3 probe = Vec3::Zero();  ///< Position of the probe [m].
  std::int64_t tick_ns = 0;   ///< Time that HandTick::step took [ns], without device and links.
  /// Delay of the tick's start after its deadline [ns]; 0 in virtual time.
  std::int64_t wake_ns = 0;
  bool missed = false;          ///< True for a late tick (TickTime::missed).
  std::int64_t late_ticks = 0;  ///< Number of late ticks so far.
  Fault fault = Fault::kNone;   ///< Cause of the cut of the force; kNone if the force is not cut.
  std::uint64_t scene = 0;      ///< Scene::id; 0 without a scene.
  TickInput input;              ///< Inputs of the tick.
  StepReport report;            ///< Report of the tick; initial values without a scene.
};

}  // namespace palpate
