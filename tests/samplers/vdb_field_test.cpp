#include "palpate/samplers/grid/vdb_field.h"

#include <array>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <vector>

#include <Eigen/Geometry>
#include <catch2/catch.hpp>
#include <openvdb/tools/Interpolation.h>

#include "palpate/samplers/grid/cell.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/volume.h"
#include "tests/support/counters.h"
#include "tests/support/probe.h"
#include "tests/support/random.h"
#include "tests/support/vdb_grids.h"

namespace palpate::vdb_field_test {
using namespace palpate::test;
using openvdb::Coord;
using openvdb::Vec3d;
using openvdb::math::Transform;

namespace {

openvdb::Vec3d vdb(const Vec3& v) {
  return {v.x(), v.y(), v.z()};
}
Vec3 eigen(const openvdb::Vec3d& v) {
  return {v.x(), v.y(), v.z()};
}

/// Writes a grid to a file, loads it, and returns its field.
FieldPtr fieldOf(const openvdb::GridBase::Ptr& grid, const Placement& placement = {},
                 const Sampling& sampling = {}) {
  const TemporaryFolder folder;
  writeVdb(folder / "a.vdb", {grid});
  return makeVdbField(loadVolume(folder / "a.vdb", ""), placement, sampling);
}

/// Returns a grid of random values in a cube, with gaps between them, and one active tile.
openvdb::FloatGrid::Ptr roughGrid() {
  openvdb::initialize();
  Random random(1);
  auto grid = openvdb::FloatGrid::create(0.25F);
  auto accessor = grid->getAccessor();
  for (int i = 0; i < 20000; ++i) {
    const Vec3 p = random.inCube(20.0);
    accessor.setValue(Coord::round(vdb(p)), static_cast<float>(random.uniform(-1, 1)));
  }
  grid->tree().addTile(1, Coord(16, 16, 16), 3.0F, true);
  grid->setTransform(Transform::createLinearTransform(0.5));
  grid->setName("rough");
  return grid;
}

/// Returns random voxels with gaps beside a box of one value, moved by `by` [voxels]. The move
/// decides which parts of the box are tiles, and where leaves end.
template <class GridT>
typename GridT::Ptr movedGrid(const Coord& by) {
  using Value = typename GridT::ValueType;
  openvdb::initialize();
  Random random(1);
  auto grid = GridT::create(Value(0.25F));
  grid->fill({by.offsetBy(8), by.offsetBy(23)}, Value(3.0F));
  auto accessor = grid->getAccessor();
  for (int i = 0; i < 2000; ++i) {
    const Vec3 p = Vec3::Constant(6.0) + random.inCube(6.0);
    accessor.setValue(by + Coord::round(vdb(p)), Value(static_cast<float>(random.uniform(-1, 1))));
  }
  grid->setName("moved");
  return grid;
}

/// Returns all numbers of a field's sample at p [m].
std::vector<double> readingOf(Probe& probe, const Vec3& p) {
  std::vector<double> out;
  if (probe.field.index() == 0) {
    const ScalarSample s = probe.scalar(p);
    out = {s.value, s.inside ? 1.0 : 0.0};
    out.insert(out.end(), s.gradient.data(), s.gradient.data() + 3);
  } else {
    const VectorSample s = probe.vector(p);
    out = {s.inside ? 1.0 : 0.0};
    out.insert(out.end(), s.value.data(), s.value.data() + 3);
    out.insert(out.end(), s.jacobian.data(), s.jacobian.data() + 9);
  }
  return out;
}

/// Returns the trilinear interpolation, at index p, of the quantity that `at` returns for a voxel.
template <class F>
double blend(const Vec3d& p, F at) {
  const Coord c = Coord::floor(p);
  double sum = 0.0;
  for (int n = 0; n < 8; ++n) {
    const int i = n >> 2;
    const int j = (n >> 1) & 1;
    const int k = n & 1;
    const Vec3d t = p - c.asVec3d();
    sum += (i == 1 ? t.x() : 1 - t.x()) * (j == 1 ? t.y() : 1 - t.y()) *
           (k == 1 ? t.z() : 1 - t.z()) * at(c.offsetBy(i, j, k));
  }
  return sum;
}

}  // namespace

TEST_CASE("a position beside a missing voxel of an image has no data", "[samplers]") {
  openvdb::initialize();
  const auto value = [](const Vec3& p) { return p.x() + 2.0 * p.y() + 3.0 * p.z(); };
  const auto grid = openvdb::FloatGrid::create(60.0F);
  grid->insertMeta("inactive_is_missing", openvdb::BoolMetadata(true));
  for (auto at = openvdb::CoordBBox(Coord(0), Coord(11)).begin(); at; ++at) {
    if ((*at).x() < 5 && (*at).y() < 5) continue;
    grid->tree().setValue(*at, static_cast<float>(value(eigen((*at).asVec3d()))));
  }
  for (const Interpolation interpolation :
       {Interpolation::kTrilinear, Interpolation::kQuadratic, Interpolation::kCubic}) {
    Probe probe(fieldOf(grid, {}, {interpolation}));
    const auto is_inside = [&](double x, double y, double z) {
      return probe.scalar(Vec3(x, y, z)).inside;
    };
    CAPTURE(static_cast<int>(interpolation));
    CHECK(!is_inside(2.0, 2.0, 2.0));
    CHECK(!is_inside(4.5, 2.3, 2.3));
    CHECK(!is_inside(4.99, 4.99, 2.3));
    CHECK(!is_inside(4.0, 2.0, 2.0));
    // At the last voxels before the hole, the weight of all missing voxels is zero.
    CHECK(is_inside(5.0, 2.3, 2.3));
    CHECK(is_inside(5.0, 5.0, 2.0));
    CHECK(is_inside(5.01, 2.3, 2.3));
    // Beyond the image, the background continues the data, as in other images.
    CHECK(is_inside(11.5, 8.2, 8.2));
    CHECK(!is_inside(12.5, 8.2, 8.2));
  }
  Probe linear(fieldOf(grid));
  Random random(5);
  for (int i = 0; i < 2000; ++i) {
    const Vec3 p = Vec3::Constant(5.5) + random.inCube(5.5);
    const ScalarSample s = linear.scalar(p);
    CAPTURE(p);
    if (s.inside) CHECK(s.value == Approx(value(p)).margin(1e-4));
    CHECK(s.inside == (p.x() >= 5.0 || p.y() >= 5.0));
  }
}

TEST_CASE(
    "the value is trilinear, and the gradient is the difference of values at slope_reach on both "
    "sides",
    "[samplers]") {
  const auto grid = roughGrid();
  const double reach = GENERATE(0.5, 1.0);
  Probe probe(fieldOf(grid, {}, {Interpolation::kTrilinear, false, reach}));
  Random random(2);
  const auto& tree = grid->constTree();
  const auto value = [&](const Coord& c) { return static_cast<double>(tree.getValue(c)); };
  double worst = 0.0;
  for (int i = 0; i < 50000; ++i) {
    const Vec3 p = random.inCube(14.0);
    const Vec3d at = grid->transform().worldToIndex(vdb(p));
    const ScalarSample s = probe.scalar(p);
    worst = std::max(worst, std::abs(s.value - blend(at, value)));
    for (int a = 0; a < 3; ++a) {
      Vec3d step(0.0);
      step[a] = reach;
      const double slope =
          (blend(at + step, value) - blend(at - step, value)) / (2.0 * reach * 0.5);  // voxels are
                                                                                      // 0.5 m
      worst = std::max(worst, std::abs(s.gradient[a] - slope));
    }
    bool any = false;
    for (int n = 0; n < 8; ++n) {
      any = any || tree.isValueOn(Coord::floor(at).offsetBy(n >> 2, (n >> 1) & 1, n & 1));
    }
    REQUIRE(s.inside == any);
  }
  CHECK(worst < 1e-12);
}

namespace {

/// Returns indices that are difficult for a sampler: near active voxels, outside, and at the
/// borders of leaves (8), of their parents (128) and of their grandparents (4096).
template <class GridT>
std::vector<Vec3d> hardIndices(const GridT& grid, int count, Random& random) {
  std::vector<Coord> leaves;
  for (auto leaf = grid.tree().cbeginLeaf(); leaf; ++leaf) leaves.push_back(leaf->origin());
  const openvdb::CoordBBox box = grid.evalActiveVoxelBoundingBox();
  std::vector<Vec3d> indices;
  for (int i = 0; i < count; ++i) {
    Vec3d at;
    if (leaves.empty() || i % 8 == 0) {
      const Vec3 margin = random.inCube(20.0);
      for (int a = 0; a < 3; ++a) {
        at[a] = random.uniform(box.min()[a], box.max()[a]) + margin[a];
      }
    } else {
      const Coord leaf =
          leaves[static_cast<std::size_t>(random.integer(static_cast<int>(leaves.size())))];
      const Vec3 in = random.inCube(6.0);
      at = leaf.asVec3d() + Vec3d(4 + in.x(), 4 + in.y(), 4 + in.z());
    }
    const double seams[] = {1, 8, 128, 4096};
    if (i % 2 == 0) {
      // The index is on a face, or off the face by 1e-9 or 0.5 voxel.
      const double size = seams[random.integer(4)];
      const int a = random.integer(3);
      const double seam = size * std::round(at[a] / size);
      const double side[] = {0.0, 1e-9, -1e-9, 0.5, -0.5};
      if (std::abs(seam - at[a]) < 64) at[a] = seam + side[random.integer(5)];
    }
    indices.push_back(at);
  }
  return indices;
}

/// Compares values and derivatives with the trilinear interpolation of the stored voxels, in double
/// precision and index space. Derivatives of vectors are one-sided at the faces of the active
/// bounding box. Returns the number of points.
template <class GridT>
long checkAgainstVoxels(const GridT& grid, const FieldPtr& field, Random& random) {
  using Value = typename GridT::ValueType;
  constexpr bool kScalar = std::is_arithmetic_v<Value>;
  constexpr int kComponents = kScalar ? 1 : 3;
  Probe probe(field);
  const auto accessor = grid.getConstAccessor();
  const auto component = [&](const Coord& c, int n) {
    if constexpr (kScalar) {
      return static_cast<double>(accessor.getValue(c));
    } else {
      return static_cast<double>(accessor.getValue(c)[n]);
    }
  };
  const auto map = grid.transform().baseMap();
  const openvdb::CoordBBox ends = grid.evalActiveVoxelBoundingBox();
  double largest = 0.0;
  double steepest = 0.0;
  double worst = 0.0;
  double worst_slope = 0.0;
  const std::vector<Vec3d> indices = hardIndices(grid, 20000, random);
  for (const Vec3d& index : indices) {
    // The field is read at position p. `at` is the index of p after the same rounding.
    const Vec3d p = grid.transform().indexToWorld(index);
    const Vec3d at = grid.transform().worldToIndex(p);
    for (int n = 0; n < kComponents; ++n) {
      const double value = blend(at, [&](const Coord& c) { return component(c, n); });
      Vec3d slope;
      for (int a = 0; a < 3; ++a) {
        if constexpr (kScalar) {
          Vec3d step(0.0);
          step[a] = Sampling().slope_reach;
          const auto value_at = [&](const Vec3d& place) {
            return blend(place, [&](const Coord& c) { return component(c, n); });
          };
          slope[a] = (value_at(at + step) - value_at(at - step)) / (2.0 * step[a]);
        } else {
          slope[a] = blend(at, [&](const Coord& c) {
            Coord low = c;
            Coord high = c;
            --low[a];
            ++high[a];
            if (!ends.isInside(low)) low = c;
            if (!ends.isInside(high)) high = c;
            const int steps = ends.isInside(c) ? high[a] - low[a] : 0;
            return steps == 0 ? 0.0 : (component(high, n) - component(low, n)) / steps;
          });
        }
      }
      const Vec3 gradient = eigen(map->applyIJT(slope));
      double got = 0.0;
      Vec3 got_gradient;
      if constexpr (kScalar) {
        const ScalarSample s = probe.scalar(eigen(p));
        got = s.value;
        got_gradient = s.gradient;
      } else {
        const VectorSample s = probe.vector(eigen(p));
        got = s.value[n];
        got_gradient = s.jacobian.row(n).transpose();
      }
      largest = std::max(largest, std::abs(value));
      steepest = std::max(steepest, gradient.norm());
      worst = std::max(worst, std::abs(got - value));
      worst_slope = std::max(worst_slope, (got_gradient - gradient).norm());
    }
  }
  WARN(grid.getName() << " (" << grid.valueType() << "): value off by " << worst / largest
                      << " of the largest, derivative by " << worst_slope / steepest);
  CHECK(largest > 0.0);
  CHECK(worst <= 1e-6 * largest);
  CHECK(worst_slope <= 1e-4 * steepest);
  return static_cast<long>(indices.size());
}

}  // namespace

namespace {

/// Checks that splines have the voxels' values at active voxels, to 1e-5 of the largest value.
void checkSplinesThroughVoxels(const openvdb::FloatGrid& grid,
                               const std::shared_ptr<const Volume>& volume) {
  const double largest = std::max(std::abs(volume->info().lowest), volume->info().highest);
  for (const auto order : {Interpolation::kQuadratic, Interpolation::kCubic}) {
    Probe probe(makeVdbField(volume, {}, {order}));
    double worst = 0.0;
    std::uint64_t n = 0;
    const std::uint64_t step = grid.activeVoxelCount() / 2000 + 1;
    for (auto voxel = grid.cbeginValueOn(); voxel; ++voxel) {
      if (n++ % step != 0 || !voxel.isVoxelValue()) continue;
      const Vec3 p = eigen(grid.transform().indexToWorld(voxel.getCoord()));
      worst = std::max(worst, std::abs(probe.scalar(p).value - static_cast<double>(*voxel)));
    }
    CHECK(worst < 1e-5 * largest);
  }
}

}  // namespace

TEST_CASE("a field equals the voxels of every grid of the data, also at seams and outside",
          "[.][data]") {
  const std::filesystem::path folder = std::filesystem::path(std::getenv("PALPATE_DATA")) / "vdb";
  openvdb::initialize();
  Random random(31);
  int grids = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (entry.path().extension() != ".vdb") continue;
    openvdb::io::File file(entry.path().string());
    file.open(false);
    for (const GridInfo& info : describeGrids(entry.path())) {
      if (!info.refusal.empty()) continue;
      CAPTURE(entry.path().filename().string(), info.name);
      const auto base = file.readGrid(info.name);
      const FieldPtr field = makeVdbField(loadVolume(entry.path(), info.name), Placement{});
      long points = 0;
      const auto check = [&](const auto& grid) {
        if (grid) points = checkAgainstVoxels(*grid, field, random);
      };
      check(openvdb::gridPtrCast<openvdb::FloatGrid>(base));
      check(openvdb::gridPtrCast<openvdb::DoubleGrid>(base));
      check(openvdb::gridPtrCast<openvdb::Vec3SGrid>(base));
      check(openvdb::gridPtrCast<openvdb::Vec3DGrid>(base));
      CHECK(points > 0);
      if (const auto scalar = openvdb::gridPtrCast<openvdb::FloatGrid>(base)) {
        checkSplinesThroughVoxels(*scalar, loadVolume(entry.path(), info.name));
      }
      ++grids;
    }
  }
  CHECK(grids >= 4);
}

