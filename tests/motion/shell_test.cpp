/// Tests thin walls and grooves: how often the proxy passes through them, and how far it enters.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <iostream>
#include <numbers>
#include <numeric>
#include <vector>

#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "tests/support/corner_noise.h"
#include "tests/support/motion_problems.h"
#include "tests/support/random.h"

namespace palpate::shell_test {
using namespace palpate::bench;

namespace {

/// Returns a random rotation.
Mat3 anyFrame(int seed) {
  test::Random random(static_cast<std::uint64_t>(seed));
  const double angle = random.uniform(0.0, 6.28);
  return Eigen::Quaterniond(Eigen::AngleAxisd(angle, random.direction())).toRotationMatrix();
}

/// Returns random values at grid points `grain` voxels apart, interpolated linearly between them.
std::function<double(const Vec3&)> roughness(int side, double grain, double bias,
                                             test::Random& random) {
  const auto n = static_cast<std::size_t>(side);
  std::vector<double> values(n * n * n);
  for (double& value : values) value = bias + random.uniform(-1.0, 1.0);
  return [=](const Vec3& p) { return betweenCorners(values, n, p / grain); };
}

}  // namespace

TEST_CASE("a solid of 1.5 voxels is not crossed at 2 m/s, except for 0.2 % of presses on thin fog",
          "[motion][release]") {
  // The requirement is for loads of 0.6 times the strength, the goal for 0.9.
  const long count = test::cases(1000);
  long strokes = 0;
  long crossed = 0;
  // At level 0.25, a fog shell of one voxel is 1.5 voxels thick.
  for (const Shell& shell :
       {makeShell("level set", 1.5), makeShell("level set", 2.0), makeShell("level set", 3.0),
        makeShell("fog", 2.0), makeShell("fog", 1.0, 0.25)}) {
    for (const double load : {0.6, 0.9}) {
      for (const double degrees : {0.0, 45.0, 72.0}) {
        const ShellResult r = pressShell(shell, degrees, load, count, {});
        CAPTURE(shell.name, load, degrees, r.samples, r.most_samples, r.cells, r.most_cells);
        // At load 0.9, bumps of the thinnest fog bear more than the strength, so some oblique
        // strokes yield or cross.
        const bool bumpy = shell.level < 0.5 && load > 0.6 && degrees > 0.0;
        CHECK(r.yielded <= (bumpy ? std::max(count / 100, 1L) : 0));
        CHECK(r.crossed <= (bumpy ? std::max(count / 500, 1L) : 0));
        strokes += count;
        crossed += r.crossed;
        CHECK(r.most_samples <= 16 + 2);
      }
    }
  }
  std::cout << "crossed: " << crossed << " of " << strokes << " strokes\n";
}

TEST_CASE("of presses on one voxel at most 2.5 % cross a level set, 9 % a fog, 40 % a binary fog",
          "[motion][release]") {
  // The surface of a binary fog has steps, and oblique strokes press on the sides of the steps, so
  // many strokes cross.
  const long count = test::cases(1000);
  const auto of = [&](long in_1000) { return std::max(in_1000 * count / 1000, 2L); };
  struct Case {
    Shell shell;
    long crossed;  // limit for 1,000 strokes at load 0.9; the limit at load 0.6 is five
    long yielded;
  };
  for (const auto& [shell, crossed, yielded] : {Case{makeShell("level set", 1.0), 25, 30},
                                                {makeShell("fog", 1.0), 90, 80},
                                                {makeShell("binary fog", 1.0, 0.25), 400, 330}}) {
    for (const double degrees : {0.0, 45.0, 72.0}) {
      for (const bool hard : {false, true}) {
        const ShellResult r = pressShell(shell, degrees, hard ? 0.9 : 0.6, count, {});
        CAPTURE(shell.name, degrees, hard, r.crossed, r.yielded);
        CHECK(r.crossed <= of(hard ? crossed : 5));
        CHECK(r.yielded <= of(hard ? yielded : 5));
      }
    }
  }
}

TEST_CASE("under a deeply pressing hand the proxy enters a groove's walls by less than a voxel",
          "[motion]") {
  // A move along one wall's plane would lead behind the other wall. Angles are in degrees.
  for (const double opening : {30.0, 60.0, 88.0, 120.0}) {
    for (const double deep : {3.0, 16.0}) {
      for (int turned = 0; turned < test::share(6); ++turned) {
        const Mat3 frame = anyFrame(turned);
        const Vec3 edge(24.3, 23.7, 24.45);
        const double half = opening * std::numbers::pi / 360.0;
        const Vec3 a = frame * Vec3(std::sin(half), std::cos(half), 0.0);
        const Vec3 b = frame * Vec3(std::sin(half), -std::cos(half), 0.0);
        const auto free = [&](const Vec3& p) { return std::min(a.dot(p - edge), b.dot(p - edge)); };
        SurfaceMotion groove;
        groove.field = scalarGrid(48, free);
        const Stepper tick = engineOn(groove, ModeKind::kIsosurface, {}, 60.0);
        double deepest = 0.0;
        for (int t = 0; t < 3000; ++t) {
          // The hand moves in, then back and forth along the edge, and a little to the sides.
          const double along = t < 300 ? 0.0 : 6.0 * std::asin(std::sin(0.06 * (t - 300)));
          const double aside = t < 300 ? 0.0 : 1.5 * std::sin(0.013 * (t - 300));
          const Vec3 hand =
              edge + frame * Vec3(6.0 - (6.0 + deep) * std::min(1.0, t / 300.0), aside, along);
          deepest = std::min(deepest, free(tick(kVoxel * hand).proxy / kVoxel));
        }
        CAPTURE(opening, deep, turned);
        // Trilinear interpolation rounds the edge by up to a voxel.
        CHECK(deepest > -1.0);
      }
    }
  }
}

TEST_CASE("a hand beyond the walls of a hollow box does not pull the proxy out of the box",
          "[motion]") {
  for (const double beyond : {3.0, 20.0}) {
    for (const double speed : {1.0, 3.0}) {
      for (int turned = 0; turned < test::share(6); ++turned) {
        const Mat3 frame = anyFrame(turned);
        constexpr double kHalf = 9.0;
        const Vec3 middle(24.3, 23.7, 24.45);
        const auto free = [&](const Vec3& p) {
          return kHalf - (frame.transpose() * (p - middle)).cwiseAbs().maxCoeff();
        };
        SurfaceMotion box;
        box.field = scalarGrid(48, free);
        const Stepper tick = engineOn(box, ModeKind::kIsosurface, {}, 60.0);
        double deepest = 0.0;
        for (int t = 0; t < 4000; ++t) {
          const double r = (kHalf + beyond) * std::min(1.0, t / 300.0);
          const double angle = speed * 1e-3 * t;
          const Vec3 hand =
              middle + r * frame * Vec3(std::cos(angle), std::sin(angle), std::sin(0.7 * angle));
          deepest = std::min(deepest, free(tick(kVoxel * hand).proxy / kVoxel));
        }
        CAPTURE(beyond, speed, turned);
        CHECK(deepest > -1.0);
      }
    }
  }
}

TEST_CASE("a rough solid holds a pressing hand with at most 1.01 times its strength",
          "[motion][release]") {
  // A load above the strength must always move the proxy through the solid.
  constexpr double kStrength = 1.0;  // [N]
  constexpr int kSide = 24;
  const long count = test::cases(6);
  std::uint64_t setting = 0;
  for (const double grain : {1.0, 2.0, 4.0}) {      // voxels
    for (const double bias : {0.0, 0.3}) {          // half or two thirds of the space are free
      for (const double step : {0.06, 0.3, 1.0}) {  // voxels per tick
        double hardest = 0.0;
        ++setting;
        std::vector<std::uint64_t> seeds(static_cast<std::size_t>(count));
        std::iota(seeds.begin(), seeds.end(), 1000 * setting);
        // These seeds have the largest known loads.
        if (setting == 2) seeds.push_back(2337);
        if (setting == 3) seeds.insert(seeds.end(), {3116, 3148});
        for (const std::uint64_t seed : seeds) {
          test::Random random(seed);
          SurfaceMotion rough;
          rough.field = scalarGrid(kSide, roughness(kSide, grain, bias, random));
          for (int press = 0; press < 10; ++press) {
            const Stepper tick = engineOn(rough, ModeKind::kIsosurface, {}, kStrength);
            const Vec3 way = random.direction();
            const Vec3 middle = Vec3::Constant(0.5 * kSide) + random.inCube(4.0);
            double most = 0.0;
            const auto ticks = static_cast<int>(44.0 / step);
            for (int t = 0; t < ticks; ++t) {
              const Vec3 hand = kVoxel * (middle + (step * t - 18.0) * way);
              most = std::max(most, kMotionStiffness * (tick(hand).proxy - hand).norm());
            }
            hardest = std::max(hardest, most);
          }
        }
        CAPTURE(grain, bias, step, hardest);
        // The margin of 1 % is 0.026 voxel, as the spring is 2.56 voxels long.
        CHECK(hardest <= 1.01 * kStrength);
        CHECK(hardest > (count < 6 ? 0.2 : 0.9) * kStrength);
      }
    }
  }
}

}  // namespace palpate::shell_test
