/// Exploration path for the simulated hand of `palpate feel`. The path leads through the places
/// where modes act.
#pragma once

#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/scene/scene.h"

namespace palpate::cli {

/// Cost of the search for a path.
struct Search {
  int rays = 0;     ///< Number of probe rays.
  int met = 0;      ///< Number of rays on which a mode acted on the probe.
  long reads = 0;   ///< Number of readings of fields on all rays.
  double ms = 0.0;  ///< Duration of the search and of the planning [ms].
  int visits = 0;   ///< Number of visits in the path.
};

/// Returns an exploration path, on which the hand touches, strokes and presses the scene's modes
/// from several sides.
///
/// The search sends a probe along straight rays through the scene, in ticks of its own. Forces do
/// not deflect the probe. The value of a mode on a ray is its force against the probe. Modes of all
/// kinds count alike, whether their volume moves or belongs to a part. Each visit takes the ray
/// with the highest value for the modes that were visited least so far, far from the last visits.
/// The hand moves along this ray, presses each mode to its strength, strokes, and withdraws. During
/// planning a probe moves along the path, so that the hand's target allows for the forces that the
/// hand will feel.
///
/// The same scene gives the same path for any `seconds`. After one minute the path repeats.
/// @param bounds   Box about all fields and guides of the scene [m].
/// @param radius   Radius of the arm's workspace about the origin of W [m]. The path stays within
///                 it.
/// @param seconds  Duration of the path [s].
///
/// Cost: at most kMostRays rays and kMostReads readings of fields; in a moving scene, each visit
/// searches again with one eighth of both limits.
[[nodiscard]] HandTarget findingHand(const Scene& scene, const Box& bounds, double radius,
                                     double seconds, Search* search = nullptr);

}  // namespace palpate::cli
