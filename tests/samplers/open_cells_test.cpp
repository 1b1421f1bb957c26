#include "palpate/samplers/grid/open_cells.h"

#include <cmath>
#include <numbers>

#include <catch2/catch.hpp>

#include "palpate/samplers/grid/make_volume.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "tests/support/random.h"
#include "tests/support/vdb_grids.h"

namespace palpate::open_cells_test {
using namespace palpate::test;
using openvdb::Coord;
using openvdb::Vec3d;
using openvdb::math::Transform;

namespace {

constexpr double kRadius = 20.0;

OpenCells find(const openvdb::GridBase& grid, double level, Solid solid) {
  const auto found = findOpenCells(*makeVolume(grid), {}, level, solid);
  REQUIRE(found.has_value());
  return *found;
}

/// Finds a grid's open cells by checking each cell. The grid's transform is the identity.
OpenCells reference(const openvdb::FloatGrid& grid, double level, Solid solid) {
  const openvdb::CoordBBox box = grid.evalActiveVoxelBoundingBox();
  const auto accessor = grid.getConstAccessor();
  OpenCells out;
  for (auto low = openvdb::CoordBBox(box.min().offsetBy(-1), box.max()).begin(); low; ++low) {
    int active = 0;
    int free = 0;
    for (int n = 0; n < 8; ++n) {
      const Coord at = (*low).offsetBy(n >> 2, (n >> 1) & 1, n & 1);
      const double height = accessor.getValue(at) - level;
      active += static_cast<int>(accessor.isValueOn(at));
      free += static_cast<int>(solid == Solid::kAbove ? height <= 0.0 : height >= 0.0);
    }
    if (active == 0 || active == 8 || free == 0 || free == 8) continue;
    if (out.count++ == 0) out.first_F = Vec3((*low).x(), (*low).y(), (*low).z());
  }
  return out;
}

}  // namespace

TEST_CASE("the cells where a surface leaves its data are counted, and the first one is located",
          "[samplers]") {
  const auto ball = makeBall(kRadius, 1.0);
  CHECK(find(*ball, 0.0, Solid::kBelow).count == 0);
  const auto cut = ball->deepCopy();
  for (auto voxel = cut->beginValueOn(); voxel; ++voxel) {
    if (voxel.getCoord().x() > 3) voxel.setValueOff();
  }
  const OpenCells found = find(*cut, 0.0, Solid::kBelow);
  // The ring at the cut has about 2 pi r cells, and half as many more where it is oblique to the
  // grid.
  const double around = 2.0 * std::numbers::pi * std::sqrt(kRadius * kRadius - 9.0);
  CAPTURE(found.count, around);
  CHECK(static_cast<double>(found.count) > 0.8 * around);
  CHECK(static_cast<double>(found.count) < 1.6 * around);
  CHECK(found.first_F.x() == 3.0);
  CHECK(std::abs(Vec3(3.0, found.first_F.y(), found.first_F.z()).norm() - kRadius) < 2.0);
  // The place is given in the file's space.
  cut->setTransform(Transform::createLinearTransform(0.5));
  CHECK(find(*cut, 0.0, Solid::kBelow).first_F == 0.5 * found.first_F);
  // The values of a fog are valid up to the end of its data.
  cut->setGridClass(openvdb::GRID_FOG_VOLUME);
  CHECK(find(*cut, 0.0, Solid::kBelow).count == 0);
}

TEST_CASE("each open cell is counted once, in leaves and in tiles", "[samplers][release]") {
  openvdb::initialize();
  Random random(3);
  auto grid = openvdb::FloatGrid::create(0.25F);
  grid->setGridClass(openvdb::GRID_LEVEL_SET);
  const auto noise = [&](int voxels, double reach) {
    for (int i = 0; i < voxels; ++i) {
      const Vec3 p = random.inCube(reach);
      grid->tree().setValue(Coord::round(Vec3d(p.x(), p.y(), p.z())),
                            static_cast<float>(random.uniform(-1, 1)));
    }
  };
  SECTION("full and partial leaves") {
    noise(8000, 14.0);
  }
  SECTION("few voxels in many leaves") {
    noise(500, 60.0);
  }
  SECTION("tiles next to leaves and to other tiles") {
    noise(3000, 12.0);
    for (const Coord& at : {Coord(16, 0, 0), Coord(24, 0, 0), Coord(16, 8, 8), Coord(-24, -8, 0)}) {
      grid->tree().addTile(1, at, random.uniform() < 0.5 ? 1.0F : -1.0F, true);
    }
    grid->tree().addTile(1, Coord(-32, -8, 0), -0.5F, false);
  }
  SECTION("a tile of an upper node") {
    grid->tree().addTile(2, Coord(0, 0, 0), -0.5F, true);
    grid->tree().addTile(1, Coord(128, 8, 8), -0.75F, true);
    grid->tree().setValue(Coord(64, 64, 128), 1.0F);
  }
  for (const Solid solid : {Solid::kAbove, Solid::kBelow}) {
    const OpenCells found = find(*grid, 0.1, solid);
    const OpenCells expected = reference(*grid, 0.1, solid);
    CHECK(found.count == expected.count);
    CHECK(found.count > 0);
    CHECK(found.first_F == expected.first_F);
  }
}

TEST_CASE("only trilinear scalars are searched for open cells", "[samplers]") {
  const auto ball = makeVolume(*makeBall(2.0, 0.1));
  for (const Interpolation other :
       {Interpolation::kNearest, Interpolation::kQuadratic, Interpolation::kCubic}) {
    CHECK_FALSE(findOpenCells(*ball, {other, false}, 0.0, Solid::kBelow).has_value());
  }
  // A level that no cell contains.
  CHECK(findOpenCells(*ball, {}, 7.0, Solid::kBelow)->count == 0);
  const auto flow = makeGrid<openvdb::Vec3SGrid>(3, Transform::createLinearTransform(),
                                                 [](const Vec3d& p) { return openvdb::Vec3s(p); });
  CHECK_FALSE(findOpenCells(*makeVolume(*flow), {}, 1.0, Solid::kAbove).has_value());
}

}  // namespace palpate::open_cells_test
