/// Tests the force of a level-set sphere from a .vdb file, pressed from random directions.
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <iostream>

#include <catch2/catch.hpp>

#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "tests/support/random.h"
#include "tests/support/vdb_grids.h"

namespace palpate::press_test {
using namespace palpate::test;

namespace {

constexpr double kStiffness = 500.0;

struct Pressed {
  /// RMS angle between the force and the radius [degrees].
  double direction_rms = 0.0;
  double magnitude_max = 0.0;  ///< Largest relative error of the force against k times depth.
  double leaves_rms = 0.0;     ///< RMS relative error, against s/k, of the depth of yielding.
};

/// Presses along cases(1000) directions to 2 to 8 mm below a surface of known radius. Then presses
/// until the same surface with a strength of `weak` [N] yields.
Pressed press(const std::shared_ptr<const Volume>& volume, double radius_F, double strength,
              double weak) {
  const Placement placement = fitInto(volume->info(), 0.1);
  const FieldPtr field = makeVdbField(volume, placement);
  const Vec3 centre = placement(Vec3::Zero());
  const double radius = placement.scale * radius_F;
  GraphSpec spec;
  ModeSpec mode;
  mode.kind = ModeKind::kIsosurface;
  mode.of = "ball";
  mode.solid = Solid::kBelow;
  mode.strength = strength;
  spec.modes = {mode};
  const auto hard = makeScene(spec, {{"ball", field}}, {kStiffness, 0.0});
  spec.modes[0].strength = weak;
  const auto soft = makeScene(spec, {{"ball", field}}, {kStiffness, 0.0});

  Random random(1);
  Reader reader;
  Pressed result;
  const long n = cases(1000);
  for (long i = 0; i < n; ++i) {
    const Vec3 d = random.direction();
    const double depth = random.uniform(2e-3, 8e-3);
    ProxyState state({100.0, 1e9});
    StepReport r;
    const auto at = [&](double height) {
      return hapticStep(*hard, reader, {centre + (radius + height) * d}, state, 1e-3);
    };
    for (double height = 3e-3; height > -depth; height -= 1e-4) r = at(height);
    for (int tick = 0; tick < 20; ++tick) r = at(-depth);
    const double cosine = std::clamp(r.force.normalized().dot(d), -1.0, 1.0);
    const double angle = std::acos(cosine) * 180.0 / M_PI;
    result.direction_rms += angle * angle / static_cast<double>(n);
    result.magnitude_max =
        std::max(result.magnitude_max, std::abs(r.force.norm() / (kStiffness * depth) - 1.0));

    // As in figure 6 of Lundin et al., the proxy stays on the surface until the hand is s/k below
    // the surface.
    ProxyState gentle({100.0, 1e9});
    const double reach = weak / kStiffness;
    double held = 0.0;
    double leaves = 0.0;
    for (double height = 3e-3; height > -2.0 * reach && leaves == 0.0; height -= 2e-6) {
      const StepReport s =
          hapticStep(*soft, reader, {centre + (radius + height) * d}, gentle, 1e-3);
      const double at_radius = (s.proxy - centre).norm();
      if (height > -0.5 * reach) held = at_radius;
      if (at_radius < held - 1e-6) leaves = held - (radius + height);
    }
    const double off = leaves / reach - 1.0;
    result.leaves_rms += off * off / static_cast<double>(n);
    REQUIRE(leaves > 0.0);
  }
  result.direction_rms = std::sqrt(result.direction_rms);
  result.leaves_rms = std::sqrt(result.leaves_rms);
  std::cout << "sphere of " << radius_F / volume->info().voxel.x() << " voxels pressed along " << n
            << " directions: force direction " << result.direction_rms
            << " degrees rms from radial, magnitude within " << 100 * result.magnitude_max
            << " % of k times depth, leaves at s/k within " << 100 * result.leaves_rms
            << " % rms\n";
  return result;
}

}  // namespace

TEST_CASE("a level-set sphere pressed along 1,000 directions gives the radial force k times depth",
          "[press][fig6][release]") {
  openvdb::initialize();
  const auto sphere = makeBall(3.0, 0.05);
  const TemporaryFolder folder;
  writeVdb(folder / "ball.vdb", {sphere});
  const Pressed pressed = press(loadVolume(folder / "ball.vdb", ""), 3.0, 5.0, 1.0);
  CHECK(pressed.direction_rms < 0.1);
  CHECK(pressed.magnitude_max < 0.005);
  CHECK(pressed.leaves_rms < 0.0025);
}

TEST_CASE("aswf_sphere.vdb pressed along 1,000 directions gives the radial force k times depth",
          "[.][data]") {
  const char* data = std::getenv("PALPATE_DATA");
  REQUIRE(data != nullptr);
  const auto file = std::filesystem::path(data) / "vdb" / "aswf_sphere.vdb";
  const auto volume = loadVolume(file, "ls_sphere");
  // Measures the sphere's radius along the x axis, at which the distance is zero, by bisection.
  const FieldPtr field = makeVdbField(volume, {});
  FieldCache cache;
  std::get<0>(field)->reset(cache);
  double low = 2.5;
  double high = 3.5;
  while (high - low > 1e-12) {
    const double middle = 0.5 * (low + high);
    (std::get<0>(field)->sample({middle, 0, 0}, cache).value < 0.0 ? low : high) = middle;
  }
  const Pressed pressed = press(volume, low, 5.0, 1.0);
  CHECK(low == Approx(3.0).margin(0.01));
  CHECK(pressed.direction_rms < 0.1);
  CHECK(pressed.magnitude_max < 0.005);
  CHECK(pressed.leaves_rms < 0.0025);
}

}  // namespace palpate::press_test
