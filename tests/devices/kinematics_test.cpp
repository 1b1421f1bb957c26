/// Tests arm kinematics: Jacobians against finite differences, known poses, and singular poses.
#include "palpate/devices/hid/kinematics.h"

#include <cmath>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <Eigen/Dense>
#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "tests/support/random.h"

namespace palpate::kinematics_test {
using palpate::test::Random;

namespace {

struct Arm {
  std::string name;
  std::shared_ptr<const Kinematics> model;
  std::function<Joints(Random&)> joints;  ///< Returns random joint positions within reach.
};

std::vector<Arm> arms() {
  const auto about = [](double a, double b, double c, double half) {
    return [=](Random& random) {
      Joints j{};
      j[0] = a + random.uniform(-half, half);
      j[1] = b + random.uniform(-half, half);
      j[2] = c + random.uniform(-half, half);
      for (std::size_t i = 3; i < kMostJoints; ++i) j[i] = random.uniform(-3.0, 3.0);
      return j;
    };
  };
  const std::vector<ChainLink> three{
      {0.1, 0.2, 0.0, M_PI / 2}, {0, 0, 0.25, 0}, {0.3, 0, 0.2, 0.1}};
  std::vector<ChainLink> six = three;
  six.push_back({0, 0.05, 0, -M_PI / 2});
  six.push_back({0, 0, 0.02, M_PI / 2});
  six.push_back({0.2, 0.03, 0, 0});
  return {
      {"cartesian", makeCartesian(), about(0, 0, 0, 0.2)},
      {"chain of 3", makeChain(three), about(0, 0, 0, 3.0)},
      {"chain of 6", makeChain(six, {0.01, -0.02, 0.03}), about(0, 0, 0, 3.0)},
      {"capstan arm", makeCapstanArm(0.08, 0.205, 0.245), about(0, 0.4, 1.2, 0.5)},
      {"pantograph", makePantograph({0.08, 0.1, 0.1, 0.08}, 0.05), about(1.0, 2.2, 0, 0.4)},
      {"delta", makeDelta(0.08, 0.03, 0.06, 0.12), about(0.3, 0.3, 0.3, 0.35)},
  };
}

}  // namespace

TEST_CASE("an arm's Jacobians are the derivatives of its tip position", "[kinematics]") {
  Random random(3);
  for (const Arm& arm : arms()) {
    CAPTURE(arm.name);
    double worst = 0.0;
    for (long n = 0; n < test::cases(2000); ++n) {
      const Joints q = arm.joints(random);
      const ArmPose pose = arm.model->at(q);
      REQUIRE(pose.reachable);
      for (std::size_t i = 0; i < arm.model->joints(); ++i) {
        // Five-point difference; its error is of order h^4.
        const double h = 1e-3;
        const auto at = [&](double d) {
          Joints moved = q;
          moved[i] += d;
          return arm.model->at(moved).position_D;
        };
        const Vec3 slope = (8.0 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12.0 * h);
        worst = std::max(worst, (slope - pose.jacobian[i]).norm());
      }
    }
    CHECK(worst < 1e-9);
  }
}

TEST_CASE("points on an arm's links move as their Jacobians predict", "[kinematics]") {
  Random random(13);
  for (const Arm& arm : arms()) {
    CAPTURE(arm.name);
    const Kinematics& model = *arm.model;
    for (std::size_t link = 0; link < model.links(); ++link) {
      double worst = 0.0;
      double stretch = 0.0;
      for (long n = 0; n < test::cases(300); ++n) {
        const Joints q = arm.joints(random);
        const Vec3 place = random.inCube(0.1);
        const Vec3 other = random.inCube(0.1);
        const ArmPose pose = model.on(link, place, q);
        for (std::size_t i = 0; i < model.joints(); ++i) {
          const double h = 1e-3;
          const auto at = [&](double d) {
            Joints moved = q;
            moved[i] += d;
            // The link is rigid, so distances between its points are constant.
            const Vec3 here = model.on(link, place, moved).position_D;
            const double apart = (model.on(link, other, moved).position_D - here).norm();
            stretch = std::max(stretch, std::abs(apart - (other - place).norm()));
            return here;
          };
          const Vec3 slope = (8.0 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12.0 * h);
          worst = std::max(worst, (slope - pose.jacobian[i]).norm());
        }
      }
      CAPTURE(link);
      CHECK(worst < 1e-8);
      CHECK(stretch < 1e-12);
    }
  }
  const Joints q{1.2, 2.0, 0.4, 0.1, 0.2, 0.3};
  const auto tipIs = [&](const Kinematics& model, std::size_t link, const Vec3& place) {
    return (model.on(link, place, q).position_D - model.at(q).position_D).norm() < 1e-12;
  };
  const auto panto = makePantograph({0.08, 0.1, 0.12, 0.08}, 0.05);
  CHECK(tipIs(*makeCartesian(), 2, Vec3::Zero()));
  CHECK(tipIs(*makeCapstanArm(0.08, 0.2, 0.25), 2, {0.25, 0, 0}));
  CHECK(tipIs(*panto, 1, {0.1, 0, 0}));
  CHECK(tipIs(*panto, 2, {0.12, 0, 0}));
  const auto delta = makeDelta(0.08, 0.03, 0.06, 0.12);
  const Joints level{0.3, 0.3, 0.3};
  CHECK((delta->on(3, Vec3::Zero(), level).position_D - delta->at(level).position_D).norm() == 0.0);
}

TEST_CASE("joint torques from the Jacobian reproduce the force at the tip", "[kinematics]") {
  // Principle of virtual work: torques J^T f. Solving J^T f = torques must give back f.
  Random random(5);
  for (const Arm& arm : arms()) {
    CAPTURE(arm.name);
    const std::size_t n = arm.model->joints();
    for (long k = 0; k < test::cases(2000); ++k) {
      const ArmPose pose = arm.model->at(arm.joints(random));
      Vec3 force = random.inCube(5.0);
      if (n == 2) force.z() = 0.0;
      Eigen::MatrixXd j(3, static_cast<int>(n));
      Eigen::VectorXd torques(static_cast<int>(n));
      for (std::size_t i = 0; i < n; ++i) {
        j.col(static_cast<int>(i)) = pose.jacobian[i];
        torques[static_cast<int>(i)] = Kinematics::torque(pose, i, force);
      }
      const Eigen::VectorXd rates = Eigen::VectorXd::Random(static_cast<int>(n));
      REQUIRE(torques.dot(rates) == Approx(force.dot(j * rates)).margin(1e-12));
      const Eigen::JacobiSVD<Eigen::MatrixXd> svd(j.transpose(),
                                                  Eigen::ComputeThinU | Eigen::ComputeThinV);
      if (svd.singularValues().tail(1)[0] < 1e-3) continue;
      const Vec3 back = svd.solve(torques);
      // A planar arm cannot make a force perpendicular to its plane.
      const Vec3 wanted = n == 2 ? Vec3(force.x(), force.y(), 0.0) : force;
      REQUIRE((back - wanted).norm() < 1e-9);
    }
  }
}

TEST_CASE("known joint angles give the known tip positions", "[kinematics]") {
  // WoodenHaptics in its home pose: the upper link vertical, the lower link horizontal.
  const auto woody = makeCapstanArm(0.08, 0.205, 0.245);
  CHECK((woody->at({0, 0, M_PI / 2}).position_D - Vec3(0.245, 0, 0.285)).norm() < 1e-15);
  CHECK((woody->at({M_PI / 2, 0, M_PI / 2}).position_D - Vec3(0, 0.245, 0.285)).norm() < 1e-15);
  // The tip of a delta with equal joint angles is on its axis. If the upper arms are horizontal:
  // fore^2 = (base - plate + upper)^2 + z^2.
  const auto delta = makeDelta(0.08, 0.03, 0.06, 0.14);
  const Vec3 tip = delta->at({0, 0, 0}).position_D;
  CHECK((tip - Vec3(0, 0, -std::sqrt(0.14 * 0.14 - 0.11 * 0.11))).norm() < 1e-12);
  CHECK(delta->at({0.3, 0.3, 0.3}).position_D.z() < tip.z());
  // If the joint angles are mirror images, the tip is on the pantograph's line of symmetry.
  const auto panto = makePantograph({0.08, 0.1, 0.1, 0.08}, 0.05);
  const Vec3 middle = panto->at({M_PI / 2 - 0.3, M_PI / 2 + 0.3}).position_D;
  CHECK(middle.x() == Approx(-0.025));
  CHECK(middle.y() > 0.08);
  CHECK(middle.z() == 0.0);
  const auto chain =
      makeChain(std::vector<ChainLink>{{0, 0, 0.3, 0}, {0, 0, 0.2, 0}, {0, 0, 0, 0}});
  CHECK((chain->at({M_PI / 2, -M_PI / 2, 1.0}).position_D - Vec3(0.2, 0.3, 0)).norm() < 1e-15);
}

TEST_CASE("an unreachable pose of an arm gives finite numbers and no torque", "[kinematics]") {
  const auto delta = makeDelta(0.08, 0.03, 0.06, 0.12);
  const auto panto = makePantograph({0.08, 0.1, 0.1, 0.08}, 0.05);
  // First the rods are too short to meet. Then, at `along`, they are in one line and cannot hold
  // the tip.
  CHECK_FALSE(makeDelta(0.08, 0.03, 0.06, 0.1)->at({0, 0, 0}).reachable);
  CHECK_FALSE(panto->at({0.0, M_PI}).reachable);
  // The elbows are 0.2 m apart, the length of both rods.
  const double along = std::acos((0.1 - 0.025) / 0.08);
  CHECK_FALSE(panto->at({along, M_PI - along}).reachable);
  CHECK(Kinematics::torque(panto->at({0.0, M_PI}), 0, {1, 1, 0}) == 0.0);
  Random random(7);
  long lost = 0;
  for (long i = 0; i < test::cases(100000); ++i) {
    Joints q{};
    for (double& joint : q) joint = random.uniform(-10.0, 10.0);
    for (const auto& model : {delta, panto, makeCapstanArm(0.08, 0.2, 0.2)}) {
      const ArmPose pose = model->at(q);
      REQUIRE(pose.position_D.allFinite());
      for (std::size_t j = 0; j < model->joints(); ++j) REQUIRE(pose.jacobian[j].allFinite());
      lost += pose.reachable ? 0 : 1;
      // In every reachable pose a force of 1 N along x needs torques below 12 N m.
      for (std::size_t j = 0; j < model->joints(); ++j) {
        REQUIRE(std::abs(Kinematics::torque(pose, j, Vec3::UnitX())) < 12.0);
      }
    }
  }
  CHECK(lost > 0);
}

TEST_CASE("impossible arm geometries are refused", "[kinematics]") {
  CHECK_THROWS_AS(makeCapstanArm(0.1, 0.0, 0.1), DeviceError);
  CHECK_THROWS_AS(makeCapstanArm(std::nan(""), 0.1, 0.1), DeviceError);
  CHECK_THROWS_AS(makeDelta(0.1, 0.05, -1, 0.1), DeviceError);
  CHECK_THROWS_AS(makePantograph({0.1, 0.1, 0.1, INFINITY}, 0.0), DeviceError);
  CHECK_THROWS_AS(makePantograph({0.1, 0.1, 0.1, 0.1}, -1.0), DeviceError);
  CHECK_THROWS_AS(makeChain(std::vector<ChainLink>(2)), DeviceError);
  CHECK_THROWS_AS(makeChain(std::vector<ChainLink>(7)), DeviceError);
  CHECK_THROWS_AS(makeChain(std::vector<ChainLink>(3), {0, std::nan(""), 0}), DeviceError);
}

}  // namespace palpate::kinematics_test
