#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>

#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/engine/field/placement.h"
#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "tests/support/counters.h"
#include "tests/support/formula_fields.h"
#include "tests/support/random.h"

namespace palpate::moving_test {
using palpate::test::CountScope;
using palpate::test::Random;

namespace {

constexpr double kDt = 1e-3;
constexpr double kVoxel = 0.1 / 128.0;
constexpr double kStiffness = 500.0;
constexpr double kPi = std::numbers::pi;
const ForceLimits kOpen{1e3, 1e12};

Keyframe keyAt(double time, const Vec3& translate,
               const Eigen::Quaterniond& turn = Eigen::Quaterniond::Identity()) {
  return {time, {turn.w(), turn.x(), turn.y(), turn.z()}, translate};
}

MotionPtr motion(const std::vector<Keyframe>& keys, bool repeat = false) {
  return std::make_shared<const Motion>(keys, repeat);
}

/// Returns a motion from start to end that begins at time `from` [s] with speed `speed` [m/s].
MotionPtr straight(const Vec3& start, const Vec3& end, double speed, double from = 0.0) {
  return motion({keyAt(from, start), keyAt(from + (end - start).norm() / speed, end)});
}

/// Returns an endless rotation about an axis through W's origin, at `rate` [rad/s].
MotionPtr spinning(const Vec3& axis, double rate) {
  std::vector<Keyframe> keys;
  for (int i = 0; i <= 4; ++i) {
    const double angle = 0.5 * kPi * i;
    keys.push_back(keyAt(std::abs(angle / rate), Vec3::Zero(),
                         Eigen::Quaterniond(Eigen::AngleAxisd(std::copysign(angle, rate), axis))));
  }
  return motion(keys, true);
}

ModeSpec mode(ModeKind kind, const char* of, double strength, double friction = 0.0) {
  ModeSpec spec;
  spec.kind = kind;
  spec.of = of;
  spec.strength = strength;
  spec.friction = friction;
  spec.solid = Solid::kBelow;
  return spec;
}

std::unique_ptr<const Scene> sceneOf(const std::vector<ModeSpec>& modes,
                                     const std::map<std::string, FieldPtr>& fields,
                                     const std::map<std::string, MotionPtr>& motions) {
  GraphSpec spec;
  spec.modes = modes;
  spec.motions = motions;
  return makeScene(spec, fields, {kStiffness, 0.0});
}

/// A hand in a scene, with its proxy.
struct Hand {
  const Scene& scene;
  Reader reader;
  ProxyState state{kOpen};

