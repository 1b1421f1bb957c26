#include "palpate/samplers/bricks/bricks.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstring>
#include <fstream>
#include <iterator>
#include <map>
#include <mutex>
#include <set>
#include <sys/file.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <thread>
#include <unistd.h>
#include <zlib.h>
#include <zstd.h>

#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>
#include <openvdb/math/Half.h>
#include <tbb/global_control.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/far_bricks.h"
#include "palpate/samplers/bricks/write_bricks.h"
#include "palpate/samplers/grid/make_volume.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume_grid.h"
#include "tests/support/counters.h"
#include "tests/support/random.h"
#include "tests/support/thinned.h"
#include "tests/support/vdb_grids.h"

namespace palpate::bricks_test {
using namespace palpate::test;
using Catch::Contains;
using openvdb::Coord;
using openvdb::CoordBBox;
using openvdb::Vec3d;
using openvdb::math::Transform;

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
using Bytes = std::vector<std::byte>;

/// Returns a transform with rotation, unequal scales, a reflection, and a large translation.
Transform::Ptr skewed() {
  auto transform = Transform::createLinearTransform(1.0);
  transform->preRotate(0.4, openvdb::math::X_AXIS);
  transform->preScale(Vec3d(0.25, -1.5, 3.0));
  transform->postTranslate(Vec3d(1000.0, -20.0, 0.125));
  return transform;
}

/// Returns scattered voxels about the origin, and tiles of 8^3 and of 128^3 voxels. Voxels and
/// tiles are active or inactive, with random values from -1 to 1.
template <class GridT>
typename GridT::Ptr scattered(std::uint64_t seed, const typename GridT::ValueType& background) {
  using Value = typename GridT::ValueType;
  openvdb::initialize();
  Random random(seed);
  auto grid = GridT::create(background);
  const auto any = [&] {
    const auto one = [&] { return static_cast<float>(random.uniform(-1.0, 1.0)); };
    if constexpr (std::is_arithmetic_v<Value>) {
      return one();
    } else {
      return Value(one(), one(), one());
    }
  };
  const double reach = test::kSanitized ? 0.5 : 1.0;
  const auto at = [&] { return static_cast<int>(reach * random.uniform(-90.0, 120.0)); };
  for (int n = 0; n < 3000; ++n) {
    const Coord c(at(), at() / 2, at());
    n % 3 == 0 ? grid->tree().setValueOff(c, any()) : grid->tree().setValueOn(c, any());
  }
  const Value tile = any();
  grid->tree().addTile(1, Coord(8, 8, 8), tile, true);
  grid->tree().addTile(1, Coord(16, 8, 8), tile, false);
  grid->tree().addTile(2, Coord(128, 0, 0), any(), true);
  grid->tree().addTile(2, Coord(-128, 0, -128), any(), false);
  grid->setTransform(skewed());
  grid->setName("scattered");
  grid->insertMeta("value_unit", openvdb::StringMetadata("HU"));
  grid->insertMeta("image_size", openvdb::Vec3IMetadata({3, 4, 5}));
  return grid;
}

/// Returns a level set of balls from a formula, with a band of 3 voxels on each side. `balls` has
/// centres and radii.
BrickInput ballsBy(const std::vector<std::pair<VoxelAt, double>>& balls, const VoxelAt& lower,
                   const VoxelAt& upper) {
  BrickInput input;
  input.name = "balls";
  input.grid_class = GridClass::kLevelSet;
  input.background = {3.0F, 0.0F, 0.0F};
  input.lower = lower;
  input.upper = upper;
  input.identity = "balls";
  input.fill = [balls](const BrickBox& box) {
    const auto distance = [&](const Vec3& p) {
      double least = 1e9;
      for (const auto& [at, radius] : balls) {
        least = std::min(least, (p - Vec3(at[0], at[1], at[2])).norm() - radius);
      }
      return least;
    };
    const Vec3 corner(box.lower[0], box.lower[1], box.lower[2]);
    const double middle = distance(corner + Vec3::Constant(0.5 * (kBrickEdge - 1)));
    if (std::abs(middle) > 64.0) {
      box.values[0] = middle > 0.0 ? 3.0F : -3.0F;
      return BoxFilled::kOneValue;
    }
    std::size_t n = 0;
    for (int i = 0; i < kBrickEdge; ++i) {
      for (int j = 0; j < kBrickEdge; ++j) {
        for (int k = 0; k < kBrickEdge; ++k, ++n) {
          const double d = distance(corner + Vec3(i, j, k));
          box.values[n] = static_cast<float>(std::clamp(d, -3.0, 3.0));
          if (std::abs(d) < 3.0) box.active[n / 8] |= static_cast<std::uint8_t>(1U << (n % 8));
        }
      }
    }
    return BoxFilled::kEach;
  };
  return input;
}

/// Returns a fog whose bricks must all be stored as objects.
BrickInput fogOf(int bricks, const std::string& identity = "fog") {
  BrickInput input;
  input.name = identity;
  input.grid_class = GridClass::kFog;
  input.upper = {kBrickSide * bricks - 1, kBrickSide * bricks - 1, kBrickSide * bricks - 1};
  input.identity = identity;
  input.fill = [](const BrickBox& box) {
    std::size_t n = 0;
    for (int i = 0; i < kBrickEdge; ++i) {
      for (int j = 0; j < kBrickEdge; ++j) {
        const int row = 7 * (box.lower[0] + i) + 13 * (box.lower[1] + j) + 31 * box.lower[2];
        for (int k = 0; k < kBrickEdge; ++k, ++n) {
          box.values[n] = static_cast<float>((row + 31 * k) & 255);
        }
      }
    }
    std::fill(box.active.begin(), box.active.end(), std::uint8_t{0xFF});
    return BoxFilled::kEach;
  };
  return input;
}

template <class GridT>
const GridT& gridIn(const Volume& volume) {
  return *std::get<typename GridT::ConstPtr>(volume.grid().parts.front().data);
}

/// Counts the voxels whose values or states differ, in and around the bounding box of both grids.
template <class GridT>
int differences(const GridT& a, const GridT& b) {
  CoordBBox box = a.evalActiveVoxelBoundingBox();
  CoordBBox leaves;
  a.tree().evalLeafBoundingBox(leaves);
  box.expand(leaves);
  b.tree().evalLeafBoundingBox(leaves);
  box.expand(leaves);
  box.expand(5);
  const auto of_a = a.getConstAccessor();
  const auto of_b = b.getConstAccessor();
  int count = 0;
  for (auto c = box.begin(); c; ++c) {
    const auto va = of_a.getValue(*c);
    const auto vb = of_b.getValue(*c);
    if (std::memcmp(&va, &vb, sizeof va) != 0 || of_a.isValueOn(*c) != of_b.isValueOn(*c)) ++count;
  }
  return count;
}

Bytes bytesIn(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  const std::string text{std::istreambuf_iterator<char>(stream), {}};
  const auto bytes = std::as_bytes(std::span(text));
  return {bytes.begin(), bytes.end()};
}

void put(const fs::path& file, const Bytes& bytes) {
  std::ofstream stream(file, std::ios::binary);
  stream.write(reinterpret_cast<const char*>(bytes.data()),
               static_cast<std::streamsize>(bytes.size()));
}

/// Returns the bytes of every file of a folder, by path.
std::map<std::string, Bytes> allIn(const fs::path& folder) {
  std::map<std::string, Bytes> files;
  for (const auto& one : fs::recursive_directory_iterator(folder)) {
    const std::string name = one.path().lexically_relative(folder).string();
    files[name] = one.is_regular_file() ? bytesIn(one.path()) : Bytes{};
  }
  return files;
}

template <class Body>
std::string errorOf(Body body) {
  try {
    body();
  } catch (const Error& e) {
    return e.what();
  }
  return "no error";
}

/// Returns the ids of the bricks that are stored as objects.
std::vector<BrickId> storedIn(const BrickManifest& manifest) {
  std::vector<BrickId> ids;
  for (std::int32_t l = 0; l < static_cast<std::int32_t>(manifest.levels().size()); ++l) {
    for (const BrickEntry& entry : manifest.entries(l)) {
      if (entry.kind == BrickKind::kStored) ids.push_back({l, entry.at});
    }
  }
  return ids;
}

/// Returns a manifest with changed facts or a changed table, and with a valid checksum.
Bytes forged(const Bytes& manifest, const std::function<void(Json&)>& change,
             const std::function<void(Bytes&)>& change_table = nullptr) {
  std::uint32_t size = 0;
  std::memcpy(&size, manifest.data() + 8, 4);
  const auto* text = reinterpret_cast<const char*>(manifest.data() + 12);
  Json json = Json::parse(text, text + size);
  change(json);
  const std::string now = json.dump();
  Bytes table(manifest.begin() + 12 + size, manifest.end() - 4);
  Bytes out(manifest.begin(), manifest.begin() + 8);
  const auto add = [&](const void* from, std::size_t count) {
    const auto* bytes = static_cast<const std::byte*>(from);
    out.insert(out.end(), bytes, bytes + count);
  };
  size = static_cast<std::uint32_t>(now.size());
  add(&size, 4);
  add(now.data(), now.size());
  if (change_table) change_table(table);
  add(table.data(), table.size());
  const auto sum = static_cast<std::uint32_t>(
      crc32_z(0, reinterpret_cast<const Bytef*>(out.data()), out.size()));
  add(&sum, 4);
  return out;
}

}  // namespace

