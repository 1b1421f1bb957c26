/// Tests the published methods in bench/methods: they must be correct where their papers claim it,
/// and show their known errors elsewhere.
#include <algorithm>
#include <cmath>
#include <vector>

#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "palpate/bench/methods/constraint_approach.h"
#include "palpate/bench/methods/euler_adaptive.h"
#include "palpate/bench/methods/euler_fixed.h"
#include "palpate/bench/methods/force_function.h"
#include "palpate/bench/methods/nelder_mead.h"
#include "palpate/bench/methods/residual.h"
#include "palpate/bench/methods/simplex.h"
#include "palpate/bench/methods/smallest_residual.h"
#include "tests/support/counters.h"
#include "tests/support/problems.h"
#include "tests/support/random.h"
#include "tests/support/reference_solver.h"

namespace palpate::methods_test {
using namespace palpate::methods;
using palpate::bench::BalanceProblem;
using palpate::bench::Family;
using palpate::bench::kFamilies;
using palpate::bench::makeProblem;
using palpate::bench::reachOf;
using palpate::test::describe;
using palpate::test::Random;
using palpate::test::Reference;
using palpate::test::solveReference;

namespace {

constexpr double kStiffness = 500.0;

/// Returns a plane through the origin with its normal along z.
std::vector<Primitive> onePlane(double strength) {
  return {{PrimitiveKind::kPlane, Vec3::Zero(), Vec3::UnitZ(), strength}};
}

/// A problem with its reference solution.
struct Known {
  BalanceProblem problem;
  Vec3 offset;
  double bound;  ///< Error bound of the reference [m].
  double reach;  ///< S/k [m].
};
std::vector<Known> knownProblems(int primitives, long per_family) {
  Random random(11);
  std::vector<Known> known;
  for (const Family family : kFamilies) {
    for (long i = 0; i < per_family; ++i) {
      const BalanceProblem p = makeProblem(family, primitives, random);
      const Reference r = solveReference(p.probe, p.stiffness, p.primitives);
      if (r.error_bound > 1e-4 * reachOf(p)) continue;
      known.push_back({p, r.offset, r.error_bound, reachOf(p)});
    }
  }
  // The shares that Score reports are meaningful only if few problems were dropped.
  REQUIRE(static_cast<double>(known.size()) >=
          0.9 * static_cast<double>(kFamilies.size()) * static_cast<double>(per_family));
  return known;
}

/// Results of a method on known problems.
struct Score {
  double reached = 0.0;  ///< Share of problems solved to within 1e-3 S/k.
  double settled = 0.0;
  double mean_iterations = 0.0;
  int median_iterations = 0;
};
template <class Method>
Score scoreOf(const Method& method, const std::vector<Known>& known) {
  Score score;
  std::vector<int> iterations;
  const double one = 1.0 / static_cast<double>(known.size());
  for (const Known& k : known) {
    const BalanceProblem& p = k.problem;
    const Balance b = method(p.probe, p.stiffness, p.primitives, p.start);
    if ((b.offset - k.offset).norm() <= 1e-3 * k.reach) score.reached += one;
    if (b.settled) score.settled += one;
    iterations.push_back(b.iterations);
    score.mean_iterations += one * b.iterations;
  }
  std::sort(iterations.begin(), iterations.end());
  score.median_iterations = iterations[iterations.size() / 2];
  return score;
}

}  // namespace

TEST_CASE(
    "the residual force f_res is minus the slope of the potential and zero on a primitive's kink",
    "[methods][eq14]") {
  Random random(1);
  for (int i = 0; i < 200; ++i) {
    const Vec3 probe = random.inCube(5e-3);
    std::vector<Primitive> set;
    for (int j = 0; j < 4; ++j) set.push_back(random.primitive());
    const Vec3 offset = random.inCube(5e-3);
    Vec3 slope;
    const double h = 1e-8;
    for (int axis = 0; axis < 3; ++axis) {
      const Vec3 step = h * Vec3::Unit(axis);
      slope[axis] = (potential(offset + step, probe, kStiffness, set) -
                     potential(offset - step, probe, kStiffness, set)) /
                    (2.0 * h);
    }
    CAPTURE(describe(probe, kStiffness, set));
    CHECK((residualForce(offset, probe, kStiffness, set) + slope).norm() < 1e-3);
  }
  for (const PrimitiveKind kind :
       {PrimitiveKind::kPoint, PrimitiveKind::kLine, PrimitiveKind::kPlane}) {
    CHECK(forceOf({kind, Vec3::Zero(), Vec3::UnitZ(), 2.0}, Vec3::Zero()).norm() == 0.0);
    CHECK(forceOf({kind, Vec3::Zero(), Vec3::UnitZ(), 2.0}, Vec3(1e-9, 0, -1e-9)).norm() ==
          Approx(2.0));
  }
}

TEST_CASE("a force function pushes with its full strength where a plane would only hold the proxy",
          "[methods][fig5]") {
  const auto force = [](double depth, double strength) {
    const Vec3 probe(0, 0, -depth);
    return kStiffness * forceFunction(probe, kStiffness, onePlane(strength), probe).offset.z();
  };
  const auto balance = [](double depth, double strength) {
    return kStiffness *
           solveReference(Vec3(0, 0, -depth), kStiffness, onePlane(strength)).offset.z();
  };
  // At a depth of more than s/k, proxy and probe are behind the plane, and both methods give s.
  CHECK(force(3e-3, 1.0) == Approx(balance(3e-3, 1.0)));
  CHECK(force(-1e-3, 1.0) == 0.0);
  // Up to a depth of s/k, the plane holds the proxy: with 0.5 N at 1 mm, and with almost no force
  // at 1 nm. The force function gives 1 N at any depth.
  CHECK(balance(1e-3, 1.0) == Approx(0.5));
  CHECK(force(1e-3, 1.0) == Approx(1.0));
  CHECK(balance(1e-9, 1.0) < 1e-6);
  CHECK(force(1e-9, 1.0) == Approx(1.0));
}

TEST_CASE(
    "the constraint approach of eq. 2 gives the balance of orthogonal primitives at any positions",
    "[methods][eq2]") {
  Random random(2);
  for (int i = 0; i < 300; ++i) {
    BalanceProblem p = makeProblem(Family::kOrthogonal, 1 + i % 3, random);
    for (Primitive& primitive : p.primitives) primitive.position = random.inCube(4e-3);
    if (i % 2 == 0) {
      p.primitives.push_back({PrimitiveKind::kForce, Vec3::Zero(), random.direction(), 1.0});
    }
    const Balance b = constraintApproach(p.probe, p.stiffness, p.primitives, p.start);
    const Reference r = solveReference(p.probe, p.stiffness, p.primitives);
    CAPTURE(describe(p.probe, p.stiffness, p.primitives));
    CHECK((b.offset - r.offset).norm() <= r.error_bound + 1e-12);
  }
}

TEST_CASE(
    "the constraint approach of eq. 2 gives more than 1 N for weak primitives that are not "
    "orthogonal",
    "[methods][eq2][eq7]") {
  // Two planes of 1e-9 N, whose normals differ by 45 degrees. The hand is 4 mm behind the first
  // plane, along its normal.
  const Vec3 slanted = Vec3(1, 0, 1).normalized();
  const std::vector<Primitive> set{{PrimitiveKind::kPlane, Vec3::Zero(), Vec3::UnitZ(), 1e-9},
                                   {PrimitiveKind::kPlane, Vec3::Zero(), slanted, 1e-9}};
  const Vec3 probe(0, 0, -4e-3);
  const Reference r = solveReference(probe, kStiffness, set);
  CHECK(kStiffness * r.offset.norm() < 2.1e-9);
  // Eq. (5) of Lundin et al. gives (0, 0, -4) + (-2, 0, -2) mm. The correct position is (0, 0, -4)
  // mm.
  const Balance b = constraintApproach(probe, kStiffness, set, Vec3::Zero());
  CHECK((b.offset - Vec3(-2e-3, 0, -2e-3)).norm() < 1e-9);
  CHECK(kStiffness * b.offset.norm() == Approx(std::sqrt(2.0)));
}

TEST_CASE("Euler's method: a residual force within the tolerance bounds the error",
          "[methods][eq15]") {
  // The potential is strongly convex with constant k, and eq. (14) gives a subgradient of the
  // potential. So a residual force r bounds the error by r/k.
  const int count = GENERATE(1, 2, 5);
  int settled = 0;
  for (const Known& k : knownProblems(count, 4)) {
    const BalanceProblem& p = k.problem;
    const EulerFixedParams params{0.5, 1e-6, 200};
    const Balance b = eulerFixed(p.probe, p.stiffness, p.primitives, p.start, params);
    if (!b.settled) continue;
    ++settled;
    CAPTURE(describe(p.probe, p.stiffness, p.primitives));
    CHECK((b.offset - k.offset).norm() <= params.tolerance * k.reach + k.bound);
  }
  CHECK(settled > 5);
}

TEST_CASE(
    "Euler's method with a fixed step does not settle at a holding plane, and ends within its step "
    "times s/k of the plane",
    "[methods][eq14]") {
  const double s = 2.0;
  const Vec3 probe(0, 0, -1e-3);  // s/k is 4 mm, so the answer is on the plane
  for (const double step : {0.5, 0.1, 1e-2}) {
    const EulerFixedParams params{step, 1e-4, 5000};
    const Balance b = eulerFixed(probe, kStiffness, onePlane(s), Vec3(0, 0, 1e-3), params);
    CHECK_FALSE(b.settled);
    CHECK(b.iterations == 5000);
    const double height = b.offset.z() - 1e-3;
    CHECK(std::abs(height) <= step * s / kStiffness);
    CHECK(std::abs(height) > 1e-6);
    CHECK(residualForce(b.offset, probe, kStiffness, onePlane(s)).norm() >= 0.5 - 1e-9);
  }
  // The default parameters reach 1e-3 S/k, but need 20,000 iterations.
  const Balance b = eulerFixed(probe, kStiffness, onePlane(s), Vec3(0, 0, 1e-3));
  CHECK(std::abs(b.offset.z() - 1e-3) <= 1e-3 * s / kStiffness);
  CHECK(b.iterations == 20000);
  // At a depth of more than s/k, the force is smooth at the solution, so the method settles.
  const Balance deep = eulerFixed(Vec3(0, 0, -8e-3), kStiffness, onePlane(s), Vec3::Zero());
  CHECK(deep.settled);
  CHECK(deep.offset.z() == Approx(4e-3).epsilon(1e-3));
}

TEST_CASE("Euler with an adaptive step finds fig. 6's balance also where |f_res| does not vanish",
          "[methods][fig6]") {
  const double s = 2.0;
  for (double depth = 2e-4; depth < 10e-3; depth += 4e-4) {
    const Vec3 probe(3e-3, 0, -depth);
    const Balance b = eulerAdaptive(probe, kStiffness, onePlane(s), Vec3(1e-3, 0, 1e-3));
    const double held = std::min(depth, s / kStiffness);
    CAPTURE(depth);
    CHECK(b.settled);
    CHECK((b.offset - Vec3(0, 0, held)).norm() <= 1e-3 * s / kStiffness);
    // If a plane holds the proxy, the residual above the plane is the spring's force. Below the
    // plane, the residual is the strength minus the spring's force.
    const double pull = kStiffness * held;
    const double left = residualForce(b.offset, probe, kStiffness, onePlane(s)).norm();
    if (depth < s / kStiffness) CHECK(left > 0.9 * std::min(pull, s - pull));
  }
}

TEST_CASE(
    "Euler's method with an adaptive step does not settle at a plane loaded to 0.999 of its "
    "strength",
    "[methods][fig6]") {
  const double s = 2.0;
  const Vec3 probe(0, 0, -0.999 * s / kStiffness);
  const Balance b = eulerAdaptive(probe, kStiffness, onePlane(s), Vec3::Zero());
  CHECK_FALSE(b.settled);
  CHECK(b.iterations == EulerAdaptiveParams{}.max_iterations);
  // If the step can only shrink, the method settles.
  CHECK(
      eulerAdaptive(probe, kStiffness, onePlane(s), Vec3::Zero(), {1.0, 0.75, 3e-5, 2000}).settled);
}

TEST_CASE(
    "section 4.3: Euler with an adaptive step takes at most 40 iterations (median) and misses 1 to "
    "20 %",
    "[methods][paper]") {
  const auto method = [](auto&&... problem) { return eulerAdaptive(problem...); };
  const Score two = scoreOf(method, knownProblems(2, 20));
  CHECK(two.reached > 0.88);
  CHECK(two.reached < 0.99);
  CHECK(two.settled > 0.97);  // share of problems that meet the method's own stopping rule
  CHECK(two.median_iterations <= 40);
  CHECK(two.mean_iterations < 100.0);
  const Score eight = scoreOf(method, knownProblems(8, 4));
  CHECK(eight.reached > 0.8);
  CHECK(eight.reached < 0.99);
}

TEST_CASE("the simplex method finds the minimum of a narrow quadratic valley to 1e-7",
          "[methods]") {
  const Vec3 bottom(0.3, -0.2, 0.7);
  const auto valley = [&](const Vec3& x) {
    const Vec3 d = x - bottom;
    return d.x() * d.x() + 100.0 * d.y() * d.y() + 10.0 * d.z() * d.z() + d.x() * d.z();
  };
  const SimplexResult found = minimiseBySimplex(valley, Vec3::Zero(), {1.0, 1e-8, 1000});
  CHECK(found.settled);
  CHECK((found.best - bottom).norm() < 1e-7);
  CHECK(found.value == valley(found.best));
  const SimplexResult stopped = minimiseBySimplex(valley, Vec3::Zero(), {1.0, 1e-8, 20});
  CHECK_FALSE(stopped.settled);
  CHECK(stopped.evaluations < 24);
}

TEST_CASE(
    "section 4.3: Nelder-Mead on the potential finds the balance in 150 to 400 iterations (mean)",
    "[methods][paper]") {
  const int count = GENERATE(2, 8);
  const Score score =
      scoreOf([](auto&&... problem) { return nelderMead(problem...); }, knownProblems(count, 10));
  CHECK(score.reached > 0.98);
  CHECK(score.settled > 0.98);
  CHECK(score.mean_iterations > 150.0);
  CHECK(score.mean_iterations < 400.0);
}

TEST_CASE("the point with the smallest |f_res| is the balance of one plane, figs 5 and 6",
          "[methods][fig5][fig6]") {
  const double s = 2.0;
  for (double depth = 1e-4; depth < 10e-3; depth += 1e-4) {
    const Vec3 probe(3e-3, 0, -depth);
    const Balance b = smallestResidual(probe, kStiffness, onePlane(s), Vec3(1e-3, 0, 1e-3));
    CAPTURE(depth);
    CHECK((b.offset - Vec3(0, 0, std::min(depth, s / kStiffness))).norm() <= 1e-3 * s / kStiffness);
  }
}

TEST_CASE("section 4.2: |f_res| can be smallest off the balance, and the start decides the result",
          "[methods][eq15]") {
  const BalanceProblem pair = palpate::bench::makeMisledPair();
  const std::vector<Primitive>& planes = pair.primitives;
  const Vec3& probe = pair.probe;
  REQUIRE(pair.stiffness == kStiffness);
  const auto magnitude = [&](const Vec3& offset) {
    return residualForce(offset, probe, kStiffness, planes).norm();
  };
  const Reference r = solveReference(probe, kStiffness, planes);

  // A search from the probe finds the balance. Another minimum is at the tip of a narrow wedge.
  const Balance from_probe = smallestResidual(probe, kStiffness, planes, probe);
  CHECK((from_probe.offset - r.offset).norm() < 1e-6);

  // A search with small steps that starts in the wedge stays there. Its result has a smaller
  // |f_res| than the balance, but is more than a millimetre away from the balance.
  SmallestResidualParams fine;
  fine.size = 1e-3;
  const Vec3 tip(0.0030742, -0.00644263, 0);
  const Vec3 start = tip + 1e-4 * (planes[0].direction + planes[1].direction).normalized();
  const Balance from_wedge = smallestResidual(probe, kStiffness, planes, start, fine);
  REQUIRE(from_wedge.settled);
  CHECK((from_wedge.offset - r.offset).norm() > 1e-3);
  CHECK(magnitude(from_wedge.offset) < magnitude(from_probe.offset) - 0.1);
  CHECK((eulerAdaptive(probe, kStiffness, planes, start).offset - r.offset).norm() < 1e-5);
}

TEST_CASE("the point with the smallest |f_res| is the balance of most but not all random problems",
          "[methods][eq15]") {
  const auto method = [](auto&&... problem) { return smallestResidual(problem...); };
  const Score two = scoreOf(method, knownProblems(2, 10));
  CHECK(two.reached > 0.85);
  CHECK(two.reached < 0.99);
  const Score eight = scoreOf(method, knownProblems(8, 4));
  CHECK(eight.reached > 0.7);
  CHECK(eight.reached < 0.95);
}

TEST_CASE(
    "every method leaves the proxy at the probe if no primitive has strength, and allocates no "
    "memory",
    "[methods][realtime]") {
  const Vec3 probe(1e-3, 2e-3, -3e-3);
  const std::vector<Primitive> none;
  const std::vector<Primitive> idle{{PrimitiveKind::kPoint, probe, Vec3::UnitX(), 0.0},
                                    {PrimitiveKind::kPlane, Vec3::Zero(), Vec3::UnitX(), 0.0}};
  for (const auto& set : {none, idle}) {
    const test::CountScope scope;
    const Balance answers[] = {forceFunction(probe, kStiffness, set, Vec3::Zero()),
                               constraintApproach(probe, kStiffness, set, probe),
                               eulerFixed(probe, kStiffness, set, Vec3::Zero()),
                               eulerAdaptive(probe, kStiffness, set, Vec3::Zero()),
                               nelderMead(probe, kStiffness, set, Vec3::Zero()),
                               smallestResidual(probe, kStiffness, set, Vec3::Zero())};
    const long allocations = test::CountScope::counts().allocations;
    CHECK(allocations == 0);
    for (const Balance& b : answers) CHECK(b.offset.norm() < 1e-10);
  }
}

}  // namespace palpate::methods_test
