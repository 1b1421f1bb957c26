/// Tests that the volumes that `palpate make` computes have the documented properties.
#include "palpate/scenes/library/made.h"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume.h"
#include "tests/support/vdb_files.h"

namespace palpate::made_test {
using Catch::Contains;

namespace {

/// Returns J_ab = d v_a / d x_b of the wind, by central differences.
Mat3 jacobian(const made::Wind& wind, const Vec3& p, double step) {
  Mat3 J;
  for (int b = 0; b < 3; ++b) {
    const Vec3 d = step * Vec3::Unit(b);
    J.col(b) = (wind.velocity(p + d) - wind.velocity(p - d)) / (2.0 * step);
  }
  return J;
}

/// Returns the integral of v dl along a circle about `centre` in a plane x = const.
template <class Velocity>
double circulation(const Velocity& velocity, const Vec3& centre, double radius) {
  constexpr int kSteps = 720;
  double sum = 0.0;
  for (int i = 0; i < kSteps; ++i) {
    const double angle = 2.0 * M_PI * (i + 0.5) / kSteps;
    const Vec3 out(0.0, std::cos(angle), std::sin(angle));
    const Vec3 along(0.0, -std::sin(angle), std::cos(angle));
    sum += velocity(Vec3(centre + radius * out)).dot(along) * (2.0 * M_PI * radius / kSteps);
  }
  return sum;
}

/// Reads a grid as a scene does, with one metre per unit of the file.
std::shared_ptr<const VectorField> vectorOf(const std::filesystem::path& file,
                                            const std::string& grid, bool axial) {
  Sampling sampling;
  sampling.axial = axial;
  return std::get<std::shared_ptr<const VectorField>>(
      makeVdbField(loadVolume(file, grid), Placement{}, sampling));
}

}  // namespace

TEST_CASE("the procedural wind has no divergence, and its vortices have the stated circulation",
          "[made]") {
  const made::Wind wind;
  std::mt19937 random(1);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  for (int i = 0; i < 500; ++i) {
    const Vec3 p(0.12 + 0.24 * unit(random), 0.24 * unit(random), 0.14 * unit(random) - 0.03);
    CAPTURE(p.transpose());
    const Mat3 J = jacobian(wind, p, 1e-5);
    CHECK(std::abs(J.trace()) < 1e-4 * (1.0 + J.norm()));
  }
  // Far behind the wing, the circulation along a circle is that of the vorticity inside the circle.
  const auto velocity = [&](const Vec3& p) { return wind.velocity(p); };
  const Vec3 right(5.0, 0.5 * wind.span, 0.0);
  const Vec3 left(5.0, -0.5 * wind.span, 0.0);
  for (const double radius : {0.015, 0.03, 0.06}) {
    const double share = radius * radius / (radius * radius + wind.core * wind.core);
    CHECK(circulation(velocity, right, radius) == Approx(share * wind.circulation).epsilon(0.01));
    CHECK(circulation(velocity, left, radius) == Approx(-share * wind.circulation).epsilon(0.01));
  }
  // On its axis, a vortex has vorticity circulation / (pi core^2), along the stream.
  const Mat3 J = jacobian(wind, right, 1e-5);
  const Vec3 curl(J(2, 1) - J(1, 2), J(0, 2) - J(2, 0), J(1, 0) - J(0, 1));
  CHECK(curl.x() == Approx(wind.circulation / (M_PI * wind.core * wind.core)).epsilon(0.01));
  CHECK(std::hypot(curl.y(), curl.z()) < 1e-3 * curl.x());
  // The wing has lift: the air is faster above it than below, and moves down behind it.
  CHECK(wind.velocity({0, 0, 0.03}).x() > wind.stream + 1.0);
  CHECK(wind.velocity({0, 0, -0.03}).x() < wind.stream - 1.0);
  CHECK(wind.velocity({0.2, 0, 0}).z() < -1.0);
  CHECK(wind.velocity({-50, 0, 0}).isApprox(Vec3(wind.stream, 0, 0), 1e-4));
}

TEST_CASE(
    "the procedural wind's voxels equal its formula, and its divergence is below 2 % of its "
    "Jacobian",
    "[made]") {
  const test::TemporaryFolder folder;
  const auto grids = writeMade("wind-tunnel", std::nullopt, folder / "wind.vdb");
  REQUIRE(grids.size() == 2);
  CHECK(grids[0].name == "velocity");
  const auto field = vectorOf(folder / "wind.vdb", "velocity", false);
  FieldCache cache;
  field->reset(cache);
  const made::Wind wind;
  std::mt19937 random(2);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  double worst = 0.0;
  double divergence2 = 0.0;
  double jacobian2 = 0.0;
  for (int i = 0; i < 2000; ++i) {
    const Vec3 p(0.12 + 0.22 * unit(random), 0.22 * unit(random), 0.12 * unit(random) - 0.03);
    const Vec3 at = 0.005 * (p / 0.005).array().round().matrix();
    worst = std::max(worst, (field->sample(at, cache).value - wind.velocity(at)).norm());
    const Mat3 J = field->sample(p, cache).jacobian;
    divergence2 += J.trace() * J.trace();
    jacobian2 += J.squaredNorm();
  }
  CHECK(worst < 1e-5);  // [m/s]; rounding of floats
  CHECK(std::sqrt(divergence2 / jacobian2) < 0.02);
  const auto velocity = [&](const Vec3& p) { return field->sample(p, cache).value; };
  for (const double sign : {1.0, -1.0}) {
    const Vec3 centre(0.3, sign * 0.5 * wind.span, 0.0);
    const auto exact = [&](const Vec3& p) { return wind.velocity(p); };
    const double turned = circulation(velocity, centre, 0.05);
    CHECK(turned == Approx(circulation(exact, centre, 0.05)).epsilon(0.01));
    CHECK(turned == Approx(sign * wind.circulation).epsilon(0.15));
  }
}

TEST_CASE("procedural level sets equal the distance to their surface", "[made]") {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  const auto slope = [](auto distance, const Vec3& p, double step) {
    Vec3 g;
    for (int a = 0; a < 3; ++a) {
      const Vec3 d = step * Vec3::Unit(a);
      g[a] = (distance(p + d) - distance(p - d)) / (2.0 * step);
    }
    return g.norm();
  };
  for (int i = 0; i < 500; ++i) {
    const Vec3 p(unit(random), unit(random), unit(random));
    const Vec3 at_bowl = 40.0 * p;
    const Vec3 at_wing = p.cwiseProduct(Vec3(0.06, 0.17, 0.03));
    CAPTURE(p.transpose());
    // Tests points outside the solid and away from the bowl's centre. Elsewhere a distance field
    // has ridges, where differences mix the slopes of two sides.
    if (made::bowl(at_bowl) > 0.0 && at_bowl.norm() > 1.0) {
      CHECK(slope(made::bowl, at_bowl, 1e-4) == Approx(1.0).epsilon(1e-3));
    }
    if (made::wing(at_wing) > 0.0) {
      CHECK(slope(made::wing, at_wing, 1e-7) == Approx(1.0).epsilon(1e-3));
    }
  }
  CHECK(made::bowl({30, 0, 0}) == Approx(-3.0));
  CHECK(made::bowl({0, 0, -20}) == Approx(7.0));
  CHECK(made::bowl({0, 0, 15}) == Approx(30.0 * std::sin(M_PI / 3.0) - 3.0));
  CHECK(made::wing(Vec3::Zero()) == Approx(-0.008));
  CHECK(made::cloud({14, 0, 8}) == 1.0);
  CHECK(made::cloud({31, 0, 8}) == Approx(0.5));
  CHECK(made::cloud({14, 0, 35}) == 0.0);
}

TEST_CASE("procedural fibres have random signs, and a lower anisotropy where they cross",
          "[made]") {
  CHECK(made::fibre({20, 0, 0}).anisotropy == Approx(0.799).margin(0.001));
  CHECK(std::abs(made::fibre({20, 0, 0}).direction.x()) == Approx(1.0));
  CHECK(made::fibre({0, 0, 0}).anisotropy == Approx(0.484).margin(0.001));
  CHECK(made::fibre({0, 20, 12}).anisotropy == 0.0);
  // On the bend, the fibres are perpendicular to the radius about (-24, 0).
  const Vec3 on_bend(-24 + 24 * std::cos(1.0), 24 * std::sin(1.0), 0.0);
  CHECK(std::abs(made::fibre(on_bend).direction.dot(Vec3(-std::sin(1.0), std::cos(1.0), 0))) ==
        Approx(1.0));
  int up = 0;
  for (int i = -10; i < 10; ++i) {
    for (int j = -10; j < 10; ++j) {
      for (int k = -10; k < 10; ++k) up += made::signAt(i, j, k) > 0.0 ? 1 : 0;
    }
  }
  CHECK(up > 3800);
  CHECK(up < 4200);

  const test::TemporaryFolder folder;
  (void)writeMade("fibres", std::nullopt, folder / "fibres.vdb");
  const auto anisotropy = loadVolume(folder / "fibres.vdb", "anisotropy");
  CHECK(anisotropy->info().lowest >= 0.0);
  CHECK(anisotropy->info().highest <= 1.0);
  const auto plain = vectorOf(folder / "fibres.vdb", "direction", false);
  const auto axial = vectorOf(folder / "fibres.vdb", "direction", true);
  FieldCache plain_cache;
  FieldCache axial_cache;
  plain->reset(plain_cache);
  axial->reset(axial_cache);
  double shortest_plain = 1.0;
  double shortest_axial = 1.0;
  for (double x = -31.5; x < -10.0; x += 1.0) {
    const Vec3 p(x, 0.5, 0.5);
    shortest_plain = std::min(shortest_plain, plain->sample(p, plain_cache).value.norm());
    shortest_axial = std::min(shortest_axial, axial->sample(p, axial_cache).value.norm());
  }
  CHECK(shortest_plain < 0.5);  // the signs cancel
  CHECK(shortest_axial > 0.99);
}

TEST_CASE("a procedural volume is reproducible, and a coarser one is as large to within 4 voxels",
          "[made][release]") {
  const test::TemporaryFolder folder;
  for (const MadeVolume& volume : madeVolumes()) {
    CAPTURE(volume.name);
    const auto first = writeMade(volume.name, std::nullopt, folder / "a.vdb");
    const auto second = writeMade(volume.name, std::nullopt, folder / "b.vdb");
    const auto coarse = writeMade(volume.name, 2.0 * volume.voxel, folder / "c.vdb");
    REQUIRE(first.size() == 2);
    const auto a = describeGrids(folder / "a.vdb");
    const auto b = describeGrids(folder / "b.vdb");
    const auto c = describeGrids(folder / "c.vdb");
    for (std::size_t i = 0; i < 2; ++i) {
      CHECK(first[i].active_voxels == second[i].active_voxels);
      CHECK(a[i].refusal.empty());
      CHECK(a[i].mean == b[i].mean);
      CHECK(a[i].lowest == b[i].lowest);
      CHECK(a[i].highest == b[i].highest);
      if (first[i].frames > 1) continue;  // displacement grids keep their voxel size
      CHECK(coarse[i].voxel == Approx(2.0 * first[i].voxel));
      CHECK((c[i].bounds.size() - a[i].bounds.size()).cwiseAbs().maxCoeff() <
            4.0 * coarse[i].voxel);
    }
    for (const GridInfo& grid : a) {
      CHECK_THAT(grid.source, Contains("palpate make " + volume.name));
    }
  }
}

TEST_CASE(
    "an unknown procedural volume and a voxel size out of range and a missing folder are rejected",
    "[made]") {
  const test::TemporaryFolder folder;
  CHECK_THROWS_WITH(writeMade("wind-tunel", std::nullopt, folder / "a.vdb"),
                    Contains("did you mean \"wind-tunnel\"?"));
  CHECK_THROWS_WITH(writeMade("teapot", std::nullopt, folder / "a.vdb"),
                    Contains("use one of wind-tunnel, fibres, two-bodies"));
  for (const double voxel : {0.0, -1.0, 9.0, std::nan("")}) {
    CHECK_THROWS_WITH(writeMade("fibres", voxel, folder / "a.vdb"),
                      Contains("--voxel") && Contains("0.25 to 3 mm"));
  }
  CHECK_THROWS_WITH(writeMade("fibres", std::nullopt, folder / "no" / "a.vdb"),
                    Contains("cannot be written"));
  CHECK_FALSE(std::filesystem::exists(folder / "a.vdb"));
}

}  // namespace palpate::made_test