TEST_CASE("16-bit floating-point numbers are read and rounded as by OpenVDB", "[bricks]") {
  for (std::uint32_t bits = 0; bits < 65536; ++bits) {
    openvdb::math::half theirs;
    theirs.setBits(static_cast<std::uint16_t>(bits));
    const auto expected = static_cast<float>(theirs);
    const float ours = floatOfHalf(static_cast<std::uint16_t>(bits));
    CAPTURE(bits);
    if (std::isnan(expected)) {
      REQUIRE(std::isnan(ours));
      REQUIRE((halfOfFloat(ours) & 0x7FFFU) > 0x7C00U);
      continue;
    }
    REQUIRE(std::memcmp(&ours, &expected, sizeof ours) == 0);
    REQUIRE(halfOfFloat(ours) == bits);
  }
  Random random(5);
  for (int n = 0; n < 200000; ++n) {
    auto value = static_cast<float>(
        std::ldexp(random.uniform(-1.0, 1.0), static_cast<int>(random.uniform(-28.0, 18.0))));
    // Every second value is halfway between two 16-bit values.
    if (n % 2 == 0) {
      const auto low = static_cast<std::uint16_t>(random.uniform(0.0, 31743.0));
      value = 0.5F * (floatOfHalf(low) + floatOfHalf(static_cast<std::uint16_t>(low + 1)));
      if (std::isinf(value)) value = 65520.0F;
    }
    CAPTURE(value);
    REQUIRE(halfOfFloat(value) == openvdb::math::half(value).bits());
  }
}

TEST_CASE("a volume is read back from its bricks unchanged to the last bit", "[bricks]") {
  const TemporaryFolder folder;
  const bool halved = GENERATE(false, true);
  SECTION("scalars are read back unchanged") {
    const auto grid = scattered<openvdb::FloatGrid>(halved ? 1 : 2, -0.25F);
    grid->setGridClass(halved ? openvdb::GRID_UNKNOWN : openvdb::GRID_FOG_VOLUME);
    if (halved) {
      // 16 bits represent these values exactly.
      for (auto v = grid->beginValueAll(); v; ++v) v.setValue(floatOfHalf(halfOfFloat(*v)));
    }
    const auto volume = makeVolume(*grid);
    const BrickReport report = writeBricks(folder / "b", brickInput(volume, halved));
    const auto back = loadBricks(folder / "b");
    CHECK(differences(gridIn<openvdb::FloatGrid>(*volume), gridIn<openvdb::FloatGrid>(*back)) == 0);
    const GridInfo& was = volume->info();
    for (const GridInfo* is : {&back->info(), &report.manifest.info()}) {
      CHECK(is->name == was.name);
      CHECK(is->grid_class == was.grid_class);
      CHECK(is->half == halved);
      CHECK(is->active_voxels == was.active_voxels);
      CHECK(is->bounds.lower.isApprox(was.bounds.lower));
      CHECK(is->bounds.upper.isApprox(was.bounds.upper));
      CHECK(is->lowest == was.lowest);
      CHECK(is->highest == was.highest);
      CHECK(is->mean == Approx(was.mean));
      CHECK(is->background == was.background);
      CHECK(is->voxel.isApprox(was.voxel));
      CHECK(is->refusal.empty());
    }
    const auto& part = back->grid().parts.front();
    CHECK(part.linear.isApprox(volume->grid().parts.front().linear, 1e-14));
    CHECK(part.origin.isApprox(volume->grid().parts.front().origin, 1e-14));
    const auto& read = gridIn<openvdb::FloatGrid>(*back);
    CHECK(read.metaValue<std::string>("value_unit") == "HU");
    CHECK(read.metaValue<openvdb::Vec3i>("image_size") == openvdb::Vec3i(3, 4, 5));
  }
  SECTION("vectors are read back unchanged") {
    const openvdb::Vec3f background(0.5F, -1.0F, 0.0F);
    const auto grid = scattered<openvdb::Vec3SGrid>(3, background);
    if (halved) {
      const auto round = [](float v) { return floatOfHalf(halfOfFloat(v)); };
      for (auto v = grid->beginValueAll(); v; ++v) {
        v.setValue(openvdb::Vec3f(round((*v)[0]), round((*v)[1]), round((*v)[2])));
      }
    }
    const auto volume = makeVolume(*grid);
    (void)writeBricks(folder / "b", brickInput(volume, halved));
    const auto back = loadBricks(folder / "b");
    CHECK(differences(gridIn<openvdb::Vec3SGrid>(*volume), gridIn<openvdb::Vec3SGrid>(*back)) == 0);
    CHECK(back->info().vector);
    CHECK(back->info().highest == Approx(volume->info().highest));
  }
  SECTION("a level set is read back unchanged") {
    const auto grid = makeBall(4.0, 0.1);
    if (halved) {
      for (auto v = grid->beginValueAll(); v; ++v) v.setValue(floatOfHalf(halfOfFloat(*v)));
      grid->tree().root().setBackground(floatOfHalf(halfOfFloat(grid->background())), true);
    }
    const auto volume = makeVolume(*grid);
    (void)writeBricks(folder / "b", brickInput(volume, halved));
    const auto back = loadBricks(folder / "b");
    CHECK(differences(gridIn<openvdb::FloatGrid>(*volume), gridIn<openvdb::FloatGrid>(*back)) == 0);
  }
}

