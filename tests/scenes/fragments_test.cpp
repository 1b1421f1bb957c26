/// Tests that the fragments of palpate shatter are the solid that they were broken from, closed,
/// and strewn as ordered.
#include "palpate/scenes/library/fragments.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>
#include <sstream>
#include <string>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/volume_grid.h"
#include "palpate/scenes/library/scene_file.h"
#include "tests/support/vdb_grids.h"

namespace palpate::fragments_test {
using namespace palpate::test;
using Catch::Matchers::Contains;
using openvdb::Coord;
using openvdb::Vec3d;
using openvdb::math::Transform;

namespace {

constexpr double kValue = 100.0;
constexpr int kSide = 48;

/// Makes a ball of bone in softer matter, with voxels of 2, 2 and 3 mm.
openvdb::FloatGrid::Ptr makeBone(const std::string& name = "bone") {
  const auto transform = Transform::createLinearTransform();
  transform->preScale(Vec3d(2.0, 2.0, 3.0));
  transform->postTranslate(Vec3d(-10.0, 20.0, 5.0));
  const Vec3d middle = transform->indexToWorld(Vec3d(0.5 * kSide));
  return makeGrid<openvdb::FloatGrid>(
      kSide, transform,
      [&](const Vec3d& p) {
        return static_cast<float>(kValue + 10.0 * (40.0 - (p - middle).length()));
      },
      name);
}

std::string textOf(const std::filesystem::path& file) {
  std::ostringstream text;
  text << std::ifstream(file).rdbuf();
  return text.str();
}

struct Broken {
  TemporaryFolder folder;
  openvdb::FloatGrid::Ptr bone = makeBone();
  Fragments made;