  explicit Hand(const Scene& s) : scene(s) {}
  StepReport at(const Vec3& hand) { return hapticStep(scene, reader, {hand}, state, kDt); }
};

/// Returns the height of the proxy above the ball's surface [voxels]. The ball's centre at rest is
/// W's origin.
double offSurface(const Hand& hand, double radius) {
  return ((hand.state.bodies()[0].pose.toRest(hand.state.proxy())).norm() - radius) / kVoxel;
}

/// Returns a uniform vector field.
FieldPtr wind(const Vec3& v) {
  return makeVectorField(FieldFrame{1e-3, 1.0, {Vec3::Constant(-1), Vec3::Constant(1)}, 0.0},
                         [v](const Vec3&) {
                           return VectorSample{v, Mat3::Zero(), true};
                         });
}

}  // namespace

TEST_CASE("a motion rotates and translates at a constant rate between two keyframes",
          "[modes][moving]") {
  const Vec3 axis = Vec3(1, 2, 2) / 3.0;
  const auto turn = [&](double angle) {
    return Eigen::Quaterniond(Eigen::AngleAxisd(angle, axis));
  };
  Eigen::Quaterniond other = turn(2.0);
  other.coeffs() *= -3.0;  // the same rotation, as a quaternion that is not of unit length
  const std::vector<Keyframe> keys{keyAt(1.0, {0, 0, 0}, turn(0.5)), keyAt(3.0, {0.2, 0, 0}, other),
                                   keyAt(4.0, {0.2, 0, 0.1}, turn(0.5))};
  const Motion once(keys);
  const auto check = [&](const Pose& pose, double angle, const Vec3& translate) {
    CHECK((pose.linear - turn(angle).toRotationMatrix()).norm() < 1e-14);
    CHECK((pose.translate - translate).norm() < 1e-15);
  };
  check(once.poseAt(-5.0), 0.5, {0, 0, 0});
  check(once.poseAt(1.0), 0.5, {0, 0, 0});
  check(once.poseAt(2.0), 1.25, {0.1, 0, 0});
  check(once.poseAt(3.0), 2.0, {0.2, 0, 0});
  check(once.poseAt(3.5), 1.25, {0.2, 0, 0.05});
  check(once.poseAt(99.0), 0.5, {0.2, 0, 0.1});
  CHECK(once.poseAt(99.0) == once.poseAt(100.0));  // after its end, a motion holds the last pose
                                                   // exactly
  std::vector<Keyframe> closed = keys;
  closed.back().translate.setZero();
  const Motion again(closed, true);
  check(again.poseAt(0.0), 0.5, {0, 0, 0});
  check(again.poseAt(2.0 + 3.0 * 1000), 1.25, {0.1, 0, 0});
  check(Motion(std::vector<Keyframe>{keyAt(7.0, {0, 1, 0})}).poseAt(0.0), 0.0, {0, 1, 0});

  // sweep() returns a box around all positions of the moving box. topSpeed() returns an upper bound
  // of the speed of its points.
  const Box box{{0.1, -0.01, -0.01}, {0.12, 0.01, 0.01}};
  const auto z = [](double angle) {
    return Eigen::Quaterniond(Eigen::AngleAxisd(angle, Vec3::UnitZ()));
  };
  const Motion quarter(
      std::vector<Keyframe>{keyAt(0, {0, 0, 0}, z(0)), keyAt(0.5, {0, 0, 0.5}, z(0.5 * kPi))});
  const Box swept = quarter.sweep(box);
  const double far = std::hypot(0.12, 0.01);
  CHECK(swept.upper.x() == Approx(far).epsilon(0.002));
  CHECK(swept.upper.y() == Approx(far).epsilon(0.002));
  CHECK(swept.lower.x() == Approx(-0.01));
  CHECK(swept.lower.y() == Approx(-0.01));
  CHECK(swept.upper.z() == Approx(0.51));
  CHECK(quarter.topSpeed(box) == Approx(1.0 + kPi * std::hypot(far, 0.01)));
}

TEST_CASE("a motion turns the shorter way for either sign of its quaternions", "[modes][moving]") {
  for (const double angle : {0.3, 1.2, 2.4, 3.1}) {
    const Eigen::Quaterniond to(Eigen::AngleAxisd(angle, Vec3(1, 2, 2) / 3.0));
    for (const double sign : {1.0, -1.0}) {
      CAPTURE(angle, sign);
      const Eigen::Quaterniond written(Eigen::Vector4d(sign * to.coeffs()));
      const Motion motion(
          std::vector<Keyframe>{keyAt(0.0, Vec3::Zero()), keyAt(1.0, Vec3::Zero(), written)});
      const Mat3 half = Eigen::AngleAxisd(0.5 * angle, Vec3(1, 2, 2) / 3.0).toRotationMatrix();
      CHECK((motion.poseAt(0.5).linear - half).norm() < 1e-12);
    }
  }
}

TEST_CASE("invalid keyframes are refused with their JSON path", "[modes][moving]") {
  using Catch::Contains;
  const auto error = [](const std::vector<Keyframe>& keys, bool repeat = false) {
    try {
      const Motion made(keys, repeat, "/k");
    } catch (const SceneError& e) {
      return std::string(e.what());
    }
    return std::string("no error");
  };
  const Eigen::Quaterniond half(Eigen::AngleAxisd(kPi, Vec3::UnitX()));
  const Keyframe a = keyAt(0.0, Vec3::Zero());
  const Keyframe b = keyAt(1.0, Vec3::UnitX());
  Keyframe zero = b;
  zero.rotation_wxyz = {0, 0, 0, 0};
  Keyframe nan = b;
  nan.translate.x() = std::nan("");
  CHECK_THAT(error({}), Contains("/k: there is no keyframe"));
  CHECK_THAT(error({a, b, b}),
             Contains("/k/2/time: the time is not later than that of the keyframe"));
  CHECK_THAT(error({a, keyAt(std::nan(""), Vec3::Zero())}), Contains("/k/1/time"));
  CHECK_THAT(error({a, keyAt(1e300, Vec3::Zero())}), Contains("/k/1/time"));
  CHECK_THAT(error({a, zero}), Contains("/k/1/rotation_wxyz: the quaternion is zero"));
  CHECK_THAT(error({a, nan}), Contains("/k/1/translate"));
  CHECK_THAT(error({a, keyAt(1.0, Vec3::Zero(), half)}), Contains("half turn"));
  CHECK_THAT(error({a}, true), Contains("cannot repeat"));
  CHECK_THAT(error({a, b}, true), Contains("/k/1: a repeated motion must end where it began"));
  CHECK(error({a, b}) == "no error");

  const std::map<std::string, FieldPtr> fields{{"ball", makeSphere(Vec3::Zero(), 0.03)}};
  const auto skin = mode(ModeKind::kIsosurface, "ball", 3.0);
  CHECK_THROWS_WITH(sceneOf({skin}, fields, {{"bal", motion({a, b})}}),
                    Contains("/volumes/bal") && Contains("did you mean \"ball\""));
  CHECK_THROWS_WITH(sceneOf({skin}, fields, {{"ball", nullptr}}), Contains("/volumes/ball"));
}

TEST_CASE("a ball that moves over a resting hand keeps the proxy on its surface",
          "[modes][moving]") {
  // The ball moves at 0.2 m/s. In its orbits, the hand rests 2.56 voxels deep in the ball.
  constexpr double kRadius = 40.0 * kVoxel;
  constexpr double kDeep = 2.56 * kVoxel;
  constexpr double kSpeed = 0.2;
  const std::map<std::string, FieldPtr> fields{{"ball", makeSphere(Vec3::Zero(), kRadius, kVoxel)}};
  const Vec3 still(0.01, -0.02, 0.03);
  const auto orbit = [&](double spin) {
    const double r = kRadius - kDeep;
    const double lap = 2.0 * kPi * r / kSpeed;
    std::vector<Keyframe> keys{keyAt(-0.05, still - Vec3(r + 0.01, 0, 0))};
    constexpr int kSteps = 7200;
    for (int i = 0; i <= kSteps; ++i) {
      const double angle = 20.0 * kPi * i / kSteps;
      const double time = 10.0 * lap * i / kSteps;
      const Eigen::Quaterniond turn(Eigen::AngleAxisd(spin * time, Vec3(1, 1, 1).normalized()));
      keys.push_back(keyAt(time, still - r * Vec3(std::cos(angle), std::sin(angle), 0.0), turn));
    }
    for (Keyframe& key : keys) key.time += 0.05;
    return std::pair(motion(keys), 10.0 * lap + 0.05);
  };
  struct Case {
    const char* name;
    MotionPtr moves;
    double seconds;
  };
  const auto [round, ten_laps] = orbit(0.0);
  const auto [spun, again] = orbit(0.5 * kPi);
  const double deep = 6.0 * kVoxel;
  std::vector<Case> cases{
      {"orbit", round, ten_laps},
      {"orbit and spin", spun, again},
      {"head on", straight(still - Vec3(0, 0, 0.045), still - Vec3(0, 0, kRadius - deep), kSpeed),
       0.2},
      {"tangential",
       straight(still + Vec3(-0.04, 0, kDeep - kRadius), still + Vec3(0.04, 0, kDeep - kRadius),
                kSpeed),
       0.4}};
  for (const double friction : {0.0, 0.3}) {
    for (const Case& c : cases) {
      CAPTURE(c.name, friction);
      const auto scene = sceneOf({mode(ModeKind::kIsosurface, "ball", 5.0, friction)}, fields,
                                 {{"ball", c.moves}});
      Hand hand(*scene);
      double worst = 0.0;
      int held = 0;
      int more = 0;
      const int ticks = static_cast<int>(c.seconds / kDt);
      for (int i = 0; i < ticks; ++i) {
        const StepReport r = hand.at(still);
        REQUIRE(r.status == StepStatus::kConverged);
        more += r.samples > 1 ? 1 : 0;
        if (!(r.wanted.norm() > 1e-9)) continue;
        ++held;
        worst = std::max(worst, std::abs(offSurface(hand, kRadius)));
      }
      CHECK(held > ticks / 5);
      CHECK(more <= 5);       // ticks in which contact begins
      CHECK(worst <= 0.001);  // [voxels]
    }
  }
}

TEST_CASE("friction carries the proxy along with a spinning ball until it slips",
          "[modes][moving]") {
  constexpr double kRadius = 0.03;
  constexpr double kRate = 0.5 * kPi;
  const std::map<std::string, FieldPtr> fields{{"ball", makeSphere(Vec3::Zero(), kRadius, kVoxel)}};
  for (const ModeKind kind : {ModeKind::kIsosurface, ModeKind::kSurface}) {
    for (const double mu : {0.1, 0.3, 0.8}) {
      for (const double rate : {kRate, -kRate}) {
        CAPTURE(mu, rate);
        const auto scene = sceneOf({mode(kind, "ball", 5.0, mu)}, fields,
                                   {{"ball", spinning(Vec3::UnitZ(), rate)}});
        Hand hand(*scene);
        hand.at({kRadius, 0, 0});
        const Vec3 held(kRadius - 2e-3, 0, 0);  // 1 N: 2 mm times 500 N/m
        bool slipped = false;
        int stuck = 0;
        double creep = 0.0;
        StepReport r;
        hand.at(held);
        Vec3 at_rest = hand.state.bodies()[0].pose.toRest(hand.state.proxy());
        for (int i = 0; i < 2000; ++i) {
          r = hand.at(held);
          const Vec3 q = hand.state.primitives().items()[0].direction;
          const double load = r.wanted.dot(q);
          const Vec3 along = r.wanted - load * q;
          const Vec3 now = hand.state.bodies()[0].pose.toRest(hand.state.proxy());
          // While the proxy sticks, the tangential force grows with the ball's rotation. While the
          // proxy slips, the tangential force is mu times the load.
          REQUIRE(along.norm() <= mu * load * (1.0 + 1e-6));
          slipped = slipped || along.norm() > 0.999 * mu * load;
          if (!slipped) {
            ++stuck;
            creep = std::max(creep, (now - at_rest).norm());
          }
        }
        const Vec3 q = hand.state.primitives().items()[0].direction;
        const double load = r.wanted.dot(q);
        const Vec3 along = r.wanted - load * q;
        CHECK(slipped);
        // The surface moves by 0.047 mm per tick. The proxy slips after the surface has moved by mu
        // times 2 mm.
        CHECK(stuck == Approx(mu * 2e-3 / (kRadius * kRate * kDt)).margin(3.0 + 10.0 * mu));
        CHECK(creep <= 1e-9 * kVoxel);
        CHECK(along.norm() == Approx(mu * load).epsilon(1e-6));
        CHECK(along.normalized().dot(Vec3::UnitZ().cross(q)) * std::copysign(1.0, rate) > 0.999);
        if (kind == ModeKind::kIsosurface) CHECK(std::abs(offSurface(hand, kRadius)) < 0.01);
      }
    }
  }
}

TEST_CASE("two bodies with different motions push the hand at the same time or in turn",
          "[modes][moving]") {
  // One ball comes from the left, a spinning ball comes from the front, and a floor is at rest.
  constexpr double kRadius = 0.03;
  const std::map<std::string, FieldPtr> fields{
      {"left", makeSphere(Vec3::Zero(), kRadius, kVoxel)},
      {"front", makeSphere(Vec3::Zero(), kRadius, kVoxel)},
      {"floor", makeHalfSpace(Vec3::Zero(), Vec3::UnitZ(), kVoxel)}};
  const Eigen::Quaterniond turn(Eigen::AngleAxisd(1.0, Vec3::UnitY()));
  const double deep = 1e-3;
  const auto scene = sceneOf(
      {mode(ModeKind::kIsosurface, "left", 5.0), mode(ModeKind::kIsosurface, "front", 5.0),
       mode(ModeKind::kIsosurface, "floor", 5.0)},
      fields,
      {{"left", straight({-0.045, 0, 0}, {deep - kRadius, 0, 0}, 0.2)},
       {"front", motion({keyAt(0.0, {0, -0.05, 0}), keyAt(0.2, {0, deep - kRadius, 0}, turn)})}});
  Hand hand(*scene);
  hand.at({0, 0, 0.01});
  double worst = 0.0;
  StepReport r;
  for (int i = 0; i < 400; ++i) {
    r = hand.at({0, 0, -deep});
    REQUIRE(r.status <= StepStatus::kIterationLimit);
    const Vec3 p = hand.state.proxy();
    if (hand.state.time() < 0.25) continue;  // both balls have stopped
    worst = std::max(worst, std::abs(p.z()) / kVoxel);
    for (std::size_t b : {0U, 1U}) {
      worst = std::max(worst,
                       std::abs(hand.state.bodies()[b].pose.toRest(p).norm() - kRadius) / kVoxel);
    }
  }
  CHECK(worst <= 0.01);
  // Because the balls are round, each pushes the proxy out by 0.98 mm instead of 1 mm.
  CHECK((r.wanted / kStiffness - Vec3(deep, deep, deep)).norm() < 0.05 * deep);

  // The balls pass the hand one after the other.
  const auto passing = sceneOf(
      {mode(ModeKind::kIsosurface, "left", 5.0), mode(ModeKind::kIsosurface, "front", 5.0)}, fields,
      {{"left", straight({-0.1, deep - kRadius, 0}, {0.1, deep - kRadius, 0}, 0.2)},
       {"front", straight({deep - kRadius, 0.2, 0}, {deep - kRadius, -0.1, 0}, 0.2)}});
  Hand other(*passing);
  double by_left = 0.0;
  double by_front = 0.0;
  for (int i = 0; i < 1500; ++i) {
    const StepReport step = other.at(Vec3::Zero());
    double& most = step.wanted.y() > step.wanted.x() ? by_left : by_front;
    most = std::max(most, step.wanted.norm());
  }
  CHECK(by_left == Approx(kStiffness * deep).epsilon(0.01));
  CHECK(by_front == Approx(kStiffness * deep).epsilon(0.01));
  CHECK(other.at(Vec3::Zero()).wanted.norm() < 1e-12);
}

TEST_CASE("a moving volume that passes beside the hand causes no force", "[modes][moving]") {
  constexpr double kRadius = 0.03;
  const std::map<std::string, FieldPtr> fields{{"ball", makeSphere(Vec3::Zero(), kRadius, kVoxel)}};
  for (const double speed : {0.2, 2.0, 20.0}) {
    const auto scene =
        sceneOf({mode(ModeKind::kIsosurface, "ball", 5.0, 0.5)}, fields,
                {{"ball", straight({-0.1, kRadius + 1e-3, 0}, {0.1, kRadius + 1e-3, 0}, speed)}});
    Hand hand(*scene);
    for (int i = 0; i < 0.3 / speed / kDt; ++i) {
      const StepReport r = hand.at(Vec3::Zero());
      REQUIRE(r.wanted.norm() < 1e-12);
      REQUIRE(hand.state.proxy().norm() < 1e-15);
      REQUIRE(r.injected < 1e-15);
    }
  }
}

TEST_CASE("a moving surface does not pass through the proxy, and at 10 m/s ticks report a limit",
          "[modes][moving]") {
  // At 3 m/s the surface moves by 3.84 voxels per tick, which takes eight slices of at most half a
  // voxel.
  constexpr double kRadius = 0.03;
  const std::map<std::string, FieldPtr> fields{{"ball", makeSphere(Vec3::Zero(), kRadius, kVoxel)}};
  const double deep = 2.0 * kVoxel;
  for (const double speed : {0.2, 1.0, 2.0, 3.0, 10.0}) {
    CAPTURE(speed);
    const auto scene = sceneOf({mode(ModeKind::kIsosurface, "ball", 5.0)}, fields,
                               {{"ball", straight({0, 0, -0.1}, {0, 0, deep - kRadius}, speed)}});
    Hand hand(*scene);
    bool limited = false;
    for (int i = 0; i < 1000; ++i) {
      limited = hand.at(Vec3::Zero()).status != StepStatus::kConverged || limited;
      REQUIRE(sideOf(hand.state.memory(0)) == Side::kOutside);
    }
    CHECK(std::abs(offSurface(hand, kRadius)) < 1e-9);
    CHECK(limited == (speed > 3.0));  // the status must report that the tick may have missed a
                                      // surface
  }
}

TEST_CASE("a hand that moves with a fast ball needs one reading in each slice of a tick",
          "[modes][moving]") {
  constexpr double kRadius = 0.03;
  constexpr double kSpeed = 2.0;  // [m/s]; 2.56 voxels per tick
  const std::map<std::string, FieldPtr> fields{{"ball", makeSphere(Vec3::Zero(), kRadius, kVoxel)}};
  const Vec3 touch(0, 0, kRadius - 2.0 * kVoxel);
  for (const Vec3& way : {Vec3(0, 0, 1), Vec3(1, 0, 0), Vec3(0.6, 0, -0.8)}) {
    for (const double friction : {0.0, 0.3}) {
      CAPTURE(way, friction);
      const auto scene = sceneOf({mode(ModeKind::kIsosurface, "ball", 5.0, friction)}, fields,
                                 {{"ball", straight(Vec3::Zero(), 2.0 * way, kSpeed, 0.1)}});
      Hand hand(*scene);
      for (int i = 0; i <= 100; ++i) {
        hand.at(touch + Vec3(0, 0, std::max(0.0, 3.0 - 0.06 * i) * kVoxel));
      }
      StepTrace trace;
      for (int i = 101; i <= 600; ++i) {
        // The ball and the hand have moved by the same distance at the end of each tick.
        const double gone = kSpeed * (kDt * i - 0.1);
        const StepReport r =
            hapticStep(*scene, hand.reader, {touch + gone * way}, hand.state, kDt, &trace);
        const auto slices =
            std::count_if(trace.steps().begin(), trace.steps().end(),
                          [](const StepTrace::Step& step) { return step.foreseen; });
        REQUIRE(slices > 1);
        REQUIRE(r.substeps == slices);
        REQUIRE((r.wanted - kStiffness * 2.0 * kVoxel * Vec3::UnitZ()).norm() < 1e-9);
      }
    }
  }
}

TEST_CASE("a moving viscous medium pulls the hand in the medium's direction of motion",
          "[modes][moving]") {
  const Vec3 way = Vec3(1, -2, 2) / 3.0;
  const std::map<std::string, FieldPtr> fields{{"air", wind(Vec3::UnitZ())}};
  const std::map<std::string, MotionPtr> moving{{"air", straight(Vec3::Zero(), 2.0 * way, 0.1)}};
  SECTION("a held hand feels the full strength of the drag") {
    const auto scene = sceneOf({mode(ModeKind::kViscosity, "air", 0.4)}, fields, moving);
    Hand hand(*scene);
    StepReport r;
    for (int i = 0; i < 300; ++i) {
      r = hand.at(Vec3(0.01, 0, 0));
      // At 0.1 m/s the spring's force grows by 0.05 N per tick.
      const double expected = std::min(0.4, kStiffness * 1e-4 * i);
      REQUIRE((r.wanted - expected * way).norm() < 1e-9);
    }
    CHECK(r.injected < 1e-12);  // in steady motion the drag adds no energy
  }
  SECTION("a held hand in a stream is dragged only perpendicular to the stream") {
    const auto scene = sceneOf({mode(ModeKind::kFollow, "air", 0.4)}, fields, moving);
    Hand hand(*scene);
    StepReport r;
    for (int i = 0; i < 300; ++i) r = hand.at(Vec3(0.01, 0, 0));
    const Vec3 across = Vec3(way.x(), way.y(), 0.0).normalized();
    CHECK((r.wanted - 0.4 * across).norm() < 1e-9);
  }
  SECTION("a released hand moves with the medium, or as fast as the drag can pull the arm") {
    for (const double speed : {0.05, 0.1}) {
      const std::map<std::string, MotionPtr> at{{"air", straight(Vec3::Zero(), 2.0 * way, speed)}};
      const auto scene = sceneOf({mode(ModeKind::kViscosity, "air", 0.3)}, fields, at);
      Hand hand(*scene);
      constexpr double kMass = 0.1;
      constexpr double kViscous = 4.0;
      Vec3 x = Vec3::Zero();
      Vec3 v = Vec3::Zero();
      for (int i = 0; i < 3000; ++i) {
        const Vec3 force = hand.at(x).wanted;
        v += kDt / kMass * (force - kViscous * v);
        x += kDt * v;
      }
      CHECK((v - std::min(speed, 0.3 / kViscous) * way).norm() < 1e-6);
    }
  }
}

TEST_CASE("a scene's time starts with the first tick in that scene and continues through faults",
          "[modes][moving]") {
  const std::map<std::string, FieldPtr> fields{{"ball", makeSphere(Vec3::Zero(), 0.03, kVoxel)}};
  const auto make = [&] {
    return sceneOf({mode(ModeKind::kIsosurface, "ball", 5.0)}, fields,
                   {{"ball", straight({-0.1, 0, 0}, {0.1, 0, 0}, 0.1)}});
  };
  const auto one = make();
  const auto two = make();
  Reader reader;
  ProxyState state(kOpen);
  const auto tick = [&](const Scene& scene, double x, double dt = kDt) {
    return hapticStep(scene, reader, {{x, 0.04, 0}}, state, dt).status;
  };
  const auto at = [&](double time) {
    CHECK(state.time() == Approx(time));
    CHECK(state.bodies()[0].pose.translate.x() == Approx(0.1 * time - 0.1));
  };
  CHECK(tick(*one, 0.0) == StepStatus::kConverged);
  at(0.0);
  for (int i = 0; i < 100; ++i) (void)tick(*one, 0.0);
  at(0.1);
  for (const double dt : {0.0, -1.0, std::nan(""), HUGE_VAL}) (void)tick(*one, 0.0, dt);
  at(0.1);
  (void)tick(*two, 0.0);  // a second scene, built from the same data
  at(0.0);
  for (int i = 0; i < 50; ++i) (void)tick(*two, 0.0);
  at(0.05);
  CHECK(tick(*two, std::nan("")) == StepStatus::kFault);
  for (int i = 0; i < 49; ++i) CHECK(tick(*two, 0.0) == StepStatus::kFault);
  state.clearFault();
  CHECK(tick(*two, 0.0) == StepStatus::kConverged);
  at(0.101);
  CHECK(state.proxy() == Vec3(0, 0.04, 0));
}

}  // namespace palpate::moving_test