TEMPLATE_TEST_CASE(
    "a sample is the same to the last bit for any division of its voxels into leaves", "[samplers]",
    openvdb::FloatGrid, openvdb::DoubleGrid, openvdb::Vec3SGrid) {
  const auto interpolation = GENERATE(Interpolation::kTrilinear, Interpolation::kNearest);
  Probe here(fieldOf(movedGrid<TestType>(Coord(0)), {}, {interpolation}));
  Random random(7);
  for (int move = 0; move < 24; ++move) {
    const Coord by = Coord::round(vdb(random.inCube(20.0)));
    CAPTURE(interpolation, by);
    Probe there(fieldOf(movedGrid<TestType>(by), {}, {interpolation}));
    for (int i = 0; i < 1000; ++i) {
      // The coordinates are multiples of 1/64, so that sums with whole numbers are exact.
      const Vec3 p = (64.0 * (Vec3::Constant(11.0) + random.inCube(15.0))).array().round() / 64.0;
      REQUIRE(readingOf(there, p + eigen(by.asVec3d())) == readingOf(here, p));
    }
  }
}

TEST_CASE("the trilinear value agrees with OpenVDB's own sampler", "[samplers]") {
  const auto grid = roughGrid();
  Probe probe(fieldOf(grid));
  Random random(3);
  for (int i = 0; i < 5000; ++i) {
    const Vec3 p = random.inCube(14.0);
    const float theirs = openvdb::tools::BoxSampler::sample(grid->constTree(),
                                                            grid->transform().worldToIndex(vdb(p)));
    REQUIRE(probe.scalar(p).value == Approx(theirs).margin(1e-6));
  }
}

