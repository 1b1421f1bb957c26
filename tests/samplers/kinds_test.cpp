/// Tests the kinds of grids that files store: staggered, by component, in index space, axial, and
/// with invalid values.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>

#include <Eigen/LU>
#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/make_volume.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume.h"
#include "tests/support/counters.h"
#include "tests/support/probe.h"
#include "tests/support/random.h"
#include "tests/support/vdb_grids.h"

namespace palpate::kinds_test {
using namespace palpate::test;
using Catch::Contains;
using openvdb::Coord;
using openvdb::Vec3d;
using openvdb::Vec3s;
using openvdb::math::Transform;

namespace {

constexpr std::array kSmooth{Interpolation::kTrilinear, Interpolation::kQuadratic,
                             Interpolation::kCubic};

Vec3 eigen(const Vec3d& v) {
  return {v.x(), v.y(), v.z()};
}

/// Returns a transform with unequal scales, shear and translation.
Transform::Ptr oblong() {
  auto transform = Transform::createLinearTransform(1.0);
  transform->postScale(Vec3d(0.5, 0.25, 0.4));
  transform->postShear(0.3, openvdb::math::X_AXIS, openvdb::math::Y_AXIS);
  transform->postTranslate(Vec3d(3.0, -2.0, 1.0));
  return transform;
}

/// Returns the vector from a voxel's centre to its lower face on one index axis.
Vec3d toFace(int axis) {
  const auto transform = oblong();
  Vec3d index(0.0);
  index[axis] = -0.5;
  return transform->indexToWorld(index) - transform->indexToWorld(Vec3d(0.0));
}

const Mat3 kSlope = (Mat3() << 0.5, -1.0, 2.0, 0.25, 0.75, -0.5, 1.5, 0.0, -1.25).finished();
const Vec3 kOffset(0.1, -0.2, 0.3);

Vec3 linear(const Vec3& p) {
  return kSlope * p + kOffset;
}

std::shared_ptr<const Volume> reload(const openvdb::GridPtrVec& grids, const std::string& name,
                                     const LoadOptions& options = {}) {
  const TemporaryFolder folder;
  writeVdb(folder / "a.vdb", grids);
  return loadVolume(folder / "a.vdb", name, options);
}

/// Checks the field's value and Jacobian at random points in the middle of the grid.
void requireLinear(const std::shared_ptr<const Volume>& volume) {
  const auto transform = oblong();
  for (const Interpolation order : kSmooth) {
    const auto field = std::get<1>(makeVdbField(volume, {}, {order}));
    FieldCache cache;
    field->reset(cache);
    Random random(3);
    for (int i = 0; i < 500; ++i) {
      const Vec3d index(random.uniform(11, 13), random.uniform(11, 13), random.uniform(11, 13));
      const Vec3 p = eigen(transform->indexToWorld(index));
      VectorSample s;
      {
        const CountScope scope;
        s = field->sample(p, cache);
        const Counts counts = CountScope::counts();
        REQUIRE(counts.allocations + counts.locks + counts.exceptions == 0);
      }
      CAPTURE(wordFor(order), p.transpose());
      REQUIRE(s.inside);
      REQUIRE((s.value - linear(p)).norm() < 1e-4);  // a spline has ripples from the grid's edge,
                                                     // eleven voxels away
      REQUIRE((s.jacobian - kSlope).norm() < 1e-3);
    }
  }
}

/// Returns component c of `linear` at the face where a staggered grid stores it.
double onFace(int c, const Vec3d& centre) {
  return linear(eigen(centre + toFace(c)))[c];
}

openvdb::FloatGrid::Ptr component(int c, const Transform::Ptr& transform) {
  return makeGrid<openvdb::FloatGrid>(
      24, transform, [=](const Vec3d& p) { return static_cast<float>(linear(eigen(p))[c]); },
      std::string("vel.") + "xyz"[c]);
}

}  // namespace

TEST_CASE("a staggered grid is read with each component at the centre of its face",
          "[samplers][kinds]") {
  auto grid = makeGrid<openvdb::Vec3SGrid>(
      24, oblong(),
      [](const Vec3d& p) { return Vec3s(Vec3d(onFace(0, p), onFace(1, p), onFace(2, p))); }, "vel");
  grid->setGridClass(openvdb::GRID_STAGGERED);
  const auto volume = reload({grid}, "");
  CHECK(volume->info().grid_class == GridClass::kStaggered);
  CHECK(volume->info().vector);
  requireLinear(volume);
}

TEST_CASE("three scalar grids form one vector and each grid is sampled at its own position",
          "[samplers][kinds]") {
  openvdb::GridPtrVec grids;
  for (int c = 0; c < 3; ++c) {
    auto transform = oblong();
    transform->postTranslate(toFace(c));
    grids.push_back(component(c, transform));
  }
  grids.push_back(makeGrid<openvdb::FloatGrid>(4, oblong(), [](const Vec3d&) { return 1.0F; }));
  requireLinear(reload(grids, "vel"));
  CHECK(reload(grids, "vel.y")->info().vector == false);

  const TemporaryFolder folder;
  writeVdb(folder / "a.vdb", grids);
  const std::vector<std::string> names = gridNames(folder / "a.vdb");
  REQUIRE(names.size() == 2);
  CHECK(std::count(names.begin(), names.end(), "vel") == 1);
  const auto infos = describeGrids(folder / "a.vdb");
  REQUIRE(infos.size() == 5);
  CHECK(infos.back().name == "vel");
  CHECK(infos.back().type == "3 x float");
  std::uint64_t parts = 0;
  for (const GridInfo& info : infos) parts += info.name.rfind("vel.", 0) == 0 ? info.memory : 0;
  CHECK(infos.back().memory == parts);

  // Scalars of different types, or scalars that do not overlap, do not form a vector.
  grids[1] = makeGrid<openvdb::DoubleGrid>(
      24, oblong(), [](const Vec3d&) { return 1.0; }, "vel.y");
  CHECK_THROWS_WITH(reload(grids, "vel"), Contains("no grid"));
  auto apart = Transform::createLinearTransform(1.0);
  apart->postTranslate(Vec3d(1e4, 0, 0));
  grids[1] = component(1, apart);
  CHECK_THROWS_WITH(reload(grids, "vel"), Contains("do not overlap"));
}

TEST_CASE("active tiles count in the range and mean of the magnitudes of a vector of three grids",
          "[samplers][kinds]") {
  // Each component is constant in boxes. Most voxels are in tiles.
  const auto boxes = [](int c, int n, bool tiles) {
    openvdb::initialize();
    auto grid = openvdb::FloatGrid::create();
    auto transform = Transform::createLinearTransform(0.5);
    if (c == 2) transform->postTranslate(Vec3d(0.2, 0.7, -1.2));
    if (c == 1) transform->postRotate(0.1, openvdb::math::Z_AXIS);
    grid->setTransform(transform);
    grid->setName(std::string("vel.") + "xyz"[c]);
    grid->sparseFill({Coord(0), Coord(n)}, 1.0F + static_cast<float>(c));
    grid->sparseFill({Coord(n / 3, 5, 8 * c), Coord(n / 2, n / 2, n)}, 4.0F - 3.0F * c);
    grid->sparseFill({Coord(9), Coord(21)}, 0.0F, false);
    grid->tree().setValue(Coord(7, 6, 5), 9.0F);
    if (!tiles) grid->tree().voxelizeActiveTiles();
    return grid;
  };
  const auto infoOf = [&](int n, bool tiles) {
    return reload({boxes(0, n, tiles), boxes(1, n, tiles), boxes(2, n, tiles)}, "vel")->info();
  };
  const GridInfo sparse = infoOf(50, true);
  const GridInfo dense = infoOf(50, false);
  CHECK(sparse.lowest == dense.lowest);
  CHECK(sparse.highest == dense.highest);
  CHECK(sparse.mean == Approx(dense.mean).epsilon(1e-12));
  CHECK(sparse.lowest < sparse.highest);
  // In these grids, some tiles have 128^3 voxels.
  const GridInfo large = infoOf(127, true);
  CHECK(large.highest >= sparse.highest);
  CHECK(large.lowest > 0.0);
}

TEST_CASE("vectors in index space are transformed by the rule of their kind", "[samplers][kinds]") {
  const auto kind =
      GENERATE(openvdb::VEC_INVARIANT, openvdb::VEC_COVARIANT, openvdb::VEC_CONTRAVARIANT_RELATIVE);
  const auto transform = oblong();
  auto grid = makeGrid<openvdb::Vec3SGrid>(
      8, transform, [](const Vec3d&) { return Vec3s(1, 2, 4); }, "v");
  grid->setVectorType(kind);
  grid->tree().root().setBackground(Vec3s(1, 2, 4), false);
  const auto read = [&] {
    const auto volume = reload({grid}, "v");
    const auto field = std::get<1>(makeVdbField(volume, {}));
    FieldCache cache;
    field->reset(cache);
    return field->sample(volume->info().bounds.centre(), cache).value;
  };
  CHECK((read() - Vec3(1, 2, 4)).norm() < 1e-6);
  grid->setIsInWorldSpace(false);
  Mat3 linear_map;
  for (int a = 0; a < 3; ++a) {
    linear_map.col(a) = eigen(transform->indexToWorld(Vec3d(a == 0, a == 1, a == 2)) -
                              transform->indexToWorld(Vec3d(0.0)));
  }
  Vec3 expected(1, 2, 4);
  if (kind == openvdb::VEC_COVARIANT || kind == openvdb::VEC_COVARIANT_NORMALIZE) {
    expected = linear_map.inverse().transpose() * expected;
  }
  if (kind == openvdb::VEC_COVARIANT_NORMALIZE) expected.normalize();
  if (kind == openvdb::VEC_CONTRAVARIANT_RELATIVE) expected = linear_map * expected;
  const auto volume = reload({grid}, "v");
  CHECK(volume->info().was_local == (kind != openvdb::VEC_INVARIANT));
  CHECK(volume->info().background == Approx(expected.norm()));
  CHECK((read() - expected).norm() < 1e-5);
}

TEST_CASE("axial vectors are interpolated with their signs aligned", "[samplers][kinds]") {
  // The fibres turn by about 3 degrees per voxel. Each voxel's sign is random.
  Random random(5);
  const auto direction = [](const Vec3d& p) {
    const double a = 0.05 * p.x() + 0.03 * p.y();
    return Vec3d(std::cos(a), std::sin(a), 0.2).unit();
  };
  auto grid = makeGrid<openvdb::Vec3SGrid>(
      24, Transform::createLinearTransform(1.0),
      [&](const Vec3d& p) {
        return Vec3s(direction(p) * (random.uniform(-1, 1) < 0.0 ? -1.0 : 1.0));
      },
      "fibres");
  const auto volume = reload({grid}, "");
  const auto worstAngle = [&](bool axial) {
    const auto field = std::get<1>(makeVdbField(volume, {}, {Interpolation::kTrilinear, axial}));
    FieldCache cache;
    field->reset(cache);
    Random places(6);
    double worst = 0.0;
    for (int i = 0; i < 2000; ++i) {
      const Vec3 p = Vec3::Constant(12) + places.inCube(9.0);
      const Vec3 v = field->sample(p, cache).value;
      const double cosine = std::abs(v.dot(eigen(direction({p.x(), p.y(), p.z()})))) / v.norm();
      worst = std::max(worst, std::acos(std::min(1.0, cosine)));
    }
    return worst * 180.0 / M_PI;
  };
  CHECK(worstAngle(true) < 0.1);
  const auto field = std::get<1>(makeVdbField(volume, {}, {Interpolation::kTrilinear, true}));
  FieldCache cache;
  field->reset(cache);
  for (double x = 5.0; x < 15.0; x += 0.1) {
    const CountScope scope;
    const VectorSample s = field->sample({x, 12.3, 11.7}, cache);
    const Counts counts = CountScope::counts();
    REQUIRE(counts.allocations + counts.locks + counts.exceptions == 0);
    // The Jacobian must have the same sign as the value. The direction turns by 0.05 rad per voxel
    // along x.
    REQUIRE(s.jacobian.col(0).norm() == Approx(0.05 / std::sqrt(1.04)).epsilon(0.01));
    REQUIRE(s.jacobian.col(0).dot(s.value) == Approx(0.0).margin(1e-4));
  }
  CHECK(worstAngle(false) > 45.0);
  CHECK_THROWS_WITH(makeVdbField(volume, {}, {Interpolation::kCubic, true}),
                    Contains("do not support cubic interpolation"));
  CHECK_THROWS_WITH(makeVdbField(reload({makeBall(1.0, 0.1)}, ""), {}, {{}, true}),
                    Contains("only vectors can be axial"));
}

TEST_CASE("non-finite voxels are refused or filled on request", "[samplers][kinds]") {
  auto grid =
      makeGrid<openvdb::FloatGrid>(10, Transform::createLinearTransform(1.0),
                                   [](const Vec3d& p) { return static_cast<float>(p.x()); });
  grid->tree().setValue(Coord(5, 5, 5), std::numeric_limits<float>::quiet_NaN());
  grid->tree().setValue(Coord(2, 2, 2), std::numeric_limits<float>::infinity());
  grid->tree().addTile(1, Coord(64, 0, 0), std::numeric_limits<float>::quiet_NaN(), true);
  CHECK_THROWS_WITH(reload({grid}, ""), Contains("3 of its values") && Contains("fill"));
  const LoadOptions fill{NonFinite::kFill, {}, nullptr};
  const auto volume = reload({grid}, "", fill);
  CHECK(volume->info().filled == 3);
  CHECK(volume->info().non_finite == 0);
  CHECK(volume->info().active_voxels == 998);
  CHECK(volume->info().highest == 9.0);
  for (const Interpolation order : kSmooth) {
    const auto field = std::get<0>(makeVdbField(volume, {}, {order}));
    FieldCache cache;
    field->reset(cache);
    CHECK(field->sample({5, 5, 5}, cache).value == Approx(0.0).margin(1e-5));
    CHECK(std::isfinite(field->sample({2.5, 2.5, 2.5}, cache).value));
    CHECK_FALSE(field->sample({68, 4, 4}, cache).inside);
  }
  grid->tree().root().setBackground(std::numeric_limits<float>::quiet_NaN(), false);
  grid->tree().setValueOff(Coord(7, 7, 7), -0.25F);
  const auto zeroed = reload({grid}, "", fill);
  CHECK(zeroed->info().background == 0.0);
  const auto field = std::get<0>(makeVdbField(zeroed, {}));
  FieldCache cache;
  field->reset(cache);
  CHECK(field->sample({7, 7, 7}, cache).value == -0.25);  // finite values stay

  // Smoothing of floats near the end of their range must give finite values.
  auto steep = makeGrid<openvdb::FloatGrid>(10, Transform::createLinearTransform(1.0),
                                            [](const Vec3d&) { return 2e38F; });
  CHECK(reload({steep}, "", {NonFinite::kRefuse, {1.0}, nullptr})->info().highest <= 2e38F);
}

TEST_CASE("several volumes load at the same time with progress, and equal ones are loaded once",
          "[samplers][kinds]") {
  const TemporaryFolder folder;
  writeVdb(folder / "a.vdb", {makeBall(2.0, 0.1)});
  writeVdb(folder / "b.vdb", {makeBall(1.0, 0.1)});
  double last = 0.0;
  bool forward = true;
  const auto results = loadVolumes({{folder / "a.vdb", "ball"},
                                    {folder / "none.vdb", ""},
                                    {folder / "b.vdb", ""},
                                    {folder / "a.vdb", "ball"},
                                    {folder / "a.vdb", "ball", NonFinite::kRefuse, {1.0}}},
                                   [&](double done) {
                                     forward = forward && done >= last && done <= 1.0;
                                     last = done;
                                   });
  REQUIRE(results.size() == 5);
  CHECK(last == Approx(1.0));
  CHECK(results[0].volume == results[3].volume);
  CHECK(results[0].volume != results[4].volume);
  CHECK(results[2].volume->info().active_voxels < results[0].volume->info().active_voxels);
  CHECK_THROWS_AS(std::rethrow_exception(results[1].error), VolumeError);
  CHECK(forward);
}

TEST_CASE("a long load of volumes reports its progress and can be cancelled", "[samplers][kinds]") {
  const TemporaryFolder folder;
  writeVdb(folder / "a.vdb", {makeBall(24.0, 0.1)});
  std::vector<double> said;
  const auto volume = loadVolume(folder / "a.vdb", "",
                                 {NonFinite::kRefuse, {}, [&](double d) { said.push_back(d); }});
  CHECK(said.size() > 10);
  CHECK(std::is_sorted(said.begin(), said.end()));
  CHECK(said.back() == 1.0);
  const auto stop = [](double done) {
    if (done > 0.3) throw Error("loading", "it was stopped", "none");
  };
  CHECK_THROWS_WITH(loadVolume(folder / "a.vdb", "", {NonFinite::kRefuse, {}, stop}),
                    Contains("it was stopped"));
  // The loader must read a file to its end even if the file is deleted during the load.
  const auto gone = [&](double) { std::filesystem::remove(folder / "a.vdb"); };
  CHECK(loadVolume(folder / "a.vdb", "", {NonFinite::kRefuse, {}, gone})->info().mean ==
        volume->info().mean);
}

TEST_CASE("the inside flag of a sample is the same for all interpolations except nearest",
          "[samplers][kinds]") {
  const bool level_set = GENERATE(true, false);
  auto grid = makeBall(1.0, 0.1);
  if (!level_set) grid->setGridClass(openvdb::GRID_FOG_VOLUME);
  const auto volume = reload({grid}, "");
  Random random(12);
  for (const Interpolation order : {Interpolation::kTrilinear, Interpolation::kQuadratic,
                                    Interpolation::kCubic, Interpolation::kNearest}) {
    const auto field = std::get<0>(makeVdbField(volume, {}, {order}));
    FieldCache cache;
    field->reset(cache);
    for (int i = 0; i < 3000; ++i) {
      const Vec3 p = random.inCube(1.5);
      const Vec3d index = grid->transform().worldToIndex(Vec3d(p.x(), p.y(), p.z()));
      int active = 0;
      for (int n = 0; n < 8; ++n) {
        const Coord corner = Coord::floor(index).offsetBy(n >> 2, (n >> 1) & 1, n & 1);
        active += static_cast<int>(grid->tree().isValueOn(corner));
      }
      const bool expected = order == Interpolation::kNearest
                                ? grid->tree().isValueOn(Coord::round(index))
                                : active >= (level_set ? 8 : 1);
      CAPTURE(wordFor(order), p.transpose());
      REQUIRE(field->sample(p, cache).inside == expected);
    }
  }
}

TEST_CASE("splines have data where the trilinear value has, beside holes and tiles",
          "[samplers][kinds]") {
  openvdb::initialize();
  const std::string kind = GENERATE("fog", "level set", "missing", "outside");
  CAPTURE(kind);
  Random random(4);
  const auto grid = openvdb::FloatGrid::create(kind == "level set" ? 1.0F : 0.0F);
  if (kind == "level set") grid->setGridClass(openvdb::GRID_LEVEL_SET);
  if (kind == "missing") grid->insertMeta(kMetaInactiveIsMissing, openvdb::BoolMetadata(true));
  if (kind == "outside") grid->insertMeta(kMetaImportedFrom, openvdb::StringMetadata("mesh"));
  const auto value = [&] { return static_cast<float>(random.uniform(-0.5, 0.5)); };
  for (auto at = openvdb::CoordBBox(Coord(-10), Coord(10)).begin(); at; ++at) {
    if (kind == "level set") break;  // noise is not a distance
    if (random.uniform() < 0.9) grid->tree().setValue(*at, value());
    if (random.uniform() < 0.1) grid->tree().setValueOff(*at, value());
  }
  grid->fill({Coord(0), Coord(7)}, -0.3F);                     // a tile
  grid->fill({Coord(8, 0, 0), Coord(15, 7, 7)}, 0.2F, false);  // an inactive tile beside it
  grid->fill({Coord(-8, -5, -4), Coord(-3, -1, 6)}, grid->background(), false);
  const auto volume = makeVolume(*grid);
  std::vector<Probe> probes;
  probes.reserve(kSmooth.size());
  for (const Interpolation order : kSmooth) probes.emplace_back(makeVdbField(volume, {}, {order}));
  int within = 0;
  int differences = 0;
  for (int i = 0; i < 5000; ++i) {
    const Vec3 p = random.inCube(13.0);
    const bool inside = probes[0].scalar(p).inside;
    within += inside ? 1 : 0;
    for (Probe& probe : probes) differences += probe.scalar(p).inside == inside ? 0 : 1;
  }
  CHECK(differences == 0);
  CHECK((within > 90 && within < 4800));
}

TEST_CASE("spline coefficients are computed once for each volume and degree",
          "[samplers][kinds][spline]") {
  const auto volume = reload({makeBall(2.0, 0.1)}, "");
  const std::uint64_t grid = volume->memory();
  CHECK(grid == volume->info().memory);
  (void)makeVdbField(volume, {}, {Interpolation::kCubic});
  const std::uint64_t one = volume->memory();
  CHECK(one > grid);
  (void)makeVdbField(volume, {2.0, Mat3::Identity(), Vec3::Zero()}, {Interpolation::kCubic});
  CHECK(volume->memory() == one);
  (void)makeVdbField(volume, {}, {Interpolation::kQuadratic});
  CHECK(volume->memory() > one);
}

TEST_CASE("a spline equals the voxel values at the faces of large tiles",
          "[samplers][kinds][spline]") {
  auto grid = openvdb::FloatGrid::create(0.0F);
  grid->tree().addTile(2, Coord(0, 0, 0), 1.0F, true);  // 128^3
  grid->setName("tile");
  const auto volume = reload({grid}, "");
  for (const Interpolation order : {Interpolation::kQuadratic, Interpolation::kCubic}) {
    const auto field = std::get<0>(makeVdbField(volume, {}, {order}));
    FieldCache cache;
    field->reset(cache);
    Random random(9);
    for (int i = 0; i < 300; ++i) {
      const Coord at(static_cast<int>(random.uniform(-4, 132)),
                     static_cast<int>(random.uniform(-4, 132)),
                     static_cast<int>(random.uniform(-4, 4)));
      CAPTURE(wordFor(order), at.x(), at.y(), at.z());
      REQUIRE(field->sample(eigen(at.asVec3d()), cache).value ==
              Approx(grid->tree().getValue(at)).margin(2e-5));
    }
  }
}

TEST_CASE("a volume with a great many different tiles is refused as a spline",
          "[samplers][kinds][spline]") {
  auto grid = openvdb::FloatGrid::create(0.0F);
  // The 1536 leaves at the faces of each tile of 128^3 voxels have other neighbours.
  for (int n = 0; n < 512; ++n) {
    grid->tree().addTile(2, Coord(n / 64 * 128, n / 8 % 8 * 128, n % 8 * 128), 1.0F + n % 7, true);
  }
  grid->setName("tiles");
  const auto volume = reload({grid}, "");
  CHECK_THROWS_WITH(makeVdbField(volume, {}, {Interpolation::kCubic}),
                    Contains("grid \"tiles\": too many of its tiles differ from their neighbours"));
  CHECK(std::get<0>(makeVdbField(volume, {}, {})) != nullptr);
}

}  // namespace palpate::kinds_test