TEST_CASE("each level of a brick volume is the mean of the finer level, with voxels twice as large",
          "[bricks][release]") {
  const TemporaryFolder folder;
  const bool level_set = GENERATE(true, false);
  const bool halved = GENERATE(false, true);
  BrickInput input;
  if (level_set) {
    input = ballsBy({{{-10, 0, 20}, 70.0}}, {-100, -90, -70}, {80, 90, 110});
    input.linear = Vec3(0.5, 1.0, -2.0).asDiagonal();
    input.linear(0, 1) = 0.3;
    input.origin = Vec3(7.0, 8.0, 9.0);
  } else {
    const auto grid = scattered<openvdb::FloatGrid>(4, 0.125F);
    grid->setGridClass(openvdb::GRID_FOG_VOLUME);
    input = brickInput(makeVolume(*grid));
  }
  input.format.half = halved;
  const BrickManifest manifest = writeBricks(folder / "b", input).manifest;
  REQUIRE(manifest.levels().size() >= 2);
  CHECK(manifest.levels().back().bricks() <= 8);
  for (std::int32_t l = 1; l < static_cast<std::int32_t>(manifest.levels().size()); ++l) {
    const auto fine = loadBricks(folder / "b", l - 1);
    const auto coarse = loadBricks(folder / "b", l);
    const auto& finer = gridIn<openvdb::FloatGrid>(*fine);
    const auto& coarser = gridIn<openvdb::FloatGrid>(*coarse);
    const auto of_fine = finer.getConstAccessor();
    const auto of_coarse = coarser.getConstAccessor();
    // A coarse voxel is in the centre of eight fine voxels.
    const auto& map = coarse->grid().parts.front();
    const auto& before = fine->grid().parts.front();
    CHECK(map.toFile(Vec3(3, -4, 5)).isApprox(before.toFile(Vec3(6.5, -7.5, 10.5)), 1e-12));
    CHECK(manifest.levels()[static_cast<std::size_t>(l)]
              .toFile(Vec3(1, 2, 3))
              .isApprox(map.toFile(Vec3(1, 2, 3)), 1e-12));

    const BrickLevel& level = manifest.levels()[static_cast<std::size_t>(l)];
    const VoxelAt first = level.voxelOf({0, 0, 0});
    CoordBBox box(Coord(first[0], first[1], first[2]), Coord(first[0], first[1], first[2]));
    for (int a = 0; a < 3; ++a) {
      box.max()[a] += kBrickSide * level.count[static_cast<std::size_t>(a)] - 1;
    }
    box.expand(4);
    int wrong_values = 0;
    int wrong_states = 0;
    for (auto c = box.begin(); c; ++c) {
      double sum = 0.0;
      bool any = false;
      for (int n = 0; n < 8; ++n) {
        const Coord child(2 * (*c).x() + (n >> 2), 2 * (*c).y() + ((n >> 1) & 1),
                          2 * (*c).z() + (n & 1));
        sum += static_cast<double>(of_fine.getValue(child));
        any = any || of_fine.isValueOn(child);
      }
      auto mean = static_cast<float>(sum / 8.0);
      if (halved) mean = floatOfHalf(halfOfFloat(mean));
      if (of_coarse.getValue(*c) != mean) ++wrong_values;
      // Near the surface, where both signs occur within three voxels, a coarse voxel may be active
      // although no fine one is.
      if (level_set && !any && of_coarse.isValueOn(*c)) {
        const CoordBBox about((*c).offsetBy(-3), (*c).offsetBy(3));
        bool negative = false;
        bool positive = false;
        for (auto d = about.begin(); d; ++d) {
          (of_coarse.getValue(*d) < 0.0F ? negative : positive) = true;
        }
        any = negative && positive;
      }
      if (of_coarse.isValueOn(*c) != any) ++wrong_states;
    }
    CAPTURE(l);
    CHECK(wrong_values == 0);
    CHECK(wrong_states == 0);
  }
}

TEST_CASE(
    "a ball's surface in bricks is closed on every level on which its radius is three voxels or "
    "more",
    "[bricks][release]") {
  const TemporaryFolder folder;
  const std::vector<std::pair<VoxelAt, double>> balls{
      {{5, -3, 8}, 24.5}, {{1500, 60, 0}, 13.0}, {{60, 900, -40}, 49.0}};
  const BrickManifest manifest =
      writeBricks(folder / "b", ballsBy(balls, {-70, -70, -110}, {1600, 1000, 80})).manifest;
  REQUIRE(manifest.levels().size() >= 4);
  int looked = 0;
  for (std::int32_t l = 0; l < static_cast<std::int32_t>(manifest.levels().size()); ++l) {
    const auto volume = loadBricks(folder / "b", l);
    const auto& grid = gridIn<openvdb::FloatGrid>(*volume);
    const auto accessor = grid.getConstAccessor();
    const double voxel = std::ldexp(1.0, l);
    for (const auto& [at, radius] : balls) {
      if (radius < 3.0 * voxel) continue;
      ++looked;
      const Vec3 centre(at[0], at[1], at[2]);
      const CoordBBox about = CoordBBox::createCube(
          Coord::floor(grid.worldToIndex(Vec3d(centre.x(), centre.y(), centre.z()))) -
              Coord(static_cast<int>(radius / voxel) + 4),
          2 * static_cast<int>(radius / voxel) + 9);
      // Each voxel must have the correct sign, except within a voxel of the surface. So the surface
      // is closed and in the right position.
      int astray = 0;
      for (auto c = about.begin(); c; ++c) {
        const Vec3d p = grid.indexToWorld(*c);
        const double beyond = ((Vec3(p.x(), p.y(), p.z()) - centre).norm() - radius) / voxel;
        const bool negative = accessor.getValue(*c) < 0.0F;
        if ((beyond > 1.0 && negative) || (beyond < -1.0 && !negative)) ++astray;
      }
      CHECK(astray == 0);
      // On coarse levels, all cells with both signs, and all cells within two cells of those, must
      // have data at all corners.
      int crossed = 0;
      int lacking = 0;
      for (auto c = about.begin(); c; ++c) {
        bool negative = false;
        bool positive = false;
        for (int n = 0; n < 8; ++n) {
          const float v = accessor.getValue((*c).offsetBy(n >> 2, (n >> 1) & 1, n & 1));
          (v < 0.0F ? negative : positive) = true;
        }
        if (!negative || !positive) continue;
        ++crossed;
        const CoordBBox corners((*c).offsetBy(-2), (*c).offsetBy(3));
        for (auto d = corners.begin(); d; ++d) {
          if (!accessor.isValueOn(*d)) ++lacking;
        }
      }
      CAPTURE(l, radius);
      CHECK(crossed > 0);
      if (l > 0) CHECK(lacking == 0);
    }
  }
  CHECK(looked >= 6);
}

