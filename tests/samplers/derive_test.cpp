#include "palpate/samplers/grid/derive.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>

#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "tests/support/counters.h"
#include "tests/support/probe.h"
#include "tests/support/random.h"
#include "tests/support/vdb_grids.h"

namespace palpate::derive_test {
using namespace palpate::test;
using Catch::Contains;
using openvdb::Coord;
using openvdb::Vec3d;
using openvdb::Vec3f;
using openvdb::math::Transform;

namespace {

Vec3 eigen(const Vec3d& v) {
  return {v.x(), v.y(), v.z()};
}

/// Writes grids to a file and loads them with the loader.
std::shared_ptr<const Volume> load(const openvdb::GridPtrVec& grids, const std::string& name) {
  const TemporaryFolder folder;
  writeVdb(folder / "a.vdb", grids);
  return loadVolume(folder / "a.vdb", name);
}

/// Returns a transform with rotation and translation, whose axes are neither orthogonal nor of
/// equal length.
Transform::Ptr skewed(double voxel = 0.1) {
  openvdb::Mat4R matrix = openvdb::Mat4R::identity();
  const std::array<std::array<double, 3>, 3> rows{
      {{1.0, 0.3, -0.2}, {-0.4, 1.5, 0.1}, {0, 0.5, 2}}};
  for (int a = 0; a < 3; ++a) {
    for (int i = 0; i < 3; ++i) {
      matrix(a, i) = voxel * rows[static_cast<std::size_t>(a)][static_cast<std::size_t>(i)];
    }
    matrix(3, a) = 0.7 - a;
  }
  return Transform::createLinearTransform(matrix);
}

/// Returns a grid of random voxels with gaps, an active tile of 8^3 voxels, and an active tile of
/// 128^3 voxels.
template <class GridT>
typename GridT::Ptr rough(const typename GridT::ValueType& tile) {
  openvdb::initialize();
  Random random(1);
  using Value = typename GridT::ValueType;
  const auto value = [&]() -> Value {
    if constexpr (std::is_arithmetic_v<Value>) {
      return static_cast<Value>(random.uniform(-1, 1));
    } else {
      return Value(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
    }
  };
  auto grid = GridT::create(value());
  auto accessor = grid->getAccessor();
  for (int i = 0; i < 8000; ++i) {
    const Vec3 p = random.inCube(14.0);
    accessor.setValue(Coord::round(Vec3d(p.x(), p.y(), p.z())), value());
  }
  grid->tree().addTile(1, Coord(16, 16, 16), tile, true);
  grid->tree().addTile(2, Coord(128, 0, 0), tile, true);
  accessor.setValue(Coord(127, 3, 3), value());
  grid->setTransform(skewed());
  grid->setName("rough");
  return grid;
}

/// The Arnold-Beltrami-Childress flow with wave number 1, which equals its curl.
Vec3d abc(const Vec3d& p) {
  return {std::sin(p.z()) + 0.5 * std::cos(p.y()), 0.8 * std::sin(p.x()) + std::cos(p.z()),
          0.5 * std::sin(p.y()) + 0.8 * std::cos(p.x())};
}

Vec3 stored(Probe& probe, const Vec3& p) {
  if (probe.field.index() == 0) return {probe.scalar(p).value, 0, 0};
  return probe.vector(p).value;
}

constexpr std::array kOfVectors{Derivation::kMagnitude, Derivation::kDivergence, Derivation::kQ,
                                Derivation::kLambda2,   Derivation::kCurl,       Derivation::kUnit};

}  // namespace

TEST_CASE("voxels of a derived grid equal the values that are derived on the fly",
          "[samplers][derive]") {
  const auto grid = rough<openvdb::Vec3SGrid>(Vec3f(1, -2, 0.5));
  const auto volume = load({grid}, "rough");
  Probe source(volume);
  for (const Derivation what : kOfVectors) {
    CAPTURE(wordFor(what));
    const auto made = deriveVolume(volume, what);
    CHECK(made->info().name == std::string(wordFor(what)) + " of rough");
    CHECK(made->info().vector == kindOf(what).vector);
    CHECK(made->info().active_voxels == volume->info().active_voxels);
    CHECK((made->info().bounds.lower - volume->info().bounds.lower).norm() < 1e-12);
    CHECK((made->info().voxel - volume->info().voxel).norm() < 1e-12);
    CHECK(made->info().memory > 0);
    Probe probe(made);
    double worst = 0.0;
    double largest = 0.0;
    long count = 0;
    const auto compare = [&](const Coord& at) {
      const Vec3 p = eigen(grid->transform().indexToWorld(at));
      const Vec3 truth = onTheFly(what, source.vector(p));
      worst = std::max(worst, (stored(probe, p) - truth).norm());
      largest = std::max(largest, truth.norm());
      ++count;
    };
    for (auto leaf = grid->tree().cbeginLeaf(); leaf; ++leaf) {
      for (auto voxel = leaf->cbeginValueOn(); voxel; ++voxel) compare(voxel.getCoord());
    }
    // Compares voxels at the faces, edges, corners and in the interior of the tiles.
    for (const int x : {16, 17, 20, 23}) {
      for (const int y : {16, 19, 23}) {
        for (const int z : {16, 22, 23}) compare({x, y, z});
      }
    }
    for (const int x : {128, 129, 135, 136, 200, 254, 255}) {
      for (const int y : {0, 3, 60, 127}) {
        for (const int z : {0, 3, 77, 127}) compare({x, y, z});
      }
    }
    CHECK(count > 5000);
    // The error comes from the skewed transform, and from rounding positions and values to floats.
    CHECK(worst < 3e-6 * largest);
  }
}

TEST_CASE("a derived gradient grid equals the gradient read on the fly", "[samplers][derive]") {
  const auto grid = rough<openvdb::DoubleGrid>(2.0);
  const auto volume = load({grid}, "rough");
  const auto made = deriveVolume(volume, Derivation::kGradient);
  const auto steepness = deriveVolume(made, Derivation::kMagnitude);
  CHECK(made->info().type == "vec3d");
  CHECK(steepness->info().type == "double");
  Probe source(volume);
  Probe gradient(made);
  Probe magnitude(steepness);
  double worst = 0.0;
  for (auto leaf = grid->tree().cbeginLeaf(); leaf; ++leaf) {
    for (auto voxel = leaf->cbeginValueOn(); voxel; ++voxel) {
      const Vec3 p = eigen(grid->transform().indexToWorld(voxel.getCoord()));
      const Vec3 truth = source.scalar(p).gradient;
      worst = std::max(worst, (gradient.vector(p).value - truth).norm());
      worst = std::max(worst, std::abs(magnitude.scalar(p).value - truth.norm()));
    }
  }
  CHECK(worst < 1e-10);
}

TEST_CASE("derived grids converge to the exact properties of a flow, in the placement's axes",
          "[samplers][derive]") {
  std::map<Derivation, std::vector<double>> errors;
  Placement placement;
  placement.scale = 0.02;
  placement.rotation = Eigen::AngleAxisd(0.7, Vec3(1, 2, 3).normalized()).matrix();
  for (const double voxel : {0.2, 0.1}) {
    const int n = static_cast<int>(4.0 / voxel);
    const auto volume = load({makeGrid<openvdb::Vec3DGrid>(n, skewed(voxel), abc, "flow")}, "flow");
    Probe spin(makeVdbField(deriveVolume(volume, Derivation::kCurl), placement));
    Probe source(makeVdbField(deriveVolume(volume, Derivation::kDivergence), placement));
    Random random(3);
    double curl_error = 0.0;
    double divergence_error = 0.0;
    for (int i = 0; i < 2000; ++i) {
      const Vec3 index = Vec3::Constant(0.5 * n) + random.inCube(0.5 * n - 3.0);
      const Vec3d p_F = skewed(voxel)->indexToWorld(Vec3d(index.x(), index.y(), index.z()));
      const Vec3 p_W = placement(eigen(p_F));
      const Vec3 truth = placement.rotation * eigen(abc(p_F));
      curl_error = std::max(curl_error, (spin.vector(p_W).value - truth).norm());
      divergence_error = std::max(divergence_error, std::abs(source.scalar(p_W).value));
    }
    errors[Derivation::kCurl].push_back(curl_error);
    errors[Derivation::kDivergence].push_back(divergence_error);
  }
  CHECK(errors[Derivation::kCurl][1] < 0.06);
  CHECK(errors[Derivation::kCurl][0] / errors[Derivation::kCurl][1] > 3.4);
  CHECK(errors[Derivation::kDivergence][0] / errors[Derivation::kDivergence][1] > 3.0);
}

TEST_CASE("lambda2 and curl of a staggered vector are those that are derived on the fly",
          "[samplers][derive]") {
  const auto transform = Transform::createLinearTransform(0.1);
  auto grid = makeGrid<openvdb::Vec3SGrid>(
      24, transform, [](const Vec3d& p) { return Vec3f(-p.y(), p.x(), 2.0 * p.z()); }, "flow");
  grid->setGridClass(openvdb::GRID_STAGGERED);
  const auto volume = load({grid}, "flow");
  REQUIRE(volume->info().vector);
  const auto core = deriveVolume(volume, Derivation::kLambda2);
  const auto spin = deriveVolume(volume, Derivation::kCurl);
  CHECK(core->info().type == "float");
  CHECK(core->info().active_voxels <= 24 * 24 * 24);
  Probe source(volume);
  Probe lambda(core);
  Probe curls(spin);
  const Vec3 p(1.03, 0.98, 1.11);
  REQUIRE(lambda.scalar(p).inside);
  CHECK(lambda.scalar(p).value == Approx(lambda2(source.vector(p).jacobian)).epsilon(1e-4));
  CHECK((curls.vector(p).value - curl(source.vector(p).jacobian)).norm() < 1e-4);
}

TEST_CASE("at the end of the data a vector's derivatives use only the data", "[samplers][derive]") {
  // The flow has curl 2 and divergence 2, and its values are far from zero.
  const auto flow = [](const Vec3d& p) { return Vec3f(20.0 - p.y(), 5.0 + p.x(), 2.0 * p.z()); };
  const auto transform = Transform::createLinearTransform(0.5);
  const auto grid = makeGrid<openvdb::Vec3SGrid>(9, transform, flow, "flow");
  const bool staggered = GENERATE(false, true);
  if (staggered) grid->setGridClass(openvdb::GRID_STAGGERED);
  const auto volume = load({grid}, "flow");
  Probe source(volume);
  Probe curls(deriveVolume(volume, Derivation::kCurl));
  Random random(7);
  Box in = volume->info().bounds;
  // The last face of a staggered component is half a voxel below the last voxel's centre.
  const Box centres = in;
  if (staggered) in.upper -= Vec3::Constant(0.25);
  double worst = 0.0;
  double lost = 0.0;
  for (int i = 0; i < 500; ++i) {
    Vec3 p;
    for (int a = 0; a < 3; ++a) {
      // Many of the points are on the faces.
      p[a] = std::clamp(random.uniform(in.lower[a] - 1.0, in.upper[a] + 1.0), in.lower[a],
                        in.upper[a]);
    }
    const VectorSample s = source.vector(p);
    worst = std::max(worst, (curl(s.jacobian) - Vec3(0, 0, 2)).norm());
    worst = std::max(worst, std::abs(divergence(s.jacobian) - 2.0));
    lost = std::max(lost, (curls.vector(p).value - Vec3(0, 0, 2)).norm());
  }
  CHECK(worst < 1e-4);
  if (!staggered) CHECK(lost < 1e-4);
  // Within one voxel beyond the last voxel, the derivatives fade to zero.
  const Vec3 out(0.0, 0.0, 0.5);
  const Vec3 middle(2.0, 2.0, centres.upper.z());
  CHECK(curl(source.vector(middle + 0.5 * out).jacobian).z() == Approx(1.0).epsilon(0.01));
  CHECK(curl(source.vector(middle + 1.01 * out).jacobian).norm() < 0.05);
}

TEST_CASE("an inactive voxel between active ones counts as data, except in a grid from a mesh",
          "[samplers][derive]") {
  // The flow is a vortex about the axis of the block. On the axis, the velocity is zero like the
  // background, and the voxels are inactive.
  const auto transform = Transform::createLinearTransform(1.0);
  const auto grid = makeGrid<openvdb::Vec3SGrid>(
      9, transform, [](const Vec3d& p) { return Vec3f(4.0 - p.y(), p.x() - 4.0, 0.0); }, "flow");
  for (int k = 0; k < 9; ++k) grid->tree().setValueOff(Coord(4, 4, k), Vec3f(0.0F));
  const Vec3 axis(4, 4, 4);
  const Vec3 beside(4, 3, 4);
  {
    Probe image(load({grid}, "flow"));
    CHECK(curl(image.vector(axis).jacobian).z() == Approx(2.0));
    CHECK(curl(image.vector(beside).jacobian).z() == Approx(2.0));
  }
  // In a grid from a mesh, an inactive voxel is outside of all cells of the mesh.
  grid->insertMeta("imported_from", openvdb::StringMetadata("mesh"));
  for (int k = 0; k < 9; ++k) grid->tree().setValueOff(Coord(4, 4, k), Vec3f(1e6F));
  const auto volume = load({grid}, "flow");
  Probe mesh(volume);
  Probe curls(deriveVolume(volume, Derivation::kCurl));
  CHECK(curl(mesh.vector(axis).jacobian).norm() == 0.0);
  CHECK(curl(mesh.vector(beside).jacobian).z() == Approx(2.0));
  CHECK(curls.vector(beside).value.z() == Approx(2.0));
  CHECK(curl(mesh.vector({3, 3, 4}).jacobian).z() == Approx(2.0));
}

TEST_CASE("at the edge of a mesh a spline's derivatives are those of the data",
          "[samplers][derive]") {
  openvdb::initialize();
  const auto grid = openvdb::Vec3SGrid::create();
  grid->insertMeta("imported_from", openvdb::StringMetadata("mesh"));
  const Mat3 J = (Mat3() << 1.0, -2.0, 0.5, 3.0, 0.25, -1.0, 2.0, 1.5, -4.0).finished();
  const auto flow = [&](const Vec3& p) { return Vec3(Vec3(50.0, -60.0, 70.0) + J * p); };
  // The data fill a box with a notch, so some edges of the data are inside the active bounding box.
  const auto isIn = [](const Coord& c) { return c.x() < 10 || c.y() < 10; };
  for (auto voxel = openvdb::CoordBBox(Coord(0), Coord(20)).begin(); voxel; ++voxel) {
    if (!isIn(*voxel)) continue;
    const Vec3 v = flow(Vec3((*voxel).x(), (*voxel).y(), (*voxel).z()));
    grid->tree().setValue(*voxel, openvdb::Vec3f(openvdb::Vec3d(v.x(), v.y(), v.z())));
  }
  const auto volume = makeVolume(*grid);
  const auto interpolation = GENERATE(Interpolation::kQuadratic, Interpolation::kCubic);
  const auto field = std::get<1>(makeVdbField(volume, {}, {interpolation}));
  FieldCache cache;
  field->reset(cache);
  for (const Vec3& p : {Vec3(0.1, 10.0, 10.0), Vec3(4.0, 19.9, 4.0), Vec3(9.0, 15.0, 10.0),
                        Vec3(8.7, 15.2, 0.3), Vec3(15.0, 8.9, 19.8), Vec3(9.5, 9.5, 10.0)}) {
    const VectorSample s = field->sample(p, cache);
    CAPTURE(p, s.jacobian);
    CHECK(s.inside);
    CHECK((s.value - flow(p)).norm() < 0.1);
    CHECK((s.jacobian - J).norm() < 0.1);
  }
}

TEST_CASE("a field that is derived from an image has no data beside the image's missing voxels",
          "[samplers]") {
  openvdb::initialize();
  const auto grid = openvdb::Vec3SGrid::create(Vec3f(0.0F));
  grid->setName("v");
  grid->insertMeta("inactive_is_missing", openvdb::BoolMetadata(true));
  for (auto at = openvdb::CoordBBox(Coord(0), Coord(11)).begin(); at; ++at) {
    if ((*at).x() >= 5 || (*at).y() >= 5) grid->tree().setValue(*at, Vec3f(3.0F, 4.0F, 0.0F));
  }
  Probe speed(makeVdbField(deriveVolume(load({grid}, "v"), Derivation::kMagnitude), {}));
  CHECK_FALSE(speed.scalar(Vec3(4.5, 2.3, 2.3)).inside);
  CHECK_FALSE(speed.scalar(Vec3(4.99, 4.99, 2.3)).inside);
  const ScalarSample beside = speed.scalar(Vec3(5.01, 2.3, 2.3));
  CHECK(beside.inside);
  CHECK(beside.value == Approx(5.0));
}

TEST_CASE("a derivation of a wrong type or beyond the range of floats is refused",
          "[samplers][derive]") {
  const auto transform = Transform::createLinearTransform(1.0);
  const auto vectors =
      load({makeGrid<openvdb::Vec3SGrid>(
               4, transform, [](const Vec3d& p) { return Vec3f(1e30 * p.y(), 1e30 * p.x(), 0); },
               "flow")},
           "flow");
  CHECK_THROWS_WITH(deriveVolume(vectors, Derivation::kGradient),
                    "grid \"flow\": it is a vector: for gradient give a scalar grid");
  CHECK_THROWS_WITH(
      deriveVolume(vectors, Derivation::kQ),
      Contains("grid \"flow\": its q is outside the range of float at") && Contains("scale"));
  CHECK_NOTHROW(deriveVolume(vectors, Derivation::kCurl));
  const auto scalars = load({makeBall(1.0, 0.1)}, "ball");
  CHECK_THROWS_AS(deriveVolume(scalars, Derivation::kCurl), VolumeError);
  CHECK(deriveVolume(scalars, Derivation::kGradient)->info().grid_class == GridClass::kLevelSet);
}

TEST_CASE("deriving properties from samples and reading a derived grid allocate no memory",
          "[samplers][derive][realtime]") {
  const auto volume = load({makeGrid<openvdb::Vec3SGrid>(
                               20, skewed(), [](const Vec3d& p) { return Vec3f(abc(p)); }, "flow")},
                           "flow");
  Probe source(volume);
  Probe made(deriveVolume(volume, Derivation::kLambda2));
  Random random(5);
  double sum = 0.0;
  long allocations = 0;
  {
    const CountScope count;
    for (int i = 0; i < 1000; ++i) {
      const Vec3 p = random.inCube(3.0);
      const VectorSample s = source.vector(p);
      sum += lambda2(s.jacobian) + qCriterion(s.jacobian) + unit(s.value).x();
      sum += made.scalar(p).value;
    }
    allocations = CountScope::counts().allocations;
  }
  CHECK(std::isfinite(sum));
  CHECK(allocations == 0);
}

}  // namespace palpate::derive_test
