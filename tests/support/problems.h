/// Random balances of known difficulty, the inputs of tests and benchmarks for every method.
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
  Vec3 start = Vec3::Zero();  ///< The proxy of the tick before [m].
  std::vector<Primitive> primitives;
};

/// Families. The last eight are adversarial.
enum class Family {
  kRandom,        ///< Any kinds, anchors in a cube of 4 mm, strengths to 3 N.
  kOnePoint,      ///< All anchored at the start, as modes place them.
  kNearParallel,  ///< At one point, directions within 1e-2 rad of each other.
  kSlot,          ///< Planes that face each other, 0 to 1 um apart.
  kOrthogonal,    ///< At one point, directions of one orthonormal frame: at most three planes, or a
                  ///< line and the plane across it, or a point.
  kPlanes,        ///< Planes only.
  kMotion,        ///< A plane and others, up to a tenth of a millimetre off the start: one tick of
                  ///< a surface with its drag.
  kStrengths,     ///< Strengths from 1e-9 to 1e4 N in one set.
  kStiffness,     ///< k from 1 to 1e5 N/m.
  kKink,          ///< The probe on the kink of the first primitive.
  kEdge,          ///< The probe on the edge of the first two, planes.
  kCorner,        ///< The probe on the corner of the first three, planes.
  kNearKinks,     ///< Anchors 1e-16 to 1e-2 m from one point, each at its own distance.
  kOneDirection,  ///< At one point, directions 1e-9 rad apart.
  kFar,           ///< Positions 1e4 m from the origin.
};
inline constexpr std::array<Family, 15> kFamilies = {
    Family::kRandom,     Family::kOnePoint,     Family::kNearParallel, Family::kSlot,
    Family::kOrthogonal, Family::kPlanes,       Family::kMotion,       Family::kStrengths,
    Family::kStiffness,  Family::kKink,         Family::kEdge,         Family::kCorner,
    Family::kNearKinks,  Family::kOneDirection, Family::kFar};

/// Returns the word for tables and charts.
[[nodiscard]] const char* wordFor(Family family) noexcept;

/// Returns a problem of `count` primitives. kOrthogonal has at most three; kSlot and the edge and
/// corner have at least as many as they need.
[[nodiscard]] BalanceProblem makeProblem(Family family, int count, test::Random& random);

/// Returns two planes with the smallest |f_res| not at their balance, but near (3.07, -6.44, 0) mm.
/// 15 of 4,000 random pairs in 2-D have this property.
[[nodiscard]] BalanceProblem makeMisledPair();

/// Returns the sum of strengths over stiffness [m]: the proxy is never farther than this from the
/// probe.
[[nodiscard]] double reachOf(const BalanceProblem& problem) noexcept;

}  // namespace palpate::bench