TEST_CASE("a brick whose voxels are all equal has a manifest entry but no stored object",
          "[bricks]") {
  const TemporaryFolder folder;
  openvdb::initialize();
  auto grid = openvdb::FloatGrid::create(0.0F);
  grid->setName("tiles");
  grid->tree().addTile(2, Coord(0, 0, 0), 1.0F, true);
  grid->tree().addTile(2, Coord(128, 0, 0), 1.0F, true);
  for (int n = 0; n < 27; ++n) {
    grid->tree().addTile(2, Coord(1024 + n / 9 * 128, n / 3 % 3 * 128, n % 3 * 128), -2.0F, false);
  }
  const auto volume = makeVolume(*grid);
  const BrickManifest manifest = writeBricks(folder / "b", brickInput(volume)).manifest;
  // The voxels of 4 x 2 x 2 bricks have the value 1, and each of these bricks has a neighbour that
  // differs. Among the other 6 x 6 x 6 bricks, the inner bricks equal all their neighbours.
  std::size_t active = 0;
  std::size_t inactive = 0;
  std::size_t stored = 0;
  for (const BrickEntry& entry : manifest.entries(0)) {
    active += entry.kind == BrickKind::kActive ? 1 : 0;
    inactive += entry.kind == BrickKind::kInactive ? 1 : 0;
    stored += entry.kind == BrickKind::kStored ? 1 : 0;
    if (entry.kind == BrickKind::kInactive) CHECK(entry.value[0] == -2.0F);
  }
  CHECK(active == 0);
  CHECK(inactive == 4 * 4 * 4);
  std::size_t files = 0;
  for (const auto& one : fs::directory_iterator(folder / "b" / "0")) {
    if (one.path().filename() != ".zarray") ++files;
  }
  CHECK(files == stored);
  // Reading a brick without an object fills the slot with its value. Positions outside of the
  // volume and levels that do not exist have no brick.
  PosixBricks source(folder / "b");
  Bytes slot(manifest.format().bytes());
  const auto inner = manifest.holding(0, {1200, 200, 200});
  REQUIRE(inner);
  REQUIRE(source.read(*inner, slot).status == BrickStatus::kArrived);
  const BrickView view(manifest.format(), slot.data());
  for (const std::size_t n : {std::size_t{0}, std::size_t{1000}, kBrickVoxels - 1}) {
    CHECK(view.value(n) == -2.0F);
    CHECK(!view.active(n));
  }
  CHECK(!manifest.holding(0, {-70, 0, 0}));
  CHECK(!manifest.holding(99, {0, 0, 0}));
  const auto back = loadBricks(folder / "b");
  const auto& read = gridIn<openvdb::FloatGrid>(*back);
  for (const Coord& c : {Coord(0, 0, 0), Coord(255, 127, 127), Coord(256, 0, 0), Coord(1024, 0, 0),
                         Coord(1407, 383, 383), Coord(1408, 0, 0), Coord(1200, 1, 200)}) {
    CHECK(read.tree().getValue(c) == gridIn<openvdb::FloatGrid>(*volume).tree().getValue(c));
    CHECK(read.tree().isValueOn(c) == gridIn<openvdb::FloatGrid>(*volume).tree().isValueOn(c));
  }
}

TEST_CASE("a brick's apron equals the adjacent voxels of its neighbours", "[bricks][release]") {
  const TemporaryFolder folder;
  BrickInput input = ballsBy({{{0, 5, 3}, 90.0}}, {-100, -100, -100}, {100, 100, 100});
  input.format.half = GENERATE(false, true);
  const BrickManifest manifest = writeBricks(folder / "b", input).manifest;
  PosixBricks source(folder / "b");
  Bytes slot(manifest.format().bytes());
  int wrong = 0;
  for (std::int32_t l = 0; l < static_cast<std::int32_t>(manifest.levels().size()); ++l) {
    const auto volume = loadBricks(folder / "b", l);
    const auto accessor = gridIn<openvdb::FloatGrid>(*volume).getConstAccessor();
    for (const BrickEntry& entry : manifest.entries(l)) {
      REQUIRE(source.read({l, entry.at}, slot).status == BrickStatus::kArrived);
      const BrickView view(manifest.format(), slot.data());
      const VoxelAt first = manifest.levels()[static_cast<std::size_t>(l)].voxelOf(entry.at);
      for (int i = -kBrickApron; i < kBrickSide + kBrickApron; ++i) {
        for (int j = -kBrickApron; j < kBrickSide + kBrickApron; ++j) {
          for (int k = -kBrickApron; k < kBrickSide + kBrickApron; ++k) {
            const Coord c(first[0] + i, first[1] + j, first[2] + k);
            const std::size_t n = BrickView::numberOf(i, j, k);
            if (view.value(n) != accessor.getValue(c) || view.active(n) != accessor.isValueOn(c)) {
              ++wrong;
            }
          }
        }
      }
    }
  }
  CHECK(wrong == 0);
}

TEST_CASE("a folder of bricks is a Zarr group, and each object is a chunk of its array",
          "[bricks][release]") {
  const TemporaryFolder folder;
  const bool vector = GENERATE(false, true);
  const bool halved = GENERATE(false, true);
  const auto volume = vector ? makeVolume(*scattered<openvdb::Vec3SGrid>(6, {0, 0, 0}))
                             : makeVolume(*scattered<openvdb::FloatGrid>(6, 2.5F));
  const BrickManifest manifest = writeBricks(folder / "b", brickInput(volume, halved)).manifest;
  const auto json = [&](const fs::path& file) {
    std::ifstream stream(folder / "b" / file);
    return Json::parse(stream);
  };
  CHECK(json(".zgroup") == Json{{"zarr_format", 2}});
  const Json facts = json(".zattrs").at("palpate");
  CHECK(facts.at("metadata").at("value_unit") == Json{{"string", "HU"}});
  CHECK(facts.at("levels").size() == manifest.levels().size());
  for (std::size_t l = 0; l < manifest.levels().size(); ++l) {
    const Json array = json(fs::path(std::to_string(l)) / ".zarray");
    const auto shape = array.at("shape").get<std::vector<std::uint64_t>>();
    const auto chunks = array.at("chunks").get<std::vector<std::uint64_t>>();
    CHECK(array.at("zarr_format") == 2);
    CHECK(array.at("dtype") == (halved ? "<f2" : "<f4"));
    CHECK(array.at("order") == "C");
    CHECK(array.at("dimension_separator") == ".");
    CHECK(array.at("filters").is_null());
    CHECK(array.at("compressor").at("id") == "zstd");
    CHECK(array.at("fill_value") == (vector ? 0.0 : 2.5));
    REQUIRE(shape.size() == (vector ? 7 : 6));
    std::uint64_t bytes = halved ? 2 : 4;
    for (std::size_t a = 0; a < shape.size(); ++a) {
      CHECK(chunks[a] == (a < 3 ? 1 : shape[a]));
      if (a < 3) {
        CHECK(shape[a] == static_cast<std::uint64_t>(manifest.levels()[l].count[a]));
      }
      bytes *= chunks[a];
    }
    // Every object must be a chunk of the array, with the right size.
    for (const auto& one : fs::directory_iterator(folder / "b" / std::to_string(l))) {
      const std::string name = one.path().filename().string();
      if (name == ".zarray") continue;
      const Bytes object = bytesIn(one.path());
      CHECK(ZSTD_getFrameContentSize(object.data(), object.size()) == bytes);
      Bytes chunk(bytes);
      CHECK(ZSTD_decompress(chunk.data(), chunk.size(), object.data(), object.size()) == bytes);
      CHECK(std::count(name.begin(), name.end(), '.') == (vector ? 6 : 5));
    }
  }
}

