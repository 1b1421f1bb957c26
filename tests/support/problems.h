/// Random balance problems of known difficulty, for tests and benchmarks of all methods.
#pragma once

#include <array>
#include <vector>

#include "palpate/engine/balance/primitive.h"
#include "tests/support/random.h"

namespace palpate::bench {

/// A balance to solve for.
struct BalanceProblem {
  Vec3 probe = Vec3::Zero();  ///< [m]
  double stiffness = 500.0;   ///< [N/m]
  Vec3 start = Vec3::Zero();  ///< Proxy of the previous tick [m].
  std::vector<Primitive> primitives;
};

/// Families of problems. The last eight are adversarial.
enum class Family {
  kRandom,        ///< All kinds, anchors in a cube of 4 mm, strengths up to 3 N.
  kOnePoint,      ///< All anchored at the start, as many modes place them.
  kNearParallel,  ///< Anchored at one point, directions within about 1e-2 rad of one axis.
  kSlot,          ///< Planes that face each other at a distance of 0 or 1 um.
  /// Anchored at one point, directions of one orthonormal frame: up to three planes, or a line and
  /// the plane across it, or a point.
  kOrthogonal,
  kPlanes,  ///< Planes only.
  /// A plane and other primitives, up to 0.1 mm from the start, as in a tick on a surface with
  /// viscosity.
  kMotion,
  kStrengths,     ///< Strengths of 1e-9 to 1e4 N in one set.
  kStiffness,     ///< k of 1 to 1e5 N/m.
  kKink,          ///< The probe is at the position of the first primitive.
  kEdge,          ///< The probe is on the edge where the first two primitives, planes, meet.
  kCorner,        ///< The probe is on the corner where the first three primitives, planes, meet.
  kNearKinks,     ///< Anchors at distances of 1e-16 to 1e-2 m from one point.
  kOneDirection,  ///< Anchored at one point, directions within about 1e-9 rad of one axis.
  kFar,           ///< Positions with coordinates near +-1e4 m.
};
inline constexpr std::array<Family, 15> kFamilies = {
    Family::kRandom,     Family::kOnePoint,     Family::kNearParallel, Family::kSlot,
    Family::kOrthogonal, Family::kPlanes,       Family::kMotion,       Family::kStrengths,
    Family::kStiffness,  Family::kKink,         Family::kEdge,         Family::kCorner,
    Family::kNearKinks,  Family::kOneDirection, Family::kFar};

/// Returns the family's name in tables and charts.
[[nodiscard]] const char* wordFor(Family family) noexcept;

/// Returns a problem of `count` primitives, but at most three for kOrthogonal, at least two for
/// kEdge, and at least three for kCorner.
[[nodiscard]] BalanceProblem makeProblem(Family family, int count, test::Random& random);

/// Returns two planes. The net force f_res is smallest near (3.07, -6.44, 0) mm, which is not their
/// balance.
[[nodiscard]] BalanceProblem makeMisledPair();

/// Returns the sum of strengths divided by the stiffness: the largest possible distance from probe
/// to proxy [m].
[[nodiscard]] double reachOf(const BalanceProblem& problem) noexcept;

}  // namespace palpate::bench