TEST_CASE("value and gradient of a trilinear field are continuous across cell faces",
          "[samplers]") {
  Probe probe(fieldOf(roughGrid()));
  Random random(4);
  for (int i = 0; i < 2000; ++i) {
    Vec3 p = random.inCube(9.0);
    p.x() = 0.5 * std::round(p.x() / 0.5);  // on a face
    const ScalarSample a = probe.scalar(p - Vec3(1e-12, 0, 0));
    const ScalarSample b = probe.scalar(p + Vec3(1e-12, 0, 0));
    REQUIRE(std::abs(a.value - b.value) < 1e-10);
    REQUIRE((a.gradient - b.gradient).norm() < 1e-9);
  }
}

TEST_CASE("the gradient of a linear function is exact under any affine map and placement",
          "[samplers]") {
  const Vec3 slope(1.5, -2.0, 0.75);
  // The map from index to file is anisotropic, rotated and sheared, or mirrored.
  Mat3 linear;
  const int kind = GENERATE(0, 1, 2);
  if (kind == 0) linear = Vec3(0.7, 0.7, 1.4).asDiagonal();
  if (kind == 1) linear << 0.5, 0.2, 0.1, -0.1, 0.6, 0.0, 0.05, 0.1, 0.4;
  if (kind == 2) linear << -1, 0, 0, 0, 1, 0, 0, 0, 2;
  openvdb::Mat4R matrix = openvdb::Mat4R::identity();
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) matrix(c, r) = linear(r, c);
    matrix(3, r) = 3.0 * r - 1.0;
  }
  const auto transform = Transform::createLinearTransform(matrix);
  const auto grid = makeGrid<openvdb::DoubleGrid>(
      12, transform, [&](const Vec3d& p) { return slope.dot(eigen(p)) + 0.5; });
  const Mat3 turn = Eigen::AngleAxisd(0.7, Vec3(1, 2, -1).normalized()).toRotationMatrix();
  const Placement placement{0.01, turn, {0.1, 0.2, -0.3}};
  Probe probe(fieldOf(grid, placement));
  CHECK(std::get<0>(probe.field)->frame().metres_per_unit == 0.01);
  CHECK(std::get<0>(probe.field)->frame().voxel ==
        Approx(0.01 * linear.colwise().norm().minCoeff()));
  Random random(5);
  for (int i = 0; i < 1000; ++i) {
    const Vec3d index(random.uniform(1, 10), random.uniform(1, 10), random.uniform(1, 10));
    const Vec3 p_F = eigen(transform->indexToWorld(index));
    const ScalarSample s = probe.scalar(placement(p_F));
    REQUIRE(s.value == Approx(slope.dot(p_F) + 0.5).margin(1e-11));
    // The gradient is per unit of the file, so the placement only rotates the gradient.
    REQUIRE((s.gradient - turn * slope).norm() < 1e-10);
    REQUIRE((probe.cellGradient(placement(p_F)) - turn * slope).norm() < 1e-10);
    REQUIRE(s.inside);
  }
}