  explicit Broken(const FragmentOrder& order) {
    writeVdb(folder / "bone.vdb", {bone});
    std::filesystem::create_directory(folder / "out");
    made = strewFragments(*loadVolume(folder / "bone.vdb", ""), order, folder / "out");
  }
  [[nodiscard]] std::vector<openvdb::FloatGrid::Ptr> pieces() const {
    std::vector<openvdb::FloatGrid::Ptr> grids;
    for (int i = 1; i <= made.pieces; ++i) {
      char name[32];
      std::snprintf(name, sizeof name, "out/fragment-%03d.vdb", i);
      openvdb::io::File file((folder / name).string());
      file.open(false);
      grids.push_back(openvdb::gridPtrCast<openvdb::FloatGrid>(file.readGrid("fragment")));
    }
    return grids;
  }
};

FragmentOrder someOrder() {
  FragmentOrder order;
  order.value = kValue;
  order.pieces = 7;
  order.places = 40;
  order.room = 0.5;
  return order;
}

}  // namespace

TEST_CASE("fragments are the solid, each voxel in one of them, and closed", "[scale]") {
  const Broken broken(someOrder());
  CHECK(broken.made.pieces == 7);
  const auto pieces = broken.pieces();
  std::map<Coord, int> times;
  std::uint64_t active = 0;
  std::uint64_t as_they_were = 0;
  // Values fall by 10 per unit of length at the skin and at the faces of fragments. No step is
  // larger than that of a voxel's edge.
  double steepest = 0.0;
  for (const auto& piece : pieces) {
    active += piece->activeVoxelCount();
    const auto accessor = piece->getConstAccessor();
    const auto source = broken.bone->getConstAccessor();
    // The piece is centred about its own middle.
    const auto box = piece->evalActiveVoxelBoundingBox();
    const Vec3d middle = piece->indexToWorld((box.min().asVec3d() + box.max().asVec3d()) * 0.5);
    CHECK(middle.length() < 1e-6);
    CHECK(piece->voxelSize() == Vec3d(2.0, 2.0, 3.0));
    for (auto at = piece->cbeginValueOn(); at; ++at) {
      REQUIRE(*at <= source.getValue(at.getCoord()));
      for (int axis = 0; axis < 3; ++axis) {
        Coord next = at.getCoord();
        ++next[axis];
        if (!accessor.isValueOn(next)) continue;
        const double step = std::abs(double{*at} - double{accessor.getValue(next)});
        steepest = std::max(steepest, step / (axis == 2 ? 3.0 : 2.0));
      }
      if (!(*at > kValue)) continue;
      as_they_were += *at == source.getValue(at.getCoord()) ? 1 : 0;
      ++times[at.getCoord()];
      for (int axis = 0; axis < 3; ++axis) {
        for (const int side : {-1, 1}) {
          Coord next = at.getCoord();
          next[axis] += side;
          REQUIRE(accessor.isValueOn(next));  // so its edge is below the value everywhere
        }
      }
    }
  }
  CHECK(active == broken.made.voxels);
  std::size_t solid = 0;
  for (auto at = broken.bone->cbeginValueOn(); at; ++at) solid += *at > kValue ? 1 : 0;
  CHECK(std::all_of(times.begin(), times.end(), [](const auto& t) { return t.second == 1; }));
  CHECK(times.size() <= solid);
  CHECK(times.size() > solid - solid / 100);
  // Far from faces the values are the volume's. The ball's middle is 400 above kValue, and no voxel
  // is so far from a face.
  CHECK(as_they_were > solid / 4);
  CHECK(as_they_were < solid);
  CHECK(steepest < 20.0);
  CHECK(steepest > 5.0);
}

TEST_CASE("strewn fragments lie in their room and are felt where they lie", "[scale]") {
  const Broken broken(someOrder());
  CHECK(broken.made.places == 40);
  CHECK(broken.made.size > 0.02);
  CHECK(broken.made.overlap > 0.01);
  const BuiltScene built = buildScene(readSceneFile(broken.folder / "out/scene.json"));
  REQUIRE(built.scene->parts.size() == 40);
  CHECK(built.volumes.size() == 7);
  Box middles;
  for (const Part& part : built.scene->parts) middles.extend(part.bounds.centre());
  CHECK(middles.size().maxCoeff() < 0.5);
  CHECK(middles.size().minCoeff() > 0.3);
  // From outside to the middle of some fragments: they hold.
  int held = 0;
  for (std::size_t i = 0; i < 10; ++i) {
    Reader reader;
    ProxyState state;
    const Box& box = built.scene->parts[i].bounds;
    const Vec3 from = box.centre() + Vec3(0, 0, 0.6 * box.size().norm());
    StepReport r;
    double most = 0.0;
    for (double way = 0.0; way <= 1.0; way += 0.005) {
      const Vec3 at = from + way * (box.centre() - from);
      r = hapticStep(*built.scene, reader, {at}, state, 1e-3);
      most = std::max(most, r.force.norm());
    }
    held += most > 0.5 ? 1 : 0;
  }
  CHECK(held >= 7);
}

TEST_CASE("the same order breaks and strews the same, another seed does not", "[scale]") {
  const Broken one(someOrder());
  const Broken again(someOrder());
  FragmentOrder other = someOrder();
  other.seed = 2;
  const Broken apart(other);
  const std::string scene = textOf(one.folder / "out/scene.json");
  CHECK(scene == textOf(again.folder / "out/scene.json"));
  CHECK(scene != textOf(apart.folder / "out/scene.json"));
  const auto a = one.pieces();
  const auto b = again.pieces();
  REQUIRE(a.size() == b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    CHECK(a[i]->activeVoxelCount() == b[i]->activeVoxelCount());
    CHECK(a[i]->evalActiveVoxelBoundingBox() == b[i]->evalActiveVoxelBoundingBox());
    CHECK(a[i]->transform() == b[i]->transform());
    const auto twin = b[i]->getConstAccessor();
    bool same = true;
    for (auto at = a[i]->cbeginValueOn(); at; ++at) same &= *at == twin.getValue(at.getCoord());
    CHECK(same);
  }
}

TEST_CASE("what cannot be broken is refused, whoever cancels is heard", "[scale]") {
  const TemporaryFolder folder;
  auto ball = makeBall(2.0, 0.1);
  auto flow = makeGrid<openvdb::Vec3SGrid>(
      8, Transform::createLinearTransform(1.0), [](const Vec3d& p) { return openvdb::Vec3f(p); },
      "flow");
  writeVdb(folder / "a.vdb", {makeBone(), ball, flow});
  std::filesystem::create_directory(folder / "out");
  const auto refusal = [&](const std::string& grid, const FragmentOrder& order) -> std::string {
    try {
      (void)strewFragments(*loadVolume(folder / "a.vdb", grid), order, folder / "out");
    } catch (const Error& e) {
      return e.what();
    }
    return "no error";
  };
  const auto with = [](auto change) {
    FragmentOrder order = someOrder();
    change(order);
    return order;
  };
  CHECK_THAT(refusal("ball", someOrder()), Contains("level set"));
  CHECK_THAT(refusal("flow", someOrder()), Contains("vectors"));
  CHECK_THAT(refusal("bone", with([](auto& o) { o.value = 1e6; })), Contains("no surface"));
  CHECK_THAT(refusal("bone", with([](auto& o) { o.pieces = 1; })), Contains("--pieces"));
  CHECK_THAT(refusal("bone", with([](auto& o) { o.places = 6; })), Contains("--count"));
  CHECK_THAT(refusal("bone", with([](auto& o) { o.room = 0.0; })), Contains("--room"));
  CHECK_THAT(refusal("bone", with([](auto& o) { o.strength = -1.0; })), Contains("--strength"));
  CHECK(std::filesystem::is_empty(folder / "out"));
  struct Cancelled {};
  CHECK_THROWS_AS(strewFragments(*loadVolume(folder / "a.vdb", "bone"), someOrder(), folder / "out",
                                 [](double) { throw Cancelled(); }),
                  Cancelled);
  CHECK_THROWS_WITH(
      strewFragments(*loadVolume(folder / "a.vdb", "bone"), someOrder(), folder / "nowhere"),
      Contains("cannot be written"));
}

}  // namespace palpate::fragments_test
