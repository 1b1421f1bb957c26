/// Exploration path of the simulated hand of `palpate feel`, through the places where modes act.
#pragma once

#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/scene/scene.h"

namespace palpate::cli {

/// Effort of the search.
struct Search {
  int rays = 0;     ///< Number of probe rays; each is a straight path of the probe.
  int met = 0;      ///< Rays on which a mode acted.
  long reads = 0;   ///< Reads of fields, on all rays.
  double ms = 0.0;  ///< Duration, with the planning of the path [ms].
  int visits = 0;   ///< Planned visits.
};

/// Returns a path that finds, touches, strokes and presses the scene's modes from several sides.
///
/// The search casts probe rays through the scene, with ticks of its own: the probe moves along each
/// ray and yields to no force. The force of a mode against the probe is the mode's worth there. All
/// kinds of modes count alike, of any volume or part, static or moving. A visit takes the ray that
/// is worth most by the least visited modes and is farthest from the last visits. The hand follows
/// the ray, presses each mode on it to its strength, strokes, and withdraws. The search's probe
/// goes along the path first, so that the hand's target accounts for the force that the hand will
/// meet.
///
/// The same scene gives the same path for any `seconds`; after a minute the path begins again.
/// @param bounds   Box about all that can be felt [m].
/// @param radius   Radius of the arm's workspace about W's origin [m]. The path stays within it.
/// @param seconds  Duration of the path [s].
/// Bounded: at most kMostRays rays and kMostReads reads of fields. In a moving scene each visit has
/// a share of both limits.
[[nodiscard]] HandTarget findingHand(const Scene& scene, const Box& bounds, double radius,
                                     double seconds, Search* search = nullptr);

}  // namespace palpate::cli