TEST_CASE("the bytes of bricks do not depend on the number of threads or on a run that ended early",
          "[bricks][release]") {
  const TemporaryFolder folder;
  const BrickInput input = ballsBy({{{0, 0, 0}, 90.0}}, {-100, -100, -100}, {100, 100, 100});
  (void)writeBricks(folder / "whole", input);
  const auto whole = allIn(folder / "whole");
  CHECK(whole.count("palpate.bricks") == 1);
  CHECK(whole.count(".partial") == 0);
  {
    const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
    (void)writeBricks(folder / "one", input);
    CHECK(allIn(folder / "one") == whole);
  }
  // The test stops each run at its n-th progress report, and repeats runs until the export is
  // complete.
  std::uint64_t kept = 0;
  int runs = 0;
  for (int patience = 1; patience < 1000; patience += 9) {
    int words = 0;
    BrickOptions options;
    options.progress = [&](double done) {
      CHECK(done >= 0.0);
      CHECK(done <= 1.0);
      if (++words > patience) throw Error("the test", "it ends here", "go on");
    };
    ++runs;
    try {
      kept = writeBricks(folder / "again", input, options).kept;
      break;
    } catch (const Error&) {
      CHECK(!fs::exists(folder / "again" / "palpate.bricks"));
      CHECK_THAT(errorOf([&] { (void)loadBricks(folder / "again"); }),
                 Contains("it is unfinished"));
      CHECK(isBricks(folder / "again"));
    }
  }
  CHECK(runs > 3);
  CHECK(kept > 10);
  CHECK(allIn(folder / "again") == whole);
  // A run on a complete folder must leave the folder unchanged.
  const BrickReport report = writeBricks(folder / "again", input);
  CHECK(report.written == 0);
  CHECK(report.manifest.identity() != 0);
  CHECK(allIn(folder / "again") == whole);
}

TEST_CASE("bricks of an interrupted run are checked before the next run keeps them", "[bricks]") {
  const TemporaryFolder folder;
  const BrickInput input = fogOf(2);
  const BrickManifest manifest = writeBricks(folder / "whole", input).manifest;
  const auto whole = allIn(folder / "whole");
  fs::copy(folder / "whole", folder / "b", fs::copy_options::recursive);
  fs::remove(folder / "b" / "palpate.bricks");
  const auto ids = storedIn(manifest);
  const auto place = [&](std::size_t n) {
    return folder / "b" / brickObject(ids[n], manifest.format());
  };
  // One brick is missing, one is truncated, one has a wrong bit, and one is replaced by another
  // brick. The folder of partial files contains a file.
  fs::remove(place(0));
  fs::resize_file(place(1), 100);
  Bytes bytes = bytesIn(place(2));
  bytes[bytes.size() / 2] ^= std::byte{4};
  put(place(2), bytes);
  put(place(3), bytesIn(place(4)));
  fs::create_directory(folder / "b" / ".partial");
  put(folder / "b" / ".partial" / "17", bytes);
  const BrickReport report = writeBricks(folder / "b", input);
  CHECK(report.written == 4);
  CHECK(report.kept == ids.size() - 4);
  CHECK(allIn(folder / "b") == whole);
}

TEST_CASE("bricks are not written into a folder with other contents or during another run",
          "[bricks]") {
  const TemporaryFolder folder;
  (void)writeBricks(folder / "b", fogOf(1));
  const auto before = allIn(folder / "b");
  const auto trying = [&](const fs::path& where, const BrickInput& input,
                          const BrickOptions& options = {}) {
    return errorOf([&] { (void)writeBricks(where, input, options); });
  };
  CHECK_THAT(trying(folder / "b", fogOf(1, "other")), Contains("another input, of other options"));
  BrickOptions options;
  options.compression = 4;
  CHECK_THAT(trying(folder / "b", fogOf(1), options), Contains("another input, of other options"));
  fs::remove(folder / "b" / "palpate.bricks");
  CHECK_THAT(trying(folder / "b", fogOf(1, "other")),
             Contains("unfinished bricks of another input"));
  CHECK(trying(folder / "b", fogOf(1)) == "no error");
  CHECK(allIn(folder / "b") == before);

  fs::create_directory(folder / "photos");
  put(folder / "photos" / "a.jpg", Bytes(3));
  CHECK_THAT(trying(folder / "photos", fogOf(1)),
             Contains("it exists already and contains \"a.jpg\""));
  fs::create_directory(folder / "zarr");
  put(folder / "zarr" / ".zattrs", Bytes(3));
  CHECK_THAT(
      trying(folder / "zarr", fogOf(1)),
      Contains("data of another program (its .zattrs is not palpate's): name another folder"));
  put(folder / "file", Bytes(3));
  CHECK_THAT(trying(folder / "file", fogOf(1)), Contains("it exists already and is not a folder"));
  CHECK_THAT(trying(folder / "no" / "b", fogOf(1)),
             Contains("the folder cannot be created (No such"));
  fs::create_directory(folder / "empty");
  CHECK(trying(folder / "empty", fogOf(1)) == "no error");

  // A second writer starts while the first writer runs.
  const BrickInput input = fogOf(1);
  options = {};
  std::string second;
  options.progress = [&](double) {
    if (second.empty()) second = trying(folder / "c", input);
  };
  CHECK(trying(folder / "c", input, options) == "no error");
  CHECK_THAT(second, Contains("another run is writing into it"));
}

TEST_CASE("an input that bricks cannot store is refused with a one-line message", "[bricks]") {
  const TemporaryFolder folder;
  const auto trying = [&](const BrickInput& input, int compression = 3) {
    BrickOptions options;
    options.compression = compression;
    std::string why = errorOf([&] { (void)writeBricks(folder / "b", input, options); });
    CHECK(std::count(why.begin(), why.end(), '\n') == 0);
    CHECK(!fs::exists(folder / "b" / "palpate.bricks"));
    fs::remove_all(folder / "b");
    return why;
  };
  BrickInput input = fogOf(1);
  input.fill = [](const BrickBox& box) {
    std::fill(box.values.begin(), box.values.end(), 1.0F);
    box.values[BrickView::numberOf(1, 2, 3)] = std::nanf("");
    return BoxFilled::kEach;
  };
  CHECK_THAT(trying(input),
             Contains("its value at voxel (1, 2, 3) is not a finite number: replace it"));
  input.format.half = true;
  input.fill = [](const BrickBox& box) {
    box.values[0] = 1e5F;
    return BoxFilled::kOneValue;
  };
  CHECK_THAT(trying(input), Contains("or is too large for 16 bits: replace it, or store 32 bits"));
  input = fogOf(1);
  input.grid_class = GridClass::kStaggered;
  CHECK_THAT(trying(input), Contains("it is staggered"));
  input = fogOf(1);
  input.linear.col(1).setZero();
  CHECK_THAT(trying(input), Contains("its transform is singular"));
  input = fogOf(1);
  input.upper[1] = -1;
  CHECK_THAT(trying(input), Contains("its extent is empty"));
  input.upper[1] = std::numeric_limits<std::int32_t>::max();
  CHECK_THAT(trying(input), Contains("more than 2^30 voxels from the origin"));
  input = fogOf(1);
  input.background[0] = std::nanf("");
  CHECK_THAT(trying(input), Contains("its background is not a finite number"));
  CHECK_THAT(trying(fogOf(1), 0), Contains("its compression level is 0: give 1 to 19"));
  CHECK_THAT(trying(fogOf(1), 20), Contains("its compression level is 20"));
}