TEST_CASE("the Jacobian of the gradient matches finite differences in any placement",
          "[samplers]") {
  const auto kind = GENERATE(Interpolation::kTrilinear, Interpolation::kQuadratic,
                             Interpolation::kCubic, Interpolation::kNearest);
  const double reach = GENERATE(0.3, 0.5, 1.0);
  // With axes parallel to W's, the maps are diagonal.
  const Placement placement =
      GENERATE(test::slanted(), Placement{0.02, Mat3::Identity(), Vec3::Zero()});
  openvdb::Mat4R matrix = openvdb::Mat4R::identity();
  matrix.setToScale(openvdb::Vec3R(0.7, 0.7, 1.4));
  const auto grid = makeGrid<openvdb::DoubleGrid>(
      16, Transform::createLinearTransform(matrix), [](const Vec3d& p) {
        return std::sin(p[0]) * std::cos(0.7 * p[1]) + 0.3 * p[2] * p[0] - 0.1 * p[1] * p[2];
      });
  Probe probe(fieldOf(grid, placement, {kind, false, reach}));
  Random random(6);
  constexpr double kStep = 1e-8;  // [m]; much smaller than a cell
  for (int i = 0; i < 1000; ++i) {
    const Vec3 index(random.uniform(4, 11), random.uniform(4, 11), random.uniform(4, 11));
    const Vec3 cell = (index - index.array().round().matrix()).cwiseAbs();
    // Skips points near faces of a trilinear cell or of a spline's piece, and near places at which
    // the difference reaches a face.
    if (cell.minCoeff() < 0.01 || cell.maxCoeff() > 0.49) continue;
    if (((cell.array() - reach).abs() < 0.01).any()) continue;
    const Vec3 p = placement(Vec3(0.7, 0.7, 1.4).cwiseProduct(index));
    const Mat3 by = probe.gradientJacobian(p);
    Mat3 differences;
    for (int a = 0; a < 3; ++a) {
      const Vec3 aside = kStep * Vec3::Unit(a);
      differences.col(a) =
          (probe.scalar(p + aside).gradient - probe.scalar(p - aside).gradient) / (2.0 * kStep);
    }
    REQUIRE((by - differences).norm() <= 1e-4 * (1.0 + differences.norm()));
  }
}

