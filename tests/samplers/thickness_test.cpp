#include "palpate/samplers/grid/thickness.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <catch2/catch.hpp>

#include "palpate/samplers/grid/openvdb_grids.h"
#include "tests/support/probe.h"
#include "tests/support/random.h"
#include "tests/support/vdb_grids.h"

namespace palpate::thickness_test {
using namespace palpate::test;
using openvdb::Coord;
using openvdb::Vec3d;
using openvdb::math::Transform;

namespace {

/// Loads a grid through a file and the loader, as users do.
std::shared_ptr<const Volume> load(const openvdb::GridBase::Ptr& grid) {
  const TemporaryFolder folder;
  grid->setName("it");
  writeVdb(folder / "a.vdb", {grid});
  return loadVolume(folder / "a.vdb", "it");
}

Thickness measure(const std::shared_ptr<const Volume>& volume, double level, Solid solid) {
  const auto found = measureThickness(volume, {}, level, solid);
  REQUIRE(found.has_value());
  CHECK(found->thin_cells <= found->surface_cells);
  CHECK(found->below_one <= found->thin_cells);
  CHECK(std::isfinite(found->least) == (found->thin_cells > 0));
  CHECK(std::isfinite(found->tenth) == (found->thin_cells > 0));
  if (found->thin_cells > 0) {
    CHECK(found->least <= found->tenth);
    CHECK(found->tenth <= kThick);
    CHECK(found->crowd > 0);
    CHECK(found->crowd <= found->thin_cells);
    // The reported places are on the surface.
    Probe probe(volume);
    for (const Vec3& p_F : {found->thinnest_F, found->crowd_F}) {
      const ScalarSample there = probe.scalar(p_F);
      CHECK(there.inside);
      CHECK(there.value == Approx(level).margin(1e-9));
    }
  }
  return *found;
}

bool same(const Thickness& a, const Thickness& b) {
  return a.surface_cells == b.surface_cells && a.thin_cells == b.thin_cells &&
         a.below_one == b.below_one && a.least == b.least && a.tenth == b.tenth &&
         a.thinnest_F == b.thinnest_F && a.crowd == b.crowd && a.crowd_F == b.crowd_F;
}

/// Counts the cells with corners on both sides, one by one.
template <class GridT>
std::uint64_t surfaceCells(const GridT& grid, double level, Solid solid) {
  const openvdb::CoordBBox box = grid.evalActiveVoxelBoundingBox();
  const int wanted = grid.getGridClass() == openvdb::GRID_LEVEL_SET ? 8 : 1;
  const auto accessor = grid.getConstAccessor();
  std::uint64_t count = 0;
  for (auto low = openvdb::CoordBBox(box.min().offsetBy(-1), box.max()).begin(); low; ++low) {
    int active = 0;
    int free = 0;
    for (int n = 0; n < 8; ++n) {
      const Coord at = (*low).offsetBy(n >> 2, (n >> 1) & 1, n & 1);
      const double height = accessor.getValue(at) - level;
      active += static_cast<int>(accessor.isValueOn(at));
      free += static_cast<int>(solid == Solid::kAbove ? height <= 0.0 : height >= 0.0);
    }
    if (active >= wanted && free > 0 && free < 8) ++count;
  }
  return count;
}

constexpr double kRadius = 20.0;

double height(const Vec3d& p) {
  return (p - Vec3d(31.6, 32.3, 31.85)).length() - kRadius;
}

/// Returns a shell of a sphere as a level set. If `thickness` is 0, returns a solid ball.
openvdb::FloatGrid::Ptr levelSet(double thickness) {
  auto grid =
      makeGrid<openvdb::FloatGrid>(64, Transform::createLinearTransform(), [=](const Vec3d& p) {
        const double h = thickness > 0.0 ? std::abs(height(p)) - 0.5 * thickness : height(p);
        return static_cast<float>(std::clamp(h, -3.0, 3.0));
      });
  grid->setGridClass(openvdb::GRID_LEVEL_SET);
  return grid;
}

/// Returns the same as a fog, with its edges spread over one voxel.
openvdb::FloatGrid::Ptr fog(double thickness) {
  auto grid =
      makeGrid<openvdb::FloatGrid>(64, Transform::createLinearTransform(), [=](const Vec3d& p) {
        const double h = thickness > 0.0 ? std::abs(height(p)) - 0.5 * thickness : height(p);
        return static_cast<float>(std::clamp(0.5 - h, 0.0, 1.0));
      });
  grid->setGridClass(openvdb::GRID_FOG_VOLUME);
  return grid;
}

}  // namespace

TEST_CASE("a plate is as thick as it is made, in voxels along the way in", "[samplers][motion]") {
  openvdb::Mat4R matrix = openvdb::Mat4R::identity();
  Mat3 linear = Mat3::Zero();
  SECTION("cubes") {
    linear.diagonal() = Vec3(0.1, 0.1, 0.1);
  }
  SECTION("oblong voxels") {
    linear.diagonal() = Vec3(3.0, 0.5, 1.0);
  }
  SECTION("skewed voxels") {
    linear << 1.0, -0.1, 0.0, 0.3, 1.5, 0.2, -0.2, 0.1, 2.0;
  }
  for (int a = 0; a < 3; ++a) {
    for (int i = 0; i < 3; ++i) matrix(i, a) = linear(a, i);
    matrix(3, a) = 0.7 - a;
  }
  // The path in follows the normal. In index space it is longer than the plate by this factor.
  const Vec3 way = (linear.transpose() * linear).inverse().col(0);
  const double longer = way.norm() / way.x();
  constexpr int kSide = 20;
  for (const double thickness : {0.3, 1.0, 1.2, 1.45, 1.55, 2.0, 3.0}) {
    CAPTURE(thickness, longer);
    const auto transform = Transform::createLinearTransform(matrix);
    auto grid = makeGrid<openvdb::DoubleGrid>(kSide, transform, [&](const Vec3d& p) {
      return std::abs(transform->worldToIndex(p).x() - 10.0) - 0.5 * thickness;
    });
    grid->setGridClass(openvdb::GRID_LEVEL_SET);
    const Thickness found = measure(load(grid), 0.0, Solid::kBelow);
    // If a side is on the voxels, rounding decides in which of two layers of cells it is.
    if (thickness != 2.0) CHECK(found.surface_cells == 2 * (kSide - 1) * (kSide - 1));
    const double seen = thickness * longer;
    if (seen > kThick) {
      CHECK(found.thin_cells == 0);
      continue;
    }
    // A slanting path in can leave the data at the rim.
    if (longer == 1.0) CHECK(found.thin_cells == found.surface_cells);
    CHECK(found.thin_cells > 0.8 * static_cast<double>(found.surface_cells));
    CHECK(found.least == Approx(seen).epsilon(1e-9));
    CHECK(found.tenth - seen < 0.010001);
    if (std::abs(seen - 1.0) > 1e-6) CHECK((found.below_one > 0) == (seen < 1.0));
  }
}

TEST_CASE("a lone voxel is thin by hand", "[samplers][motion]") {
  openvdb::initialize();
  auto grid = openvdb::FloatGrid::create(0.0F);
  // One voxel is in the middle of a leaf, one in its corner. No other leaf has its cells.
  for (const int at : {3, 0}) {
    grid->clear();
    grid->tree().setValue(Coord(at), 1.0F);
    const Thickness found = measure(load(grid), 0.5, Solid::kAbove);
    CHECK(found.surface_cells == 8);
    CHECK(found.thin_cells == 8);
    CHECK(found.below_one == 8);
    CHECK(found.crowd == 8);
    // Along the diagonal the value is (1 - t)^3.
    CHECK(found.least == Approx(2.0 * std::sqrt(3.0) * (1.0 - std::cbrt(0.5))).epsilon(1e-9));
    // The solid around it has no end.
    CHECK(measure(load(grid), 0.5, Solid::kBelow).thin_cells == 0);
  }
}

TEST_CASE("shells of a sphere are thin below 1.5 voxels, a ball is nowhere", "[samplers][motion]") {
  const auto look = [](const openvdb::FloatGrid::Ptr& grid, double level, Solid solid) {
    const auto volume = load(grid);
    const Thickness found = measure(volume, level, solid);
    CHECK(found.surface_cells == surfaceCells(*grid, level, solid));
    CHECK(same(found, measure(volume, level, solid)));
    return found;
  };
  // Between voxels the distance to the middle reads too large, so the shell is a little thinner.
  for (const double thickness : {1.3, 1.4, 1.45}) {
    CAPTURE(thickness);
    const Thickness found = look(levelSet(thickness), 0.0, Solid::kBelow);
    CHECK(found.thin_cells == found.surface_cells);
    CHECK(found.below_one == 0);
    CHECK(found.least > thickness - 0.15);
    CHECK(found.tenth < thickness);
  }
  const Thickness nearly = look(levelSet(1.55), 0.0, Solid::kBelow);
  CHECK(nearly.thin_cells > 0);
  CHECK(nearly.thin_cells < 0.01 * static_cast<double>(nearly.surface_cells));
  CHECK(nearly.least > 1.4);
  for (const double thickness : {1.6, 2.0, 3.0, 0.0}) {
    CAPTURE(thickness);
    CHECK(look(levelSet(thickness), 0.0, Solid::kBelow).thin_cells == 0);
  }
  // A shell of one voxel is thinner all round. Some places are measured at a slant, along the
  // ridge.
  for (const bool cloud : {false, true}) {
    const auto grid = cloud ? fog(1.0) : levelSet(1.0);
    const Thickness found = look(grid, cloud ? 0.5 : 0.0, cloud ? Solid::kAbove : Solid::kBelow);
    const auto cells = static_cast<double>(found.surface_cells);
    CHECK(static_cast<double>(found.thin_cells) > 0.999 * cells);
    CHECK(static_cast<double>(found.below_one) > 0.85 * cells);
    CHECK(found.least < 0.5);
  }
  // Felt at a fourth of its density, a fog of one voxel is half a voxel thicker.
  const Thickness low = look(fog(1.0), 0.25, Solid::kAbove);
  CHECK(low.thin_cells < 0.01 * static_cast<double>(low.surface_cells));
  CHECK(low.least > 1.4);
  for (const double thickness : {2.0, 3.0, 0.0}) {
    CAPTURE(thickness);
    for (const double level : {0.25, 0.5}) {
      CHECK(look(fog(thickness), level, Solid::kAbove).thin_cells == 0);
    }
  }
  // Turned inside out, the shell is free, and the space round it and within it is thick.
  CHECK(look(levelSet(1.0), 0.0, Solid::kAbove).thin_cells == 0);
}

TEST_CASE("a shell of single voxels has holes, and is thin all round", "[samplers][motion]") {
  const auto grid = makeGrid<openvdb::FloatGrid>(
      64, Transform::createLinearTransform(),
      [](const Vec3d& p) { return std::abs(height(p)) < 0.5 ? 1.0F : 0.0F; });
  grid->setGridClass(openvdb::GRID_FOG_VOLUME);
  const auto volume = load(grid);
  const Thickness found = measure(volume, 0.5, Solid::kAbove);
  CHECK(found.surface_cells == surfaceCells(*grid, 0.5, Solid::kAbove));
  CHECK(static_cast<double>(found.thin_cells) > 0.9 * static_cast<double>(found.surface_cells));
  // Counts paths from outside to the middle that do not meet the surface.
  Probe probe(volume);
  Random random(5);
  const Vec3 centre(31.6, 32.3, 31.85);
  int holes = 0;
  for (int i = 0; i < 1000; ++i) {
    const Vec3 from = centre + (kRadius + 5.0) * random.direction();
    holes += static_cast<int>(
        !std::get<0>(probe.field)->firstFall(from, centre, 0.5, -1.0, probe.cache).found);
  }
  CHECK(holes > 0);
}

TEST_CASE("each surface cell is counted once, whatever holds its voxels", "[samplers][motion]") {
  openvdb::initialize();
  Random random(3);
  auto grid = openvdb::FloatGrid::create(0.25F);
  const auto noise = [&](int voxels, double reach) {
    for (int i = 0; i < voxels; ++i) {
      const Vec3 p = random.inCube(reach);
      grid->tree().setValue(Coord::round(Vec3d(p.x(), p.y(), p.z())),
                            static_cast<float>(random.uniform(-1, 1)));
    }
  };
  SECTION("leaves, full and not") {
    noise(8000, 14.0);
  }
  SECTION("few voxels in many leaves") {
    noise(500, 60.0);
  }
  SECTION("tiles beside leaves and tiles") {
    noise(3000, 12.0);
    for (const Coord& at : {Coord(16, 0, 0), Coord(24, 0, 0), Coord(16, 8, 8), Coord(-24, -8, 0)}) {
      grid->tree().addTile(1, at, random.uniform() < 0.5 ? 1.0F : -1.0F, true);
    }
    grid->tree().addTile(1, Coord(-32, -8, 0), -0.5F, false);
  }
  SECTION("a tile of a node") {
    grid->tree().addTile(2, Coord(0, 0, 0), -0.5F, true);
    grid->tree().addTile(1, Coord(128, 8, 8), -0.75F, true);
    grid->tree().setValue(Coord(64, 64, 128), 1.0F);
  }
  for (const Solid solid : {Solid::kAbove, Solid::kBelow}) {
    const Thickness found = measure(load(grid), 0.1, solid);
    CHECK(found.surface_cells == surfaceCells(*grid, 0.1, solid));
    CHECK(found.surface_cells > 0);
    // The same voxels, all in leaves.
    auto voxels = grid->deepCopy();
    voxels->tree().voxelizeActiveTiles();
    CHECK(same(found, measure(load(voxels), 0.1, solid)));
  }
}

TEST_CASE("where most thin cells are together is a wall, not the thinnest speck",
          "[samplers][motion]") {
  openvdb::initialize();
  auto grid = openvdb::FloatGrid::create(0.0F);
  // A plate of one layer of voxels about (20, 20, 20), and a weaker lone voxel.
  for (int i = 17; i <= 23; ++i) {
    for (int j = 17; j <= 23; ++j) grid->tree().setValue(Coord(i, j, 20), 1.0F);
  }
  grid->tree().setValue(Coord(60, 60, 60), 0.75F);
  const Thickness found = measure(load(grid), 0.5, Solid::kAbove);
  CHECK((found.thinnest_F - Vec3::Constant(60.0)).norm() < 1.0);
  CHECK((found.crowd_F - Vec3::Constant(20.0)).cwiseAbs().maxCoeff() < 4.0);
  // The plate's cells in its leaf: x and y from 16 to 23, z 19 and 20.
  CHECK(found.crowd == 2 * 8 * 8);
}

TEST_CASE("only trilinear scalars are looked at for thin places", "[samplers][motion]") {
  const auto ball = load(makeBall(2.0, 0.1));
  for (const Interpolation other :
       {Interpolation::kNearest, Interpolation::kQuadratic, Interpolation::kCubic}) {
    CHECK_FALSE(measureThickness(ball, {other, false}, 0.0, Solid::kBelow).has_value());
  }
  CHECK(measure(ball, 0.0, Solid::kBelow).thin_cells == 0);
  // A level that does not occur.
  CHECK(measure(ball, 7.0, Solid::kBelow).surface_cells == 0);
  const auto flow = load(makeGrid<openvdb::Vec3SGrid>(
      3, Transform::createLinearTransform(), [](const Vec3d& p) { return openvdb::Vec3s(p); }));
  CHECK_FALSE(measureThickness(flow, {}, 1.0, Solid::kAbove).has_value());
}

TEST_CASE("a surface that leaves its data is counted, with the place", "[samplers]") {
  const auto ball = makeBall(kRadius, 1.0);
  CHECK(measure(load(ball), 0.0, Solid::kBelow).open_cells == 0);
  const auto cut = ball->deepCopy();
  for (auto voxel = cut->beginValueOn(); voxel; ++voxel) {
    if (voxel.getCoord().x() > 3) voxel.setValueOff();
  }
  const Thickness found = measure(load(cut), 0.0, Solid::kBelow);
  // The ring at the cut has about 2 pi r cells, and half as many again where it runs at a slant.
  const double around = 2.0 * std::numbers::pi * std::sqrt(kRadius * kRadius - 9.0);
  CAPTURE(found.open_cells, around);
  CHECK(static_cast<double>(found.open_cells) > 0.8 * around);
  CHECK(static_cast<double>(found.open_cells) < 1.6 * around);
  CHECK(found.open_F.x() == 3.0);
  CHECK(std::abs(Vec3(3.0, found.open_F.y(), found.open_F.z()).norm() - kRadius) < 2.0);
}

TEST_CASE("a gap between two solids is as wide as it is", "[thickness]") {
  constexpr int kSide = 20;
  const auto transform = Transform::createLinearTransform(0.5);
  // `sense` 1: solid where x is below `at`, in voxels; -1: above.
  const auto half = [&](double at, double sense) {
    auto grid = makeGrid<openvdb::FloatGrid>(kSide, transform, [&](const Vec3d& p) {
      return 0.5 * sense * (transform->worldToIndex(p).x() - at);
    });
    grid->setGridClass(openvdb::GRID_LEVEL_SET);
    return load(grid);
  };
  Placement place;
  place.scale = 0.01;
  place.rotation = Eigen::AngleAxisd(0.7, Vec3(1, 2, 3).normalized()).toRotationMatrix();
  place.translate = Vec3(0.1, -0.2, 0.3);
  const auto volume = half(9.3, 1.0);
  for (const double width : {-3.0, -0.4, 0.0, 0.03, 0.1, 0.5, 1.0, 1.9, 2.1, 4.0}) {
    CAPTURE(width);
    const FieldPtr other = makeVdbField(half(9.3 + width, -1.0), place, {});
    const auto gap =
        measureGap(volume, {}, 0.0, Solid::kBelow, place, *std::get<0>(other), 0.0, Solid::kBelow);
    REQUIRE(gap.has_value());
    CHECK(gap->surface_cells == (kSide - 1) * (kSide - 1));
    const bool is_gap = width > 0.05 && width < kGap;
    CHECK(gap->facing_cells == (is_gap ? gap->surface_cells : 0));
    CHECK(gap->widest == Approx(is_gap ? width : 0.0).margin(1e-4));
    CHECK(gap->length_F == Approx(is_gap ? 0.5 * width : 0.0).margin(1e-4));
    CHECK(gap->median == Approx(is_gap ? width : 0.0).margin(0.0101));
    if (is_gap) CHECK(2.0 * gap->widest_F.x() == Approx(9.3).margin(1e-4));
  }

  // One ball lies in another, beyond the band of the larger one.
  const auto ball = [&](double radius) {
    auto grid = makeGrid<openvdb::FloatGrid>(34, transform, [&](const Vec3d& p) {
      return 0.5 * ((transform->worldToIndex(p) - Vec3d(17.0)).length() - radius);
    });
    for (auto at = grid->beginValueAll(); at; ++at) {
      if (std::abs(*at) <= 1.5F) continue;
      at.setValue(*at < 0.0F ? -1.5F : 1.5F);
      at.setValueOff();
    }
    grid->setGridClass(openvdb::GRID_LEVEL_SET);
    return load(grid);
  };
  const FieldPtr outer = makeVdbField(ball(14.0), place, {});
  const auto within = measureGap(ball(10.0), {}, 0.0, Solid::kBelow, place, *std::get<0>(outer),
                                 0.0, Solid::kBelow);
  CHECK(within->surface_cells > 1000);
  CHECK(within->facing_cells == 0);
}

}  // namespace palpate::thickness_test
