/// Tracing a stream: the curve whose direction is everywhere v / |v|. Method: trace_cells.h.
#pragma once

#include "palpate/engine/types.h"

namespace palpate {

/// What to trace.
struct TraceOrder {
  Vec3 along = Vec3::UnitX();  ///< Forward direction where v has no sign, as for fibres' axes.
  double length = 0.0;         ///< Arc length, negative backwards [m].
  Vec3 hand = Vec3::Zero();    ///< The hand from the start [m]; decides `hairpin` and `shortened`.
  double tolerance = 1e-4;     ///< Largest error of a step [voxels].
  int max_steps = 16;   ///< Most steps, >= 1; too long ones are repeated, up to four times as many
  double stride = 0.5;  ///< Step to try first [voxels]: Trace::stride of the last trace.
};

/// The end of a trace.
struct Trace {
  Vec3 position = Vec3::Zero();    ///< Where the trace ends [m].
  Vec3 direction = Vec3::UnitX();  ///< v / |v| at the end, turned to where `along` points.
  double length = 0.0;             ///< Arc length gone, with the sign of the one ordered [m].
  double stride = 0.5;             ///< Step for the next trace to try first [voxels].
  int samples = 0;                 ///< Values of v that were read.
  bool capped = false;             ///< The steps were used up: the rest is still to go.
  bool hairpin = false;            ///< The curve bends about a centre nearer than the hand.
  bool shortened = false;          ///< The trace ends at the place nearest to the hand.
};

}  // namespace palpate
