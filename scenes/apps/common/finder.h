/// Finds a path of a simulated hand that touches the modes of a scene.
#pragma once

#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/scene/scene.h"

namespace palpate::cli {

struct Search {
  int rays = 0;     ///< Number of rays tried (RaySearch::rays_cast).
  int met = 0;      ///< Number of rays on which a force opposed the probe (kLeastContact).
  long reads = 0;   ///< Number of field readings of search and planning.
  double ms = 0.0;  ///< Duration of search and planning [ms].
  int visits = 0;
};

/// Returns an exploration path: the hand touches, strokes and presses the scene's modes.
///
/// The search moves a probe along straight rays; forces do not deflect the probe. The value of a
/// ray grows with the forces of the modes against the probe's motion. Each visit uses the ray with
/// the highest value. Modes with few visits, and places far from the last visits, raise the value.
/// The hand moves along the ray, strokes and presses at up to three depths, and withdraws. The
/// planner offsets the hand's target, so that the arm follows the path against the forces.
///
/// The same scene gives the same path for any `seconds`; a longer path only continues it. The path
/// repeats after the visit in which its first minute ends.
/// @param bounds   Box about all fields and guides of the scene [m].
/// @param radius   Radius of the arm's workspace about the origin of W [m]; bounds the path.
/// @param seconds  Duration of the path [s].
///
/// Cost of a search: at most kMostRays rays and about kMostReads field readings (ray_search.cpp).
/// In a moving scene, each visit searches again with one eighth of both limits.
[[nodiscard]] HandTarget findingHand(const Scene& scene, const Box& bounds, double radius,
                                     double seconds, Search* search = nullptr);

}  // namespace palpate::cli
