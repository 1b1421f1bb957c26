/// The claims of Lundin et al., "The Orthogonal Constraints Problem ...", one by one.
#include <cmath>
#include <iostream>

#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "bench/methods/constraint_approach.h"
#include "bench/methods/residual.h"
#include "engine/solver.h"
#include "tests/support/random.h"
#include "tests/support/reference_solver.h"

using namespace palpate;
using palpate::methods::Constraint;
using palpate::methods::constraintProxy;
using palpate::methods::residualForce;
using palpate::test::describe;
using palpate::test::Random;
using palpate::test::solveReference;

namespace {

constexpr double kStiffness = 500.0;

/// Smallest |f_res| at x and on a tiny circle about it.
double smallestResidualNear(const Vec3& x, const Vec3& probe,
                            const std::vector<Primitive>& planes) {
  double least = residualForce(x - probe, probe, kStiffness, planes).norm();
  for (int i = 0; i < 720; ++i) {
    const double a = i * M_PI / 360.0;
    const Vec3 y = x + 1e-7 * Vec3(std::cos(a), std::sin(a), 0);
    least = std::min(least, residualForce(y - probe, probe, kStiffness, planes).norm());
  }
  return least;
}

}  // namespace

TEST_CASE("fig. 2, eq. 7: weak non-orthogonal constraints give a spurious force, primitives none",
          "[paper][fig2][eq7]") {
  Random random(2);
  std::cout
      << "strength N | eq. (2) force N | primitives N | their sum N | reference N  (largest of "
         "200 sets of 3)\n";
  for (double strength = 1e-9; strength < 2e-2; strength *= 10.0) {
    double constraint_force = 0.0;
    double primitive_force = 0.0;
    double reference_force = 0.0;
    for (int i = 0; i < 200; ++i) {
      // Three directions 10 to 60 degrees apart, all at the old proxy, the hand 5 mm away.
      const Vec3 proxy = random.inCube(1e-2);
      const Vec3 probe = proxy + 5e-3 * random.direction();
      const Vec3 axis = random.direction();
      std::vector<Constraint> constraints;
      std::vector<Primitive> planes;
      for (int j = 0; j < 3; ++j) {
        const double angle = random.uniform(10.0, 60.0) * M_PI / 180.0;
        const Vec3 q = Eigen::AngleAxisd(angle, axis.cross(random.direction()).normalized()) * axis;
        constraints.push_back({q, strength});
        planes.push_back({PrimitiveKind::kPlane, proxy, q, strength});
      }
      const Vec3 old_way =
          kStiffness * (constraintProxy(probe, proxy, kStiffness, constraints) - probe);
      const SolveResult solved = solveProxy(probe, kStiffness, planes, proxy);
      const test::Reference reference = solveReference(probe, kStiffness, planes);
      const double force = kStiffness * solved.offset.norm();
      CAPTURE(describe(probe, kStiffness, planes));
      REQUIRE(force <= 3.0 * strength * (1.0 + 1e-6));
      REQUIRE(kStiffness * (solved.offset - reference.offset).norm() <=
              kStiffness * (solved.error_bound + reference.error_bound));
      REQUIRE(kStiffness * (solved.offset - reference.offset).norm() <= 1e-5 * 3.0 * strength);
      constraint_force = std::max(constraint_force, old_way.norm());
      primitive_force = std::max(primitive_force, force);
      reference_force = std::max(reference_force, kStiffness * reference.offset.norm());
    }
    std::cout << strength << " | " << constraint_force << " | " << primitive_force << " | "
              << 3.0 * strength << " | " << reference_force << '\n';
    // The old method fails: newtons out of nothing.
    CHECK(constraint_force > 1.0);
    CHECK(constraint_force > 100.0 * 3.0 * strength);
  }
}

TEST_CASE("weak primitives of any kind and direction: at most their sum, equal to the reference",
          "[paper]") {
  Random random(4);
  for (double strength = 1e-9; strength < 2e-2; strength *= 10.0) {
    for (int i = 0; i < 100; ++i) {
      const Vec3 probe = random.inCube(5e-3);
      std::vector<Primitive> set;
      double sum = 0.0;
      for (int j = 0; j < 4; ++j) {
        set.push_back(random.primitive());
        set.back().strength = strength * random.uniform(0.1, 1.0);
        sum += set.back().strength;
      }
      const SolveResult solved = solveProxy(probe, kStiffness, set, probe);
      const test::Reference reference = solveReference(probe, kStiffness, set);
      CAPTURE(describe(probe, kStiffness, set));
      REQUIRE(kStiffness * solved.offset.norm() <= sum * (1.0 + 1e-6));
      REQUIRE(kStiffness * (solved.offset - reference.offset).norm() <= 1e-5 * sum);
    }
  }
}