TEST_CASE("the turn of a half-step difference in the middle of a cell is that just above it",
          "[samplers]") {
  // At the last number below 1/2, a sum with 1/2 rounds to 1.
  std::array<double, 64> values;
  Random random(8);
  for (double& v : values) v = random.uniform(-1, 1);
  Rows<double, 4> rows;
  for (std::size_t n = 0; n < 16; ++n) rows.first[n] = &values[4 * n];
  TrilinearKernel<1> kernel;
  kernel.load(rows, [](auto&) {});
  const double below = std::nextafter(0.5, 0.0);
  const auto turn_at = [&](double t) { return kernel.turning(Vec3::Constant(t), 0.5); };
  for (std::size_t a = 0; a < 3; ++a) {
    CHECK(turn_at(below)[a][a] == Approx(turn_at(0.5 - 1e-9)[a][a]).epsilon(1e-6));
    CHECK(turn_at(0.5)[a][a] == Approx(turn_at(0.5 + 1e-9)[a][a]).epsilon(1e-6));
    CHECK(std::abs(turn_at(below)[a][a] - turn_at(0.5)[a][a]) > 0.01);
  }
}

TEST_CASE("Jacobian, curl and divergence of a linear field are exact, and turn with the volume",
          "[samplers]") {
  Mat3 J;
  J << 1, 2, 3, -4, 5, 6, 7, -8, 9;
  const auto transform = Transform::createLinearTransform(0.25);
  const auto grid = makeGrid<openvdb::Vec3DGrid>(
      12, transform, [&](const Vec3d& p) { return vdb(J * eigen(p) + Vec3(1, 2, 3)); });
  const Mat3 turn = Eigen::AngleAxisd(0.4, Vec3(1, 1, 1).normalized()).toRotationMatrix();
  const Placement placement{0.02, turn, {0.0, 0.1, 0.0}};
  Probe probe(fieldOf(grid, placement));
  Random random(6);
  for (int i = 0; i < 500; ++i) {
    const Vec3 p_F(random.uniform(0.5, 2), random.uniform(0.5, 2), random.uniform(0.5, 2));
    const VectorSample s = probe.vector(placement(p_F));
    REQUIRE((s.value - turn * (J * p_F + Vec3(1, 2, 3))).norm() < 1e-10);
    REQUIRE((s.jacobian - turn * J * turn.transpose()).norm() < 1e-9);
    REQUIRE((curl(s.jacobian) - turn * Vec3(-14, -4, -6)).norm() < 1e-9);
    REQUIRE(divergence(s.jacobian) == Approx(15.0));
  }
}

