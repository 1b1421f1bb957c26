/// Tests scenes with volumes that deform: "warp", its frames, and the deforming volumes of `palpate
/// make`.
#include <cmath>
#include <filesystem>
#include <fstream>
#include <string>

#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>

#include "palpate/engine/tick/step.h"
#include "palpate/scenes/library/frames.h"
#include "palpate/scenes/library/made.h"
#include "palpate/scenes/library/scene_cache.h"
#include "palpate/scenes/library/scene_file.h"
#include "tests/support/built_scene.h"
#include "tests/support/json_schema.h"
#include "tests/support/vdb_grids.h"

namespace palpate::warp_test {
using namespace palpate::test;
using Catch::Contains;
using Json = nlohmann::json;

namespace {

Json heartScene() {
  Json scene = Json::parse(R"({
    "palpate": 1, "coupling": {"stiffness": 500},
    "volumes": {
      "heart": {"file": "heart.vdb", "grid": "muscle", "place": {"unit": "mm",
        "warp": {"field": "u", "times": [], "repeat": true}}},
      "u": {"file": "heart.vdb", "grid": "u", "place": {"like": "heart"}}},
    "modes": [{"name": "muscle", "mode": "isosurface", "of": "heart", "value": 0, "solid": "below",
               "strength": 6}]})");
  for (int i = 0; i <= 16; ++i) {
    scene["volumes"]["heart"]["place"]["warp"]["times"].push_back(0.05 * i);
  }
  return scene;
}

/// Writes displacement grids, one file per frame.
void writeFrames(const std::filesystem::path& folder, const std::string& before, int first,
                 int count) {
  for (int i = 0; i < count; ++i) {
    const auto grid = makeGrid<openvdb::Vec3SGrid>(
        6, openvdb::math::Transform::createLinearTransform(20.0),
        [i](const openvdb::Vec3d&) { return openvdb::Vec3f(0.0F, 0.0F, 0.25F * i); }, "shift");
    std::string number = std::to_string(first + i);
    number.insert(0, 4 - number.size(), '0');
    writeVdb(folder / (before + number + ".vdb"), {grid});
  }
}

}  // namespace

TEST_CASE("a procedural heart holds the hand where its formula has moved the wall",
          "[scene][warp]") {
  const TemporaryFolder folder;
  (void)writeMade("beating-heart", std::nullopt, folder / "heart.vdb");
  const BuiltScene heart = built(heartScene(), folder.path());
  REQUIRE(heart.motions.count("heart") == 1);
  CHECK(heart.motions.count("u") == 0);
  CHECK(heart.fields.count("u") == 0);
  const Placement place = heart.placements.at("heart");
  CHECK(heart.motions.at("heart")->topSpeed({}) > 0.02);
  // The hand moves inwards from the side, and rests for two heartbeats.
  Reader reader;
  ProxyState state({1e3, 1e12});
  double off = 0.0;
  double moved = 0.0;
  double speed = 0.0;
  int held = 0;
  Vec3 last = Vec3::Zero();
  for (int i = 0; i < 1700; ++i) {
    const double x = std::max(20.0, 45.0 - 0.1 * i);  // [mm]
    const StepReport r = hapticStep(*heart.scene, reader, {place({x, 3.0, -5.0})}, state, 1e-3);
    REQUIRE(r.status == StepStatus::kConverged);
    if (!(r.wanted.norm() > 0.0)) continue;
    ++held;
    // p is in the file's unit, millimetres.
    const Vec3 p = place.rotation.transpose() * (r.proxy - place.translate) / place.scale;
    off = std::max(off, std::abs(made::ventricle(p + made::beat(p, state.time() / 0.8))));
    if (held > 400) {
      moved = std::max(moved, 32.0 - p.x());
      speed = std::max(speed, 1e3 * (r.proxy - last).norm());
    }
    last = r.proxy;
  }
  CAPTURE(off, moved, speed);
  CHECK(held > 1200);
  CHECK(moved > 3.0);   // [mm]; the wall moves inwards
  CHECK(speed > 0.01);  // [m/s]
  CHECK(off < 0.15);    // [mm]; a voxel is 1 mm
}

