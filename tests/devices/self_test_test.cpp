/// Tests the self-test on correct and on faulty simulated arms.
#include "palpate/devices/arm/self_test.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/safety/limit_force.h"
#include "tests/support/random.h"

namespace palpate::self_test_test {
using Catch::Contains;

namespace {

constexpr double kRate = 1000.0;

struct Run {
  SelfTestResult result;
  double largest = 0.0;   ///< Largest force [N].
  double farthest = 0.0;  ///< Largest distance from the start [m].
  bool ended = false;
};

/// Runs the self-test as the program does: its forces pass limitForce before they reach the arm.
Run tried(const ArmParams& arm, const GripParams& grip = {0.0, 0.0},
          const std::function<Vec3(const Vec3&)>& wires = nullptr,
          const Vec3& gravity = Vec3::Zero(), const SelfTestParams& params = {}) {
  SimulatedDevice device(arm, grip, {[](double) { return Vec3(0, 0, 0); }, 1000.0}, kRate);
  SelfTest self(params);
  LimiterState limiter;
  const ForceLimits limits{params.force, 100.0};
  Run run;
  for (int i = 0; i < 60000 && !self.done(); ++i) {
    const HandState hand = device.read();
    const Vec3 wanted = self.next(hand, i / kRate, limiter.sent);
    const Vec3 force = limitForce(wanted, Vec3::Zero(), 1.0 / kRate, limits, limiter).force;
    run.largest = std::max(run.largest, force.norm());
    run.farthest = std::max(run.farthest, device.position().norm());
    device.write((wires ? wires(force) : force) + gravity);
  }
  run.ended = self.done();
  run.result = self.result();
  return run;
}

ArmParams arm(double mass, double viscous, double coulomb) {
  ArmParams params;
  params.mass = mass;
  params.viscous = viscous;
  params.coulomb = coulomb;
  params.encoder = 2e-5;
  params.delay = 1e-3;
  return params;
}

/// Checks that the reported problems contain these words.
void expectWords(const Run& run, const std::string& words) {
  CAPTURE(words);
  std::string all;
  for (const std::string& problem : run.result.problems) all += problem + "; ";
  CHECK_THAT(all, Contains(words));
}

}  // namespace

TEST_CASE("the self-test measures an arm's friction with at most 0.5 N", "[hid][release]") {
  for (const double mass : {0.05, 0.1, 0.3}) {
    for (const double viscous : {0.1, 0.5, 1.5}) {
      for (const double coulomb : {0.02, 0.1, 0.25}) {
        CAPTURE(mass, viscous, coulomb);
        const Run run = tried(arm(mass, viscous, coulomb));
        CHECK(run.ended);
        CHECK(run.largest <= 0.5);
        CHECK(run.farthest < 0.04);
        for (const std::string& problem : run.result.problems) UNSCOPED_INFO(problem);
        REQUIRE(run.result.problems.empty());
        for (const AxisResult& axis : run.result.axes) {
          REQUIRE(axis.fitted);
          CHECK(axis.along > 0.99);
          CHECK(axis.viscous == Approx(viscous).margin(0.1 * viscous + 0.05));
          CHECK(axis.coulomb == Approx(coulomb).margin(0.1 * coulomb + 0.015));
          CHECK(axis.mass == Approx(mass).epsilon(0.1));
          CHECK(std::abs(axis.bias) < 0.01);
          CHECK(axis.breakaway >= coulomb - 0.02);
        }
      }
    }
  }
}

TEST_CASE("the self-test names an arm's faults and their remedy", "[hid]") {
  const ArmParams good = arm(0.1, 0.5, 0.05);
  const auto says = [](const Run& run, const std::string& words) {
    expectWords(run, words);
    CHECK(run.ended);
    CHECK(run.farthest < 0.06);
  };
  says(tried(good, {0, 0}, [](const Vec3& f) { return Vec3(f.x(), -f.y(), f.z()); }),
       "pushed to +y, the arm moved the other way");
  says(tried(good, {0, 0}, [](const Vec3& f) { return Vec3(-f); }),
       "pushed to +x, the arm moved the other way");
  says(tried(good, {0, 0}, [](const Vec3& f) { return Vec3(f.y(), f.x(), f.z()); }),
       "pushed to +x, the arm moved in another direction");
  says(tried(good, {0, 0}, [](const Vec3& f) { return Vec3(f.x(), 0, f.z()); }),
       "y: 0.5 N did not move the arm");
  says(tried(arm(0.1, 0.5, 0.7)), "x: 0.5 N did not move the arm");
  says(tried(good, {2000.0, 20.0}), "did not move the arm");
  const Run heavy = tried(good, {0, 0}, nullptr, {0, 0, -0.4});
  says(heavy, "the released arm moves in direction (0, 0, -1) by itself, with 0.399 N");
  CHECK(heavy.result.weight == Approx(0.4).margin(0.01));
  CHECK(heavy.result.held);
  // The message distinguishes an arm that falls from an arm that rises because it carries too much
  // weight.
  for (const double up : {-1.0, 1.0}) {
    SelfTestParams params;
    params.down = Vec3(0, 0, -1);
    says(tried(good, {0, 0}, nullptr, {0, 0, 0.3 * up}, params),
         up < 0.0 ? "add a mass of 0.0306 kg to gravity/masses"
                  : "reduce gravity/masses of its profile by 0.0306 kg");
    params.down = Vec3(1, 0, 0);
    says(tried(good, {0, 0}, nullptr, {0, 0, 0.3 * up}, params),
         "this direction is not gravity/down");
  }
}

TEST_CASE("the self-test finds wrong force scales and directions from implausible motion",
          "[hid]") {
  const ArmParams good = arm(0.1, 0.5, 0.05);
  // Tests motors that are ten times too strong, a force that is rotated by 35 degrees, and one
  // motor that is six times too weak.
  expectWords(tried(good, {0, 0}, [](const Vec3& f) { return Vec3(10.0 * f); }), "moved farther");
  expectWords(tried(good, {0, 0},
                    [](const Vec3& f) {
                      const double c = std::cos(0.61);
                      const double s = std::sin(0.61);
                      return Vec3(c * f.x() - s * f.y(), s * f.x() + c * f.y(), f.z());
                    }),
              "moved in another direction");
  CHECK_FALSE(tried(good, {0, 0}, [](const Vec3& f) {
                return Vec3(f.x(), f.y() / 6.0, f.z());
              }).result.problems.empty());
  // The y axis has a wrong sign, and a force along x also acts along y. The self-test must not
  // use an axis whose sign is unknown.
  const Run coupled =
      tried(good, {0, 0}, [](const Vec3& f) { return Vec3(f.x(), -f.y() + 0.3 * f.x(), f.z()); });
  expectWords(coupled, "pushed to +y, the arm moved the other way");
  for (const std::string& problem : coupled.result.problems) {
    INFO(problem);
    CHECK(problem.find("pushed to ") == 0);
  }
  CHECK(coupled.farthest < 0.06);
}

TEST_CASE("the delay of an arm's force is measured by the self-test to a fraction of a tick",
          "[hid]") {
  test::Random random(7);
  const long arms = test::cases(60);
  std::vector<double> off;  // relative errors of the viscous friction
  double farthest = 0.0;    // largest error of a delay for encoder steps below 20 um [s]
  long told = 0;
  for (long i = 0; i < arms; ++i) {
    ArmParams any = arm(random.logUniform(0.05, 0.4), random.logUniform(0.1, 2.0),
                        random.logUniform(0.01, 0.25));
    any.encoder = random.logUniform(2e-6, 6e-5);
    any.delay = random.uniform(0.0, 6e-3);
    // The fit cannot distinguish amplifier lag from delay.
    if (random.uniform(0.0, 1.0) < 0.3) any.lag = random.logUniform(1e-4, 1e-3);
    const double late = any.delay + any.lag;
    CAPTURE(any.mass, any.viscous, any.coulomb, any.encoder, any.delay, any.lag);
    const Run run = tried(any);
    if (!run.result.problems.empty())
      continue;  // encoder steps are too coarse or the friction is too large
    ++told;
    double least = 1.0;
    double most = 0.0;
    for (const AxisResult& axis : run.result.axes) {
      least = std::min(least, axis.delay - 3.0 * axis.delay_error - 0.5e-3);
      most = std::max(most, axis.delay + 3.0 * axis.delay_error + 0.5e-3);
      if (any.encoder < 2e-5) farthest = std::max(farthest, std::abs(axis.delay - late));
      off.push_back(std::abs(axis.viscous / any.viscous - 1.0));
      // The loop uses these shares of the measured friction as lower limits.
      CHECK(0.25 * axis.viscous < any.viscous);
      CHECK(0.5 * axis.coulomb < any.coulomb);
    }
    CHECK(least < late);
    CHECK(late < most);
  }
  CHECK(told > 0.9 * static_cast<double>(arms));
  std::nth_element(off.begin(), off.begin() + static_cast<std::ptrdiff_t>(off.size() / 2),
                   off.end());
  WARN("of " << told << " arms: the delay at most " << 1e3 * farthest
             << " ms off with steps below 20 um; median relative error of b: "
             << off[off.size() / 2]);
  CHECK(farthest < 0.4e-3);
  CHECK(off[off.size() / 2] < 0.02);
  ArmParams slow = arm(0.15, 0.5, 0.05);
  slow.delay = 0.03;
  expectWords(tried(slow), "ms late or later");
}

TEST_CASE("the self-test distinguishes a small weight from friction", "[hid]") {
  const Run run = tried(arm(0.2, 0.5, 0.15), {0, 0}, nullptr, {0, 0, -0.08});
  for (const std::string& problem : run.result.problems) UNSCOPED_INFO(problem);
  REQUIRE(run.result.problems.empty());
  CHECK(run.result.axes[2].bias == Approx(-0.08).margin(0.01));
  CHECK(run.result.axes[2].coulomb == Approx(0.15).margin(0.02));
  CHECK(run.result.axes[0].bias == Approx(0.0).margin(0.01));
}

TEST_CASE("comparing with a ruler reveals a wrong position scale of any axis", "[hid]") {
  const ArmAxes axes;
  const auto trouble = [&](const Vec3& way, int axis = 0) {
    return rulerTrouble(way, 0.1, axes, axis);
  };
  CHECK(trouble({0.1, 0, 0}).empty());
  CHECK(trouble({0.093, 0, 0}).empty());
  // A user's hand does not move exactly along the axis.
  CHECK(trouble({0.095, 0.03, -0.02}).empty());
  CHECK_THAT(trouble({1.0, 0, 0}), Contains("over 0.1 m of ruler along +x the arm reports 1 m"));
  for (const double scale : {0.25, 0.67, 1.5, 4.0, 0.0, std::nan("")}) {
    for (int axis = 0; axis < 3; ++axis) {
      CAPTURE(scale, axis);
      CHECK_THAT(trouble(0.1 * scale * Vec3::Unit(axis), axis), Contains("the scale of its"));
    }
  }
  CHECK_THAT(trouble({0, 0, -0.1}, 2), Contains("along +z the arm reports the opposite direction"));
  CHECK_THAT(trouble({0, 0.1, 0}, 2), Contains("along +z the arm reports the direction (0, 1, 0)"));
}

TEST_CASE("the self-test uses only the directions in which the arm has motors", "[hid]") {
  const ArmParams good = arm(0.1, 0.5, 0.05);
  for (const double lean : {0.0, 0.5}) {  // [rad], about x
    const Vec3 across(0, -std::sin(lean), std::cos(lean));
    const Mat3 plane = Mat3::Identity() - across * across.transpose();
    const auto motors = [&](const Vec3& f) { return Vec3(plane * f); };
    // Without the motors' plane in SelfTestParams::axes, the self-test reports a faulty motor.
    CHECK_FALSE(tried(good, {0, 0}, motors).result.problems.empty());
    SelfTestParams params;
    params.axes = axesWithin(plane);
    const Run run = tried(good, {0, 0}, motors, Vec3::Zero(), params);
    for (const std::string& problem : run.result.problems) UNSCOPED_INFO(problem);
    REQUIRE(run.result.problems.empty());
    CHECK_FALSE(run.result.axes[2].driven);
    CHECK_FALSE(run.result.axes[2].fitted);
    for (const std::size_t a : {0U, 1U}) {
      CHECK(run.result.axes[a].driven);
      CHECK(run.result.axes[a].along > 0.99);
      CHECK(run.result.axes[a].viscous == Approx(0.5).margin(0.05));
      CHECK(run.result.axes[a].coulomb == Approx(0.05).margin(0.01));
    }
    // Within the plane, the usual checks apply.
    const Run turned = tried(
        good, {0, 0}, [&](const Vec3& f) { return Vec3(f.x(), -motors(f).y(), -motors(f).z()); },
        Vec3::Zero(), params);
    expectWords(turned, "pushed to +y" + std::string(lean > 0.0 ? " (0, 0.878, 0.479)" : "") +
                            ", the arm moved the other way");
  }
  SelfTestParams params;
  params.axes = axesWithin(Vec3::UnitY() * Vec3::UnitY().transpose());
  const Run run = tried(
      good, {0, 0}, [](const Vec3& f) { return Vec3(0, f.y(), 0); }, Vec3::Zero(), params);
  CHECK(run.result.problems.empty());
  CHECK(run.result.axes[1].fitted);
  CHECK(run.result.seconds < 10.0);
}

TEST_CASE("the self-test reports a low position rate and long pauses", "[hid]") {
  SelfTestParams params;
  params.input_rate = 1000.0;
  params.stale = 0.01;
  const auto problems = [&](int every) {
    SelfTest self(params);
    HandState hand;
    for (int i = 0; i < 30000 && !self.done(); ++i) {
      hand.age = 1e-3 * (i % every);
      (void)self.next(hand, 1e-3 * i, Vec3::Zero());
    }
    std::string all;
    for (const std::string& problem : self.result().problems) all += problem + "; ";
    return all;
  };
  CHECK_THAT(problems(1), !Contains("positions per second") && !Contains("a pause of"));
  CHECK_THAT(problems(4),
             Contains("the arm sends 250 positions per second") && !Contains("a pause of"));
  CHECK_THAT(problems(20),
             Contains("a pause of 20 ms between two positions is longer than the limit of 10 ms"));
}

TEST_CASE("the self-test counts new positions and measures the longest pause between them",
          "[hid]") {
  // An arm that reports at 250 Hz in a loop of 1 kHz.
  SelfTest self;
  HandState hand;
  for (int i = 0; i < 400; ++i) {
    hand.age = 1e-3 * (i % 4);
    (void)self.next(hand, 1e-3 * i, Vec3::Zero());
  }
  const SelfTestResult result = self.result();
  CHECK(result.positions == Approx(100).margin(2));
  CHECK(result.slowest == Approx(0.004).margin(1e-6));
  CHECK(result.noise == 0.0);
  CHECK_THAT(result.problems.back(), Contains("ended early"));
}

}  // namespace palpate::self_test_test
