/// Tracing of a stream, the curve with the direction v / |v| everywhere. Method: trace_cells.h.
#pragma once

#include "palpate/engine/types.h"

namespace palpate {

/// Request for a trace. The trace ends at a given arc length, or at the point nearest to the hand.
struct TraceOrder {
  /// Direction at the start that counts as forward. The trace starts along v or -v, whichever is
  /// closer to it, so v may lack a sign, as fibre axes do.
  Vec3 along = Vec3::UnitX();
  /// Arc length [m], < 0 for backwards; if `to_hand`, the largest in either direction.
  double length = 0.0;
  bool to_hand = false;      ///< True to trace to the first place that is nearest to the hand.
  Vec3 hand = Vec3::Zero();  ///< Vector from the start to the hand [m]; decides `hairpin`.
  Mat3 metric = Mat3::Identity();  ///< Metric M of distances to the hand: |d|^2 = d^T M d.
  /// A trace to the hand ends when the pull along the curve is at most this [voxels].
  double near = 1e-3;
  Vec3 bend = Vec3::Zero();  ///< Second derivative of the curve at the start, if known [1/voxel].
  double tolerance = 1e-4;   ///< Largest estimated error of a step [voxels]. Steps of up to 0.06
                             ///< voxel are accepted with any error.
  int max_steps =
      16;  ///< Largest number of steps, >= 1; with rejected steps, at most four times this number.
  double stride = 0.5;  ///< Longest first step to try [voxels]: Trace::stride of the last trace.
};

/// The result of a trace.
struct Trace {
  Vec3 position = Vec3::Zero();  ///< End of the trace [m].
  /// v / |v| at the end, with the sign that continues `along` from the start. If v has no direction
  /// at the end, the direction just before the end; if v has none at the start, `along`.
  Vec3 direction = Vec3::UnitX();
  double length = 0.0;  ///< Arc length traced, negative backwards [m].
  double stride = 0.5;  ///< First step that the next trace should try [voxels].
  int samples = 0;      ///< Number of values of v read.
  bool capped = false;  ///< True if the trace ended early because its steps were used up.
  bool hairpin =
      false;  ///< True if, in some step, the centre of curvature was nearer than the hand.
  bool arrived = false;      ///< True if the trace ended at a place nearest to the hand.
  Vec3 bend = Vec3::Zero();  ///< Second derivative of the curve in the last step [1/voxel]; without
                             ///< a step, that of the request.
};

}  // namespace palpate