TEST_CASE("bricks keep the background in voxels beyond the volume's extent", "[bricks]") {
  const TemporaryFolder folder;
  BrickInput input = fogOf(1);
  input.lower = {-3, 5, 60};
  input.upper = {70, 6, 63};
  input.fill = [](const BrickBox& box) {
    box.values[0] = 7.0F;
    box.active[0] = 1;
    return BoxFilled::kOneValue;
  };
  (void)writeBricks(folder / "b", input);
  const auto volume = loadBricks(folder / "b");
  CHECK(volume->info().active_voxels == 74 * 2 * 4);
  CHECK(volume->info().bounds.lower == Vec3(-3, 5, 60));
  CHECK(volume->info().bounds.upper == Vec3(70, 6, 63));
  CHECK(volume->info().lowest == 7.0);
}

TEST_CASE("a missing, changed or damaged brick is reported in one line", "[bricks]") {
  const TemporaryFolder folder;
  const BrickManifest manifest = writeBricks(folder / "b", fogOf(2)).manifest;
  (void)writeBricks(folder / "other", fogOf(2, "other"));
  PosixBricks source(folder / "b");
  Bytes slot(manifest.format().bytes());
  const BrickId id{0, {0, 1, 1}};
  const std::string name = brickObject(id, manifest.format());
  const fs::path place = folder / "b" / name;
  const Bytes whole = bytesIn(place);
  const auto read = [&](BrickStatus status, const std::string& says) {
    const BrickArrival arrival = source.read(id, slot);
    CHECK(arrival.id == id);
    CHECK(wordFor(arrival.status) == std::string(wordFor(status)));
    CHECK(std::count(arrival.why.begin(), arrival.why.end(), '\n') == 0);
    CHECK_THAT(arrival.why, Contains(says));
    CHECK_THAT(arrival.why, Contains(place.string()));
    if (status != BrickStatus::kGone) {
      CHECK_THAT(errorOf([&] { (void)loadBricks(folder / "b"); }), Contains(says));
    }
    if (status == BrickStatus::kGone) return;
    CHECK(source.read({0, {0, 0, 0}}, slot).status == BrickStatus::kArrived);
  };
  CHECK(source.read(id, slot).status == BrickStatus::kArrived);
  CHECK(source.read(id, slot).why.empty());

  fs::remove(place);
  read(BrickStatus::kMissing, "it is missing: copy or write the volume again");
  for (const std::size_t size : {std::size_t{0}, std::size_t{10}, whole.size() - 1}) {
    put(place, Bytes(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(size)));
    read(BrickStatus::kCut, "it has " + std::to_string(size) + " bytes instead of the " +
                                std::to_string(whole.size()) + " in the manifest");
  }
  Bytes longer = whole;
  longer.push_back(std::byte{0});
  put(place, longer);
  read(BrickStatus::kCut, "bytes instead of the");
  put(place, Bytes(10'000'000));
  read(BrickStatus::kCut, "bytes instead of the");
  Random random(3);
  for (int n = 0; n < 40; ++n) {
    Bytes flipped = whole;
    const auto at =
        static_cast<std::size_t>(random.uniform(0.0, 1.0) * static_cast<double>(whole.size()));
    flipped[at] ^= static_cast<std::byte>(1U << (n % 8));
    put(place, flipped);
    read(BrickStatus::kDamaged, "its checksum is wrong");
  }
  // All bricks have the same size in memory, so the source must recognise a wrong brick by its
  // contents.
  put(place, bytesIn(folder / "b" / brickObject({0, {1, 0, 0}}, manifest.format())));
  read(BrickStatus::kOthers, "it is the brick of another level or position");
  put(place, bytesIn(folder / "other" / name));
  read(BrickStatus::kOthers, "it is a brick of another volume");
  fs::remove(place);
  fs::create_directory(place);
  read(BrickStatus::kDamaged, "it is not a file");
  fs::remove(place);
  REQUIRE(mkfifo(place.c_str(), 0600) == 0);
  read(BrickStatus::kDamaged, "it is not a file");
  fs::remove(place);
  fs::create_symlink(place, place);
  read(BrickStatus::kUnreadable, "it cannot be read (Too many levels of symbolic links)");
  fs::remove(place);
  put(place, whole);
  CHECK(source.read(id, slot).status == BrickStatus::kArrived);

  CHECK(source.read({0, {0, 2, 0}}, slot).status == BrickStatus::kUnknown);
  CHECK(source.read({0, {0, -1, 0}}, slot).status == BrickStatus::kUnknown);
  CHECK(source.read({-1, {0, 0, 0}}, slot).status == BrickStatus::kUnknown);
  CHECK(source.read({1 << 30, {0, 0, 0}}, slot).status == BrickStatus::kUnknown);
  // The source keeps the folder open: it finds a moved folder, and reports a removed one as gone.
  fs::rename(folder / "b", folder / "moved");
  CHECK(source.read(id, slot).status == BrickStatus::kArrived);
  fs::remove_all(folder / "moved");
  read(BrickStatus::kGone, "the volume does not exist any more");
}

TEST_CASE("a brick with non-finite values is reported as damaged", "[bricks]") {
  const TemporaryFolder folder;
  const BrickManifest manifest = writeBricks(folder / "b", fogOf(1)).manifest;
  const BrickId id{0, {0, 0, 0}};
  const fs::path place = folder / "b" / brickObject(id, manifest.format());
  // The chunk has invalid values, but correct checksums.
  const Bytes object = bytesIn(place);
  Bytes chunk(manifest.format().bytes());
  REQUIRE(ZSTD_decompress(chunk.data(), chunk.size(), object.data(), object.size()) ==
          chunk.size());
  const float none = GENERATE(std::numeric_limits<float>::infinity(), std::nanf(""));
  std::memcpy(chunk.data() + 4000, &none, sizeof none);
  Bytes bad(ZSTD_compressBound(chunk.size()));
  bad.resize(ZSTD_compress(bad.data(), bad.size(), chunk.data(), chunk.size(), 3));
  put(place, bad);
  const Bytes facts = forged(
      bytesIn(folder / "b" / "palpate.bricks"), [](Json&) {},
      [&](Bytes& table) {
        const auto size = static_cast<std::uint32_t>(bad.size());
        const auto sum = static_cast<std::uint32_t>(
            crc32_z(0, reinterpret_cast<const Bytef*>(bad.data()), bad.size()));
        std::memcpy(table.data() + 8 + 16, &size, 4);
        std::memcpy(table.data() + 8 + 20, &sum, 4);
      });
  put(folder / "b" / "palpate.bricks", facts);
  PosixBricks source(folder / "b");
  const BrickArrival arrival = source.read(id, chunk);
  CHECK(arrival.status == BrickStatus::kDamaged);
  CHECK_THAT(arrival.why, Contains("some of its values are not finite"));
}

