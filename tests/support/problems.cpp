#include "tests/support/problems.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>

#include "palpate/bench/methods/residual.h"

namespace palpate::bench {
namespace {

/// Adds at most three orthogonal planes, or a line and the plane across it, or a point.
void makeOrthogonal(const Vec3& at, int count, test::Random& random, std::vector<Primitive>& set) {
  const Mat3 frame =
      Eigen::AngleAxisd(random.uniform(-3.0, 3.0), random.direction()).toRotationMatrix();
  const auto add = [&](PrimitiveKind kind, int axis) {
    const double sign = random.integer(2) == 0 ? 1.0 : -1.0;
    set.push_back({kind, at, sign * frame.col(axis), random.uniform(0.0, 3.0)});
  };
  if (count == 1) {
    add(PrimitiveKind::kPoint, 0);
  } else if (count == 2 && random.integer(2) == 0) {
    add(PrimitiveKind::kLine, 0);
    add(PrimitiveKind::kPlane, 0);
  } else {
    for (int i = 0; i < std::min(count, 3); ++i) add(PrimitiveKind::kPlane, i);
  }
}

/// Makes the first `count` primitives planes through `at`. Adds primitives if there are fewer.
void meetAt(const Vec3& at, std::size_t count, test::Random& random, std::vector<Primitive>& set) {
  while (set.size() < count) set.push_back(random.primitive());
  for (std::size_t i = 0; i < count; ++i) {
    set[i].kind = PrimitiveKind::kPlane;
    set[i].position = at;
  }
}

}  // namespace

const char* wordFor(Family family) noexcept {
  switch (family) {
    case Family::kRandom:
      return "random";
    case Family::kOnePoint:
      return "one point";
    case Family::kNearParallel:
      return "near-parallel";
    case Family::kSlot:
      return "slot";
    case Family::kOrthogonal:
      return "orthogonal";
    case Family::kPlanes:
      return "planes";
    case Family::kMotion:
      return "motion";
    case Family::kStrengths:
      return "strengths 1e-9 to 1e4";
    case Family::kStiffness:
      return "stiffness 1 to 1e5";
    case Family::kKink:
      return "probe on a kink";
    case Family::kEdge:
      return "probe on an edge";
    case Family::kCorner:
      return "probe on a corner";
    case Family::kNearKinks:
      return "near kinks";
    case Family::kOneDirection:
      return "one direction";
    case Family::kFar:
      return "far away";
  }
  return "";
}

BalanceProblem makeProblem(Family family, int count, test::Random& random) {
  BalanceProblem problem;
  std::vector<Primitive>& set = problem.primitives;
  problem.stiffness = random.logUniform(30.0, 1e4);
  problem.start = random.inCube(2e-3);
  problem.probe = random.inCube(5e-3);
  const Vec3 anchor = problem.start;
  const Vec3 axis = random.direction();
  if (family == Family::kOrthogonal) {
    makeOrthogonal(anchor, count, random, set);
    return problem;
  }
  for (int i = 0; i < count; ++i) set.push_back(random.primitive());

  const double slot = random.integer(2) == 0 ? 0.0 : 1e-6;
  for (std::size_t i = 0; i < set.size(); ++i) {
    Primitive& p = set[i];
    switch (family) {
      case Family::kRandom:
      case Family::kOrthogonal:
      case Family::kEdge:
      case Family::kCorner:
      case Family::kKink:
        break;
      case Family::kOnePoint:
        p.position = anchor;
        break;
      case Family::kNearParallel:
        p.position = anchor;
        p.direction = (axis + 1e-2 * random.inCube(1.0)).normalized();
        break;
      case Family::kSlot:
        p.kind = PrimitiveKind::kPlane;
        p.direction = i % 2 == 0 ? axis : Vec3(-axis);
        p.position = anchor + (i % 2 == 0 ? 0.0 : slot) * axis;
        break;
      case Family::kPlanes:
        p.kind = PrimitiveKind::kPlane;
        break;
      case Family::kMotion:
        if (i == 0) p.kind = PrimitiveKind::kPlane;
        p.position = anchor;
        if (random.integer(2) == 0) {
          p.position += random.logUniform(1e-9, 1e-4) * random.direction();
        }
        break;
      case Family::kStrengths:
        p.strength = random.logUniform(1e-9, 1e4);
        break;
      case Family::kStiffness:
        problem.stiffness = random.logUniform(1.0, 1e5);
        break;
      case Family::kNearKinks:
        p.position = anchor + random.logUniform(1e-16, 1e-2) * random.direction();
        break;
      case Family::kOneDirection:
        p.position = anchor;
        p.direction = (axis + 1e-9 * random.inCube(1.0)).normalized();
        break;
      case Family::kFar:
        p.position += Vec3(1e4, -1e4, 1e4);
        break;
    }
  }
  if (family == Family::kFar) {
    problem.probe += Vec3(1e4, -1e4, 1e4);
    problem.start += Vec3(1e4, -1e4, 1e4);
  }
  if (family == Family::kKink && !set.empty()) problem.probe = set.front().position;
  if (family == Family::kEdge) meetAt(problem.probe, 2, random, set);
  if (family == Family::kCorner) meetAt(problem.probe, 3, random, set);
  return problem;
}

BalanceProblem makeMisledPair() {
  const Vec3 probe(0.00237848, -0.00479456, 0);
  const Vec3 q0 = Vec3(0.92495181, 0.38008441, 0).normalized();
  const Vec3 q1 = Vec3(-0.80588101, -0.59207753, 0).normalized();
  return {probe,
          500.0,
          probe,
          {{PrimitiveKind::kPlane, {0.0006631, -0.00057513, 0}, q0, 0.8684831298},
           {PrimitiveKind::kPlane, {-0.00184883, 0.00025814, 0}, q1, 2.0900202265}}};
}

double reachOf(const BalanceProblem& problem) noexcept {
  return methods::sumOfStrengths(problem.primitives) / problem.stiffness;
}

}  // namespace palpate::bench
