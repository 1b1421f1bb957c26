/// Tests the smoothing of a grid by a Gaussian at load.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <catch2/catch.hpp>
#include <openvdb/tools/Composite.h>
#include <openvdb/tools/LevelSetSphere.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume.h"
#include "palpate/samplers/grid/volume_grid.h"
#include "tests/support/random.h"
#include "tests/support/vdb_grids.h"

namespace palpate::smooth_test {
using namespace palpate::test;
using Catch::Contains;
using openvdb::Coord;
using openvdb::Vec3d;
using openvdb::math::Transform;

namespace {

std::shared_ptr<const Volume> smoothed(const openvdb::GridBase::Ptr& grid, double sigma,
                                       bool in_file_units = false) {
  const TemporaryFolder folder;
  writeVdb(folder / "a.vdb", {grid});
  LoadOptions options;
  options.smooth = {sigma, in_file_units};
  return loadVolume(folder / "a.vdb", "", options);
}

template <class GridT>
const GridT& gridOf(const Volume& volume) {
  return *std::get<typename GridT::ConstPtr>(volume.grid().parts.front().data);
}

/// Returns the Gaussian mean about a voxel, summed over three standard deviations to each side.
template <class GridT>
Vec3d gaussianMean(const GridT& grid, const Coord& c, const Vec3& sigma) {
  std::array<int, 3> reach{};
  for (int a = 0; a < 3; ++a) reach[static_cast<std::size_t>(a)] = static_cast<int>(3.0 * sigma[a]);
  Vec3d sum(0.0);
  double whole = 0.0;
  for (int i = -reach[0]; i <= reach[0]; ++i) {
    for (int j = -reach[1]; j <= reach[1]; ++j) {
      for (int k = -reach[2]; k <= reach[2]; ++k) {
        const double weight = std::exp(-0.5 * Vec3(i, j, k).cwiseQuotient(sigma).squaredNorm());
        sum += weight * Vec3d(grid.tree().getValue(c.offsetBy(i, j, k)));
        whole += weight;
      }
    }
  }
  return sum / whole;
}

/// Returns a grid with random active, inactive and absent voxels. The grid also has an active and
/// an inactive tile of 8^3 voxels, and active tiles of 128^3 and of 4096^3 voxels.
template <class GridT>
typename GridT::Ptr noiseWithTiles() {
  using Value = typename GridT::ValueType;
  openvdb::initialize();
  Random random(8);
  const auto draw = [&] {
    if constexpr (std::is_arithmetic_v<Value>) {
      return static_cast<Value>(random.uniform(-1, 1));
    } else {
      return Value(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
    }
  };
  auto grid = GridT::create(Value(0.75));
  grid->setName("noise");
  for (auto c = openvdb::CoordBBox(Coord(-9), Coord(13)).begin(); c; ++c) {
    const double kind = random.uniform(0, 3);
    if (kind < 1.0) grid->tree().setValueOn(*c, draw());
    if (kind > 2.0) grid->tree().setValueOff(*c, draw());
  }
  grid->tree().addTile(1, Coord(-16, 0, 0), Value(2.0), true);
  grid->tree().addTile(1, Coord(16, 0, 0), Value(-1.5), false);
  grid->tree().addTile(2, Coord(128, 0, 0), Value(0.25), true);
  grid->tree().addTile(3, Coord(4096, 0, 0), Value(0.5), true);
  return grid;
}

/// Checks random voxels of a smoothed volume against the mean over the original grid.
template <class GridT>
void requireGaussian(const GridT& grid, const Volume& volume, const Vec3& sigma) {
  const auto& is = gridOf<GridT>(volume);
  Random random(3);
  for (int i = 0; i < 3000; ++i) {
    const Vec3 p = i % 3 == 0 ? Vec3(128 + random.uniform(-5, 5), random.uniform(0, 128),
                                     random.uniform(0, 128))
                              : Vec3(random.inCube(24.0));
    const Coord c = Coord::floor(Vec3d(p.x(), p.y(), p.z()));
    const Vec3d expected = gaussianMean(grid, c, sigma);
    const Vec3d was(grid.tree().getValue(c));
    const Vec3d background(grid.background());
    CAPTURE(c, expected);
    REQUIRE((Vec3d(is.tree().getValue(c)) - expected).length() < 2e-6);
    const bool moved = (expected - was).length() > 1e-5 && (expected - background).length() > 1e-5;
    if (grid.tree().isValueOn(c) || moved) REQUIRE(is.tree().isValueOn(c));
    if (!grid.tree().isValueOn(c) && expected == was) REQUIRE_FALSE(is.tree().isValueOn(c));
  }
}

/// Returns the distance from the origin at which a field crosses a level along a direction.
double radiusAlong(const ScalarField& field, const Vec3& direction, double level, double most) {
  FieldCache cache;
  field.reset(cache);
  double low = 0.0;
  double high = most;
  const bool inner = field.sample(Vec3::Zero(), cache).value > level;
  for (int n = 0; n < 40; ++n) {
    const double middle = 0.5 * (low + high);
    ((field.sample(middle * direction, cache).value > level) == inner ? low : high) = middle;
  }
  return low;
}

double meanRadius(const Volume& volume, const ScalarField& field, double level, double most) {
  Random random(4);
  double sum = 0.0;
  for (int i = 0; i < 200; ++i) sum += radiusAlong(field, random.direction(), level, most);
  return sum / 200.0 / volume.info().voxel.x();
}

}  // namespace

TEMPLATE_TEST_CASE("smoothing equals a Gaussian sum over all voxels and the background",
                   "[samplers][smooth]", openvdb::FloatGrid, openvdb::DoubleGrid,
                   openvdb::Vec3SGrid, openvdb::Vec3DGrid) {
  const auto grid = noiseWithTiles<TestType>();
  const auto volume = smoothed(grid, 1.3);
  requireGaussian(*grid, *volume, Vec3::Constant(1.3));
  CHECK(volume->info().smoothing.sigma == 1.3);
  CHECK(volume->info().background == Approx(Vec3d(grid->background()).length() *
                                            (volume->info().vector ? 1.0 : 1.0 / std::sqrt(3.0))));
  // In large tiles, only the faces may get leaves.
  const auto& tree = gridOf<TestType>(*volume).tree();
  CHECK(tree.probeConstLeaf(Coord(130, 64, 64)) != nullptr);
  CHECK(tree.probeConstLeaf(Coord(192, 64, 64)) == nullptr);
  CHECK(tree.probeConstLeaf(Coord(4096 + 2048, 2048, 2048)) == nullptr);
  CHECK(tree.isValueOn(Coord(4096 + 2048, 2048, 2048)));
}

TEST_CASE(
    "a smoothing width in the file's unit is the same length along axes of unequal voxel sizes",
    "[samplers][smooth]") {
  const auto grid = noiseWithTiles<openvdb::FloatGrid>();
  auto transform = Transform::createLinearTransform(1.0);
  transform->postScale(Vec3d(0.5, 0.25, 0.4));
  transform->postShear(0.3, openvdb::math::X_AXIS, openvdb::math::Y_AXIS);
  grid->setTransform(transform);
  const Vec3d edges = grid->voxelSize();
  const auto volume = smoothed(grid, 0.5, true);
  requireGaussian(*grid, *volume, 0.5 * Vec3(1 / edges.x(), 1 / edges.y(), 1 / edges.z()));
  CHECK(volume->info().smoothing.sigma == Approx(0.5 / edges.y()));
}

TEST_CASE(
    "smoothing reports its RMS and largest change and the wavelength that keeps half its height",
    "[samplers][smooth]") {
  const double sigma = GENERATE(0.8, 2.0);
  Random random(8);
  const auto unit = Transform::createLinearTransform(1.0);
  const auto noise = makeGrid<openvdb::FloatGrid>(
      30, unit, [&](const Vec3d&) { return static_cast<float>(random.uniform(-1, 1)); });
  const auto volume = smoothed(noise, sigma);
  const Smoothing said = volume->info().smoothing;
  double squares = 0.0;
  double largest = 0.0;
  for (auto value = noise->cbeginValueOn(); value; ++value) {
    const double now = gridOf<openvdb::FloatGrid>(*volume).tree().getValue(value.getCoord());
    squares += std::pow(now - *value, 2);
    largest = std::max(largest, std::abs(now - *value));
  }
  CHECK(said.rms_change == Approx(std::sqrt(squares / 27000.0)));
  CHECK(said.largest_change == Approx(largest));

  const double k = 2.0 * M_PI / said.half_height_voxels;
  const auto wave = makeGrid<openvdb::FloatGrid>(
      64, unit, [&](const Vec3d& p) { return static_cast<float>(std::cos(k * (p.x() - 32.0))); });
  CHECK(gridOf<openvdb::FloatGrid>(*smoothed(wave, sigma)).tree().getValue(Coord(32)) ==
        Approx(0.5).epsilon(0.02));
}

TEST_CASE(
    "a smoothed mask has the same surface whether its surroundings are active, inactive or "
    "absent",
    "[samplers][smooth]") {
  constexpr double kRadius = 7.2;
  const float background = GENERATE(0.0F, -1000.0F);
  const double sigma = GENERATE(1.0, 1.63, 2.83);
  const double level = 0.5 * (1.0 + background);
  std::array<double, 3> radius{};
  for (std::size_t kind = 0; kind < 3; ++kind) {
    const auto grid = openvdb::FloatGrid::create(background);
    grid->setName("mask");
    for (auto c = openvdb::CoordBBox(Coord(-20), Coord(20)).begin(); c; ++c) {
      const bool in = (*c).asVec3d().length() < kRadius;
      const float value = in ? 1.0F : background;
      if (in || kind == 0) grid->tree().setValueOn(*c, value);
      if (!in && kind == 1) grid->tree().setValueOff(*c, value);
    }
    const auto volume = smoothed(grid, sigma);
    const auto field = std::get<0>(makeVdbField(volume, {}));
    radius[kind] = meanRadius(*volume, *field, level, 12.0);
    // The bounds, which determine the placement, are those before smoothing. The field has data
    // beyond the surface.
    const double edge = kind == 0 ? 20.0 : 7.0;
    CHECK(volume->info().bounds.upper == Vec3::Constant(edge));
    FieldCache cache;
    field->reset(cache);
    CHECK(field->sample({9.0, 0, 0}, cache).inside);
    CHECK(field->frame().bounds.upper.x() > 9.0);
  }
  CHECK(radius[1] == Approx(radius[0]).margin(0.001));
  CHECK(radius[2] == Approx(radius[0]).margin(0.001));
  // Smoothing moves the ball's surface inwards by about sigma^2 / R.
  CHECK(radius[0] == Approx(kRadius - sigma * sigma / kRadius).margin(0.35));
}

TEST_CASE("a smoothed ball of distances shrinks only by its curvature and stays a level set",
          "[samplers][smooth]") {
  constexpr double kRadius = 20.0;
  constexpr double kVoxel = 0.1;
  const double sigma = GENERATE(0.8, 1.0, 2.0);
  const auto ball = makeBall(kRadius * kVoxel, kVoxel);
  const auto volume = smoothed(ball, sigma);
  const auto field = std::get<0>(makeVdbField(volume, {}));
  const double moved = meanRadius(*volume, *field, 0.0, 2.5) - kRadius;
  const double before =
      meanRadius(*volume, *std::get<0>(makeVdbField(smoothed(ball, 0.0), {})), 0.0, 2.5) - kRadius;
  CAPTURE(sigma, moved, before);
  CHECK(moved - before == Approx(-sigma * sigma / kRadius).margin(0.02));
  CHECK(volume->info().smoothing.largest_change < 0.1);
  // The values are again distances, in a band of the same width.
  FieldCache cache;
  field->reset(cache);
  Random random(5);
  for (int i = 0; i < 500; ++i) {
    const double depth = random.uniform(-1.1, 1.1) * kVoxel;
    const Vec3 p = (kRadius * kVoxel + depth) * random.direction();
    const ScalarSample s = field->sample(p, cache);
    CAPTURE(depth / kVoxel);
    REQUIRE(s.inside);
    REQUIRE(s.value == Approx(depth - moved * kVoxel).margin(0.15 * kVoxel));
    REQUIRE(s.gradient.norm() == Approx(1.0).margin(0.2));
  }
  const auto& grid = gridOf<openvdb::FloatGrid>(*volume);
  CHECK(grid.background() == ball->background());
  CHECK(grid.tree().getValue(Coord(0)) == -ball->background());
  CHECK_FALSE(grid.tree().isValueOn(Coord(0)));
  CHECK(grid.activeVoxelCount() < ball->activeVoxelCount() * 12 / 10);
}

TEST_CASE("smoothing that would remove the whole surface is refused", "[samplers][smooth]") {
  const auto small =
      openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(0.5F, openvdb::Vec3f(0), 0.1F, 3.0F);
  small->setName("small");
  CHECK_THROWS_WITH(smoothed(small, 6.0), Contains("smoothing removes its whole surface"));
  // Beside a larger body, only the small body vanishes.
  const auto far = openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(
      3.0F, openvdb::Vec3f(6, 0, 0), 0.1F, 3.0F);
  openvdb::tools::csgUnion(*small, *far);
  small->setName("both");
  const auto both = smoothed(small, 6.0);
  const auto& tree = gridOf<openvdb::FloatGrid>(*both).tree();
  CHECK(tree.getValue(Coord(0)) == small->background());
  CHECK(tree.getValue(Coord(60, 0, 0)) == -small->background());
}

TEST_CASE("smoothing keeps the inactive voxels around a grid from a mesh inactive",
          "[samplers][smooth]") {
  const auto grid =
      makeGrid<openvdb::FloatGrid>(12, Transform::createLinearTransform(1.0),
                                   [](const Vec3d& p) { return static_cast<float>(1.0 + p.x()); });
  grid->insertMeta("imported_from", openvdb::StringMetadata("mesh"));
  const auto volume = smoothed(grid, 1.0);
  CHECK(volume->info().active_voxels == 12 * 12 * 12);
  CHECK(volume->info().smoothing.rms_change > 0.0);
}

TEST_CASE("a smoothing width out of range and a level set whose voxels are not cubes are refused",
          "[samplers][smooth]") {
  const auto ball = makeBall(1.0, 0.1);
  for (const double sigma : {-1.0, 32.5, std::numeric_limits<double>::quiet_NaN()}) {
    CHECK_THROWS_WITH(smoothed(ball, sigma), Contains("give a width from 0 to 32 voxels"));
  }
  CHECK_THROWS_WITH(smoothed(ball, 4.0, true), Contains("\"smooth\" is 40"));
  auto flat = Transform::createLinearTransform(1.0);
  flat->postScale(Vec3d(1, 1, 2));
  ball->setTransform(flat);
  CHECK_THROWS_WITH(smoothed(ball, 1.0), Contains("cannot be smoothed"));
}

}  // namespace palpate::smooth_test
