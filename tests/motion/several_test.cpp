/// Tests several primitives and several moving volumes at once, on grids.
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "tests/support/fresh_hand.h"
#include "tests/support/motion_problems.h"
#include "tests/support/random.h"
#include "tests/support/theorem.h"

namespace palpate::several_test {
using namespace palpate::bench;
using palpate::test::Random;

namespace {

constexpr double kPi = std::numbers::pi;
const Vec3 kCentre(52.3, 51.7, 52.45);  // centre of the large spheres [voxels]
constexpr double kRadius = 40.0;

Vec3 axisOf() {
  return Vec3(0.2, -0.5, 0.9).normalized();
}

ModeSpec isosurface(const char* of, double strength, double friction = 0.0) {
  ModeSpec mode;
  mode.kind = ModeKind::kIsosurface;
  mode.of = of;
  mode.solid = Solid::kBelow;
  mode.strength = strength;
  mode.friction = friction;
  return mode;
}

ModeSpec along(ModeKind kind, const char* of, double strength) {
  ModeSpec mode;
  mode.kind = kind;
  mode.of = of;
  mode.strength = strength;
  return mode;
}

std::unique_ptr<const Scene> sceneOf(const std::vector<ModeSpec>& modes,
                                     const std::map<std::string, FieldPtr>& fields,
                                     const std::map<std::string, MotionPtr>& motions = {},
                                     const StepParams& step = {}) {
  GraphSpec spec;
  spec.modes = modes;
  spec.motions = motions;
  return makeScene(spec, fields, {kMotionStiffness, 0.0}, step);
}

/// Returns a flow that rotates about the axis through the spheres' centre. The flow is linear, so
/// trilinear interpolation is exact.
FieldPtr whirl() {
  return vectorGrid(Vec3::Constant(106.0),
                    [](const Vec3& p) { return Vec3(0.02 * axisOf().cross(p - kCentre)); });
}

}  // namespace

TEST_CASE(
    "the proxy stays on a stream and on a surface, within a voxel of the stream with friction",
    "[motion]") {
  const FieldPtr ball = sphereMotion("level set", kRadius, 2.56).field;
  const std::map<std::string, FieldPtr> fields{{"ball", ball}, {"flow", whirl()}};
  Probed probed(std::get<0>(ball));
  const Vec3 n = axisOf();
  const Vec3 u = n.cross(Vec3(1, 0.37, -0.21)).normalized();
  const Vec3 w = n.cross(u);
  const auto laps = static_cast<double>(test::share(10));
  for (const double friction : {0.0, 0.3}) {
    for (const bool drag : {false, true}) {
      std::vector<ModeSpec> modes{isosurface("ball", 6.0, friction),
                                  along(ModeKind::kFollow, "flow", 0.6)};
      if (drag) modes.push_back(along(ModeKind::kViscosity, "ball", 0.2));
      const auto scene = sceneOf(modes, fields);
      Reader reader;
      ProxyState state({1e3, 1e12});
      // At a latitude of 30 degrees and a depth of 2.56 voxels, the load exceeds the line's
      // strength, and the ball bears the rest.
      const double latitude = kPi / 6.0;
      const auto at = [&](double angle, double radius, double aside) {
        const Vec3 out = std::cos(angle) * u + std::sin(angle) * w;
        const Vec3 up = std::cos(latitude) * n - std::sin(latitude) * out;
        return Vec3(kCentre + radius * (std::cos(latitude) * out + std::sin(latitude) * n) +
                    aside * up);
      };
      // The hand starts on the ball. If the hand came from outside, the line would hold the proxy
      // above the ball.
      for (int i = 0; i <= 200; ++i) {
        (void)provenStep(*scene, reader, {kVoxel * at(0, kRadius - 0.0128 * i, 0)}, state,
                         kMotionTick);
      }
      const Vec3 first = state.proxy() / kVoxel - kCentre;
      const double height = n.dot(first);
      const double ring = (first - height * n).norm();
      const double step = voxelsPerTick(0.5) / (kRadius * std::cos(latitude));
      double off = 0.0;
      double off_late = 0.0;
      double aside = 0.0;
      double reads = 0.0;
      long late = 0;
      const int ticks = static_cast<int>(laps * 2.0 * kPi / step);
      for (int i = 1; i <= ticks; ++i) {
        const StepReport r = provenStep(
            *scene, reader, {kVoxel * at(i * step, kRadius - 2.56, 0.0)}, state, kMotionTick);
        const Vec3 p = r.proxy / kVoxel;
        reads += r.samples + r.traced;
        late += r.status == StepStatus::kConverged ? 0 : 1;
        double& worst = r.status == StepStatus::kConverged ? off : off_late;
        worst = std::max(worst, std::abs(probed.off(p, 0.0)));
        const Vec3 d = p - kCentre;
        aside = std::max(aside, std::hypot(n.dot(d) - height, (d - n.dot(d) * n).norm() - ring));
      }
      CAPTURE(friction, drag, off, off_late, aside, reads / ticks, late);
      // Line and plane share the load along the normal, and the plane's share determines the
      // friction. In some ticks, readings alternate between sticking and slipping.
      CHECK(late <= (friction > 0.0 ? ticks / 4 : 1 + ticks / 500));
      CHECK(off <= 0.002);
      // Ticks that did not converge may be farther off.
      CHECK(off_late <= 0.015);
      // The stream's circle is on the exact sphere, up to 6.3e-3 voxel from the interpolated
      // sphere. If the interpolated sphere pushes the proxy off the stream's line, the line yields.
      // A line that yields cannot resist a sideways pull. With friction, the hand is ahead of the
      // proxy and pulls it sideways.
      CHECK(aside <= (friction > 0.0 ? 1.0 : 0.05));
      // With friction, a new search for the nearest position on the curve follows each reading.
      CHECK(reads / ticks <= (friction > 0.0 ? 27.0 : 25.0));
    }
  }
}

TEST_CASE("where two surfaces meet the proxy stays on both", "[motion]") {
  // An oblique plane cuts a ball. The hand moves along their intersection.
  const FieldPtr ball = sphereMotion("level set", kRadius, 2.56).field;
  const Vec3 n = axisOf();
  const FieldPtr floor = scalarGrid(
      106, [&](const Vec3& p) { return std::clamp(n.dot(p - kCentre) - 10.0, -3.0, 3.0); });
  Probed on_ball(std::get<0>(ball));
  Probed on_floor(std::get<0>(floor));
  const Vec3 u = n.cross(Vec3(1, 0.37, -0.21)).normalized();
  const Vec3 w = n.cross(u);
  const double ring = std::sqrt(kRadius * kRadius - 100.0);
  for (const double friction : {0.0, 0.2}) {
    const auto scene =
        sceneOf({isosurface("ball", 6.0, friction), isosurface("floor", 6.0, friction)},
                {{"ball", ball}, {"floor", floor}});
    Reader reader;
    ProxyState state({1e3, 1e12});
    const auto at = [&](double angle, double out, double up) {
      return Vec3(kCentre + (ring + out) * (std::cos(angle) * u + std::sin(angle) * w) +
                  (10.0 + up) * n);
    };
    for (int i = 0; i <= 200; ++i) {
      (void)provenStep(*scene, reader, {kVoxel * at(0, 3.0 - 0.02 * i, 2.0 - 0.02 * i)}, state,
                       kMotionTick);
    }
    const double step = voxelsPerTick(0.5) / ring;
    double off = 0.0;
    double samples = 0.0;
    long late = 0;
    constexpr int kTicks = 2000;
    for (int i = 1; i <= kTicks; ++i) {
      const StepReport r =
          provenStep(*scene, reader, {kVoxel * at(i * step, -1.0, -2.0)}, state, kMotionTick);
      const Vec3 p = r.proxy / kVoxel;
      samples += r.samples;
      late += r.status == StepStatus::kConverged ? 0 : 1;
      off = std::max({off, std::abs(on_ball.off(p, 0.0)), std::abs(on_floor.off(p, 0.0))});
    }
    CAPTURE(friction, off, samples / kTicks, late);
    CHECK(off <= 0.01);
    CHECK(samples / kTicks <= 2.0 * 2.0);  // two volumes
    CHECK(late == 0);
  }
}

TEST_CASE("slip begins at mu times the normal load of the same tick for 1,000 directions",
          "[motion]") {
  // The requirement is a relative error of 1e-9 against the engine's own normal, for one plane. The
  // test also prints the error against the exact normal.
  for (const char* kind : {"level set", "fog 6"}) {
    const SurfaceMotion motion = sphereMotion(kind, kRadius, 2.56);
    GraphSpec spec;
    spec.modes = {isosurface("ball", 8.0, 0.4)};
    spec.modes[0].value = motion.level;
    spec.modes[0].solid = motion.solid;
    const auto scene = makeScene(spec, {{"ball", motion.field}}, {kMotionStiffness, 0.0});
    test::FreshHand fresh({1e3, 1e12});
    Reader& reader = fresh.reader;
    ProxyState& state = fresh.state;
    Random random(3);
    double worst = 0.0;
    double against_true = 0.0;
    long slips = 0;
    for (long i = 0; i < test::cases(1000); ++i) {
      const Vec3 d = random.direction();
      const Vec3 t = d.cross(random.direction()).normalized();
      fresh.restart();
      StepReport r;
      for (int k = 0; k <= 60; ++k) {
        r = provenStep(*scene, reader, {kVoxel * (kCentre + (kRadius + 1.0 - 0.05 * k) * d)}, state,
                       kMotionTick);
      }
      Vec3 hand = kCentre + (kRadius - 2.0) * d;
      bool slipped = false;
      for (int k = 0; k < 60; ++k) {
        const Vec3 before = r.proxy;
        hand += 0.04 * t;
        r = provenStep(*scene, reader, {kVoxel * hand}, state, kMotionTick);
        REQUIRE(state.primitives().links().size() == 1);
        const FrictionLink link = state.primitives().links()[0];
        const double load = state.forces()[link.plane].norm();
        const double held = state.forces()[link.line].norm();
        REQUIRE(held <= 0.4 * load * (1.0 + 1e-9));
        if ((r.proxy - before).norm() < 1e-4 * kVoxel) continue;
        slipped = true;
        worst = std::max(worst, std::abs(held / (0.4 * load) - 1.0));
        const Vec3 normal = (r.proxy / kVoxel - kCentre).normalized();
        const Vec3 force = r.wanted;
        const double into = normal.dot(force);
        against_true =
            std::max(against_true, std::abs((force - into * normal).norm() / (0.4 * into) - 1.0));
      }
      slips += slipped ? 1 : 0;
    }
    CAPTURE(kind, worst, against_true, slips);
    CHECK(slips == test::cases(1000));
    CHECK(worst <= 1e-9);
    WARN(kind << ": error of the friction with the true normal: at most " << 100.0 * against_true
              << " %");
  }
}

TEST_CASE("a moving ball from a grid keeps the proxy on its surface: sliding, spinning, head-on",
          "[motion]") {
  // The requirement is 0.01 voxel at 0.2 m/s.
  const FieldPtr ball = sphereMotion("level set", kRadius, 2.56).field;
  Probed probed(std::get<0>(ball));
  const Vec3 still = kVoxel * Vec3(10, -20, 30);
  const double speed = 0.2;
  const auto key = [](double time, const Vec3& centre, const Eigen::Quaterniond& turn) {
    // A motion turns about W's origin, so its rotation also moves the ball's centre.
    return Keyframe{
        time, {turn.w(), turn.x(), turn.y(), turn.z()}, centre - turn * (kVoxel * kCentre)};
  };
  const auto orbit = [&](double spin) {
    const double r = kVoxel * (kRadius - 2.56);
    const double lap = 2.0 * kPi * r / speed;
    const Eigen::Quaterniond none = Eigen::Quaterniond::Identity();
    std::vector<Keyframe> keys{key(0.0, still - Vec3(r + 0.01, 0, 0), none)};
    constexpr int kSteps = 3600;
    for (int i = 0; i <= kSteps; ++i) {
      const double a = 10.0 * kPi * i / kSteps;
      const double time = 5.0 * lap * i / kSteps;
      const Eigen::Quaterniond turn(Eigen::AngleAxisd(spin * time, Vec3(1, 1, 1).normalized()));
      keys.push_back(key(0.05 + time, still - r * Vec3(std::cos(a), std::sin(a), 0.0), turn));
    }
    return std::pair(std::make_shared<const Motion>(keys), 5.0 * lap + 0.05);
  };
  const auto headOn = [&] {
    const Vec3 from = still - Vec3(kVoxel * (kRadius + 10.0), 0, 0);
    const Vec3 to = still - Vec3(kVoxel * (kRadius - 6.0), 0, 0);
    const double time = (to - from).norm() / speed;
    const Eigen::Quaterniond none = Eigen::Quaterniond::Identity();
    return std::pair(std::make_shared<const Motion>(
                         std::vector<Keyframe>{key(0, from, none), key(time, to, none)}),
                     time);
  };
  struct Case {
    const char* name;
    std::pair<MotionPtr, double> moves;
  };
  for (const auto& [name, moves] :
       {Case{"orbit", orbit(0.0)}, Case{"spin", orbit(0.5 * kPi)}, Case{"head on", headOn()}}) {
    for (const double friction : {0.0, 0.3}) {
      const auto scene =
          sceneOf({isosurface("ball", 8.0, friction)}, {{"ball", ball}}, {{"ball", moves.first}});
      Reader reader;
      ProxyState state({1e3, 1e12});
      double off = 0.0;
      double samples = 0.0;
      int held = 0;
      const int ticks = static_cast<int>(moves.second / kMotionTick);
      for (int i = 0; i < ticks; ++i) {
        const StepReport r = provenStep(*scene, reader, {still}, state, kMotionTick);
        REQUIRE(r.status == StepStatus::kConverged);
        samples += r.samples;
        if (!(r.wanted.norm() > 1e-9)) continue;
        ++held;
        off = std::max(off,
                       std::abs(probed.off(state.bodies()[0].pose.toRest(r.proxy) / kVoxel, 0.0)));
      }
      CAPTURE(name, friction, off, samples / ticks);
      CHECK(held > ticks / 5);
      CHECK(off <= (friction > 0.0 ? 0.01 : 2e-3));
      CHECK(samples / ticks <= 1.1);
    }
  }
}

namespace {

/// A groove between two walls that meet in an edge, open towards `out`.
struct Groove {
  Vec3 out, across, along, bottom{32.0, 32.0, 32.0};
  double sine, cosine;
  Groove(Random& random, double degrees)
      : out(random.direction()),
        across(out.cross(random.direction()).normalized()),
        along(out.cross(across)),
        sine(std::sin(0.5 * degrees * kPi / 180.0)),
        cosine(std::cos(0.5 * degrees * kPi / 180.0)) {}
  /// Returns the height above the nearer wall [voxels]; positive inside the groove.
  [[nodiscard]] double height(const Vec3& p) const {
    const Vec3 q = p - bottom;
    return std::min((sine * out + cosine * across).dot(q), (sine * out - cosine * across).dot(q));
  }
  [[nodiscard]] FieldPtr field() const {
    return scalarGrid(65, [this](const Vec3& p) { return std::clamp(height(p), -3.0, 3.0); });
  }
};

}  // namespace

TEST_CASE("the proxy enters the walls of a groove that moves with the hand by at most half a voxel",
          "[motion]") {
  // A move along one wall's plane would lead behind the other wall, so the proxy cannot move
  // relative to the groove. So the proxy must move with the groove and not stay at rest in W.
  const long runs = test::share(3);
  for (const double degrees : {30.0, 60.0, 90.0}) {
    for (const double speed : {0.0, 0.35, 1.5, 3.5}) {  // voxels per tick
      double deepest = 0.0;
      long held = 0;
      Random random(3);
      for (int run = 0; run < runs; ++run) {
        const Groove groove(random, degrees);
        const double phase = random.uniform(0.0, 2.0 * kPi);
        const Vec3 pace = speed * kVoxel * random.direction();  // [m per tick]
        constexpr int kTicks = 2000;
        const double time = kTicks * kMotionTick;
        std::map<std::string, MotionPtr> motions;
        if (speed > 0.0) {
          motions["it"] = std::make_shared<const Motion>(std::vector<Keyframe>{
              {0.0, {1, 0, 0, 0}, Vec3::Zero()}, {time, {1, 0, 0, 0}, kTicks * pace}});
        }
        const auto scene = sceneOf({isosurface("it", 40.0)}, {{"it", groove.field()}}, motions);
        Reader reader;
        ProxyState state({1e3, 1e12});
        for (int i = 0; i < kTicks; ++i) {
          const double t = kMotionTick * i;
          const double in = 2.0 + 6.0 * std::pow(std::sin(3.1 * t + phase), 2.0);
          const Vec3 hand =
              groove.bottom + (i < 200 ? 8.0 - 0.05 * i * (1.0 + in / 10.0) : -in) * groove.out +
              std::min(1.0, t / 0.2) * 4.0 * std::sin(7.0 * t + phase) * groove.across +
              6.0 * std::sin(2.3 * t) * groove.along;
          const Vec3 moved = i * pace;
          const StepReport r =
              provenStep(*scene, reader, {kVoxel * hand + moved}, state, kMotionTick);
          deepest = std::min(deepest, groove.height((r.proxy - moved) / kVoxel));
          held += r.wanted.norm() > 1.0 ? 1 : 0;
        }
      }
      CAPTURE(degrees, speed, deepest, held);
      CHECK(deepest > -0.5);
      CHECK(3 * held > 2 * 2000 * runs);  // at least two thirds of the ticks
    }
  }
}

TEST_CASE("a moving slab pushes the proxy through a weaker groove but not through a stronger one",
          "[motion][release]") {
  const long runs = std::max(test::share(4), 2L);
  for (const double degrees : {40.0, 90.0, 180.0}) {
    for (const double pace : {0.05, 0.3, 0.6, 1.2}) {  // voxels per tick
      for (const bool stronger : {true, false}) {
        Random random(11);
        for (int run = 0; run < runs; ++run) {
          const Groove groove(random, degrees);
          const Vec3 normal = (0.5 * random.direction() - groove.out).normalized();
          const auto height = [&](const Vec3& p) { return normal.dot(p - groove.bottom) + 14.0; };
          const FieldPtr slab = scalarGrid(
              65, [&](const Vec3& p) { return std::clamp(std::abs(height(p)) - 2.0, -3.0, 3.0); });
          constexpr double kWay = 26.0;
          const double end = 0.05 + kWay / pace * kMotionTick;
          const auto motion = std::make_shared<const Motion>(
              std::vector<Keyframe>{{0.0, {1, 0, 0, 0}, Vec3::Zero()},
                                    {0.05, {1, 0, 0, 0}, Vec3::Zero()},
                                    {end, {1, 0, 0, 0}, kWay * kVoxel * normal}});
          const auto scene =
              sceneOf({isosurface("groove", stronger ? 2.0 : 20.0),
                       isosurface("slab", stronger ? 20.0 : 2.0)},
                      {{"groove", groove.field()}, {"slab", slab}}, {{"slab", motion}});
          const Vec3 hand = groove.bottom + 3.0 * groove.out;
          Reader reader;
          ProxyState state({1e3, 1e12});
          double deepest = 0.0;
          for (int i = 0; i < static_cast<int>(end / kMotionTick) + 300; ++i) {
            const double in = run % 2 == 1 ? std::min(6.0, 0.1 * i) : 0.0;
            const Vec3 probe = kVoxel * (hand - in * groove.out);
            const StepReport r = provenStep(*scene, reader, {probe}, state, kMotionTick);
            deepest = std::min(deepest, groove.height(r.proxy / kVoxel));
          }
          const Vec3 seen = state.bodies()[0].pose.toRest(state.proxy()) / kVoxel;
          CAPTURE(degrees, pace, stronger, run, height(seen), deepest);
          if (stronger) {
            CHECK(height(seen) > 0.0);
          } else {
            CHECK(deepest > -1.0);
          }
        }
      }
    }
  }
}

TEST_CASE(
    "with one sub-step a tick the proxy moves at most two voxels, and the rest of the path waits",
    "[motion]") {
  StepParams step;
  step.max_substeps = 1;
  const SurfaceMotion motion = sphereMotion("level set", 40, 2.56);
  const auto scene = sceneOf({isosurface("ball", 8.0)}, {{"ball", motion.field}}, {}, step);
  Reader reader;
  ProxyState state({1e3, 1e12});
  Probed probed(std::get<0>(motion.field));
  for (int i = 0; i <= 200; ++i) {
    const Vec3 hand = motion.outside + i / 200.0 * (motion.hand(0.0) - motion.outside);
    (void)provenStep(*scene, reader, {kVoxel * hand}, state, kMotionTick);
  }
  // The hand moves by four voxels per tick. With one reading per tick, the proxy can move by two
  // voxels: one before the reading and one after the reading.
  Vec3 before = state.proxy();
  long late = 0;
  for (int i = 1; i <= 5; ++i) {
    const StepReport r =
        provenStep(*scene, reader, {kVoxel * motion.hand(4.0 * i)}, state, kMotionTick);
    CHECK((r.proxy - before).norm() <= 2.0 * kVoxel * (1.0 + 1e-9));
    late += r.status == StepStatus::kSubstepLimit ? 1 : 0;
    before = r.proxy;
  }
  CHECK(late == 5);
  StepReport r;
  for (int i = 0; i < 30; ++i) {
    r = provenStep(*scene, reader, {kVoxel * motion.hand(20.0)}, state, kMotionTick);
  }
  CHECK(r.status == StepStatus::kConverged);
  CHECK(std::abs(probed.off(r.proxy / kVoxel, 0.0)) < 1e-3);
}

TEST_CASE(
    "a tick that has used up its solver iterations stops reading, and the rest of its path waits",
    "[motion][budget]") {
  const SurfaceMotion motion = sphereMotion("level set", 40, 2.56);
  ModeSpec ball = isosurface("ball", 8.0);
  ball.friction = 0.2;
  ModeSpec drag;
  drag.kind = ModeKind::kViscosity;
  drag.of = "ball";
  drag.strength = 0.2;
  ModeSpec guide;
  guide.kind = ModeKind::kGuide;
  guide.guide.position = 2.0 * kVoxel * motion.outside;
  guide.strength = 0.01;
  const auto readingsWith = [&](int most) {
    StepParams step;
    step.max_iterations = most;
    const auto scene = sceneOf({ball, drag, guide}, {{"ball", motion.field}}, {}, step);
    Reader reader;
    ProxyState state({1e3, 1e12});
    Probed probed(std::get<0>(motion.field));
    for (int i = 0; i <= 200; ++i) {
      const Vec3 hand = motion.outside + i / 200.0 * (motion.hand(0.0) - motion.outside);
      (void)provenStep(*scene, reader, {kVoxel * hand}, state, kMotionTick);
    }
    int readings = 0;
    for (int i = 1; i <= 5; ++i) {
      const StepReport r =
          provenStep(*scene, reader, {kVoxel * motion.hand(4.0 * i)}, state, kMotionTick);
      CHECK(r.iterations <= most + 2 * SolverParams{}.max_iterations);
      CHECK((r.status == StepStatus::kSubstepLimit) == (most == 1));
      readings += r.substeps;
    }
    StepReport r;
    for (int i = 0; i < 60; ++i) {
      r = provenStep(*scene, reader, {kVoxel * motion.hand(20.0)}, state, kMotionTick);
    }
    CHECK(r.status == StepStatus::kConverged);
    CHECK(std::abs(probed.off(r.proxy / kVoxel, 0.0)) < 1e-2);
    return readings;
  };
  CHECK(readingsWith(1) <= 10);
  CHECK(readingsWith(StepParams{}.max_iterations) >= 20);
}

}  // namespace palpate::several_test