TEST_CASE("all attempts to receive a manifest share one deadline", "[bricks]") {
  struct Slow final : ObjectStore {
    int& tries;
    explicit Slow(int& counts) : tries(counts) {}
    std::unique_ptr<ObjectRequest> make() override { return std::make_unique<ObjectRequest>(); }
    void get(const std::string& /*name*/, ObjectRequest& request) noexcept override {
      ++tries;
      std::this_thread::sleep_for(std::chrono::milliseconds(30));
      request.fail("it fails");
    }
    bool begin(const std::string& /*name*/, ObjectRequest& /*request*/) noexcept override {
      return false;
    }
    void drop(ObjectRequest& /*request*/) noexcept override {}
    ObjectRequest* ended(std::chrono::milliseconds /*patience*/) noexcept override {
      return nullptr;
    }
    void wake() noexcept override {}
  };
  const auto tries = [](std::chrono::milliseconds opened) {
    int count = 0;
    StoreParams params;
    params.opened = opened;
    CHECK_THAT(errorOf([&] { FarBricks("there", std::make_unique<Slow>(count), params); }),
               Contains("it was not received (it fails)"));
    return count;
  };
  CHECK(tries(std::chrono::minutes(1)) == 3);
  CHECK(tries(std::chrono::milliseconds(40)) <= 2);
}

