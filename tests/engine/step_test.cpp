#include "palpate/engine/tick/step.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <mutex>

#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "palpate/samplers/grid/analytic_field.h"
#include "tests/support/counters.h"
#include "tests/support/formula_fields.h"
#include "tests/support/random.h"

namespace palpate::step_test {
using palpate::test::Random;

namespace {

constexpr double kDt = 1e-3;
constexpr double kRadius = 0.05;
const ForceLimits kOpen{100.0, 1e9};

ModeSpec mode(ModeKind kind, const std::string& of, TransferFunction strength) {
  ModeSpec spec;
  spec.kind = kind;
  spec.of = of;
  spec.strength = std::move(strength);
  spec.solid = Solid::kBelow;  // a distance field: solid inside
  return spec;
}

/// A scene with one field and its modes, and a hand.
struct Bench {
  std::unique_ptr<const Scene> scene;
  Reader reader;
  ProxyState state{kOpen};

  Bench(const FieldPtr& field, std::vector<ModeSpec> modes, const CouplingParams& coupling = {}) {
    GraphSpec spec;
    spec.modes = std::move(modes);
    scene = makeScene(spec, {{"it", field}}, coupling);
  }
  StepReport step(const Vec3& hand, double dt = kDt) {
    return hapticStep(*scene, reader, {hand}, state, dt);
  }
  /// Moves the hand along a line, by at most `step_length` [m] per tick.
  StepReport go(const Vec3& from, const Vec3& to, double step_length = 2e-4) {
    const int n = std::max(1, static_cast<int>(std::ceil((to - from).norm() / step_length)));
    StepReport last;
    for (int i = 0; i <= n; ++i) last = step(from + (to - from) * (static_cast<double>(i) / n));
    return last;
  }
};

Bench sphere(double strength) {
  return {makeSphere(Vec3::Zero(), kRadius), {mode(ModeKind::kIsosurface, "it", strength)}};
}

}  // namespace

TEST_CASE(
    "a sphere pressed along 1,000 directions gives the radial force k times depth, to rounding",
    "[step][fig6]") {
  Random random(1);
  double worst = 0.0;
  const long directions = test::cases(1000);
  for (long i = 0; i < directions; ++i) {
    Bench bench = sphere(5.0);
    const Vec3 d = random.direction();
    const double depth = random.uniform(1e-4, 8e-3);
    bench.go(1.02 * kRadius * d, (kRadius - depth) * d);
    const StepReport r = bench.step((kRadius - depth) * d);
    worst = std::max(worst, (r.force - 500.0 * depth * d).norm() / (500.0 * depth));
    REQUIRE(r.status == StepStatus::kConverged);
  }
  WARN("largest relative error of the force: " << worst);
  CHECK(worst < 1e-11);
}

TEST_CASE("a surface pushed harder than its strength releases the proxy at s/k", "[step][fig6]") {
  Random random(2);
  for (int i = 0; i < 50; ++i) {
    const double s = random.uniform(0.5, 3.0);
    Bench bench = sphere(s);
    const Vec3 d = random.direction();
    bench.go(1.02 * kRadius * d, kRadius * d);
    double leaves = -1.0;
    for (double depth = 0.0; depth < s / 500.0 + 2e-3; depth += 1e-5) {
      const StepReport r = bench.step((kRadius - depth) * d);
      const double height = r.proxy.norm() - kRadius;
      if (depth < s / 500.0 - 1e-9) {
        REQUIRE(std::abs(height) < 1e-12);
      }
      REQUIRE(r.force.norm() <= s * (1 + 1e-9));
      if (leaves < 0.0 && height < -1e-9) leaves = depth;
      // Skips ticks at the limit of 0.05 voxel (0.05 mm) behind the surface, where rounding decides
      // whether the contact has yielded.
      if (std::abs(height + 0.05e-3) > 0.5e-5) {
        const bool yielded = sideOf(bench.state.memory(0)) == Side::kYielded;
        REQUIRE(yielded == (height < -0.05e-3));
      }
    }
    CHECK(leaves == Approx(s / 500.0).margin(1.1e-5));
  }
}

TEST_CASE("a surface that has yielded pulls until the proxy is three voxels deep", "[step][fig6]") {
  Bench bench = sphere(1.0);
  const Vec3 d = Vec3::UnitZ();
  bench.go(1.1 * kRadius * d, kRadius * d);
  // The proxy's depth is the hand's depth minus s/k = 2 mm. Voxels are 1 mm.
  StepReport r = bench.go(kRadius * d, (kRadius - 4.9e-3) * d, 1e-5);
  CHECK(r.force.norm() == Approx(1.0).epsilon(1e-6));
  // Between hand depths of 4.9 mm and 5.1 mm, the proxy reaches a depth of three voxels, and the
  // surface releases it.
  r = bench.go((kRadius - 4.9e-3) * d, (kRadius - 5.1e-3) * d, 1e-5);
  CHECK(r.force.norm() < 1e-12);
  r = bench.go((kRadius - 5.1e-3) * d, (kRadius - 10e-3) * d, 1e-5);
  CHECK(r.force.norm() < 1e-12);
  // Inside the solid, the proxy moves freely and can leave the solid.
  r = bench.go((kRadius - 10e-3) * d, (kRadius - 0.1e-3) * d, 1e-5);
  CHECK(r.force.norm() < 1e-12);
  double most = 0.0;
  for (double z = kRadius; z < 1.05 * kRadius; z += 1e-5) {
    most = std::max(most, bench.step(z * d).force.norm());
  }
  CHECK(most < 1e-9);
  // After the proxy has left, the surface holds again.
  r = bench.go(1.05 * kRadius * d, (kRadius - 1e-3) * d);
  CHECK(r.force.norm() == Approx(0.5).epsilon(1e-6));
}

TEST_CASE("a hand that starts inside a solid is not pushed out", "[step][safety]") {
  Bench bench = sphere(3.0);
  const StepReport r = bench.go({0, 0, 0.9 * kRadius}, {0, 0, 0.99 * kRadius});
  CHECK(r.force.norm() == 0.0);
}

TEST_CASE("the force on a released hand goes to zero", "[step][passivity]") {
  const ModeKind kind = GENERATE(ModeKind::kViscosity, ModeKind::kSurface, ModeKind::kIsosurface);
  Bench bench{makeSphere(Vec3::Zero(), kRadius), {mode(kind, "it", 1.0)}, {500.0, 0.0}};
  StepReport r = bench.go({0, 0, 1.02 * kRadius}, {0, 0, kRadius - 1.5e-3});
  REQUIRE(r.force.norm() > 0.4);
  // A released arm moves slowly with the force.
  Vec3 hand(0, 0, kRadius - 1.5e-3);
  for (int i = 0; i < 4000; ++i) {
    r = bench.step(hand);
    hand += 2e-5 * r.force;
  }
  CHECK(r.force.norm() < 1e-6);
}

TEST_CASE("anchored modes add less than 1e-12 J per tick of a slow hand", "[step][passivity]") {
  Random random(4);
  const FieldPtr flow = makeVortex(Vec3::Zero(), {1, 2, 3}, 0.2, 1.0);
  const FieldPtr ball = makeSphere(Vec3::Zero(), kRadius);
  GraphSpec spec;
  spec.modes = {mode(ModeKind::kSurface, "ball", 1.0), mode(ModeKind::kViscosity, "ball", 0.5),
                mode(ModeKind::kFollow, "flow", TransferFunction::window(0.2, 0.4, 2.0))};
  const auto scene = makeScene(spec, {{"ball", ball}, {"flow", flow}});
  Reader reader;
  ProxyState state(kOpen);
  Vec3 hand(kRadius, 0, 0);
  double most = 0.0;
  long held = 0;
  const long ticks = test::cases(20000);
  for (long i = 0; i < ticks; ++i) {
    hand += 4e-4 * random.inCube(1.0) - 1e-3 * (hand - Vec3(kRadius, 0, 0));
    const StepReport r = hapticStep(*scene, reader, {hand}, state, kDt);
    most = std::max(most, r.injected);
    held += r.wanted.norm() > 0.0 ? 1 : 0;
  }
  CAPTURE(ticks, held, most);  // Catch prints these with -s
  CHECK(held > ticks / 2);
  CHECK(most < 1e-12);
}

TEST_CASE(
    "a tick that reuses the last reading and primitives computes the same as one that does not",
    "[step]") {
  // A traced tick uses neither the last tick's reading nor its primitives.
  const FieldPtr a = makeSphere(Vec3::Zero(), kRadius);
  const FieldPtr b = makeSphere({kRadius, 0, 0}, kRadius);
  GraphSpec spec;
  spec.modes = {mode(ModeKind::kIsosurface, "a", 0.5), mode(ModeKind::kIsosurface, "b", 2.0),
                mode(ModeKind::kViscosity, "a", 0.1)};
  spec.modes[0].viscosity = 0.2;
  const Vec3 crease(0.5 * kRadius, 0, std::sqrt(0.75) * kRadius);
  for (const double friction : {0.0, 0.3}) {
    spec.modes[0].friction = friction;
    const auto scene = makeScene(spec, {{"a", a}, {"b", b}});
    Reader reader;
    ProxyState plain(kOpen);
    ProxyState traced(kOpen);
    StepTrace trace;
    Random random(6);
    Vec3 hand = 1.1 * crease;
    std::array<long, 3> ticks{};  // with 1, 2, and 3 or more primitives
    for (long i = 0; i < 5000; ++i) {
      // The hand rests in some ticks, so that readings stay valid.
      if (i % 7 < 4) hand += 8e-4 * random.inCube(1.0) - 0.02 * (hand - crease);
      const StepReport one = hapticStep(*scene, reader, {hand}, plain, kDt);
      const StepReport other = hapticStep(*scene, reader, {hand}, traced, kDt, &trace);
      CAPTURE(friction, i);
      REQUIRE(one.proxy == other.proxy);
      REQUIRE(one.force == other.force);
      REQUIRE(one.primitives == other.primitives);
      REQUIRE(one.status == other.status);
      REQUIRE(one.primitives > 0);
      ++ticks.at(static_cast<std::size_t>(std::min(one.primitives, 3) - 1));
    }
    CAPTURE(ticks[0], ticks[1], ticks[2]);
    for (const long n : ticks) CHECK(n > 50);
  }
}

TEST_CASE("in free space the force is exactly zero despite damping", "[step]") {
  Bench bench{
      makeSphere(Vec3::Zero(), kRadius), {mode(ModeKind::kIsosurface, "it", 3.0)}, {500.0, 5.0}};
  Random random(5);
  for (int i = 0; i < 200; ++i) {
    const StepReport r = bench.step(Vec3(0, 0, 0.07) + random.inCube(2e-3));
    REQUIRE(r.force == Vec3::Zero());
  }
}

TEST_CASE("damping acts on the rate at which the spring's length changes", "[step][eq3]") {
  Bench bench{
      makeSphere(Vec3::Zero(), kRadius), {mode(ModeKind::kIsosurface, "it", 9.0)}, {500.0, 2.0}};
  bench.go({0, 0, 1.02 * kRadius}, {0, 0, kRadius - 1e-3});
  for (int i = 0; i < 3; ++i) bench.step({0, 0, kRadius - 1e-3});
  const StepReport r = bench.step({0, 0, kRadius - 1.1e-3});
  CHECK(r.force.z() == Approx(500.0 * 1.1e-3 + 2.0 * 1e-4 / kRateTime));
}

TEST_CASE("viscosity drags with a constant force", "[step][eq9]") {
  Bench bench{makeHalfSpace({0, 0, 1}, {0, 0, 1}), {mode(ModeKind::kViscosity, "it", 0.7)}};
  const StepReport r = bench.go(Vec3::Zero(), {0.05, 0, 0});
  CHECK((r.force - Vec3(-0.7, 0, 0)).norm() < 1e-9);
}

TEST_CASE("mode follow lets the hand slide along the flow and holds it against sideways motion",
          "[step][eq11]") {
  Bench bench{makeVortex(Vec3::Zero(), {0, 0, 1e-6}, 1.0, 1.0),
              {mode(ModeKind::kFollow, "it", 2.0)}};
  StepReport r = bench.go({0.01, 0, 0}, {0.01, 0, 0.05});
  CHECK(r.force.norm() < 1e-6);
  r = bench.go({0.01, 0, 0.05}, {0.013, 0, 0.05});
  CHECK((r.force - Vec3(-1.5, 0, 0)).norm() < 1e-5);
}

TEST_CASE("mode force pulls along a vector or down a gradient", "[step][eq8]") {
  Bench along{makeVortex(Vec3::Zero(), {0, 0, 1e-6}, 1.0, 1.0),
              {mode(ModeKind::kForce, "it", 2.0)}};
  CHECK((along.go({0.01, 0, 0}, {0.01, 0, 0.001}).force - Vec3(0, 0, 2)).norm() < 1e-6);
  Bench down{makeHalfSpace(Vec3::Zero(), {0, 1, 0}), {mode(ModeKind::kForce, "it", 2.0)}};
  CHECK((down.go({0, 0, 0}, {0, 0, 0.001}).force - Vec3(0, -2, 0)).norm() < 1e-12);
  ModeSpec attract = mode(ModeKind::kForce, "it", 2.0);
  attract.sense = Sense::kAttract;
  Bench up{makeHalfSpace(Vec3::Zero(), {0, 1, 0}), {attract}};
  CHECK((up.go({0, 0, 0}, {0, 0, 0.001}).force - Vec3(0, 2, 0)).norm() < 1e-12);
}

TEST_CASE("a hand at 2 m/s does not pass through the surface of a sphere", "[step]") {
  Random random(6);
  for (int i = 0; i < 200; ++i) {
    Bench bench = sphere(50.0);
    const Vec3 d = random.direction();
    // At 2 m/s the hand moves by two voxels per tick, to a depth of 5 mm. The start is random.
    const double phase = random.uniform(0, 2e-3);
    StepReport r;
    for (double z = kRadius + 0.02 + phase; z > kRadius - 5e-3; z -= 2e-3) r = bench.step(z * d);
    CHECK(std::abs(r.proxy.norm() - kRadius) < 1e-9);
  }
}

TEST_CASE("at the limit of sub-steps the rest of the path waits and the status reports the limit",
          "[step]") {
  Bench bench{makeHalfSpace({0, 0, -1}, {0, 0, 1}), {mode(ModeKind::kViscosity, "it", 0.1)}};
  bench.step(Vec3::Zero());
  const StepReport r = bench.step({0.04, 0, 0});
  CHECK(r.status == StepStatus::kSubstepLimit);
  CHECK(r.substeps == 16);
  // The proxy moves one voxel per reading, and one voxel after the last reading.
  CHECK(r.proxy.x() == Approx(17e-3));
  bench.step({0.04, 0, 0});
  bench.step({0.04, 0, 0});
  CHECK(bench.step({0.04, 0, 0}).status == StepStatus::kConverged);
  CHECK(bench.step({0.04, 0, 0}).force.norm() <= 0.1);
}

TEST_CASE("a free proxy keeps up with a fast hand", "[step]") {
  Bench bench{makeSphere(Vec3::Zero(), kRadius), {mode(ModeKind::kIsosurface, "it", 3.0)}};
  // The hand passes just outside a ball at 30 m/s. Voxels are 1 mm.
  for (int i = -10; i <= 10; ++i) {
    const StepReport r = bench.step({0, 0.03 * i, kRadius + 5e-4});
    REQUIRE(r.force.norm() == 0.0);
    REQUIRE(r.status == StepStatus::kConverged);
  }
}

TEST_CASE("a NaN position of the hand is a fault and gives zero force until it is cleared",
          "[step][safety]") {
  Bench bench = sphere(3.0);
  const Vec3 pressed(0, 0, kRadius - 1e-3);
  bench.go({0, 0, 1.02 * kRadius}, pressed);
  const StepReport r = bench.step({std::numeric_limits<double>::quiet_NaN(), 0, 0});
  CHECK(r.force == Vec3::Zero());
  CHECK(r.status == StepStatus::kFault);
  CHECK(bench.step(pressed).force == Vec3::Zero());
  CHECK(bench.step(pressed).status == StepStatus::kFault);
  bench.state.clearFault();
  CHECK(bench.step({0, 0, 0.08}).status == StepStatus::kConverged);
}

TEST_CASE("a field with invalid values gives a finite force within the peak limit",
          "[step][safety]") {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  Random random(7);
  const auto rubbish = makeScalarField(
      FieldFrame{1e-3, 1.0, {Vec3::Constant(-1), Vec3::Constant(1)}}, [&](const Vec3& p) {
        const auto any = [&](double v) {
          const int n = random.integer(12);
          return n == 0 ? nan : n == 1 ? 1e308 : n == 2 ? -INFINITY : v;
        };
        return ScalarSample{any(p.z()), {any(0), any(0), any(1)}, true};
      });
  Bench bench{FieldPtr(rubbish),
              {mode(ModeKind::kSurface, "it", TransferFunction::window(0, 1, 1)),
               mode(ModeKind::kIsosurface, "it", 2.0), mode(ModeKind::kForce, "it", 1.0)}};
  for (int i = 0; i < 20000; ++i) {
    const StepReport r = bench.step(random.inCube(5e-3));
    REQUIRE(r.force.allFinite());
    REQUIRE(r.force.norm() <= kOpen.peak);
    REQUIRE(r.proxy.allFinite());
    if (r.status == StepStatus::kFault) bench.state.clearFault();
  }
}

TEST_CASE("a new scene keeps the proxy and forgets surfaces that have yielded", "[step]") {
  Bench a = sphere(3.0);
  const Vec3 pressed(0, 0, kRadius - 2e-3);
  const StepReport before = a.go({0, 0, 1.02 * kRadius}, pressed);
  Bench b = sphere(3.0);
  const StepReport after = hapticStep(*b.scene, a.reader, {pressed}, a.state, kDt);
  CHECK((after.proxy - before.proxy).norm() < 1e-9);
  CHECK((after.force - before.force).norm() < 1e-6);

  // A new scene forgets that a contact has yielded. The proxy then counts as inside the new solid,
  // which causes no force.
  Bench weak = sphere(0.5);
  weak.go({0, 0, 1.02 * kRadius}, pressed);
  REQUIRE(sideOf(weak.state.memory(0)) == Side::kYielded);
  const StepReport swapped = hapticStep(*b.scene, weak.reader, {pressed}, weak.state, kDt);
  CHECK(sideOf(weak.state.memory(0)) == Side::kInside);
  CHECK(swapped.force.norm() < 1e-9);
}

TEST_CASE("a scene that is replaced while the proxy rests on its surface keeps the proxy there",
          "[step][release]") {
  Random random(12);
  for (int i = 0; i < 300; ++i) {
    const Vec3 d = random.direction();
    Bench a = sphere(3.0);
    a.go(1.02 * kRadius * d, (kRadius - 2e-3) * d);
    Bench b = sphere(3.0);
    const StepReport r = hapticStep(*b.scene, a.reader, {(kRadius - 2e-3) * d}, a.state, kDt);
    REQUIRE(r.force.norm() == Approx(1.0).epsilon(1e-6));
  }
}

TEST_CASE("both walls of a concave edge hold the hand but a convex edge lets it slide over",
          "[step]") {
  // Two half-spaces have the y axis as their common edge. Their union has a groove, and their
  // intersection has a ridge.
  const auto wedge = [](bool groove, double slope) {
    return makeScalarField(FieldFrame{1e-3, 1.0, {Vec3::Constant(-1), Vec3::Constant(1)}},
                           [=](const Vec3& p) {
                             const Vec3 a = Vec3(slope, 0, 1).normalized();
                             const Vec3 b = Vec3(-slope, 0, 1).normalized();
                             const bool first = groove ? a.dot(p) < b.dot(p) : a.dot(p) > b.dot(p);
                             const Vec3 n = first ? a : b;
                             return ScalarSample{n.dot(p), n, true};
                           });
  };
  Bench groove{FieldPtr(wedge(true, 1.0)), {mode(ModeKind::kIsosurface, "it", 2.0)}};
  StepReport r;
  for (double z = 5e-3; z > -2e-3; z -= 1e-5) r = groove.step({3e-4, 0, z});
  for (int i = 0; i < 50; ++i) r = groove.step({3e-4, 0, -2e-3});
  CHECK(r.status == StepStatus::kConverged);
  CHECK(sideOf(groove.state.memory(0)) == Side::kOutside);
  CHECK(r.proxy.norm() < 2e-5);
  CHECK((r.force - 500.0 * Vec3(-3e-4, 0, 2e-3)).norm() < 0.02);

  Bench roof{FieldPtr(wedge(false, 0.4)), {mode(ModeKind::kIsosurface, "it", 3.0)}};
  double largest = 0.0;
  for (double x = -1e-2; x < 1e-2; x += 1e-4) {
    r = roof.step({x, 0, -0.4 * std::abs(x) + (x < -8e-3 ? 1e-3 : -1e-3)});
    largest = std::max(largest, r.force.norm());
  }
  CHECK(sideOf(roof.state.memory(0)) == Side::kOutside);
  CHECK(r.proxy.x() > 8e-3);
  CHECK(largest < 1.0);
}

TEST_CASE("after a fault a hand inside the surface is not pulled outwards", "[step][safety]") {
  Bench bench = sphere(3.0);
  const Vec3 pressed(0, 0, kRadius - 1.5e-3);
  bench.go({0, 0, 1.02 * kRadius}, pressed);
  (void)bench.step({std::numeric_limits<double>::quiet_NaN(), 0, 0});
  bench.state.clearFault();
  CHECK(bench.step(pressed).force == Vec3::Zero());
  CHECK(bench.step(pressed).force == Vec3::Zero());
}

TEST_CASE("damping does not pull inwards as the hand enters or leaves a surface", "[step][eq3]") {
  Bench bench{
      makeSphere(Vec3::Zero(), kRadius), {mode(ModeKind::kIsosurface, "it", 2.0)}, {500.0, 5.0}};
  double inward = 0.0;
  for (double z = kRadius + 5e-3; z > kRadius - 3e-3; z -= 2e-3) {
    inward = std::min(inward, bench.step({0, 0, z}).force.z());
  }
  for (double z = kRadius - 3e-3; z < kRadius + 5e-3; z += 2e-3) {
    inward = std::min(inward, bench.step({0, 0, z}).force.z());
  }
  CHECK(inward == 0.0);
}

TEST_CASE("the force on a hand above the speed limit only brakes, along the driven directions",
          "[step][safety][release]") {
  Random random(23);
  for (int i = 0; i < 500; ++i) {
    Bench bench = sphere(3.0);
    const Vec3 free = random.direction();
    HandState hand;
    hand.drives = Mat3::Identity() - free * free.transpose();
    hand.position = 1.02 * kRadius * random.direction();
    (void)hapticStep(*bench.scene, bench.reader, hand, bench.state, kDt);
    hand.position *= 0.97 / 1.02;
    hand.too_fast = true;
    hand.velocity = random.uniform(1.0, 4.0) * random.direction();
    hand.max_speed = 0.5;
    const StepReport r = hapticStep(*bench.scene, bench.reader, hand, bench.state, kDt);
    REQUIRE(r.primitives > 0);
    REQUIRE(r.wanted.dot(hand.velocity) <= 1e-9);
    REQUIRE(std::abs(r.wanted.dot(free)) <= 1e-9);
  }
}

TEST_CASE("the tick does not allocate, lock or throw", "[step][realtime]") {
  GraphSpec spec;
  spec.modes = {mode(ModeKind::kIsosurface, "ball", 2.0), mode(ModeKind::kSurface, "ball", 1.0),
                mode(ModeKind::kViscosity, "ball", TransferFunction::window(0, 1, 1)),
                mode(ModeKind::kFollow, "flow", 1.0), mode(ModeKind::kForce, "flow", 0.3)};
  const auto scene = makeScene(spec, {{"ball", makeSphere(Vec3::Zero(), kRadius)},
                                      {"flow", makeVortex(Vec3::Zero(), {1, 2, 3}, 0.2, 1.0)}});
  Reader reader;
  ProxyState state(kOpen);
  Random random(8);
  const test::CountScope scope;
  for (int i = 0; i < 1000; ++i) {
    const Vec3 hand = Vec3(0, 0, kRadius) + random.inCube(3e-3);
    (void)hapticStep(*scene, reader, {i == 500 ? Vec3(NAN, 0, 0) : hand}, state, kDt);
    if (i == 510) state.clearFault();
  }
  const test::Counts counts = test::CountScope::counts();
  CHECK(counts.allocations == 0);
  CHECK(counts.locks == 0);
  CHECK(counts.exceptions == 0);
}

TEST_CASE("the test counters count allocations, exceptions and locks", "[realtime]") {
  const test::CountScope scope;
  auto* volatile made = new int(1);
  delete made;
  std::mutex mutex;
  mutex.lock();
  mutex.unlock();
  try {
    throw 1;
  } catch (int) {
  }
  const test::Counts counts = test::CountScope::counts();
  CHECK(counts.allocations >= 1);
  CHECK(counts.exceptions == 1);
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
  CHECK(counts.locks == 1);
#endif
}

}  // namespace palpate::step_test
