#include "palpate/samplers/grid/ghosts.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/make_volume.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "tests/support/random.h"
#include "tests/support/vdb_grids.h"

namespace palpate::ghosts_test {
using namespace palpate::test;
using openvdb::Coord;
using openvdb::CoordBBox;
using openvdb::Vec3d;
using openvdb::math::Transform;

namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kBand = 3.0;

struct Ball {
  Vec3 centre;  ///< In index space.
  double radius = 0.0;
};

/// Returns clamped level sets as tools make them: active only in the band, with inside tiles where
/// there is no band.
openvdb::FloatGrid::Ptr levelSet(const std::vector<Ball>& balls, double voxel = 1.0,
                                 const Vec3& origin = Vec3::Zero()) {
  openvdb::initialize();
  auto grid = openvdb::FloatGrid::create(static_cast<float>(kBand));
  grid->setGridClass(openvdb::GRID_LEVEL_SET);
  auto transform = Transform::createLinearTransform(voxel);
  transform->postTranslate(Vec3d(origin.x(), origin.y(), origin.z()));
  grid->setTransform(transform);
  const auto distance = [&](const Coord& at) {
    double least = kBand;
    for (const Ball& ball : balls) {
      least = std::min(least, (Vec3(at.x(), at.y(), at.z()) - ball.centre).norm() - ball.radius);
    }
    return static_cast<float>(std::max(least, -kBand));
  };
  for (const Ball& ball : balls) {
    const auto block = [&](double sign, int axis) {
      return static_cast<int>(std::floor((ball.centre[axis] + sign * (ball.radius + kBand)) / 8));
    };
    for (int i = block(-1, 0); i <= block(1, 0); ++i) {
      for (int j = block(-1, 1); j <= block(1, 1); ++j) {
        for (int k = block(-1, 2); k <= block(1, 2); ++k) {
          const Coord low(8 * i, 8 * j, 8 * k);
          bool band = false;
          for (auto at = CoordBBox::createCube(low, 8).begin(); at; ++at) {
            band = band || std::abs(distance(*at)) < kBand;
          }
          if (!band && distance(low) < 0) {
            grid->tree().addTile(1, low, distance(low), false);
          }
          for (auto at = CoordBBox::createCube(low, 8).begin(); at && band; ++at) {
            const float value = distance(*at);
            grid->tree().setValue(*at, value);
            if (std::abs(value) >= kBand) grid->tree().setValueOff(*at);
          }
        }
      }
    }
  }
  return grid;
}

Ghosts between(const openvdb::GridBase::Ptr& a, const openvdb::GridBase::Ptr& b, double level = 0.0,
               double sign = 1.0) {
  return ghostsBetween(*makeVolume(*a), *makeVolume(*b), level, sign);
}

bool same(const Ghosts& a, const Ghosts& b) {
  return a.pieces == b.pieces && a.of == b.of && a.share == b.share && a.where == b.where &&
         a.size == b.size;
}

/// Returns the edge of a cube that has a ball's volume.
double width(double radius) {
  return std::cbrt(4.0 / 3.0 * kPi) * radius;
}

Vec3 along(double x) {
  return {x, 0.0, 0.0};
}

/// Finds the pieces voxel by voxel, without leaves and tiles. Returns the piece of each voxel of
/// matter.
template <class GridT>
std::map<Coord, int> piecesOf(const GridT& grid, double level, double sign, int& count) {
  const bool level_set = grid.getGridClass() == openvdb::GRID_LEVEL_SET;
  // The box has all leaves and every place where scatter may put tiles. OpenVDB's own box leaves
  // out inactive leaves.
  CoordBBox box(Coord(-24), Coord(31));
  for (auto leaf = grid.tree().cbeginLeaf(); leaf; ++leaf) box.expand(leaf->getNodeBoundingBox());
  std::map<Coord, int> piece;
  for (auto at = box.begin(); at; ++at) {
    typename GridT::ValueType value{};
    const bool on = grid.tree().probeValue(*at, value);
    if (sign * (value - level) < 0 && (on || (level_set && value < 0))) piece[*at] = -1;
  }
  for (auto& [from, number] : piece) {
    if (number >= 0) continue;
    number = count++;
    std::vector<Coord> rim{from};
    while (!rim.empty()) {
      const Coord at = rim.back();
      rim.pop_back();
      for (auto next = CoordBBox(at.offsetBy(-1), at.offsetBy(1)).begin(); next; ++next) {
        const auto found = piece.find(*next);
        if (found == piece.end() || found->second >= 0) continue;
        found->second = number;
        rim.push_back(*next);
      }
    }
  }
  return piece;
}

template <class GridT>
Ghosts reference(const GridT& a, const GridT& b, double level, double sign) {
  struct Frame {
    const GridT* grid = nullptr;
    int count = 0;
    std::map<Coord, int> matter;
    std::vector<double> voxels;
    std::vector<Vec3d> sums;
    std::vector<bool> met;
  };
  std::vector<Frame> frames(2);
  frames[0].grid = &a;
  frames[1].grid = &b;
  for (Frame& frame : frames) {
    frame.matter = piecesOf(*frame.grid, level, sign, frame.count);
    const auto count = static_cast<std::size_t>(frame.count);
    frame.voxels.resize(count);
    frame.sums.resize(count);
    frame.met.resize(count);
  }
  for (std::size_t f = 0; f < 2; ++f) {
    Frame& mine = frames[f];
    Frame& other = frames[1 - f];
    for (const auto& [at, number] : mine.matter) {
      const auto piece = static_cast<std::size_t>(number);
      const Vec3d place = mine.grid->indexToWorld(at);
      mine.voxels[piece] += 1.0;
      mine.sums[piece] += place;
      const Vec3d there = other.grid->worldToIndex(place);
      const auto found = other.matter.find(Coord::floor(there + Vec3d(0.5)));
      if (found == other.matter.end()) continue;
      mine.met[piece] = true;
      other.met[static_cast<std::size_t>(found->second)] = true;
    }
  }
  Ghosts out;
  double whole = 0.0;
  double ghostly = 0.0;
  double largest = 0.0;
  for (const Frame& frame : frames) {
    for (std::size_t p = 0; p < frame.voxels.size(); ++p) {
      if (frame.voxels[p] < 8.0) continue;
      const double volume =
          frame.voxels[p] * std::abs(frame.grid->transform().baseMap()->determinant());
      ++out.of;
      whole += volume;
      if (frame.met[p]) continue;
      ++out.pieces;
      ghostly += volume;
      if (volume <= largest) continue;
      largest = volume;
      const Vec3d centre = frame.sums[p] / frame.voxels[p];
      out.where = Vec3(centre.x(), centre.y(), centre.z());
    }
  }
  out.share = whole > 0.0 ? ghostly / whole : 0.0;
  out.size = std::cbrt(largest);
  return out;
}

/// Returns random blobs, strands, specks and tiles.
template <class GridT>
typename GridT::Ptr scatter(Random& random, bool level_set, const Transform::Ptr& transform) {
  using Real = typename GridT::ValueType;
  openvdb::initialize();
  auto grid = GridT::create(level_set ? Real{1} : Real{0});
  grid->setTransform(transform);
  grid->setGridClass(level_set ? openvdb::GRID_LEVEL_SET : openvdb::GRID_FOG_VOLUME);
  const auto matter = [&] { return static_cast<Real>(random.uniform(0.6, 1.0)); };
  const Real sign = level_set ? Real{-1} : Real{1};
  const auto coord = [](const Vec3& p) { return Coord::floor(Vec3d(p.x(), p.y(), p.z())); };
  for (int i = 0; i < 4; ++i) {
    // A fog's tiles are active, the tiles inside a level set are inactive.
    const Coord at = coord(random.inCube(20.0)) & ~7;
    grid->tree().addTile(1, at, sign * matter(), !level_set);
  }
  for (int i = 0; i < 60; ++i) {
    Vec3 p = random.inCube(24.0);
    const Vec3 way = random.direction();
    const int steps = static_cast<int>(random.uniform(1.0, 14.0));
    const bool thick = random.uniform() < 0.4;
    for (int n = 0; n < steps; ++n, p += way) {
      const Coord at = coord(p);
      for (auto voxel = CoordBBox(at, at.offsetBy(thick ? 1 : 0)).begin(); voxel; ++voxel) {
        grid->tree().setValue(*voxel, sign * matter());
        if (random.uniform() < 0.3) grid->tree().setValueOff(*voxel);
      }
    }
  }
  return grid;
}

}  // namespace

