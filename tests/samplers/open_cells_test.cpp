#include "palpate/samplers/grid/open_cells.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <variant>

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

/// A cell of a grid: the number of its active corners, and whether its values cross the level.
struct CellState {
  int active = 0;
  bool crosses = false;
};

CellState stateOf(const openvdb::FloatGrid::ConstAccessor& grid, const Coord& low, double level,
                  Solid solid) {
  CellState out;
  int free = 0;
  for (int n = 0; n < 8; ++n) {
    const Coord at = low.offsetBy(n >> 2, (n >> 1) & 1, n & 1);
    const double height = grid.getValue(at) - level;
    out.active += static_cast<int>(grid.isValueOn(at));
    free += static_cast<int>(solid == Solid::kAbove ? height <= 0.0 : height >= 0.0);
  }
  out.crosses = free > 0 && free < 8;
  return out;
}

/// Finds the open cells of a grid whose values are not distances, by checking every cell. Requires
/// an identity transform.
OpenCells reference(const openvdb::FloatGrid& grid, double level, Solid solid) {
  const openvdb::CoordBBox box = grid.evalActiveVoxelBoundingBox();
  const auto accessor = grid.getConstAccessor();
  OpenCells out;
  for (auto low = openvdb::CoordBBox(box.min().offsetBy(-2), box.max().offsetBy(1)).begin(); low;
       ++low) {
    const CellState here = stateOf(accessor, *low, level, solid);
    if (!here.crosses || here.active == 0) continue;
    ++out.surface;
    if (here.active == 8) continue;
    if (out.count++ == 0) out.first_F = Vec3((*low).x(), (*low).y(), (*low).z());
  }
  return out;
}

/// Returns a ball of radius 20 voxels with a band as OpenVDB makes it from a mesh: values are
/// clipped at `outside` and `inside` voxels, and clipped voxels are inactive.
openvdb::FloatGrid::Ptr makeBanded(float outside, float inside) {
  openvdb::initialize();
  auto grid = openvdb::FloatGrid::create(outside);
  grid->setGridClass(openvdb::GRID_LEVEL_SET);
  const int side = static_cast<int>(kRadius + outside) + 3;
  for (auto voxel = openvdb::CoordBBox(Coord(-side), Coord(side)).begin(); voxel; ++voxel) {
    const Coord& c = *voxel;
    const auto v = static_cast<float>(c.asVec3d().length() - kRadius);
    if (v > -inside && v < outside) {
      grid->tree().setValueOn(c, v);
    } else {
      grid->tree().setValueOff(c, v > 0.0F ? outside : -inside);
    }
  }
  return grid;
}

}  // namespace

TEST_CASE(
    "a level set with a band of one to three voxels has data at its surface in random directions",
    "[samplers]") {
  const auto [outside, inside] =
      GENERATE(table<float, float>({{3, 3}, {1.5, 1.5}, {3, 1}, {1, 3}, {1, 1}}));
  CAPTURE(outside, inside);
  const auto volume = makeVolume(*makeBanded(outside, inside));
  const OpenCells found = *findOpenCells(*volume, {}, 0.0, Solid::kBelow);
  CHECK(found.count == 0);
  CHECK(found.surface > 5000);
  Random random(5);
  for (const Interpolation by :
       {Interpolation::kTrilinear, Interpolation::kQuadratic, Interpolation::kCubic}) {
    const auto field = std::get<0>(makeVdbField(volume, {}, {by}));
    FieldCache cache;
    field->reset(cache);
    int missing = 0;
    double farthest = 0.0;
    for (int i = 0; i < 100; ++i) {
      const Vec3 out = random.direction();
      // Finds the surface along the ray, by bisection.
      double low = kRadius - 2.0;
      double high = kRadius + 2.0;
      while (high - low > 1e-9) {
        const double middle = 0.5 * (low + high);
        (field->sample(middle * out, cache).value < 0.0 ? low : high) = middle;
      }
      if (!field->sample(high * out, cache).inside) ++missing;
      farthest = std::max(farthest, std::abs(high - kRadius));
    }
    CHECK(missing == 0);
    CHECK(farthest < 0.15);  // splines are less accurate near clipped values
  }
}

