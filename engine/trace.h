/// Along a stream: the curve whose direction is everywhere v / |v|. How: trace_cells.h.
#pragma once

#include "palpate/engine/types.h"

namespace palpate {

/// What to trace.
struct TraceOrder {
  Vec3 along = Vec3::UnitX();  ///< Which way is forward where v has no sign, as fibres' axes.
  double length = 0.0;         ///< Arc length, negative backwards [m].
  Vec3 hand = Vec3::Zero();    ///< From the start [m]: what `hairpin` and `shortened` are about.
  double tolerance = 1e-4;     ///< Error of a step [voxels].
  int max_steps = 16;  ///< >= 1; those that were too long are tried again, up to four times as many
  double stride = 0.5;  ///< Step to try first [voxels]: what the last trace left.
};

/// Where a trace came to.
struct Trace {
  Vec3 position = Vec3::Zero();    ///< [m]
  Vec3 direction = Vec3::UnitX();  ///< v / |v| there, turned to where `along` points.
  double length = 0.0;             ///< Gone of what was ordered, with its sign [m].
  double stride = 0.5;             ///< For the next trace [voxels].
  int samples = 0;                 ///< Values of v.
  bool capped = false;             ///< Out of steps: the rest is still to go.
  bool hairpin = false;            ///< It bends about a centre that is nearer than the hand.
  bool shortened = false;          ///< It ends at the place that is nearest to the hand.
};

}  // namespace palpate
