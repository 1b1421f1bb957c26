/// Finds a path of a simulated hand that touches the modes of a scene.
#pragma once

#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/scene/scene.h"

namespace palpate::cli {

struct Search {
  int rays = 0;
  int met = 0;      ///< Number of rays on which a mode acted on the probe.
  long reads = 0;   ///< Number of field readings of search and planning.
  double ms = 0.0;  ///< Duration of search and planning [ms].
  int visits = 0;
};

/// Returns an exploration path: the hand touches, strokes and presses the scene's modes.
///
/// The search moves a probe along straight rays; forces do not deflect the probe. The value of a
/// mode on a ray is the mode's force against the probe's motion. Each visit uses the ray with the
/// highest value. Modes with few visits and places far from the last visits have a higher value.
/// The hand moves along the ray, strokes and presses each mode, and withdraws. The planner offsets
/// the hand's target by the forces along the path.
///
/// The same scene gives the same path for any `seconds`. The path repeats after the visit in which
/// its first minute ends.
/// @param bounds   Box about all fields and guides of the scene [m].
/// @param radius   Radius of the arm's workspace about the origin of W [m]; bounds the path.
/// @param seconds  Duration of the path [s].
///
/// Cost of a search: at most kMostRays rays and about kMostReads field readings (ray_search.cpp).
/// In a moving scene, each visit searches again with one eighth of both limits.
[[nodiscard]] HandTarget findingHand(const Scene& scene, const Box& bounds, double radius,
                                     double seconds, Search* search = nullptr);

}  // namespace palpate::cli