TEST_CASE("an invalid warp is rejected with its path in the scene file", "[scene][warp]") {
  const TemporaryFolder folder;
  (void)writeMade("beating-heart", 3.0, folder / "heart.vdb");
  const Json good = heartScene();
  CHECK(refusal(good, folder.path()) == "taken");
  const auto with = [&](const std::function<void(Json & warp, Json & scene)>& spoil) {
    Json scene = good;
    spoil(scene["volumes"]["heart"]["place"]["warp"], scene);
    return refusal(scene, folder.path());
  };
  const std::string at = "scene.json: /volumes/heart/place/warp";
  CHECK_THAT(with([](Json& w, Json&) { w["field"] = "uu"; }),
             Contains(at + "/field: there is no volume \"uu\": did you mean \"u\"?"));
  CHECK_THAT(with([](Json& w, Json&) { w["times"].erase(0); }),
             Contains(at + "/times: 16 times are given for 17 displacement fields"));
  CHECK_THAT(with([](Json& w, Json&) { w["times"][3] = 0.1; }),
             Contains(at + "/times/3: the times do not ascend"));
  CHECK_THAT(with([](Json& w, Json&) { w.erase("field"); }), Contains("/warp"));
  CHECK_THAT(with([](Json& w, Json&) { w["times"][1] = "soon"; }), Contains("/warp/times/1"));
  CHECK_THAT(with([](Json&, Json& s) { s["volumes"]["u"]["grid"] = "muscle"; }),
             Contains("not a vector"));
  CHECK_THAT(with([](Json&, Json& s) { s["volumes"]["u"]["grid"] = "v"; }),
             Contains("/volumes/u: ") && Contains("\"v\""));
  CHECK_THAT(with([](Json&, Json& s) { s["volumes"]["u"]["file"] = "none.vdb"; }),
             Contains("none.vdb"));
  CHECK_THAT(with([](Json&, Json& s) {
               s["modes"].push_back({{"mode", "force"}, {"of", "u"}, {"strength", 1}});
             }),
             Contains("/modes/1/of: \"u\" is the displacement of another volume"));
  CHECK_THAT(with([](Json&, Json& s) { s["modes"][0]["by"] = "u"; }),
             Contains("/modes/0/by: \"u\" is the displacement of another volume"));
  CHECK_THAT(with([](Json& w, Json& s) {
               s["volumes"]["u"]["place"] = {{"scale", 0.001}, {"warp", w}};
             }),
             Contains("/volumes/u: the volume is the displacement of another volume"));
  CHECK_THAT(with([](Json&, Json& s) {
               s["fields"]["much"] = {{"magnitude", "u"}};
             }),
             Contains("/fields/much: \"u\" is the displacement of another volume"));
  CHECK_THAT(with([](Json& w, Json& s) {
               s["volumes"]["too"] = {{"file", "heart.vdb"},
                                      {"grid", "muscle"},
                                      {"place", {{"like", "heart"}, {"warp", w}}}};
             }),
             Contains("/volumes/too/place/warp"));
}

TEST_CASE("a user-defined mode cannot read the displacement of another volume", "[scene][warp]") {
  const TemporaryFolder folder;
  (void)writeMade("beating-heart", 3.0, folder / "heart.vdb");
  SceneSpec spec = parseScene(heartScene().dump(), "scene.json", folder.path());
  ModeSpec own;
  own.kind = ModeKind::kUser;
  own.user.place = +[](void*, const ModeInput&, PrimitiveSet&) noexcept { return true; };
  own.user.reads = {"heart"};
  spec.graph.modes.push_back(own);
  CHECK_NOTHROW((void)buildScene(spec));
  spec.graph.modes.back().user.reads = {"heart", "u"};
  CHECK_THROWS_WITH((void)buildScene(spec),
                    Contains("/modes/1/user/reads: \"u\" is the displacement of another volume"));
}