TEST_CASE("a ball is a ghost from where it moves by its own size", "[sequence]") {
  for (const double voxel : {1.0, 0.5}) {
    const Vec3 origin(3.0, -1.0, 0.25);
    const Vec3 centre(4.0, 5.0, -6.0);
    const auto a = levelSet({{centre, 10.0}}, voxel, origin);
    // The ball's voxels are at most 9 to each side: after 18 the last voxels overlap.
    for (const double way : {0.0, 5.0, 18.0}) {
      CAPTURE(voxel, way);
      for (const int axis : {0, 1, 2}) {
        for (const double turn : {-1.0, 1.0}) {
          const Vec3 moved = centre + turn * way * Vec3::Unit(axis);
          const Ghosts found = between(a, levelSet({{moved, 10.0}}, voxel, origin));
          CHECK(found.of == 2);
          CHECK(found.pieces == 0);
          CHECK(found.share == 0.0);
          CHECK(found.where == Vec3::Zero());
          CHECK(found.size == 0.0);
        }
      }
    }
    for (const double way : {19.0, 30.0, 500.0}) {
      CAPTURE(voxel, way);
      for (const int axis : {0, 1, 2}) {
        const auto b = levelSet({{centre + way * Vec3::Unit(axis), 10.0}}, voxel, origin);
        const Ghosts found = between(a, b);
        CHECK(found.of == 2);
        CHECK(found.pieces == 2);
        CHECK(found.share == 1.0);
        // If the pieces are equal, the first frame's is reported.
        CHECK((found.where - (voxel * centre + origin)).norm() < 1e-9);
        CHECK(found.size == Approx(voxel * width(10.0)).epsilon(0.01));
        const Ghosts back = between(b, a);
        CHECK((back.where - (voxel * (centre + way * Vec3::Unit(axis)) + origin)).norm() < 1e-9);
      }
    }
  }
}

