/// Tests the engine when another program's servo loop calls it.
#include "palpate/devices/arm/servo.h"

#include <atomic>
#include <chrono>
#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <thread>
#include <utility>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/engine/loop/haptic_thread.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "tests/support/counters.h"
#include "tests/support/scenes.h"

namespace palpate::servo_test {

namespace {

using Catch::Matchers::Contains;

constexpr double kDt = 1e-3;

DeviceInfo arm() {
  DeviceInfo info;
  info.name = "arm";
  info.watch.late = 1.0;  // [s]; so long that a busy machine has no effect
  return info;
}

std::shared_ptr<const Scene> ball(const FieldPtr& field = makeSphere(Vec3::Zero(), 0.04)) {
  GraphSpec graph;
  ModeSpec skin;
  skin.kind = ModeKind::kIsosurface;
  skin.of = "ball";
  skin.solid = Solid::kBelow;
  skin.strength = 3.0;
  graph.modes.push_back(skin);
  return makeScene(graph, {{"ball", field}});
}

/// Moves the hand to 2 mm below the surface and keeps it there, with a tremor of 1 nm. Returns the
/// last force.
Vec3 press(Servo& servo, int ticks = 2000) {
  Vec3 force = Vec3::Zero();
  for (int i = 0; i < ticks; ++i) {
    HandState hand;
    hand.position = {1e-9 * (i % 2), 0.0, std::max(0.06 - 5e-5 * i, 0.038)};
    force = servo.tick(hand, kDt);
  }
  return force;
}

}  // namespace

TEST_CASE("a servo gives force only after a scene is published", "[servo]") {
  Servo servo(arm(), 1.0 / kDt, false);
  CHECK(press(servo, 100) == Vec3::Zero());
  servo.publish(ball());
  const Vec3 force = press(servo);
  CHECK(force.z() == Approx(1.0).epsilon(1e-6));  // 500 N/m times 2 mm
  CHECK(servo.latest().report.proxy.z() == Approx(0.04).margin(1e-6));
  CHECK(servo.latest().fault == Fault::kNone);
}

TEST_CASE("a servo's force grows over half a second after a fault", "[servo]") {
  Servo servo(arm(), 1.0 / kDt, false);
  servo.publish(ball());
  (void)press(servo);
  servo.cut();
  HandState hand;
  hand.position = {0.0, 0.0, 0.038};
  CHECK(servo.tick(hand, kDt) == Vec3::Zero());
  CHECK(servo.latest().fault == Fault::kStopped);
  servo.clear();
  // The hand enters again from outside. The force is at most the peak force times the elapsed share
  // of the engagement.
  const double peak = arm().limits.peak;
  double strongest = 0.0;
  for (int i = 0; i < 400; ++i) {
    hand.position.z() = i < 40 ? 0.038 + 1e-4 * i : std::max(0.042 - 1e-4 * (i - 40), 0.036);
    const double force = servo.tick(hand, kDt).norm();
    CHECK(force <= peak * (i + 1) * kDt / kEngage * (1.0 + 1e-9));
    strongest = std::max(strongest, force);
  }
  CHECK(strongest > 0.5);
}

TEST_CASE("a servo cuts the force on a late call or an arm fault and keeps it cut", "[servo]") {
  const auto faultOf = [](const HandState& hand, double dt) {
    Servo servo(arm(), 1.0 / kDt, false);
    servo.publish(ball());
    (void)press(servo);
    CHECK(servo.tick(hand, dt) == Vec3::Zero());
    const Fault fault = servo.latest().fault;
    HandState good;
    good.position = {0.0, 0.0, 0.038};
    CHECK(servo.tick(good, kDt) == Vec3::Zero());  // the fault is latched
    return fault;
  };
  HandState hand;
  hand.position = {0.0, 0.0, 0.038};
  CHECK(faultOf(hand, 1.1) == Fault::kLate);
  hand.fault = Fault::kPower;
  CHECK(faultOf(hand, kDt) == Fault::kPower);
  hand.fault = Fault::kNone;
  hand.age = 1.0;
  CHECK(faultOf(hand, kDt) == Fault::kStale);
  hand.age = 0.0;
  hand.position.x() = 0.1;
  CHECK(faultOf(hand, kDt) == Fault::kJump);
  hand.position.x() = std::numeric_limits<double>::quiet_NaN();
  CHECK(faultOf(hand, kDt) == Fault::kNotFinite);
}

TEST_CASE("a servo's force fades while a held arm's position is frozen and returns afterwards",
          "[servo]") {
  for (const bool hand_on_it : {true, false}) {
    DeviceInfo info = arm();
    info.hand = hand_on_it;
    Servo servo(info, 1.0 / kDt, false);
    servo.publish(ball());
    (void)press(servo);
    HandState same;
    same.position = {0.0, 0.0, 0.038};
    Vec3 force;
    for (int i = 0; i < 400; ++i) force = servo.tick(same, kDt);
    CHECK(force.z() == Approx(1.0).epsilon(1e-6));  // the force does not fade yet
    for (int i = 0; i < 700; ++i) force = servo.tick(same, kDt);
    CHECK(force.z() == Approx(hand_on_it ? 0.0 : 1.0).margin(1e-6));
    CHECK(servo.latest().fault == Fault::kNone);
    for (int i = 0; i < 700; ++i) {  // when the position moves, the force returns
      same.position.x() = 1e-9 * (i % 2);
      force = servo.tick(same, kDt);
    }
    CHECK(force.z() == Approx(1.0).epsilon(1e-6));
  }
}

TEST_CASE(
    "a servo's force fades if the arm reports, or the servo measures, that the arm stands still",
    "[servo]") {
  for (const double still : {1.0, std::numeric_limits<double>::quiet_NaN()}) {
    Servo servo(arm(), 1.0 / kDt, false);
    servo.publish(ball());
    (void)press(servo);
    HandState hand;
    Vec3 force;
    for (int i = 0; i < 1100; ++i) {
      // If HandState::still is NaN, the servo itself measures how long the position has been
      // constant.
      hand.position = {std::isnan(still) ? 0.0 : 1e-9 * (i % 2), 0.0, 0.038};
      hand.still = still;
      force = servo.tick(hand, kDt);
    }
    CHECK(force.norm() == Approx(0.0).margin(1e-6));
  }
}

TEST_CASE("a servo reports a late fault if its time steps are too small, negative or NaN",
          "[servo]") {
  for (const double dt : {0.0, -1e-3, 1e-6, 1e-320, std::numeric_limits<double>::quiet_NaN()}) {
    Servo servo(arm(), 1.0 / kDt, false);
    servo.publish(ball());
    (void)press(servo);
    HandState hand;
    hand.position = {0.0, 0.0, 0.038};
    int ticks = 0;
    while (ticks < 3000 && servo.latest().fault == Fault::kNone) {
      (void)servo.tick(hand, dt);
      ++ticks;
    }
    CHECK(std::abs(ticks - arm().watch.late / kDt) <= 1.0);
    CHECK(servo.latest().fault == Fault::kLate);
    CHECK(servo.latest().report.force == Vec3::Zero());
  }
}

TEST_CASE("an invalid time step does not increase a servo's force", "[servo]") {
  for (const double dt : {0.0, -1.0, std::numeric_limits<double>::quiet_NaN(),
                          std::numeric_limits<double>::infinity()}) {
    Servo servo(arm(), 1.0 / kDt, false);
    servo.publish(ball());
    const double before = press(servo).norm();
    HandState deeper;
    deeper.position = {0.0, 0.0, 0.0375};
    CHECK(servo.tick(deeper, dt).norm() <= before * (1.0 + 1e-12));
    // Afterwards clear() ends the fault.
    servo.clear();
    (void)press(servo);
    CHECK(servo.latest().fault == Fault::kNone);
    CHECK(servo.latest().report.force.z() == Approx(1.0).epsilon(1e-6));
  }
}

TEST_CASE("a tick of a servo that takes too long is a fault only in real time", "[servo]") {
  struct Hanging final : public ScalarField {
    explicit Hanging(const std::atomic<bool>* h) : ScalarField(sphere()->frame()), hang(h) {}
    static std::shared_ptr<const ScalarField> sphere() { return makeSphere(Vec3::Zero(), 0.04); }
    void reset(FieldCache& cache) const noexcept override { ball->reset(cache); }
    [[nodiscard]] ScalarSample sample(const Vec3& p, FieldCache& cache) const noexcept override {
      if (hang->load()) std::this_thread::sleep_for(std::chrono::milliseconds(8));
      return ball->sample(p, cache);
    }

    std::shared_ptr<const ScalarField> ball = sphere();
    const std::atomic<bool>* hang;
  };
  for (const bool real : {true, false}) {
    CAPTURE(real);
    std::atomic<bool> hang{false};
    DeviceInfo info = arm();
    info.watch.late = 0.005;
    Servo servo(info, 1.0 / kDt, real);
    servo.publish(ball(std::make_shared<const Hanging>(&hang)));
    const Vec3 before = press(servo);  // on a busy machine a tick may be late in real time
    if (!real) REQUIRE(before.norm() > 0.5);
    hang = true;
    HandState hand;
    hand.position = {0.0, 0.0, 0.038};
    const Vec3 force = servo.tick(hand, kDt);
    CHECK((force.norm() > 0.5) == !real);
    hang = false;
    (void)servo.tick(hand, kDt);
    CHECK(servo.latest().fault == (real ? Fault::kLate : Fault::kNone));
    // The caller's `dt` counts in real time and in virtual time.
    CHECK(servo.tick(hand, 0.1) == Vec3::Zero());
    CHECK(servo.latest().fault == Fault::kLate);
  }
}

TEST_CASE("a servo refuses invalid rates and limits and does not allocate in a tick", "[servo]") {
  Servo servo(arm(), 1.0 / kDt, false);
  servo.publish(ball());
  {
    const test::CountScope scope;
    (void)press(servo);
    CHECK(test::CountScope::counts().allocations == 0);
  }
  for (const double rate : {0.0, -1.0, 1e-320, 1e300, std::numeric_limits<double>::quiet_NaN()}) {
    CHECK_THROWS_AS(Servo(arm(), rate), DeviceError);
  }
  DeviceInfo weak = arm();
  weak.limits.peak = 0.0;
  CHECK_THROWS_AS(Servo(weak, 1000.0), DeviceError);
}

TEST_CASE("a servo and a thread refuse a coupling that their arm does not render stably",
          "[servo]") {
  DeviceInfo weak = arm();
  weak.max_stiffness = 100.0;
  weak.max_damping = 0.2;
  const auto with = [](const CouplingParams& coupling, std::optional<TransferSpec> varying = {}) {
    GraphSpec graph = test::ballSpec();
    graph.stiffness = std::move(varying);
    return std::shared_ptr(makeScene(graph, {{"ball", makeSphere(Vec3::Zero(), 0.04)}}, coupling));
  };
  const auto ramp = [](double most) {
    TransferSpec curve(TransferFunction::piecewise({{-0.01, 50.0}, {0.0, most}}));
    curve.factors[0].by = "ball";
    return curve;
  };
  Servo servo(weak, 1.0 / kDt, false);
  test::TestDevice device;
  device.about.max_stiffness = 100.0;
  HapticThread thread(device);
  CHECK_THROWS_WITH(thread.publish(with({500.0, 0.0})), Contains("use at most 100 N/m"));
  CHECK_THROWS_WITH(
      servo.publish(with({500.0, 0.0})),
      Contains("arm: the scene's coupling stiffness, 500 N/m,") && Contains("use at most 100 N/m"));
  CHECK_THROWS_WITH(servo.publish(with({100.0, 0.5})), Contains("use at most 0.2 N s/m"));
  CHECK_THROWS_WITH(servo.publish(with({100.0, 0.0}, ramp(101.0))),
                    Contains("use at most 100 N/m"));
  CHECK_NOTHROW(servo.publish(with({100.0, 0.0}, ramp(100.0))));
  CHECK_NOTHROW(servo.publish(with({100.0, 0.2})));
  CHECK_NOTHROW(servo.publish(nullptr));
  CHECK(press(servo) == Vec3::Zero());
}

}  // namespace palpate::servo_test
