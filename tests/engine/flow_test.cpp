#include "palpate/engine/field/flow.h"

#include <cmath>
#include <limits>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "tests/support/random.h"

namespace palpate::flow_test {
using namespace palpate::test;

namespace {

struct Reference {
  double q;
  double lambda2;
};

/// Computes Q and lambda2 from their definitions, with Eigen's eigenvalue solver.
Reference referenceOf(const Mat3& J) {
  const Mat3 S = 0.5 * (J + J.transpose());
  const Mat3 O = 0.5 * (J - J.transpose());
  const Mat3 M = S * S + O * O;
  Eigen::SelfAdjointEigenSolver<Mat3> solver(M);
  return {0.5 * (O.squaredNorm() - S.squaredNorm()), solver.eigenvalues()[1]};
}

Mat3 randomMatrix(Random& random) {
  Mat3 J;
  for (int i = 0; i < 9; ++i) J.data()[i] = random.uniform(-1.0, 1.0);
  return J;
}

}  // namespace

TEST_CASE("Q and lambda2 of known flows have their analytic values", "[flow]") {
  // A solid rotation at w = 3 rad/s about z has strain rate S = 0 and rotation rate O. Then |O|^2 =
  // 2 w^2, and S^2 + O^2 = diag(-w^2, -w^2, 0).
  Mat3 rotation = Mat3::Zero();
  rotation(0, 1) = -3.0;
  rotation(1, 0) = 3.0;
  CHECK(qCriterion(rotation) == Approx(9.0));
  CHECK(lambda2(rotation) == Approx(-9.0));
  CHECK(curl(rotation) == Vec3(0, 0, 6));
  // Pure strain has no vortex.
  const Mat3 strain = Vec3(2.0, -1.0, -1.0).asDiagonal();
  CHECK(qCriterion(strain) == Approx(-3.0));
  CHECK(lambda2(strain) == Approx(1.0));
  // Simple shear consists of equal parts of rotation and strain.
  Mat3 shear = Mat3::Zero();
  shear(0, 1) = 5.0;
  CHECK(qCriterion(shear) == 0.0);
  CHECK(std::abs(lambda2(shear)) < 1e-15);
  // On the axis of Burgers' vortex, the strain rate along the axis is 1/s. The flow rotates at
  // 2 rad/s.
  Mat3 burgers = Vec3(-0.5, -0.5, 1.0).asDiagonal();
  burgers(0, 1) = -2.0;
  burgers(1, 0) = 2.0;
  CHECK(qCriterion(burgers) == Approx(4.0 - 0.75));
  CHECK(lambda2(burgers) == Approx(0.25 - 4.0));
}

TEST_CASE("Q and lambda2 of random Jacobians agree with the definitions to 1e-14", "[flow]") {
  Random random(1);
  double worst_q = 0.0;
  double worst_lambda2 = 0.0;
  for (int i = 0; i < 100000; ++i) {
    Mat3 J = randomMatrix(random);
    // Some Jacobians have eigenvalues that agree to 1e-8, some are singular to 1e-12, some have no
    // divergence. All have random magnitudes.
    if (i % 5 == 1) J = Mat3::Identity() * random.uniform(-1, 1) + 1e-9 * J;
    if (i % 5 == 2) {
      const Mat3 R = Eigen::AngleAxisd(random.uniform(0, 3), random.direction()).matrix();
      J = R * Vec3(1.0, 1.0, random.uniform(-2, 2)).asDiagonal() * R.transpose() + 1e-8 * J;
    }
    if (i % 5 == 3) J.col(2) = J.col(0) + 1e-12 * J.col(1);
    if (i % 5 == 4) J -= Mat3::Identity() * (J.trace() / 3.0);
    J *= std::pow(10.0, random.uniform(-70.0, 70.0));
    const Reference reference = referenceOf(J);
    worst_q = std::max(worst_q, std::abs(qCriterion(J) - reference.q) / J.squaredNorm());
    worst_lambda2 =
        std::max(worst_lambda2, std::abs(lambda2(J) - reference.lambda2) / J.squaredNorm());
  }
  CHECK(worst_q < 1e-14);
  CHECK(worst_lambda2 < 1e-14);
}

TEST_CASE("Q and lambda2 do not depend on the choice of axes", "[flow]") {
  Random random(2);
  for (int i = 0; i < 1000; ++i) {
    const Mat3 J = randomMatrix(random);
    const Mat3 R = Eigen::AngleAxisd(random.uniform(0, 3), random.direction()).matrix();
    const Mat3 turned = R * J * R.transpose();
    CHECK(qCriterion(turned) == Approx(qCriterion(J)).margin(1e-14));
    CHECK(lambda2(turned) == Approx(lambda2(J)).margin(1e-14));
  }
}

TEST_CASE(
    "lambda2 of a non-finite Jacobian is NaN, and unit() of a zero or non-finite vector is zero",
    "[flow]") {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double infinite = std::numeric_limits<double>::infinity();
  CHECK(qCriterion(Mat3::Zero()) == 0.0);
  CHECK(lambda2(Mat3::Zero()) == 0.0);
  Mat3 bad = Mat3::Identity();
  for (const double value : {nan, infinite, -infinite}) {
    bad(1, 2) = value;
    CHECK(std::isnan(lambda2(bad)));
  }
  CHECK(unit({0, 0, 0}) == Vec3::Zero());
  CHECK(unit({0, -3, 4}) == Vec3(0, -0.6, 0.8));
  CHECK(unit({0, 1e-101, 0}) == Vec3::Zero());
  CHECK(unit({0, 1e-99, 0}) == Vec3::UnitY());
  CHECK(unit({0, 1e100, 0}) == Vec3::UnitY());
  CHECK(unit({nan, 1, 0}) == Vec3::Zero());
  CHECK(unit({1, infinite, 0}) == Vec3::Zero());
}

}  // namespace palpate::flow_test