TEST_CASE("a small ball that jumps beside a large one is the ghost", "[sequence]") {
  const Ball large{along(0.0), 40.0};
  const Ball small{along(60.0), 8.0};
  const Ball there{along(80.0), 8.0};
  const Ball less{along(68.0), 8.0};
  const double share = std::pow(8.0 / 40.0, 3) / (1.0 + std::pow(8.0 / 40.0, 3));
  const auto a = levelSet({large, small});
  const Ghosts found = between(a, levelSet({{along(1.0), 40.0}, there}));
  CHECK(found.of == 4);
  CHECK(found.pieces == 2);
  CHECK(found.share == Approx(share).epsilon(0.03));
  CHECK((found.where - small.centre).norm() < 1e-9);
  CHECK(found.size == Approx(width(8.0)).epsilon(0.02));
  CHECK(between(a, levelSet({large, less})).pieces == 0);
  // One ball is gone, or the same ball is new.
  for (const Ghosts& gone : {between(a, levelSet({large})), between(levelSet({large}), a)}) {
    CHECK(gone.of == 3);
    CHECK(gone.pieces == 1);
    CHECK((gone.where - small.centre).norm() < 1e-9);
  }
  // If there are two ghosts, the larger one is reported, whichever frame has it.
  const auto larger = levelSet({large, {along(-80.0), 12.0}});
  for (const Ghosts& two : {between(a, larger), between(larger, a)}) {
    CHECK(two.pieces == 2);
    CHECK((two.where - along(-80.0)).norm() < 1e-9);
    CHECK(two.size == Approx(width(12.0)).epsilon(0.01));
  }
}

