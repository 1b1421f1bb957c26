/// The log of the loop: the record of one tick, as plain data.
#pragma once

#include <cstdint>

#include "palpate/engine/loop/hand_tick.h"
#include "palpate/engine/types.h"

namespace palpate {

/// One row of a trace. `input` and `report` are those of the same tick.
struct Telemetry {
  std::int64_t tick = 0;        ///< Number of the tick, from 1; 0: no tick yet.
  double time = 0.0;            ///< Time since the start [s].
  Vec3 probe = Vec3::Zero();    ///< Position of the probe [m].
  std::int64_t tick_ns = 0;     ///< Time that hapticStep took [ns].
  std::int64_t wake_ns = 0;     ///< Delay of the tick's start [ns]; 0 in virtual time.
  bool missed = false;          ///< The tick began after the next one's time.
  std::int64_t late_ticks = 0;  ///< Number of missed ticks so far.
  Fault fault = Fault::kNone;   ///< Why the force is cut; kNone: it is not.
  std::uint64_t scene = 0;      ///< Scene::id; 0: none.
  TickInput input;              ///< Inputs of the tick.
  StepReport report;            ///< Report of the tick; as initialised if there is no scene.
};

}  // namespace palpate
