/// Tests paths through grids: the first point at which the value falls below a level, and the
/// course of a streamline.
#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>

#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "palpate/engine/field/trace.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume.h"
#include "tests/support/counters.h"
#include "tests/support/probe.h"
#include "tests/support/random.h"
#include "tests/support/thinned.h"
#include "tests/support/vdb_grids.h"

namespace palpate::way_test {
using namespace palpate::test;
using openvdb::Vec3d;
using openvdb::math::Transform;

namespace {

FieldPtr fieldOf(const openvdb::GridBase::Ptr& grid, const Placement& placement = {},
                 const Sampling& sampling = {}) {
  const TemporaryFolder folder;
  writeVdb(folder / "a.vdb", {grid});
  return makeVdbField(loadVolume(folder / "a.vdb", ""), placement, sampling);
}

/// Returns random values between -1 and 1 at all voxels.
openvdb::FloatGrid::Ptr noise(int n) {
  Random random(5);
  return makeGrid<openvdb::FloatGrid>(n, Transform::createLinearTransform(1.0), [&](const Vec3d&) {
    return static_cast<float>(random.uniform(-1.0, 1.0));
  });
}

/// A flow that turns within a few voxels.
Vec3 curly(const Vec3& p) {
  return {std::sin(0.3 * p.z()) + std::cos(0.25 * p.y()),
          std::sin(0.3 * p.x()) + std::cos(0.2 * p.z()),
          std::sin(0.25 * p.y()) + std::cos(0.3 * p.x())};
}

openvdb::Vec3SGrid::Ptr curlyGrid(const Transform::Ptr& transform) {
  return makeGrid<openvdb::Vec3SGrid>(
      32, transform,
      [&](const Vec3d& at) {
        const Vec3d index = transform->worldToIndex(at);
        const Vec3 v = curly({index.x(), index.y(), index.z()});
        return openvdb::Vec3f(static_cast<float>(v.x()), static_cast<float>(v.y()),
                              static_cast<float>(v.z()));
      },
      "velocity");
}

/// Follows a streamline with the midpoint rule, in many small steps.
Vec3 inSmallSteps(const VectorField& field, FieldCache& cache, Vec3 p, double length, int steps) {
  const double h = length / steps;
  for (int i = 0; i < steps; ++i) {
    const Vec3 k = field.sample(p, cache).value.normalized();
    p += h * field.sample(p + 0.5 * h * k, cache).value.normalized();
  }
  return p;
}

}  // namespace

TEST_CASE("the first point below a level is found to within rounding on random paths through noise",
          "[samplers][motion]") {
  constexpr int kWays = test::kSanitized ? 500 : 4000;
  for (const bool turned : {false, true}) {
    const Placement placement = turned ? slanted() : Placement{};
    const FieldPtr field = fieldOf(noise(12), placement);
    const ScalarField& scalar = *std::get<0>(field);
    const auto memory = std::make_unique<FieldCache>();
    scalar.reset(*memory);
    Random random(6);
    long found = 0;
    for (int i = 0; i < kWays; ++i) {
      const Vec3 a = Vec3(6, 6, 6) + random.inCube(4.5);
      const Vec3 b = a + random.uniform(0.05, 2.5) * random.direction();
      const double level = random.uniform(-0.5, 0.5);
      const double sign = random.integer(2) == 0 ? 1.0 : -1.0;
      const auto height = [&](double share) {
        return sign * (scalar.sample(placement(a + share * (b - a)), *memory).value - level);
      };
      const Crossing crossing = scalar.firstFall(placement(a), placement(b), level, sign, *memory);
      // This reference searches in small steps, so it can miss a narrow dip between two steps.
      constexpr int kSteps = 2000;
      bool above = height(0.0) > 0.0;
      double share = 2.0;
      if (!above && height(1e-6) < height(0.0)) share = 0.0;
      for (int k = 1; k <= kSteps && share > 1.0; ++k) {
        const double h = height(static_cast<double>(k) / kSteps);
        if (above && h < 0.0) share = (k - 0.5) / kSteps;
        above = above || h > 0.0;
      }
      CAPTURE(i, turned, crossing.share, share);
      if (crossing.found && share <= 1.0) {
        REQUIRE(crossing.share <= share + 1.0 / kSteps);
        ++found;
      }
      if (crossing.found && crossing.share > 0.0) {
        REQUIRE(std::abs(height(crossing.share)) < 1e-9);
        REQUIRE(height(crossing.share + 1e-6) < height(crossing.share));
      }
      if (!crossing.found) REQUIRE(share > 1.0);
      // If the path starts above the level, it stays above the level up to the crossing.
      if (crossing.found && crossing.share > 0.0 && height(0.0) > 0.0) {
        for (int k = 0; k < 50; ++k) REQUIRE(height(crossing.share * k / 50.0) > -1e-9);
      }
      REQUIRE(crossing.cells <= 10);
    }
    CHECK(found > kWays / 4);
  }
}

TEST_CASE("a path that starts on a surface crosses it only if the path leads inwards",
          "[samplers][motion]") {
  // The field is z - 4, in a cube with an edge of nine voxels.
  const auto grid =
      makeGrid<openvdb::FloatGrid>(9, Transform::createLinearTransform(1.0),
                                   [](const Vec3d& p) { return static_cast<float>(p.z() - 4.0); });
  const FieldPtr field = fieldOf(grid);
  const ScalarField& scalar = *std::get<0>(field);
  const auto memory = std::make_unique<FieldCache>();
  scalar.reset(*memory);
  const auto fall = [&](const Vec3& a, const Vec3& b) {
    return scalar.firstFall(a, b, 0.0, 1.0, *memory);
  };
  CHECK(fall({4, 4, 4}, {4, 4, 3}).share == 0.0);     // into the solid
  CHECK_FALSE(fall({4, 4, 4}, {4.3, 4, 5.5}).found);  // out of the solid
  CHECK_FALSE(fall({4, 4, 4}, {6, 4, 4}).found);      // along the surface
  CHECK(fall({4, 4, 5.5}, {4, 4, 3.5}).share == Approx(0.75));
  CHECK(fall({4, 4, 3.5}, {4, 4, 3}).share == 0.0);  // starts in the solid and goes deeper
  CHECK_FALSE(fall({4, 4, 3}, {4, 4, 3.5}).found);   // starts in the solid and leaves it
  CHECK_FALSE(fall({40, 4, 5}, {40, 4, 3}).found);   // no data
  CHECK_FALSE(fall({4, 4, 5}, {NAN, 4, 3}).found);
  CHECK_FALSE(fall({4, 4, 5}, {4, 4, 1e300}).found);
}

TEST_CASE(
    "a streamline is traced by arc length in a slanted placement and with unequal voxel edges",
    "[samplers][motion]") {
  Transform::Ptr flat = Transform::createLinearTransform(1.0);
  flat->preScale(Vec3d(1.0, 1.5, 0.75));
  for (const auto& transform : {Transform::createLinearTransform(0.5), flat}) {
    for (const bool turned : {false, true}) {
      const Placement placement = turned ? slanted() : Placement{};
      for (const Interpolation interpolation : {Interpolation::kTrilinear, Interpolation::kCubic}) {
        const FieldPtr field = fieldOf(curlyGrid(transform), placement, {interpolation, false});
        const VectorField& flow = *std::get<1>(field);
        const auto memory = std::make_unique<FieldCache>();
        flow.reset(*memory);
        Random random(8);
        const double voxel = flow.frame().voxel;
        double worst = 0.0;
        for (int i = 0; i < 50; ++i) {
          const Vec3 index = Vec3(15, 15, 15) + random.inCube(5.0);
          const Vec3d file = transform->indexToWorld(Vec3d(index.x(), index.y(), index.z()));
          const Vec3 p = placement(Vec3(file.x(), file.y(), file.z()));
          const Vec3 d = flow.sample(p, *memory).value.normalized();
          TraceOrder order;
          order.along = i % 2 == 0 ? d : Vec3(-d);
          order.length = random.uniform(-3.0, 3.0) * voxel;
          order.tolerance = 1e-6;
          order.max_steps = 64;
          const Trace trace = flow.trace(p, order, *memory);
          REQUIRE_FALSE(trace.capped);
          REQUIRE(trace.length == Approx(order.length).margin(1e-9 * voxel));
          const double along = i % 2 == 0 ? order.length : -order.length;
          const Vec3 exact = inSmallSteps(flow, *memory, p, along, 3000);
          worst = std::max(worst, (trace.position - exact).norm() / voxel);
          const Vec3 end = flow.sample(trace.position, *memory).value.normalized();
          REQUIRE((trace.direction - (i % 2 == 0 ? end : Vec3(-end))).norm() < 1e-6);
        }
        CAPTURE(turned, wordFor(interpolation), worst);
        CHECK(worst < 2e-5);
      }
    }
  }
}

TEST_CASE(
    "a streamline trace ends at the edge of the data, where the flow is zero or after max_steps",
    "[samplers][motion]") {
  const auto transform = Transform::createLinearTransform(1.0);
  // The flow is along x for x up to 20, and zero beyond.
  const auto grid = makeGrid<openvdb::Vec3SGrid>(
      32, transform,
      [](const Vec3d& p) { return openvdb::Vec3f(p.x() < 20.5 ? 1.0F : 0.0F, 0.0F, 0.0F); }, "v");
  const FieldPtr field = fieldOf(grid);
  const VectorField& flow = *std::get<1>(field);
  const auto memory = std::make_unique<FieldCache>();
  flow.reset(*memory);
  const auto trace = [&](double x, double length, int steps = 64) {
    TraceOrder order;
    order.length = length;
    order.max_steps = steps;
    return flow.trace({x, 10.2, 10.7}, order, *memory);
  };
  CHECK(trace(5, 4).position.x() == Approx(9.0));
  CHECK(trace(5, -4).position.x() == Approx(1.0));
  const Trace still = trace(18, 6);
  CHECK(still.position.x() == Approx(21.0).margin(0.15));  // the last cell with flow
  CHECK(still.length < 3.1);
  CHECK_FALSE(still.capped);
  const Trace out = trace(2, -6);  // data end one voxel before the first voxel
  CHECK(out.position.x() == Approx(-1.0).margin(0.15));
  const Trace few = trace(5, 4, 2);
  CHECK(few.capped);
  CHECK(few.length < 4.0);
  CHECK(few.position.x() == Approx(5.0 + few.length));
  CHECK(trace(5, 0.0).samples <= 1);
  for (const double x : {static_cast<double>(NAN), 1e300, -40.0}) {
    CHECK(trace(x, 1.0).length == 0.0);
  }
}

TEST_CASE("a short streamline trace reads two values, or five if the curvature has changed",
          "[samplers][motion]") {
  const Vec3 centre(16.3, 15.7, 16.0);
  const auto grid = makeGrid<openvdb::Vec3SGrid>(
      33, Transform::createLinearTransform(1.0),
      [&](const Vec3d& p) {
        return openvdb::Vec3f(static_cast<float>(centre.y() - p.y()),
                              static_cast<float>(p.x() - centre.x()), 0.0F);
      },
      "v");
  const FieldPtr field = fieldOf(grid);
  const VectorField& circles = *std::get<1>(field);
  const auto memory = std::make_unique<FieldCache>();
  circles.reset(*memory);
  for (const double radius : {3.0, 8.0}) {
    for (const double length : {0.01, 0.03, 0.09, -0.09}) {
      CAPTURE(radius, length);
      const Vec3 start = centre + Vec3(radius, 0, 0.2);
      TraceOrder order;
      order.along = Vec3::UnitY();
      order.length = length;
      order.tolerance = 1e-3;
      order.bend = Vec3(-1.0 / radius, 0, 0);
      const double turned = length / radius;
      const Vec3 exact = centre + radius * Vec3(std::cos(turned), std::sin(turned), 0.2 / radius);
      const Trace trace = circles.trace(start, order, *memory);
      CHECK(trace.samples == 2);
      CHECK(trace.length == Approx(length).epsilon(1e-12));
      CHECK((trace.position - exact).norm() < std::abs(length * turned * turned) / 5.0);
      const Vec3 ahead(-std::sin(turned), std::cos(turned), 0.0);
      CHECK((trace.direction - ahead).norm() < turned * turned);
      // The trace takes more samples if the bend differs from that of the last tick.
      order.bend = Vec3(0, 0, 1.0);
      const Trace longer = circles.trace(start, order, *memory);
      CHECK(longer.samples == 5);
      CHECK((longer.position - exact).norm() < 1e-8);
    }
  }
}

TEST_CASE(
    "a trace towards the hand ends at the first place nearest to the hand in either direction",
    "[samplers][motion]") {
  const Vec3 centre(16.3, 15.7, 16.0);
  const auto grid = makeGrid<openvdb::Vec3SGrid>(
      33, Transform::createLinearTransform(1.0),
      [&](const Vec3d& p) {
        return openvdb::Vec3f(static_cast<float>(centre.y() - p.y()),
                              static_cast<float>(p.x() - centre.x()), 0.0F);
      },
      "v");
  const FieldPtr field = fieldOf(grid);
  const VectorField& circles = *std::get<1>(field);
  const auto memory = std::make_unique<FieldCache>();
  circles.reset(*memory);
  // W is sheared against the resting frame, so the nearest point in W is not the nearest point in
  // the resting frame.
  Mat3 shear = Mat3::Identity();
  shear(0, 1) = 0.7;
  for (const double radius : {1.5, 3.0, 8.0}) {
    for (const double sense : {1.0, -1.0}) {
      // `away` is the hand's distance outwards from the circle, in radii. At -1.5 the hand is
      // beyond the centre.
      for (const double away : {-1.5, -0.5, 0.1, 0.5, 1.1, 4.0}) {
        const Vec3 start = centre + Vec3(radius, 0, 0.2);
        TraceOrder order;
        order.along = Vec3::UnitY();
        order.to_hand = true;
        order.length = 4.0 * radius;
        order.hand = Vec3(away * radius, sense * radius, 0);
        order.max_steps = 64;
        CAPTURE(radius, sense, away);
        const Trace trace = circles.trace(start, order, *memory);
        const Vec3 left = order.hand - (trace.position - start);
        CHECK(trace.arrived);
        CHECK(trace.length == Approx(std::atan2(sense, 1.0 + away) * radius).margin(0.01));
        CHECK(std::abs(trace.direction.dot(left)) <= order.near);
        CHECK(trace.hairpin == (away < -1.0));
        order.length = 0.1;
        const Trace capped = circles.trace(start, order, *memory);
        CHECK_FALSE(capped.arrived);
        CHECK(capped.length == Approx(sense * order.length));
        order.length = 4.0 * radius;
        order.metric = shear.transpose() * shear;
        const Trace sheared = circles.trace(start, order, *memory);
        const Vec3 aside = shear * (order.hand - (sheared.position - start));
        CHECK(sheared.arrived);
        CHECK(std::abs(aside.dot(shear * sheared.direction)) <= order.near);
      }
    }
  }
}

TEST_CASE("a trace along axial vectors of random sign does not turn back", "[samplers][motion]") {
  Random random(9);
  const auto grid = makeGrid<openvdb::Vec3SGrid>(
      16, Transform::createLinearTransform(1.0),
      [&](const Vec3d&) {
        const float sign = random.integer(2) == 0 ? 1.0F : -1.0F;
        return sign * openvdb::Vec3f(0.6F, 0.0F, 0.8F);
      },
      "fibre");
  const FieldPtr field = fieldOf(grid, {}, {Interpolation::kTrilinear, true});
  const VectorField& fibres = *std::get<1>(field);
  const auto memory = std::make_unique<FieldCache>();
  fibres.reset(*memory);
  for (const double sense : {1.0, -1.0}) {
    TraceOrder order;
    order.along = sense * Vec3(0.6, 0.0, 0.8);
    order.length = 4.0;
    order.max_steps = 64;
    const Vec3 start(8, 7.3, 7.9);
    const Trace trace = fibres.trace(start, order, *memory);
    CHECK((trace.position - start - 4.0 * order.along).norm() < 1e-6);
    CHECK((trace.direction - order.along).norm() < 1e-6);
  }
}

TEST_CASE("the search for a surface and the trace of a streamline allocate no memory",
          "[samplers][motion][realtime]") {
  const FieldPtr rough = fieldOf(noise(12));
  const FieldPtr curls = fieldOf(curlyGrid(Transform::createLinearTransform(1.0)));
  const auto a = std::make_unique<FieldCache>();
  const auto b = std::make_unique<FieldCache>();
  std::get<0>(rough)->reset(*a);
  std::get<1>(curls)->reset(*b);
  Random random(10);
  const CountScope scope;
  for (int i = 0; i < 200; ++i) {
    const Vec3 p = Vec3(6, 6, 6) + random.inCube(4.0);
    (void)std::get<0>(rough)->firstFall(p, p + random.inCube(2.0), 0.0, 1.0, *a);
    TraceOrder order;
    order.length = 2.0;
    (void)std::get<1>(curls)->trace(2.0 * p, order, *b);
  }
  CHECK(CountScope::counts().allocations == 0);
}

}  // namespace palpate::way_test
