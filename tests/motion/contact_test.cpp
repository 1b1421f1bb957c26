/// Tests contact on concave and rough surfaces: the share of ticks that do not converge, and the
/// errors of the others.
#include <cmath>
#include <string>

#include <catch2/catch.hpp>

#include "tests/support/contact_problems.h"
#include "tests/support/random.h"

namespace palpate::contact_test {
using namespace palpate::bench;

namespace {

ContactRuns runs(std::uint64_t seed, ModeKind kind = ModeKind::kIsosurface) {
  ContactRuns out;
  out.frames = test::share(48);
  out.seed = seed;
  out.kind = kind;
  return out;
}

/// Checks the properties that contact must have on any surface.
void checkTheorem(const std::string& row, const ContactResult& r) {
  CAPTURE(row, r.runs, r.held, r.cappedShare(), r.readingsPerTick(), r.deepest, r.off, r.off_most,
          r.offRms(), r.unfinished, r.hardest);
  CHECK(r.held > 100 * r.runs);
  // If a tick converged, its proxy is on the surface within the tolerance.
  CHECK(r.off == 0);
  CHECK(r.off_most <= 0.01);
  // While the hand rests, the proxy must not stop in ticks that have used up their readings.
  CHECK(r.unfinished == 0);
  // No proxy gets more than a voxel behind the surface, and no force exceeds 1.05 times the
  // strength.
  CHECK(r.leaked == 0);
  CHECK(r.over == 0);
}

}  // namespace

TEST_CASE("grooves of 12 to 120 degrees hold the proxy, and few ticks reach the limit of readings",
          "[motion][release]") {
  struct Groove {
    double opening;  // [degrees]
    double capped;   // share of ticks that reach the limit of readings
  };
  for (const auto& [opening, capped] : {Groove{12.0, 0.13},
                                        {20.0, 0.05},
                                        {25.0, 0.035},
                                        {30.0, 0.025},
                                        {35.0, 0.02},
                                        {45.0, 0.01},
                                        {60.0, 0.003},
                                        {88.0, 0.001},
                                        {120.0, 0.001}}) {
    const ContactResult r = feelGrooves(opening, runs(31));
    checkTheorem("groove of " + std::to_string(opening), r);
    // With a tenth of the runs, one run can have most of the ticks that reach the limit.
    CHECK(r.cappedShare() <= (test::share(48) < 48 ? 2.0 : 1.0) * capped);
    CHECK(r.readingsPerTick() <= (opening < 20.0 ? 6.0 : 4.5));
  }
}

TEST_CASE("cubes and rough volumes hold the proxy, and few ticks reach the limit of readings",
          "[motion][release]") {
  const ContactResult hollow = feelCubes(true, runs(32));
  checkTheorem("hollow cube", hollow);
  CHECK(hollow.cappedShare() <= 5e-4);
  CHECK(hollow.readingsPerTick() <= 1.2);
  CHECK(hollow.offRms() <= 1e-3);
  const ContactResult solid = feelCubes(false, runs(33));
  checkTheorem("solid cube", solid);
  CHECK(solid.cappedShare() <= 1e-3);
  CHECK(solid.readingsPerTick() <= 1.3);
  struct Noise {
    double wavelength;  // [voxels]
    double capped;
    double readings;
  };
  for (const auto& [wavelength, capped, readings] :
       {Noise{12.0, 2e-3, 1.35}, {7.0, 1e-2, 1.75}, {4.5, 2e-2, 2.2}}) {
    const ContactResult r = feelNoise(wavelength, runs(34));
    checkTheorem("noise of " + std::to_string(wavelength), r);
    CHECK(r.cappedShare() <= capped);
    CHECK(r.readingsPerTick() <= readings);
  }
}

TEST_CASE(
    "on average a tick takes at most 1.02 readings on a ball of 20 voxels and 1.5 on one of 4",
    "[motion]") {
  for (const auto& [radius, readings] : {std::pair{20.0, 1.02}, {4.0, 1.5}}) {
    const ContactResult r = feelBalls(radius, runs(35));
    checkTheorem("ball of " + std::to_string(radius), r);
    CHECK(r.cappedShare() <= 1e-4);
    CHECK(r.readingsPerTick() <= readings);
  }
}

TEST_CASE("surfaces of random values hold a hand with at most 1.05 times their strength",
          "[motion][release]") {
  for (const double grain : {1.0, 2.0, 4.0}) {
    const ContactResult r = pressNoise(grain, runs(36));
    CAPTURE(grain, r.runs, r.hardest, r.over, r.held, r.off_most, r.cappedShare());
    // In ticks that do not converge, the hand is ahead of the proxy along the surface, so the load
    // can exceed the strength.
    CHECK(r.hardest <= 1.05);
    CHECK(r.hardest > 0.9);
    CHECK(r.cappedShare() <= 0.02);
  }
}

}  // namespace palpate::contact_test
