/// A proxy on a stream: how far it comes off the exact one, at what cost.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "tests/support/motion_problems.h"
#include "tests/support/random.h"

namespace palpate::stream_test {
using namespace palpate::bench;
using palpate::test::Random;

TEST_CASE("over 1280 voxels a proxy departs from its stream by less than 0.02", "[motion]") {
  // Asked: the sum of one-tick departures at most 0.02 voxel (goal 0.01), at most 20 samples a
  // tick.
  const auto count = static_cast<std::size_t>(palpate::test::share(3));
  for (const int wavelength : {16, 32}) {
    for (const bool abc : {true, false}) {
      const auto flow = abc ? abcFlow(wavelength) : taylorGreen(wavelength);
      for (const Stream& stream : streamsOfFlow(flow, wavelength, 1280.0, count, 1.0)) {
        const StreamResult r = feelStream(stream, 0.5, 1.0, {});
        CAPTURE(abc, wavelength, r.off_max, r.departures, r.samples, r.most_samples);
        CHECK(r.departures <= 0.01);
        CHECK(r.samples <= 20.0);
        CHECK(r.capped == 0.0);
        // One of Taylor and Green's goes round in 12 ticks: the hand passes the centre first.
        if (abc) CHECK(r.hairpins == 0.0);
      }
    }
  }
}

TEST_CASE("a stream is followed at any speed, and the more exactly the less is allowed",
          "[motion]") {
  const auto count = static_cast<std::size_t>(palpate::test::share(6));
  for (const double tolerance : {1e-2, 1e-3}) {
    for (const double speed : {0.05, 0.5, 1.0, 2.0}) {
      double off = 0.0;
      double departures = 0.0;
      for (const int wavelength : {16, 32}) {
        for (const Stream& stream :
             streamsOfFlow(abcFlow(wavelength), wavelength, 128.0, count, 1.0)) {
          StepParams step;
          step.tolerance_voxels = tolerance;
          const StreamResult r = feelStream(stream, speed, 1.0, step);
          CHECK(r.capped == 0.0);
          off = std::max(off, r.off_max);
          departures = std::max(departures, r.departures);
        }
      }
      CAPTURE(tolerance, speed, off, departures);
      // A fast hand is aside of the curve between two ticks.
      CHECK(off <= (speed < 2.0 ? 0.1 * tolerance + 1e-3 : 5e-3));
      CHECK(departures <= 0.01);
    }
  }
}

TEST_CASE("a stream that has more bends than a tick may take waits, and says so", "[motion]") {
  // One reading a tick: a voxel, where the hand goes 1.28.
  StepParams step;
  step.max_substeps = 1;
  for (const Stream& stream : streamsOfFlow(abcFlow(16), 16, 128.0, 3, 1.0)) {
    const StreamResult r = feelStream(stream, 1.0, 1.0, step);
    CAPTURE(r.off_max, r.departures, r.capped, r.most_samples);
    CHECK(r.capped > 0.1);
    CHECK(r.most_samples <= 60.0);
    // It stays on its stream all the same, behind the hand.
    CHECK(r.departures <= 0.1);
  }
}

TEST_CASE("real flows are followed", "[.][data][motion]") {
  // tests/motion/data_test.sh imports them. Paths end where the data do: 10 to 40 voxels.
  const char* folder = std::getenv("PALPATE_IMPORTED");
  REQUIRE(folder != nullptr);
  const long count = std::max(palpate::test::share(24), 6L);
  for (const char* name : {"carotid", "kitchen", "storm"}) {
    long followed = 0;
    double off = 0.0;
    double departures = 0.0;  // summed up, by 1,280 voxels of all streams
    double worst = 0.0;       // of one, drawn out to 1,280 voxels
    double samples = 0.0;
    double length = 0.0;
    for (const Stream& stream : streamsOfFile(std::string(folder) + "/" + name + ".vdb",
                                              static_cast<std::size_t>(count), 1280.0)) {
      if (stream.mostBend(1.0) >= kMostBend) continue;
      const StreamResult r = feelStream(stream, 0.5, 1.0, {});
      ++followed;
      off = std::max(off, r.off_max);
      departures += r.departures * stream.length();
      worst = std::max(worst, r.departures);
      samples += r.samples * stream.length();
      length += stream.length();
      CHECK(r.capped == 0.0);
      CHECK(r.hairpins <= 0.05);  // at a kink of kitchen's
    }
    departures /= length;
    samples /= length;
    WARN(name << ": " << followed << " streams, " << length << " voxels; off by at most " << off
              << " voxel; departures " << departures << " by 1,280 voxels, of the worst " << worst
              << "; " << samples << " samples a tick");
    CHECK(followed >= (name == std::string("storm") ? 1 : 5 * count / 24));
    CHECK(off <= 0.01);
    CHECK(worst <= 0.02);  // goal: 0.01
    // The storm's 50 voxels are turns at the edges of 25 x 14 x 8: 22.
    CHECK(samples <= (name == std::string("storm") ? 24.0 : 20.0));
  }
}

TEST_CASE("on a spline a stream has no kinks", "[motion]") {
  for (const char* interpolation : {"quadratic", "cubic"}) {
    // Its course is that of the trilinear field, so only cost and force are looked at.
    for (const Stream& stream : streamsOfFlow(abcFlow(32), 32, 128.0, 2, 1.0, interpolation)) {
      const StreamResult r = feelStream(stream, 0.5, 1.0, {});
      CAPTURE(interpolation, r.samples, r.off_max);
      CHECK(r.samples <= 20.0);
      CHECK(r.capped == 0.0);
      CHECK(r.off_max < 1.0);
    }
  }
}

TEST_CASE("at a hairpin the status says so, and no force step is larger than the strength",
          "[motion]") {
  // A hand that is beyond the stream's centre of curvature has no nearest place on it. With 1 N the
  // stream lets go of a hand 2.2 voxels aside now and then, with 3 N of one a voxel aside never.
  const long count = palpate::test::share(6);
  for (const auto& [pull, strength] : {std::pair{2.2, 1.0}, {1.0, 3.0}}) {
    Random random(9);
    int hairpins = 0;
    for (int i = 0; i < 400 && hairpins < count; ++i) {
      Stream stream = traceStream("", abcFlow(16), Vec3::Constant(8.0) + random.inCube(8.0), 200.0);
      if (stream.mostBend(pull) < 1.2) continue;
      ++hairpins;
      stream.field = fieldAbout(stream);
      const StreamResult r = feelStream(stream, engineOn(stream, {}, strength), 0.5, pull, false);
      CAPTURE(pull, r.force_step, r.force_most, r.off_max, r.capped, r.hairpins);
      // What waits along the stream comes on top.
      CHECK(r.force_most <= strength + 0.4 * voxelsPerTick(0.5));
      // And the spring that the hand's own move stretches.
      CHECK(r.force_step <= strength + 0.4 * voxelsPerTick(0.5));
      if (strength == 3.0) CHECK(r.hairpins > 0.0);
    }
    CHECK(hairpins == count);
  }
}

TEST_CASE("a hand at rest outside of a bend rests, however far it is from the centre", "[motion]") {
  // Circles: the length that a tangent gives overshoots the nearest place by kappa d of it.
  const Vec3 centre(20.3, 19.7, 20.45);
  const Vec3 axis = Vec3(0.2, -0.3, 0.93).normalized();
  const FieldPtr field =
      vectorGrid(Vec3::Constant(41.0), [&](const Vec3& p) { return Vec3(axis.cross(p - centre)); });
  const Vec3 u = axis.cross(Vec3::UnitX()).normalized();
  const Vec3 w = axis.cross(u);
  for (const double radius : {2.0, 3.0, 5.0}) {
    for (const double turns : {0.5, 0.95, 1.05, 1.5, 2.0}) {
      const double d = turns * radius;
      Stream stream;
      stream.field = field;
      const Stepper tick = engineOn(stream, {}, 1.5 * kMotionStiffness * kVoxel * d);
      double injected = 0.0;
      double step = 0.0;
      Vec3 force = Vec3::Zero();
      for (int t = 0; t < 900; ++t) {
        const Vec3 hand =
            centre + (radius + d * std::min(1.0, t / 200.0)) * u + (t < 200 ? 0.0 : 0.05) * w;
        const Ticked r = tick(kVoxel * hand);
        if (t > 400) step = std::max(step, (r.force - force).norm());
        if (t > 230) injected += r.injected;
        force = r.force;
      }
      CAPTURE(radius, turns, step, injected);
      CHECK(force.norm() == Approx(kMotionStiffness * kVoxel * d).epsilon(0.02));
      CHECK(step < 1e-3);
      CHECK(injected < 1e-9);
    }
  }
}

TEST_CASE("axes that point into one face from both sides end a stream and hold no hand",
          "[motion]") {
  // Directions without a sign, at random: as the background of a diffusion image.
  Random random(11);
  std::vector<Vec3> noise(41 * 41 * 41);
  for (Vec3& v : noise) v = random.direction();
  const auto at = [&](const Vec3& p) {
    return noise[static_cast<std::size_t>((p.x() * 41 + p.y()) * 41 + p.z())];
  };
  for (const bool axes : {false, true}) {
    Stream stream;
    stream.field = vectorGrid(Vec3::Constant(41.0), at, "trilinear", axes);
    constexpr double kStrength = 0.5;
    const double pace = 0.06;  // voxels a tick
    for (int path = 0; path < 30; ++path) {
      const Stepper tick = engineOn(stream, {}, kStrength);
      Vec3 hand = Vec3::Constant(20.0) + random.inCube(12.0);
      Vec3 way = random.direction();
      double most = 0.0;
      for (int t = 0; t < 1500; ++t) {
        way = (way + 0.05 * random.direction()).normalized();
        hand += pace * way;
        if ((hand - Vec3::Constant(20.0)).cwiseAbs().maxCoeff() > 17.0) way = -way;
        const Ticked r = tick(kVoxel * hand);
        most = std::max(most, r.force.norm());
      }
      CAPTURE(axes, path, most);
      CHECK(most <= 1.3 * kStrength);
    }
  }
}

}  // namespace palpate::stream_test