TEST_CASE("a level set's inside is matter, whatever holds it", "[sequence]") {
  const auto large = levelSet({{along(0.0), 60.0}});
  REQUIRE(large->tree().root().getTableSize() > 0);
  // The middle of the ball has tiles, without active voxels.
  REQUIRE(large->tree().getValueDepth(Coord(0)) < 3);
  for (const double voxel : {1.0, 0.5}) {
    CAPTURE(voxel);
    const Ghosts found = between(large, levelSet({{along(0.0), 12.0}}, voxel));
    CHECK(found.of == 2);
    CHECK(found.pieces == 0);
  }
  // The same frame with tiles of 128 voxels and of 4096. Only one corner's voxels touch them.
  for (const openvdb::Index level : {2U, 3U}) {
    const int edge = level == 2 ? 128 : 4096;
    auto tile = openvdb::FloatGrid::create(1.0F);
    tile->setGridClass(openvdb::GRID_LEVEL_SET);
    tile->tree().addTile(level, Coord(0), -1.0F, false);
    for (auto at = CoordBBox(Coord(-2), Coord(-1)).begin(); at; ++at) {
      tile->tree().setValue(*at, -0.5F);
    }
    for (auto at = CoordBBox::createCube(Coord(edge), 2).begin(); at; ++at) {
      tile->tree().setValue(*at, -0.5F);
    }
    CHECK(between(tile, tile).of == 2);
    CHECK(between(tile, tile).pieces == 0);
    const auto within = levelSet({{Vec3(70, 40, 30), 5.0}, {Vec3(-40, 0, 0), 5.0}});
    const auto finer = levelSet({{Vec3(140, 80, 60), 10.0}, {Vec3(-80, 0, 0), 10.0}}, 0.5);
    for (const auto& other : {within, finer}) {
      for (const Ghosts& found : {between(tile, other), between(other, tile)}) {
        CHECK(found.of == 3);
        CHECK(found.pieces == 1);
        CHECK((found.where - along(-40)).norm() < 1e-9);
      }
    }
    // A frame that is wholly elsewhere: the result is a tile's volume and middle.
    const double far = 3.0 * edge;
    const Ghosts gone = between(tile, levelSet({{Vec3(-far, 0, 0), 5.0}}));
    CHECK(gone.pieces == 2);
    CHECK(gone.size == Approx(edge).epsilon(1e-4));
    CHECK((gone.where - Vec3::Constant(0.5 * (edge - 1))).norm() < 1e-3);
  }
  // Felt from within, the outside has no end, and only the band is matter.
  const Ghosts inverse =
      between(levelSet({{along(0.0), 10.0}}), levelSet({{along(30.0), 10.0}}), 0.0, -1.0);
  CHECK(inverse.of == 2);
  CHECK(inverse.pieces == 2);
  CHECK(inverse.share == 1.0);
}

TEST_CASE("an isosurface felt from below has its ghosts above the level", "[sequence]") {
  const auto fog = [](double x) {
    auto grid =
        makeGrid<openvdb::DoubleGrid>(48, Transform::createLinearTransform(), [=](const Vec3d& p) {
          return std::clamp(6.0 - (p - Vec3d(x, 20.0, 20.0)).length(), 0.0, 4.0);
        });
    grid->setGridClass(openvdb::GRID_FOG_VOLUME);
    return grid;
  };
  const auto a = fog(10.0);
  // Above 1 the fog is a ball of radius 5, above 3 a ball of radius 3.
  CHECK(between(a, fog(17.0), 1.0, -1.0).pieces == 0);
  const Ghosts high = between(a, fog(17.0), 3.0, -1.0);
  CHECK(high.of == 2);
  CHECK(high.pieces == 2);
  CHECK(high.share == 1.0);
  CHECK((high.where - Vec3(10.0, 20.0, 20.0)).norm() < 1e-9);
  CHECK(std::abs(high.size - width(3.0)) < 1.0);
  // Felt from above, matter is all around the balls, in one piece that stays.
  const Ghosts around = between(a, fog(30.0), 1.0, 1.0);
  CHECK(around.of == 2);
  CHECK(around.pieces == 0);
  // A level that does not occur.
  const Ghosts nothing = between(a, a, 5.0, -1.0);
  CHECK(same(nothing, Ghosts{}));
  // A fog without data has no matter there, for any value.
  auto hollow = a->deepCopy();
  for (auto value = hollow->beginValueOn(); value; ++value) value.setValueOff();
  hollow->tree().setValueOn(Coord(0));
  CHECK(between(a, hollow, 1.0, -1.0).of == 1);
}

