/// A proxy on a stream: how far it comes off the exact one, at what cost.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <string>
#include <utility>
#include <vector>

#include <catch2/catch.hpp>

#include "bench/motion_problems.h"
#include "tests/support/random.h"

using namespace palpate;
using namespace palpate::bench;
using palpate::test::Random;

TEST_CASE("over 1,280 voxels a proxy departs from its stream by less than 0.02", "[motion]") {
  // Asked: the sum of one-tick departures at most 0.02 voxel (goal 0.01), at most 20 samples a
  // tick.
  for (const int wavelength : {16, 32}) {
    for (const bool abc : {true, false}) {
      const auto flow = abc ? abcFlow(wavelength) : taylorGreen(wavelength);
      for (const Stream& stream : streamsOfFlow(flow, wavelength, 1280.0, 3, 1.0)) {
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
  for (const double tolerance : {1e-2, 1e-3}) {
    for (const double speed : {0.05, 0.5, 1.0}) {
      double off = 0.0;
      double departures = 0.0;
      for (const int wavelength : {16, 32}) {
        for (const Stream& stream : streamsOfFlow(abcFlow(wavelength), wavelength, 128.0, 6, 1.0)) {
          StepParams step;
          step.tolerance_voxels = tolerance;
          const StreamResult r = feelStream(stream, speed, 1.0, step);
          CHECK(r.capped == 0.0);
          off = std::max(off, r.off_max);
          departures = std::max(departures, r.departures);
        }
      }
      CAPTURE(tolerance, speed, off, departures);
      CHECK(off <= 0.1 * tolerance + 1e-3);
      CHECK(departures <= 0.01);
    }
  }
}

TEST_CASE("real flows are followed", "[.][data][motion]") {
  // tests/motion/data_test.sh imports them. Paths end where the data do: 10 to 40 voxels.
  const char* folder = std::getenv("PALPATE_IMPORTED");
  REQUIRE(folder != nullptr);
  for (const char* name : {"carotid", "kitchen", "storm"}) {
    long followed = 0;
    double off = 0.0;
    double departures = 0.0;  // summed up, by 1,280 voxels of all streams
    double worst = 0.0;       // of one, drawn out to 1,280 voxels
    double samples = 0.0;
    double length = 0.0;
    for (const Stream& stream :
         streamsOfFile(std::string(folder) + "/" + name + ".vdb", 24, 1280.0)) {
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
    CHECK(followed >= (name == std::string("storm") ? 1 : 5));
    CHECK(off <= 0.01);
    CHECK(departures <= 0.02);
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
  for (const auto& [pull, strength] : {std::pair{2.2, 1.0}, {1.0, 3.0}}) {
    Random random(9);
    int hairpins = 0;
    for (int i = 0; i < 400 && hairpins < 6; ++i) {
      const Stream stream =
          makeStream("", abcFlow(16), Vec3::Constant(8.0) + random.inCube(8.0), 200.0);
      if (stream.mostBend(pull) < 1.2) continue;
      ++hairpins;
      const StreamResult r = feelStream(stream, engineOn(stream, {}, strength), 0.5, pull, false);
      CAPTURE(pull, r.force_step, r.force_most, r.off_max, r.capped, r.hairpins);
      // What waits along the stream comes on top.
      CHECK(r.force_most <= strength + 0.4 * voxelsPerTick(0.5));
      CHECK(r.force_step <= strength);
      if (strength == 3.0) CHECK(r.hairpins > 0.0);
    }
    CHECK(hairpins == 6);
  }
}