TEST_CASE("the frames of a sequence are the files of a pattern, and a gap between them is an error",
          "[scene][warp][sequence]") {
  const TemporaryFolder folder;
  VolumeSpec volume;
  volume.file = folder / "u_%04d.vdb";
  volume.grid = "shift";
  CHECK(isPattern(volume.file));
  CHECK_FALSE(isPattern("u_%s.vdb"));
  CHECK_FALSE(isPattern("u_%d_%d.vdb"));
  CHECK_FALSE(isPattern("u_%4d.vdb"));
  CHECK_FALSE(isPattern("u_%"));
  CHECK_FALSE(isPattern("u_1.vdb"));
  CHECK_THROWS_WITH(framesOf(volume), Contains("has no frame") && Contains("u_0001.vdb"));
  volume.file = folder / "nowhere" / "u_%04d.vdb";
  CHECK_THROWS_WITH(framesOf(volume), Contains("nowhere: no such folder"));
  volume.file = folder / "u_%04d.vdb";
  writeFrames(folder.path(), "u_", 7, 5);
  writeFrames(folder.path(), "other_u_", 1, 1);
  std::ofstream(folder / "u_00012.vdb") << "another number of digits";
  std::ofstream(folder / "u_12.vdb") << "another number of digits";
  std::ofstream(folder / "u_0012.vdb.bak") << "no frame";
  std::ofstream(folder / "u_99999999999999999999.vdb") << "no number";
  const auto frames = framesOf(volume);
  REQUIRE(frames.size() == 5);
  CHECK(frames.front().file.filename() == "u_0007.vdb");
  CHECK(frames.back().file.filename() == "u_0011.vdb");
  CHECK(frames.back().grid == "shift");
  CHECK(filesOf(volume).size() == 5);
  std::filesystem::remove(folder / "u_0009.vdb");
  CHECK_THROWS_WITH(framesOf(volume),
                    Contains("u_0009.vdb: the frame is missing, but u_0010.vdb exists"));
}

TEST_CASE("displacements from many files move a volume that is placed like the deformed one",
          "[scene][warp][sequence]") {
  const TemporaryFolder folder;
  writeFrames(folder.path(), "u_", 1, 4);  // moves up by 0.25 units per frame
  const auto ball = makeGrid<openvdb::FloatGrid>(
      41, openvdb::math::Transform::createLinearTransform(1.0),
      [](const openvdb::Vec3d& p) {
        return static_cast<float>((p - openvdb::Vec3d(20.0)).length() - 12.0);
      },
      "ball");
  writeVdb(folder / "ball.vdb", {ball});
  const Json scene = Json::parse(R"({
    "palpate": 1, "coupling": {"stiffness": 500},
    "volumes": {
      "ball": {"file": "ball.vdb", "grid": "ball", "place": {"scale": 0.001,
               "warp": {"field": "u", "times": [0, 1, 2, 3]}}},
      "same": {"file": "ball.vdb", "grid": "ball", "place": {"like": "ball"}},
      "u": {"file": "u_%04d.vdb", "grid": "shift", "place": {"scale": 0.001}}},
    "modes": [{"mode": "isosurface", "of": "same", "value": 0, "solid": "below", "strength": 3}]})");
  SceneCache cache;
  const BuiltScene made = built(scene, folder.path(), &cache);
  REQUIRE(made.motions.at("same") == made.motions.at("ball"));
  const Motion& motion = *made.motions.at("same");
  for (const double t : {0.0, 1.0, 2.0, 3.0, 9.0}) {
    const Vec3 rest = motion.poseAbout(Vec3(0.02, 0.02, 0.03), t).toRest(Vec3(0.02, 0.02, 0.03));
    CHECK(rest.z() - 0.03 == Approx(0.25e-3 * std::min(t, 3.0)).margin(1e-9));
  }
  // A scene that is built with the last scene's cache uses the same warp.
  const BuiltScene again = built(scene, folder.path(), &cache);
  CHECK(again.motions.at("ball")->warp() == motion.warp());
}

}  // namespace palpate::warp_test