TEST_CASE("a scalar grid stored as half and a float vector grid can be read", "[samplers]") {
  const auto transform = Transform::createLinearTransform(1.0);
  auto short_floats =
      makeGrid<openvdb::FloatGrid>(9, transform, [](const Vec3d& p) { return p.x(); });
  short_floats->setSaveFloatAsHalf(true);
  CHECK(Probe(fieldOf(short_floats)).scalar({3.5, 4, 4}).value == 3.5);
  const auto vec =
      makeGrid<openvdb::Vec3SGrid>(9, transform, [](const Vec3d& p) { return openvdb::Vec3s(p); });
  CHECK((Probe(fieldOf(vec)).vector({3.5, 4.25, 4}).value - Vec3(3.5, 4.25, 4)).norm() < 1e-6);
}

TEST_CASE("a sample is reported as inside in a level set's band, and up to one voxel beyond a fog",
          "[samplers]") {
  openvdb::initialize();
  const auto sphere = makeBall(2.0, 0.1);
  Probe ball(fieldOf(sphere));
  CHECK(ball.scalar({2.0, 0, 0}).inside);
  CHECK_FALSE(ball.scalar({1.0, 0, 0}).inside);
  CHECK(ball.scalar({1.0, 0, 0}).value == Approx(-0.3));
  CHECK_FALSE(ball.scalar({3.0, 0, 0}).inside);
  CHECK(ball.scalar({3.0, 0, 0}).value == Approx(0.3));

  auto fog = makeGrid<openvdb::FloatGrid>(8, Transform::createLinearTransform(1.0),
                                          [](const Vec3d&) { return 1.0F; });
  Probe edge(fieldOf(fog));
  CHECK(edge.scalar({7.5, 4, 4}).inside);
  CHECK(edge.scalar({7.5, 4, 4}).value == Approx(0.5));
  CHECK_FALSE(edge.scalar({8.5, 4, 4}).inside);
}

TEST_CASE("samples at distant and non-finite positions give the background and are outside",
          "[samplers]") {
  Probe probe(fieldOf(roughGrid()));
  for (const double x : {1e10, -1e300, std::nan(""), HUGE_VAL}) {
    const ScalarSample s = probe.scalar({0.0, x, 0.0});
    CHECK_FALSE(s.inside);
    CHECK(s.value == 0.25);
    CHECK(s.gradient == Vec3::Zero());
  }
}

TEST_CASE("the trilinear interpolation error falls with the square of the voxel size",
          "[samplers]") {
  const auto error = [](double voxel) {
    const auto transform = Transform::createLinearTransform(voxel);
    const auto f = [](const Vec3d& p) {
      return std::sin(p.x()) * std::sin(p.y()) * std::sin(p.z());
    };
    const int n = static_cast<int>(3.2 / voxel);
    Probe probe(fieldOf(makeGrid<openvdb::DoubleGrid>(n, transform, f)));
    Random random(7);
    double sum = 0.0;
    for (int i = 0; i < 2000; ++i) {
      const Vec3 p(random.uniform(0.5, 2.5), random.uniform(0.5, 2.5), random.uniform(0.5, 2.5));
      const ScalarSample s = probe.scalar(p);
      const Vec3 slope(std::cos(p.x()) * std::sin(p.y()) * std::sin(p.z()),
                       std::sin(p.x()) * std::cos(p.y()) * std::sin(p.z()),
                       std::sin(p.x()) * std::sin(p.y()) * std::cos(p.z()));
      sum += std::pow(s.value - f(vdb(p)), 2) + (s.gradient - slope).squaredNorm();
    }
    return std::sqrt(sum / 2000);
  };
  const double coarse = error(0.2);
  const double fine = error(0.1);
  CAPTURE(coarse, fine);
  CHECK(coarse / fine == Approx(4.0).margin(0.4));
}

TEST_CASE("B-splines and nearest-voxel interpolation pass through the voxel values",
          "[samplers][spline]") {
  const auto grid = roughGrid();
  const auto interpolation =
      GENERATE(Interpolation::kNearest, Interpolation::kQuadratic, Interpolation::kCubic);
  Probe probe(fieldOf(grid, {}, {interpolation}));
  CAPTURE(wordFor(interpolation));
  Random random(41);
  double worst = 0.0;
  for (int i = 0; i < 20000; ++i) {
    const Coord c = Coord::round(vdb(random.inCube(30.0)));
    const ScalarSample s = probe.scalar(eigen(grid->transform().indexToWorld(c)));
    worst = std::max(worst, std::abs(s.value - static_cast<double>(grid->tree().getValue(c))));
  }
  CHECK(worst < 2e-6);  // values are up to 3, and coefficients are floats
}