TEST_CASE("a missing or damaged manifest is refused with a one-line message", "[bricks]") {
  const TemporaryFolder folder;
  (void)writeBricks(folder / "b", fogOf(2));
  const fs::path file = folder / "b" / "palpate.bricks";
  const Bytes whole = bytesIn(file);
  const auto refusal = [](const Bytes& bytes) {
    std::string why = errorOf([&] { (void)BrickManifest::parse(bytes, "m"); });
    CHECK(std::count(why.begin(), why.end(), '\n') == 0);
    return why;
  };
  CHECK(refusal(whole) == "no error");
  CHECK(refusal(forged(whole, [](Json&) {})) == "no error");
  for (std::size_t size = 0; size < whole.size(); size += size < 64 ? 1 : 37) {
    CHECK_THAT(refusal(Bytes(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(size))),
               Contains("m: it "));
  }
  for (std::size_t at = 0; at < whole.size(); at += 7) {
    Bytes flipped = whole;
    flipped[at] ^= static_cast<std::byte>(1U << (at % 8));
    CHECK_THAT(refusal(flipped), Contains("m: it "));
  }
  Bytes longer = whole;
  longer.push_back(std::byte{0});
  CHECK_THAT(refusal(longer), Contains("it is cut off or damaged"));
  Bytes newer = whole;
  newer[7] = std::byte{'2'};
  CHECK_THAT(refusal(newer),
             Contains("it was written by another version of palpate: read it with that version"));

  // The parser refuses such a length, because parsed JSON takes much more memory than its text.
  CHECK_THAT(refusal(forged(whole, [](Json& facts) { facts["source"] = std::string(70000, 'x'); })),
             Contains("longer than 64 kB"));
  BrickInput wordy = fogOf(2);
  wordy.source = std::string(70000, 'x');
  CHECK_THAT(errorOf([&] { (void)writeBricks(folder / "wordy", wordy); }),
             Contains("more than 60 kB: shorten them"));

  // Each of these facts is wrong, although the manifest's checksum is valid.
  const std::vector<std::pair<const char*, Json>> wrong{
      {"bricks", 2},
      {"bricks", "1"},
      {"name", 7},
      {"class", "staggered"},
      {"class", "solid"},
      {"type", "double"},
      {"components", 2},
      {"components", -1},
      {"components", 1e300},
      {"components", 3},
      {"background", Json::array()},
      {"background", {"0"}},
      {"background", {1e300, 2}},
      {"lower", {0, 0}},
      {"lower", {0, 0, 0.5}},
      {"lower", {0, 0, 1000}},
      {"lower", {-4294967296, 0, 0}},
      {"upper", {1073741824, 1073741824, 1073741824}},
      {"lower", {-1073741824, -1073741824, -1073741824}},
      {"upper", {2147483648, 63, 63}},
      {"upper", {18446744073709551615U, 63, 63}},
      {"linear", {{1, 0, 0}, {0, 1, 0}, {0, 0, 0}}},
      {"linear", {{1, 0, 0}, {0, 1, 0}}},
      {"linear", nullptr},
      {"origin", {nullptr, 0, 0}},
      {"identity", "../../etc/passwd"},
      {"identity", 5},
      {"statistics", {{"active_voxels", -1}}},
      {"statistics", {{"active_voxels", 1e300}}},
      {"statistics", {{"active_voxels", 5}, {"active_lower", {0, 0}}}},
  };
  for (const auto& [key, value] : wrong) {
    CAPTURE(key, value.dump());
    const std::string name = key;
    const Json& other = value;
    CHECK_THAT(refusal(forged(whole, [&](Json& json) { json[name] = other; })),
               Contains("m: it is damaged (\""));
    CHECK_THAT(refusal(forged(whole, [&](Json& json) { json.erase(name); })),
               Contains("m: it is damaged (it has no \"" + std::string(name) + "\")"));
  }
  CHECK_THAT(refusal(forged(whole, [](Json& json) { json["statistics"] = Json::object(); })),
             Contains("m: it is damaged (it has no \"statistics/active_voxels\")"));
  // The table is refused if it has a wrong number of rows, or impossible rows.
  const auto table = [&](std::size_t at, auto number) {
    return refusal(forged(
        whole, [](Json&) {},
        [&](Bytes& bytes) { std::memcpy(bytes.data() + at, &number, sizeof number); }));
  };
  CHECK_THAT(table(0, std::uint64_t{1} << 60U), Contains("it ends before its last entry"));
  CHECK_THAT(table(0, ~std::uint64_t{0}), Contains("it ends before its last entry"));
  CHECK_THAT(table(0, std::uint64_t{7}), Contains("it is damaged"));
  CHECK_THAT(table(8, std::int32_t{-1}), Contains("entry 1 of level 0 is invalid"));
  CHECK_THAT(table(8, std::int32_t{2}), Contains("entry 1 of level 0 is invalid"));
  CHECK_THAT(table(20, std::uint32_t{3}), Contains("entry 1 of level 0 is invalid"));
  CHECK_THAT(table(24, std::uint32_t{0}), Contains("entry 1 of level 0 is invalid"));
  CHECK_THAT(table(32, std::nanf("")), Contains("entry 1 of level 0 is invalid"));
  CHECK_THAT(table(8 + 36 + 8, std::int32_t{0}), Contains(" is invalid or not in order"));
  const auto deep = std::string(60'000, '[');
  Bytes nested(whole.begin(), whole.begin() + 8);
  const auto size = static_cast<std::uint32_t>(deep.size());
  nested.resize(12 + deep.size() + 4);
  std::memcpy(nested.data() + 8, &size, 4);
  std::memcpy(nested.data() + 12, deep.data(), deep.size());
  const auto sum = static_cast<std::uint32_t>(
      crc32_z(0, reinterpret_cast<const Bytef*>(nested.data()), nested.size() - 4));
  std::memcpy(nested.data() + nested.size() - 4, &sum, 4);
  CHECK_THAT(refusal(nested), Contains("m: it is damaged"));
  Json within;
  for (int depth = 0; depth < 100; ++depth) within = Json::array({within});
  CHECK_THAT(refusal(forged(whole, [&](Json& json) { json["metadata"] = within; })),
             Contains("m: it is damaged"));

  // Reading a manifest from a folder must give the same errors.
  const auto folderSays = [&] { return errorOf([&] { (void)PosixBricks(folder / "b"); }); };
  fs::remove(file);
  CHECK_THAT(folderSays(), Contains("it is unfinished: it has no manifest: repeat the command"));
  fs::create_directory(file);
  CHECK_THAT(folderSays(), Contains("it cannot be read"));
  fs::remove(file);
  put(file, {});
  CHECK_THAT(folderSays(), Contains("palpate.bricks: it is not a manifest of bricks"));
  CHECK_THAT(errorOf([&] { (void)loadBricks(folder / "none"); }), Contains("no such folder"));
  CHECK_THAT(errorOf([&] { (void)loadBricks(folder.path()); }),
             Contains("it is not a volume in bricks"));
  put(file, whole);
  CHECK_THAT(errorOf([&] { (void)loadBricks(folder / "b", 1); }),
             Contains("it does not have level 1: give a level from 0 to 0"));
}

TEST_CASE(
    "the most urgent brick arrives first and a brick that is no longer wanted does not arrive",
    "[bricks]") {
  const TemporaryFolder folder;
  const BrickManifest manifest = writeBricks(folder / "b", fogOf(3)).manifest;
  PosixBricks source(folder / "b");
  Bytes slot(manifest.format().bytes());
  constexpr std::chrono::milliseconds kNone(0);
  CHECK(!source.next(slot, kNone));
  const BrickId far{0, {2, 2, 2}};
  const BrickId near{0, {0, 0, 0}};
  const BrickId middle{0, {1, 1, 1}};
  const BrickId never{0, {9, 9, 9}};
  source.want(
      {{never, std::nan("")}, {far, 1.0}, {near, 3.0}, {middle, 2.0}, {far, -5.0}, {never, 0.5}});
  CHECK(source.next(slot, kNone)->id == near);
  const BrickView view(manifest.format(), slot.data());
  CHECK(view.value(BrickView::numberOf(0, 0, 1)) == 31.0F);
  // The hand has turned around, so the list of wanted bricks is completely new.
  source.want({{middle, 1.0}, {never, 7.0}});
  CHECK(source.next(slot, kNone)->status == BrickStatus::kUnknown);
  CHECK(source.next(slot, kNone)->id == middle);
  CHECK(!source.next(slot, kNone));
  source.want({{far, 1.0}});
  source.want({});
  CHECK(!source.next(slot, kNone));

  // After the first brick, reading must not allocate.
  source.want({{far, 1.0}, {near, 1.0}});
  {
    const CountScope counting;
    CHECK(source.next(slot, kNone)->id == far);
    CHECK(source.next(slot, kNone)->id == near);
    CHECK(CountScope::counts().allocations == 0);
  }

  // Several threads receive bricks, and each brick must arrive once. A new want() must wake waiting
  // threads.
  std::mutex mutex;
  std::multiset<BrickId> arrived;
  std::vector<std::thread> takers;
  takers.reserve(3);
  for (int n = 0; n < 3; ++n) {
    takers.emplace_back([&] {
      Bytes own(manifest.format().bytes());
      for (;;) {
        const auto arrival = source.next(own, std::chrono::seconds(20));
        if (!arrival || arrival->id == never) return;
        const std::lock_guard lock(mutex);
        arrived.insert(arrival->id);
      }
    });
  }
  std::vector<BrickWish> wishes;
  for (const BrickEntry& entry : manifest.entries(0)) wishes.push_back({{0, entry.at}, 0.0});
  source.want(wishes);
  for (bool all = false; !all;) {
    const std::lock_guard lock(mutex);
    all = arrived.size() >= wishes.size();
  }
  for (std::thread& taker : takers) {
    // The id `never` has no brick. A thread that receives this id ends.
    source.want({{never, 0.0}});
    static_cast<void>(taker);
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  for (std::thread& taker : takers) taker.join();
  CHECK(arrived.size() == 27);
  CHECK(std::set<BrickId>(arrived.begin(), arrived.end()).size() == 27);
}

TEST_CASE(
    "a run that reaches the limit of file sizes leaves no manifest and the next run completes the "
    "bricks",
    "[bricks]") {
  const TemporaryFolder folder;
  const BrickInput input = ballsBy({{{0, 0, 0}, 50.0}}, {-60, -60, -60}, {60, 60, 60});
  (void)writeBricks(folder / "whole", input);
  rlimit was{};
  getrlimit(RLIMIT_FSIZE, &was);
  auto* const handled = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit small{30'000, was.rlim_max};
  setrlimit(RLIMIT_FSIZE, &small);
  const std::string why = errorOf([&] { (void)writeBricks(folder / "b", input); });
  setrlimit(RLIMIT_FSIZE, &was);
  (void)std::signal(SIGXFSZ, handled);
  CHECK_THAT(why, Contains("it cannot be written (File too large): raise the limit of file sizes "
                           "(ulimit -f), and run the same command again: it continues where it "
                           "stopped"));
  CHECK(!fs::exists(folder / "b" / "palpate.bricks"));
  CHECK(fs::is_empty(folder / "b" / ".partial"));
  (void)writeBricks(folder / "b", input);
  CHECK(allIn(folder / "b") == allIn(folder / "whole"));
}

TEST_CASE("writing 512 bricks needs memory of at most a quarter of the volume's size", "[bricks]") {
  const TemporaryFolder folder;
  const auto resident = [] {
    std::ifstream file("/proc/self/statm");
    double pages = 0.0;
    file >> pages >> pages;
    return pages * static_cast<double>(sysconf(_SC_PAGESIZE)) / 1e6;
  };
  // AddressSanitizer is slow and uses memory of its own. With it, the test writes fewer bricks and
  // does not check the memory.
#if defined(__SANITIZE_ADDRESS__)
  constexpr int kBricks = 3;
  constexpr double kMost = 1e9;
#else
  constexpr int kBricks = 8;
  constexpr double kMost = 0.25;
#endif
  constexpr double kWhole = 4e-6 * (64.0 * kBricks) * (64.0 * kBricks) * (64.0 * kBricks);
  const double before = resident();
  double most = 0.0;
  BrickOptions options;
  options.compression = 1;
  options.progress = [&](double) { most = std::max(most, resident() - before); };
  const BrickReport report = writeBricks(folder / "b", fogOf(kBricks), options);
  CHECK(report.manifest.info().active_voxels == 262144ULL * kBricks * kBricks * kBricks);
  CAPTURE(most, kWhole);
  CHECK(most < kMost * kWhole);
}

}  // namespace palpate::bricks_test