TEST_CASE("frames whose voxels differ are laid over each other in the file's space", "[sequence]") {
  const auto a = levelSet({{along(0.0), 10.0}});
  const auto finer = [](double x, const Vec3& origin) {
    return levelSet({{(along(x) - origin) / 0.5, 20.0}}, 0.5, origin);
  };
  const Vec3 aside(7.3, -2.1, 0.4);
  for (const Vec3& origin : {Vec3(Vec3::Zero()), aside}) {
    for (const double way : {0.0, 5.0, 18.0}) {
      CAPTURE(way);
      const Ghosts found = between(a, finer(way, origin));
      CHECK(found.of == 2);
      CHECK(found.pieces == 0);
      CHECK(found.share == 0.0);
    }
    for (const double way : {21.0, 30.0, -30.0}) {
      CAPTURE(way);
      const Ghosts found = between(a, finer(way, origin));
      CHECK(found.of == 2);
      CHECK(found.pieces == 2);
      CHECK(found.share == 1.0);
      CHECK(std::abs(found.size - width(10.0)) < 0.5);
      CHECK(std::min(found.where.norm(), (found.where - along(way)).norm()) < 0.5);
    }
  }
  // The same indices are different places, and different indices are the same place.
  CHECK(between(a, levelSet({{along(0.0), 10.0}}, 1.0, along(30.0))).pieces == 2);
  CHECK(between(a, levelSet({{along(-300.0), 10.0}}, 1.0, along(300.0))).pieces == 0);
  // Volume counts, not voxels: a small ball of finer voxels has as many voxels.
  const auto both = levelSet({{along(0.0), 10.0}}, 0.5);
  CHECK(between(levelSet({{along(30.0), 10.0}}), levelSet({{along(60.0), 10.0}})).share == 1.0);
  const auto pair = levelSet({{along(0.0), 10.0}, {along(-60.0), 10.0}}, 0.5);
  const Ghosts found = between(a, pair);
  CHECK(found.of == 3);
  CHECK(found.pieces == 1);
  CHECK(found.share == Approx(1.0 / 10.0).epsilon(1e-9));
  CHECK(between(a, both).pieces == 0);
  // A frame far beyond any index.
  CHECK(between(a, levelSet({{along(0.0), 10.0}}, 1e-3, along(1e9))).pieces == 2);
}

TEST_CASE("specks are left out, and a slanting strand is no speck", "[sequence]") {
  openvdb::initialize();
  const auto voxels = [](const std::vector<Coord>& places) {
    auto grid = openvdb::FloatGrid::create(0.0F);
    for (const Coord& at : places) grid->tree().setValue(at, 1.0F);
    return grid;
  };
  std::vector<Coord> row;
  std::vector<Coord> strand;
  std::vector<Coord> loose;
  for (int i = 0; i < 7; ++i) {
    row.emplace_back(i + 4, 0, 0);
    strand.emplace_back(i + 20, 4 - i, i - 3);
    loose.emplace_back(2 * i + 60, 2 * i, 2 * i);
  }
  const auto elsewhere = voxels({Coord(300)});
  CHECK(same(between(voxels(row), elsewhere, 0.5, -1.0), Ghosts{}));
  CHECK(same(between(voxels(strand), elsewhere, 0.5, -1.0), Ghosts{}));
  row.emplace_back(11, 0, 0);
  strand.emplace_back(27, -3, 4);
  loose.emplace_back(74, 14, 14);
  for (const std::vector<Coord>& piece : {row, strand}) {
    for (const Ghosts& found : {between(voxels(piece), elsewhere, 0.5, -1.0),
                                between(elsewhere, voxels(piece), 0.5, -1.0)}) {
      CHECK(found.of == 1);
      CHECK(found.pieces == 1);
      CHECK(found.share == 1.0);
      CHECK(found.size == Approx(2.0).epsilon(1e-12));
    }
    // A speck is left out but still present: a piece that overlaps a speck is not a ghost.
    CHECK(between(voxels(piece), voxels({piece[3]}), 0.5, -1.0).pieces == 0);
    CHECK(between(voxels(piece), voxels({piece[3]}), 0.5, -1.0).of == 1);
  }
  CHECK(between(voxels(loose), elsewhere, 0.5, -1.0).of == 0);
}