TEST_CASE("fig. 2 a: orthogonal weak constraints are right in both methods", "[paper][fig2]") {
  Random random(3);
  for (int i = 0; i < 100; ++i) {
    const Mat3 R = Eigen::AngleAxisd(random.uniform(-3, 3), random.direction()).toRotationMatrix();
    const Vec3 probe = random.inCube(5e-3);
    std::vector<Constraint> constraints;
    for (int j = 0; j < 3; ++j) constraints.push_back({R.col(j), 0.0});
    CHECK((constraintProxy(probe, Vec3::Zero(), kStiffness, constraints) - probe).norm() < 1e-16);
  }
}

TEST_CASE("section 3.1: n parallel constraints multiply the error by 1 - n each tick", "[paper]") {
  const int n = GENERATE(2, 3, 4);
  const std::vector<Constraint> constraints(static_cast<std::size_t>(n), {Vec3::UnitX(), 0.0});
  Vec3 proxy(1e-3, 0, 0);
  double error = 1e-3;
  for (int tick = 0; tick < 5; ++tick) {
    proxy = constraintProxy(Vec3::Zero(), proxy, kStiffness, constraints);
    error *= 1 - n;
    CHECK(proxy.x() == Approx(error));
  }
  const std::vector<Primitive> planes(static_cast<std::size_t>(n),
                                      {PrimitiveKind::kPlane, {1e-3, 0, 0}, Vec3::UnitX(), 1e-9});
  CHECK(kStiffness * solveProxy(Vec3::Zero(), kStiffness, planes, Vec3::Zero()).offset.norm() <=
        n * 1e-9 * (1 + 1e-6));
}

TEST_CASE("fig. 5: a plane balances the spring by a force within its strength", "[paper][fig5]") {
  const std::vector<Primitive> set{{PrimitiveKind::kPlane, Vec3::Zero(), Vec3::UnitZ(), 1.0}};
  const Vec3 probe(0, 0, -1e-3);
  const SolveResult r = solveProxy(probe, kStiffness, set, probe);
  CHECK(r.proxy.norm() < 1e-18);
  CHECK(kStiffness * r.offset.z() == Approx(0.5));
}

TEST_CASE("fig. 6: the proxy leaves the plane at s/k and stays s/k from the probe",
          "[paper][fig6]") {
  const double s = 2.0;
  const std::vector<Primitive> set{{PrimitiveKind::kPlane, Vec3::Zero(), Vec3::UnitZ(), s}};
  for (double depth = 0.0; depth < 10e-3; depth += 1e-4) {
    const Vec3 probe(3e-3, 0, -depth);
    const SolveResult r = solveProxy(probe, kStiffness, set, probe);
    CHECK(r.offset.z() == Approx(std::min(depth, s / kStiffness)).margin(1e-17));
    CHECK(r.offset.head<2>().norm() < 1e-17);
  }
}

TEST_CASE("section 4.2: the smallest |f_res| is not always the balance", "[paper][eq15]") {
  // Found among 4,000 random pairs of planes in 2-D, of which 15 are such.
  const Vec3 q0 = Vec3(0.92495181, 0.38008441, 0).normalized();
  const Vec3 q1 = Vec3(-0.80588101, -0.59207753, 0).normalized();
  const std::vector<Primitive> planes{
      {PrimitiveKind::kPlane, {0.0006631, -0.00057513, 0}, q0, 0.8684831298},
      {PrimitiveKind::kPlane, {-0.00184883, 0.00025814, 0}, q1, 2.0900202265}};
  const Vec3 probe(0.00237848, -0.00479456, 0);
  const SolveResult solved = solveProxy(probe, kStiffness, planes, probe);
  const test::Reference reference = solveReference(probe, kStiffness, planes);
  REQUIRE((solved.offset - reference.offset).norm() <= solved.error_bound + reference.error_bound);

  const Vec3 elsewhere(0.0030742, -0.00644263, 0);
  CHECK((elsewhere - solved.proxy).norm() > 1e-3);
  CHECK(smallestResidualNear(elsewhere, probe, planes) <
        smallestResidualNear(solved.proxy, probe, planes) - 0.1);
}
