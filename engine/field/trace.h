/// Tracing a stream: the curve with direction v / |v| everywhere. Method: trace_cells.h.
#pragma once

#include "palpate/engine/types.h"

namespace palpate {

/// Request for a trace: its length, or the place nearest to the hand as its end.
struct TraceOrder {
  Vec3 along = Vec3::UnitX();  ///< Forward direction if v has no sign, as for fibres' axes.
  double length = 0.0;         ///< Arc length, negative backwards [m]; to_hand: the largest length,
                               ///< either way.
  bool to_hand = false;        ///< Trace the way the hand pulls, to the first place nearest to it.
  Vec3 hand = Vec3::Zero();    ///< Vector from the start to the hand [m]; decides `hairpin`.
  Mat3 metric = Mat3::Identity();  ///< Distances to the hand: |d|^2 = d^T metric d.
  double near = 1e-3;              ///< Pull along the curve that ends a trace to the hand [voxels].
  Vec3 bend = Vec3::Zero();  ///< Second derivative of the curve, if known [1/voxel]: Trace::bend.
  double tolerance = 1e-4;   ///< Largest error of a step [voxels].
  int max_steps = 16;   ///< Largest number of steps, >= 1; too long ones are repeated, up to four
                        ///< times as many
  double stride = 0.5;  ///< Step to try first [voxels]: Trace::stride of the last trace.
};

/// The end of a trace.
struct Trace {
  Vec3 position = Vec3::Zero();    ///< End of the trace [m].
  Vec3 direction = Vec3::UnitX();  ///< v / |v| at the end, turned to the side of `along`.
  double length = 0.0;             ///< Arc length traced, negative backwards [m].
  double stride = 0.5;             ///< Step for the next trace to try first [voxels].
  int samples = 0;                 ///< Number of values of v read.
  bool capped = false;             ///< The steps were used up before the end.
  bool hairpin = false;            ///< The curve bends about a centre nearer than the hand.
  bool arrived = false;            ///< The trace ends at a place nearest to the hand.
  Vec3 bend = Vec3::Zero();        ///< Second derivative of the curve by the last step [1/voxel].
};

}  // namespace palpate