TEST_CASE("the cells in which a surface leaves its data are counted, and the first one is located",
          "[samplers]") {
  const auto ball = makeBall(kRadius, 1.0);
  CHECK(find(*ball, 0.0, Solid::kBelow).count == 0);
  const auto cut = ball->deepCopy();
  for (auto voxel = cut->beginValueOn(); voxel; ++voxel) {
    if (voxel.getCoord().x() > 3) voxel.setValueOff();
  }
  const OpenCells found = find(*cut, 0.0, Solid::kBelow);
  // The cut surface ends in a ring of about 2 pi r cells. Where the ring is oblique to the grid, it
  // has up to 50 % more cells.
  const double around = 2.0 * std::numbers::pi * std::sqrt(kRadius * kRadius - 9.0);
  CAPTURE(found.count, around);
  CHECK(static_cast<double>(found.count) > 0.8 * around);
  CHECK(static_cast<double>(found.count) < 1.6 * around);
  // The inactive voxels beside the cut have correct values, so the surface extends into one more
  // cell.
  CHECK(found.first_F.x() == 4.0);
  CHECK(std::abs(Vec3(4.0, found.first_F.y(), found.first_F.z()).norm() - kRadius) < 2.0);
  // first_F is in the file's space.
  cut->setTransform(Transform::createLinearTransform(0.5));
  CHECK(find(*cut, 0.0, Solid::kBelow).first_F == 0.5 * found.first_F);
  // The values of a fog are valid up to the end of the data.
  cut->setGridClass(openvdb::GRID_FOG_VOLUME);
  CHECK(find(*cut, 0.0, Solid::kBelow).count == 0);
}

TEST_CASE("a level set that was cut off has no data just beyond the cut", "[samplers]") {
  const auto cut = makeBall(kRadius, 1.0);
  for (auto voxel = cut->beginValueOn(); voxel; ++voxel) {
    if (voxel.getCoord().x() <= 3) continue;
    voxel.setValue(cut->background());
    voxel.setValueOff();
  }
  const auto volume = makeVolume(*cut);
  const OpenCells found = *findOpenCells(*volume, {}, 0.0, Solid::kBelow);
  CHECK(found.count > 200);
  CHECK(found.count < found.surface / 4);
  const auto field = std::get<0>(makeVdbField(volume, {}));
  FieldCache cache;
  field->reset(cache);
  for (const double depth : {0.5, 1.0, 2.5, 4.0}) {
    const ScalarSample s =
        field->sample({3.5, 0.0, std::sqrt(kRadius * kRadius - 9.0) - depth}, cache);
    CHECK_FALSE(s.inside);
  }
}

TEST_CASE("each cell on the cut of a ball is open if it has data inside the ball", "[samplers]") {
  const double band = GENERATE(3.0, 10.0);
  CAPTURE(band);
  constexpr int kCut = 3;
  const auto cut = makeBanded(static_cast<float>(band), static_cast<float>(band));
  cut->fill({Coord(kCut + 1, -40, -40), Coord(40)}, cut->background(), false);
  // Where data are missing, the surface may be off by this distance (band_cell.h) [voxels].
  const double slack = 0.05 * band;
  // A cell on the cut is open if the sphere encloses a corner that has data.
  std::uint64_t expected = 0;
  for (int j = -25; j < 25; ++j) {
    for (int k = -25; k < 25; ++k) {
      double deepest = 0.0;
      bool active = false;
      for (int n = 0; n < 4; ++n) {
        const double depth = kRadius - Vec3(kCut, j + n / 2, k + n % 2).norm();
        deepest = std::max(deepest, depth);
        active = active || std::abs(depth) < band;
      }
      if (active && deepest > slack) ++expected;
    }
  }
  const auto volume = makeVolume(*cut);
  CHECK(findOpenCells(*volume, {}, 0.0, Solid::kBelow)->count == expected);
  CHECK(expected > 100);
  // Where the field has a surface beside the cut, this surface must be that of the sphere.
  const auto field = std::get<0>(makeVdbField(volume, {}));
  FieldCache cache;
  field->reset(cache);
  Random random(11);
  int felt = 0;
  for (int i = 0; i < 1000; ++i) {
    const double angle = random.uniform(0.0, 2.0 * std::numbers::pi);
    const double x = random.uniform(kCut - 1.0, kCut + 1.0);
    const auto at = [&](double out) {
      return Vec3(x, out * std::cos(angle), out * std::sin(angle));
    };
    double low = kRadius - 3.0;
    double high = kRadius + 2.0;
    while (high - low > 1e-9) {
      const double middle = 0.5 * (low + high);
      (field->sample(at(middle), cache).value < 0.0 ? low : high) = middle;
    }
    if (!field->sample(at(high), cache).inside) continue;
    ++felt;
    CHECK(std::abs(at(high).norm() - kRadius) < slack + 0.05);
  }
  CHECK(felt > 400);
}