TEST_CASE("B-splines reproduce polynomials of their degree and the derivatives, under any map",
          "[samplers][spline]") {
  const auto interpolation = GENERATE(Interpolation::kQuadratic, Interpolation::kCubic);
  const bool cubic = interpolation == Interpolation::kCubic;
  // The map has rotation, shear, reflection and unequal scales.
  openvdb::math::Mat4d map(0.30, 0.05, 0.0, 0.0, -0.02, 0.25, 0.04, 0.0, 0.01, 0.0, -0.4, 0.0, 1.0,
                           -2.0, 3.0, 1.0);
  const auto transform = Transform::createLinearTransform(map);
  const auto value = [&](const Vec3& p) {
    const double x = p.x() - 4.0;
    const double y = p.y();
    const double z = p.z();
    return x * x - 0.5 * x * y + y + 2.0 * z + (cubic ? 0.1 * x * x * z : 0.0);
  };
  const auto slope = [&](const Vec3& p) {
    const double x = p.x() - 4.0;
    const double c = cubic ? 0.1 : 0.0;
    return Vec3(2.0 * x - 0.5 * p.y() + 2.0 * c * x * p.z(), -0.5 * x + 1.0, 2.0 + c * x * x);
  };
  const auto grid =
      makeGrid<openvdb::DoubleGrid>(56, transform, [&](const Vec3d& p) { return value(eigen(p)); });
  const Placement placement{
      0.01, Eigen::AngleAxisd(0.7, Vec3(1, 2, 3).normalized()).toRotationMatrix(), {0.1, 0.2, 0.3}};
  Probe probe(fieldOf(grid, placement, {interpolation}));
  Random random(42);
  for (int i = 0; i < 2000; ++i) {
    // The points are in the middle of the block, because the spline's prefilter changes the result
    // near the block's ends.
    const Vec3 in = random.inCube(6.0);
    const Vec3 p_F = eigen(transform->indexToWorld(Vec3d(28 + in.x(), 28 + in.y(), 28 + in.z())));
    const ScalarSample s = probe.scalar(placement(p_F));
    CHECK(s.value == Approx(value(p_F)).margin(1e-6));
    CHECK((placement.rotation.transpose() * s.gradient - slope(p_F)).norm() < 1e-5);
    CHECK(s.inside);
  }
}

TEST_CASE(
    "halved voxels divide the errors of value and gradient as the interpolation's order predicts",
    "[samplers][spline]") {
  struct Order {
    Interpolation interpolation;
    double value;
    double slope;
  };
  const Order order =
      GENERATE(Order{Interpolation::kTrilinear, 4.0, 4.0},
               Order{Interpolation::kQuadratic, 8.0, 4.0}, Order{Interpolation::kCubic, 16.0, 8.0});
  CAPTURE(wordFor(order.interpolation));
  // The field is sin x sin y sin z, with 8 or 16 voxels per wavelength. The points are away from
  // the block's ends.
  std::array<double, 2> value_error{};
  std::array<double, 2> slope_error{};
  for (std::size_t n = 0; n < 2; ++n) {
    const double wave = 2.0 * M_PI / (n == 0 ? 8.0 : 16.0);
    const auto grid = makeGrid<openvdb::DoubleGrid>(
        56, Transform::createLinearTransform(1.0), [&](const Vec3d& p) {
          return std::sin(wave * p.x()) * std::sin(wave * p.y()) * std::sin(wave * p.z());
        });
    Probe probe(fieldOf(grid, {}, {order.interpolation}));
    Random random(43);
    for (int i = 0; i < 4000; ++i) {
      const Vec3 p = Vec3::Constant(28.0) + random.inCube(8.0);
      const ScalarSample s = probe.scalar(p);
      const Vec3 sine = (wave * p).array().sin();
      const Vec3 cosine = (wave * p).array().cos();
      const Vec3 slope(cosine.x() * sine.y() * sine.z(), sine.x() * cosine.y() * sine.z(),
                       sine.x() * sine.y() * cosine.z());
      value_error[n] += std::pow(s.value - sine.prod(), 2);
      slope_error[n] += (s.gradient / wave - slope).squaredNorm();
    }
  }
  const double value_ratio = std::sqrt(value_error[0] / value_error[1]);
  const double slope_ratio = std::sqrt(slope_error[0] / slope_error[1]);
  WARN(wordFor(order.interpolation)
       << ": halving the voxel divides the error of the value by " << value_ratio
       << ", of the gradient by " << slope_ratio << "; at 16 voxels a wavelength they are "
       << std::sqrt(value_error[1] / 4000) << " and " << std::sqrt(slope_error[1] / 4000));
  CHECK(value_ratio > 0.8 * order.value);
  CHECK(slope_ratio > 0.8 * order.slope);
}

