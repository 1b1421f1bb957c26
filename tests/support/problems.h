/// Random balances of known difficulty. Tests and benchmarks give them to every method.
#pragma once

#include <array>
#include <vector>

#include "palpate/engine/balance/primitive.h"
#include "tests/support/random.h"

namespace palpate::bench {

/// One balance to find.
struct BalanceProblem {
  Vec3 probe = Vec3::Zero();  ///< [m]
  double stiffness = 500.0;   ///< [N/m]
  Vec3 start = Vec3::Zero();  ///< Proxy of the previous tick [m].
  std::vector<Primitive> primitives;
};

/// Families of problems. The last eight are adversarial.
enum class Family {
  kRandom,        ///< Any kinds of primitives, anchors in a cube of 4 mm, strengths up to 3 N.
  kOnePoint,      ///< All primitives are anchored at the start, as modes place them.
  kNearParallel,  ///< Anchored at one point, with directions within 1e-2 rad of each other.
  kSlot,          ///< Planes that face each other, 0 to 1 um apart.
  /// Anchored at one point, with directions of one orthonormal frame: at most three planes, or a
  /// line and the plane perpendicular to it, or a point.
  kOrthogonal,
  kPlanes,  ///< Planes only.
  /// A plane and others, up to a tenth of a millimetre from the start, like one tick of a surface
  /// with viscosity.
  kMotion,
  kStrengths,     ///< Strengths from 1e-9 to 1e4 N in one set.
  kStiffness,     ///< k from 1 to 1e5 N/m.
  kKink,          ///< The probe lies on the kink of the first primitive.
  kEdge,          ///< The probe lies on the edge of the first two primitives, which are planes.
  kCorner,        ///< The probe lies on the corner of the first three primitives, which are planes.
  kNearKinks,     ///< Anchors 1e-16 to 1e-2 m from one point, each at its own distance.
  kOneDirection,  ///< Anchored at one point, with directions 1e-9 rad apart.
  kFar,           ///< Positions 1e4 m from the origin.
};
inline constexpr std::array<Family, 15> kFamilies = {
    Family::kRandom,     Family::kOnePoint,     Family::kNearParallel, Family::kSlot,
    Family::kOrthogonal, Family::kPlanes,       Family::kMotion,       Family::kStrengths,
    Family::kStiffness,  Family::kKink,         Family::kEdge,         Family::kCorner,
    Family::kNearKinks,  Family::kOneDirection, Family::kFar};

/// Returns the name for tables and charts.
[[nodiscard]] const char* wordFor(Family family) noexcept;

/// Returns a problem of `count` primitives. kOrthogonal has at most three. kSlot, kEdge and kCorner
/// have at least as many as they need.
[[nodiscard]] BalanceProblem makeProblem(Family family, int count, test::Random& random);

/// Returns two planes for which the smallest |f_res| is not at their balance, but near (3.07,
/// -6.44, 0) mm. 15 of 4,000 random pairs in 2-D have this property.
[[nodiscard]] BalanceProblem makeMisledPair();

/// Returns the sum of strengths divided by the stiffness [m], the largest possible distance from
/// the probe to the proxy.
[[nodiscard]] double reachOf(const BalanceProblem& problem) noexcept;

}  // namespace palpate::bench
