/// Explains one tick and its force, for `palpate explain` and for scripts.
#pragma once

#include <span>

#include "palpate/engine/loop/hand_tick.h"
#include "palpate/scenes/apps/common/touch.h"

namespace palpate::cli {

struct Explained {
  OrderedJson json;    ///< The report, in the format of docs/formats.md.
  bool fault = false;  ///< True if a fault has cut the force.
};

/// Explains a tick of 1/rate [s], in which the hand moves from rest at `at` [m] by `push` [m].
/// Throws Error as openFor does, and if a position is out of reach or the rate is invalid.
[[nodiscard]] Explained explainTick(SceneSpec spec, const Vec3& at, const Vec3& push, double rate,
                                    const Progress& progress, const Say& say);

/// A tick of a run.
struct RunTick {
  TickInput input;
  bool scene = true;  ///< False before the first scene arrived.
};

/// Explains the last of `ticks`, at `time` [s]. `ticks` must not be empty. Repeats all ticks with
/// the run's limits, so the force is the run's force. In a scene with parts the force may differ:
/// the limiter's heat and tank then lack the contacts with parts that `opened` leaves out.
[[nodiscard]] Explained explainRun(const Opened& opened, std::span<const RunTick> ticks,
                                   const ForceLimits& limits, double time);

}  // namespace palpate::cli
