/// Where the simulated hand of `palpate feel` goes: to what the scene's modes are made of.
#pragma once

#include "palpate/devices/simulated_device.h"
#include "palpate/engine/scene.h"

namespace palpate::cli {

/// What the search took.
struct Search {
  int rays = 0;     ///< Cast, one straight way of a finger each.
  int met = 0;      ///< Of these, on which some mode acted.
  long reads = 0;   ///< Of fields, on all of them.
  double ms = 0.0;  ///< With planning the path [ms].
  int visits = 0;   ///< Planned.
};

/// A path that finds, touches, strokes and presses what there is to feel, from several sides.
///
/// Rays are cast through the scene by ticks of its own: a finger that yields to nothing goes along
/// each, and what a mode does against it there is what the mode is worth there. Whatever kind a
/// mode is, of what volume or part, placed or moving, counts alike. A visit takes the ray that is
/// worth most by what was visited least and lies farthest from the last visits; it comes along the
/// ray, presses each mode that is met to its strength, strokes, and withdraws. The same finger goes
/// along the path first, so that the hand is told where to be against the force that it will meet.
///
/// The same scene gives the same path, whatever `seconds` are; after a minute it begins again.
/// @param bounds   Of all that can be felt [m].
/// @param radius   Of the arm's workspace about W's origin, which the path does not leave [m].
/// @param seconds  How long the hand goes on [s].
/// Bounded: at most kMostRays rays and kMostReads reads of fields, for a scene that moves at each
/// visit a share of these.
[[nodiscard]] HandTarget findingHand(const Scene& scene, const Box& bounds, double radius,
                                     double seconds, Search* search = nullptr);

}  // namespace palpate::cli