TEMPLATE_TEST_CASE("pieces, overlaps and shares are those of a search voxel by voxel", "[sequence]",
                   openvdb::FloatGrid, openvdb::DoubleGrid) {
  Random random(7);
  int ghosts = 0;
  int others = 0;
  for (int n = 0; n < 24; ++n) {
    const bool level_set = n % 2 == 0;
    const auto transform = Transform::createLinearTransform(0.5);
    auto other = Transform::createLinearTransform(0.5);
    // Half of the pairs have the same voxels. The others have oblong and turned ones.
    if (n % 4 >= 2) {
      other->preScale(Vec3d(random.uniform(0.5, 1.5), random.uniform(0.5, 1.5), 1.1));
      other->preRotate(random.uniform(0.0, 0.7), openvdb::math::Y_AXIS);
      other->postTranslate(Vec3d(random.uniform(-3.0, 3.0), 0.123, 0.2));
    }
    const auto a = scatter<TestType>(random, level_set, transform);
    const auto b = scatter<TestType>(random, level_set, other);
    CAPTURE(n, level_set);
    const double level = level_set ? 0.0 : 0.5;
    const double sign = level_set ? 1.0 : -1.0;
    const Ghosts found = between(a, b, level, sign);
    const Ghosts expected = reference(*a, *b, level, sign);
    CHECK(found.of == expected.of);
    CHECK(found.pieces == expected.pieces);
    CHECK(found.share == Approx(expected.share).epsilon(1e-9));
    CHECK((found.where - expected.where).norm() < 1e-6);
    CHECK(found.size == Approx(expected.size).epsilon(1e-9));
    ghosts += found.pieces;
    others += found.of - found.pieces;
  }
  CHECK(ghosts > 50);
  CHECK(others > 50);
}

TEST_CASE("frames that are no scalars in one grid have no ghosts", "[sequence]") {
  const auto ball = makeBall(2.0, 0.1);
  const auto flow = makeGrid<openvdb::Vec3SGrid>(3, Transform::createLinearTransform(),
                                                 [](const Vec3d& p) { return openvdb::Vec3s(p); });
  CHECK_THROWS_AS(between(ball, flow), VolumeError);
  CHECK_THROWS_AS(between(flow, ball), VolumeError);
  auto staggered = flow->deepCopy();
  staggered->setGridClass(openvdb::GRID_STAGGERED);
  CHECK_THROWS_WITH(between(staggered, ball),
                    Catch::Contains("density") && Catch::Contains("values are vectors"));
  CHECK(between(ball, ball).of == 2);
}

TEST_CASE("a surface that moves farther than its band is beyond the other frame's data",
          "[sequence]") {
  const auto ballOf = [](double radius) { return makeVolume(*makeBall(radius, 1.0)); };
  const auto first = ballOf(20.0);
  CHECK(surfaceBeyondData(*first, *first, 0.0) == 0.0);
  CHECK(surfaceBeyondData(*first, *ballOf(21.5), 0.0) == 0.0);
  CHECK(surfaceBeyondData(*first, *ballOf(26.0), 0.0) == 1.0);
  CHECK(surfaceBeyondData(*ballOf(26.0), *first, 0.0) == 1.0);
  // The ball moves along x. Its surface leaves the data where it is steepest along x.
  const auto grid = makeBall(20.0, 1.0);
  grid->transform().postTranslate(openvdb::Vec3d(6.0, 0.0, 0.0));
  const double share = surfaceBeyondData(*first, *makeVolume(*grid), 0.0);
  CHECK(share > 0.3);
  CHECK(share < 0.8);
}

}  // namespace palpate::ghosts_test