TEST_CASE("a spline of a linear vector field has the field's Jacobian, and turns with the volume",
          "[samplers][spline]") {
  const auto interpolation = GENERATE(Interpolation::kQuadratic, Interpolation::kCubic);
  Mat3 J;
  J << 1, 2, -1, 0.5, -3, 4, 2, 0, 0.25;
  const auto grid =
      makeGrid<openvdb::Vec3SGrid>(56, Transform::createLinearTransform(0.1), [&](const Vec3d& p) {
        const Vec3 v = J * eigen(p);
        return openvdb::Vec3s(vdb(v));
      });
  const Placement placement{2.0, Eigen::AngleAxisd(1.1, Vec3::UnitY()).toRotationMatrix(),
                            Vec3::Zero()};
  Probe probe(fieldOf(grid, placement, {interpolation}));
  Random random(44);
  for (int i = 0; i < 500; ++i) {
    const Vec3 p_F = Vec3::Constant(2.8) + random.inCube(0.6);
    const VectorSample s = probe.vector(placement(p_F));
    const Mat3& R = placement.rotation;
    CHECK((s.value - R * J * p_F).norm() < 1e-4);
    CHECK((s.jacobian - R * J * R.transpose()).norm() < 1e-3);
  }
}

TEST_CASE("splines and their derivatives are continuous across faces and middles of cells",
          "[samplers][spline]") {
  const auto grid = roughGrid();
  const auto interpolation = GENERATE(Interpolation::kQuadratic, Interpolation::kCubic);
  Probe probe(fieldOf(grid, {}, {interpolation}));
  Random random(45);
  for (int i = 0; i < 5000; ++i) {
    Vec3 p = random.inCube(12.0);
    const int axis = random.integer(3);
    p[axis] = 0.25 * std::round(p[axis] / 0.25);  // voxels are 0.5 m: on faces and midplanes
    Vec3 beyond = p;
    p[axis] -= 1e-9;
    beyond[axis] += 1e-9;
    const ScalarSample a = probe.scalar(p);
    const ScalarSample b = probe.scalar(beyond);
    CHECK(std::abs(a.value - b.value) < 1e-6);
    CHECK((a.gradient - b.gradient).norm() < 1e-6);
  }
}

TEST_CASE(
    "reading a spline or the nearest voxel does not allocate, lock or throw, even in cold cells",
    "[samplers][spline][realtime]") {
  const auto grid = roughGrid();
  const auto interpolation =
      GENERATE(Interpolation::kNearest, Interpolation::kQuadratic, Interpolation::kCubic);
  Probe probe(fieldOf(grid, {}, {interpolation}));
  Random random(46);
  const CountScope scope;
  for (int i = 0; i < 2000; ++i) (void)probe.scalar(random.inCube(30.0));
  const Counts counts = CountScope::counts();
  CHECK(counts.allocations == 0);
  CHECK(counts.locks == 0);
  CHECK(counts.exceptions == 0);
}

TEST_CASE("every interpolation other than trilinear gives the background outside the data",
          "[samplers][spline]") {
  const auto interpolation =
      GENERATE(Interpolation::kNearest, Interpolation::kQuadratic, Interpolation::kCubic);
  Probe probe(fieldOf(roughGrid(), {}, {interpolation}));
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (const Vec3& p : {Vec3(1e12, 0, 0), Vec3(nan, 0, 0), Vec3(500, 500, 500)}) {
    const ScalarSample s = probe.scalar(p);
    CHECK_FALSE(s.inside);
    CHECK(s.value == Approx(0.25));
    CHECK(s.gradient.norm() < 1e-12);
  }
}

TEST_CASE("two placements share one volume in memory", "[samplers]") {
  const TemporaryFolder folder;
  writeVdb(folder / "a.vdb", {roughGrid()});
  const auto volume = loadVolume(folder / "a.vdb", "rough");
  Probe a(makeVdbField(volume, {}));
  Probe b(makeVdbField(volume, {1.0, Mat3::Identity(), {10, 0, 0}}));
  CHECK(volume.use_count() == 3);
  CHECK(a.scalar({1, 2, 3}).value == b.scalar({11, 2, 3}).value);
}

TEST_CASE("reading a field does not allocate, lock or throw, even in cold cells",
          "[samplers][realtime]") {
  Probe scalar(fieldOf(roughGrid()));
  Probe vector(
      fieldOf(makeGrid<openvdb::Vec3SGrid>(40, Transform::createLinearTransform(0.5),
                                           [](const Vec3d& p) { return openvdb::Vec3s(p); })));
  Random random(8);
  const CountScope scope;
  double sum = 0.0;
  for (int i = 0; i < 20000; ++i) {
    sum += scalar.scalar(random.inCube(15.0)).value + vector.vector(random.inCube(20.0)).value.x();
  }
  const Counts counts = CountScope::counts();
  CHECK(std::isfinite(sum));
  CHECK(counts.allocations == 0);
  CHECK(counts.locks == 0);
  CHECK(counts.exceptions == 0);
}

}  // namespace palpate::vdb_field_test