TEST_CASE("each open cell in leaves and tiles is counted once", "[samplers][release]") {
  openvdb::initialize();
  Random random(3);
  auto grid = openvdb::FloatGrid::create(0.001F);  // too narrow a band to contain a surface
  grid->setGridClass(openvdb::GRID_LEVEL_SET);
  const auto noise = [&](int voxels, double reach) {
    for (int i = 0; i < voxels; ++i) {
      const Vec3 p = random.inCube(reach);
      grid->tree().setValue(Coord::round(Vec3d(p.x(), p.y(), p.z())),
                            static_cast<float>(random.uniform(-1, 1)));
    }
  };
  SECTION("open cells are in full and partial leaves") {
    noise(8000, 14.0);
  }
  SECTION("open cells are in leaves with few voxels") {
    noise(500, 60.0);
  }
  SECTION("open cells are in tiles next to leaves and other tiles") {
    noise(3000, 12.0);
    for (const Coord& at : {Coord(16, 0, 0), Coord(24, 0, 0), Coord(16, 8, 8), Coord(-24, -8, 0)}) {
      grid->tree().addTile(1, at, random.uniform() < 0.5 ? 1.0F : -1.0F, true);
    }
    grid->tree().addTile(1, Coord(-32, -8, 0), -0.5F, false);
  }
  SECTION("open cells are at a tile of an upper node") {
    grid->tree().addTile(2, Coord(0, 0, 0), -0.5F, true);
    grid->tree().addTile(1, Coord(128, 8, 8), -0.75F, true);
    grid->tree().setValue(Coord(64, 64, 128), 1.0F);
  }
  for (const Solid solid : {Solid::kAbove, Solid::kBelow}) {
    const OpenCells found = find(*grid, 0.1, solid);
    const OpenCells expected = reference(*grid, 0.1, solid);
    CHECK(found.count == expected.count);
    CHECK(found.surface == expected.surface);
    CHECK(found.count > 0);
    CHECK(found.first_F == expected.first_F);
  }
}

TEST_CASE("only trilinear scalar volumes are searched for cells in which a surface leaves its data",
          "[samplers]") {
  const auto ball = makeVolume(*makeBall(2.0, 0.1));
  for (const Interpolation other :
       {Interpolation::kNearest, Interpolation::kQuadratic, Interpolation::kCubic}) {
    CHECK_FALSE(findOpenCells(*ball, {other, false}, 0.0, Solid::kBelow).has_value());
  }
  // No cell contains this level.
  CHECK(findOpenCells(*ball, {}, 7.0, Solid::kBelow)->count == 0);
  const auto flow = makeGrid<openvdb::Vec3SGrid>(3, Transform::createLinearTransform(),
                                                 [](const Vec3d& p) { return openvdb::Vec3s(p); });
  CHECK_FALSE(findOpenCells(*makeVolume(*flow), {}, 1.0, Solid::kAbove).has_value());
}

}  // namespace palpate::open_cells_test
