/// Tests scenes with sequences: "frames" and "play".
#include <cmath>
#include <filesystem>
#include <string>

#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>

#include "palpate/engine/tick/step.h"
#include "palpate/scenes/library/scene_cache.h"
#include "palpate/scenes/library/scene_file.h"
#include "tests/support/built_scene.h"
#include "tests/support/json_schema.h"
#include "tests/support/vdb_grids.h"

namespace palpate::sequence_test {
using namespace palpate::test;
using Catch::Contains;
using Json = nlohmann::json;

namespace {

/// Writes balls with radii of 10 to 15 voxels: one file per frame, and one file with all.
void writeBalls(const std::filesystem::path& folder) {
  openvdb::GridPtrVec all;
  for (int i = 0; i < 6; ++i) {
    const auto ball = makeBall(10.0 + i, 1.0);
    writeVdb(folder / ("ball_00" + std::to_string(i) + ".vdb"), {ball});
    all.push_back(ball);
  }
  writeVdb(folder / "balls.vdb", all);
}

Json ballScene() {
  return Json::parse(R"({
    "palpate": 1, "coupling": {"stiffness": 500},
    "volumes": {"ball": {"file": "ball_%03d.vdb", "frames": {"rate": 10}, "place": {"unit": "mm"}}},
    "modes": [{"name": "skin", "mode": "isosurface", "of": "ball", "value": 0, "solid": "below",
               "strength": 6}]})");
}

/// Returns the x at which the proxy rests [mm]. The hand presses along -x on the ball at play time
/// `play` [s].
double surfaceAt(const BuiltScene& scene, double play) {
  Reader reader;
  ProxyState state({1e3, 1e12});
  double height = 0.0;
  for (int i = 0; i < 200; ++i) {
    state.playAt(play, 0.0);
    const Vec3 hand(1e-3 * std::max(9.0, 20.0 - 0.1 * i), 0.0, 0.0);
    height = 1e3 * hapticStep(*scene.scene, reader, {hand}, state, 1e-3).proxy.x();
  }
  return height;
}

}  // namespace

TEST_CASE("the surface of a volume with frames follows the play time", "[scene][sequence]") {
  const TemporaryFolder folder;
  writeBalls(folder.path());
  Json scene = ballScene();
  const bool files = GENERATE(true, false);
  if (!files) {
    scene["volumes"]["ball"]["file"] = "balls.vdb";
    scene["volumes"]["ball"]["grid"] = "ball";
  }
  const BuiltScene ball = built(scene, folder.path());
  REQUIRE(ball.sequences.count("ball") == 1);
  CHECK(ball.play == PlayParams{1.0, false, 0.0, 0.5, false});
  for (const double play : {0.0, 0.05, 0.23, 0.5}) {
    CHECK(surfaceAt(ball, play) == Approx(10.0 + 10.0 * play).margin(0.02));
  }
  // The scene's bounds contain all frames. `volumes` has the first frame.
  CHECK(ball.bounds.upper.x() > 15e-3);
  CHECK(ball.volumes.at("ball")->info().bounds.upper.x() < 14.0);
  CHECK(ball.scene->parts.empty());
}

TEST_CASE("a note names the frames without data", "[scene][sequence]") {
  const TemporaryFolder folder;
  writeBalls(folder.path());
  const auto other = makeBall(11.0, 1.0);
  other->setName("other");
  writeVdb(folder / "ball_002.vdb", {other});
  Json scene = ballScene();
  scene["volumes"]["ball"]["grid"] = "ball";
  const BuiltScene ball = built(scene, folder.path());
  REQUIRE(ball.notes.size() == 1);
  CHECK_THAT(ball.notes[0], Contains("1 of the sequence's 6 frames have no data") &&
                                Contains("ball_002.vdb: there is no grid \"ball\""));
}

TEST_CASE("a scene's play settings are read, checked and completed with defaults",
          "[scene][sequence]") {
  const TemporaryFolder folder;
  writeBalls(folder.path());
  Json scene = ballScene();
  scene["volumes"]["ball"]["frames"] = {{"times", {1, 2, 3, 5, 8, 13}}};
  CHECK(built(scene, folder.path()).play == PlayParams{1.0, false, 1.0, 13.0, false, 1.0});
  scene["play"] = {{"speed", -2.0}, {"paused", true}, {"from", 2}, {"to", 4}, {"repeat", true}};
  CHECK(built(scene, folder.path()).play == PlayParams{-2.0, true, 2.0, 4.0, true, 4.0});
  CHECK_FALSE(schemaComplaint(scene, sceneSchema()));
  // A sequence that repeats has no end.
  scene["play"] = {{"speed", 3}};
  scene["volumes"]["ball"]["frames"] = {{"rate", 10}, {"repeat", true}};
  const PlayParams play = built(scene, folder.path()).play;
  CHECK(play.speed == 3.0);
  CHECK(std::isinf(play.to));
  CHECK(play.from < -1e300);
  CHECK(play.begin == 0.0);
  scene["play"] = {{"speed", -1}, {"from", 0.2}};
  CHECK_THAT(refusal(scene, folder.path()), Contains("/play/speed") && Contains("\"to\""));
  scene["play"] = {{"speed", 3}};
  scene["play"]["repeat"] = true;
  CHECK_THAT(refusal(scene, folder.path()), Contains("/play/repeat") && Contains("\"to\""));
  scene["play"] = {{"from", 3}, {"to", 1}};
  CHECK_THAT(refusal(scene, folder.path()), Contains("/play/to"));
  scene["volumes"]["ball"]["frames"] = {{"rate", 10}};
  scene["play"] = {{"from", 3}};
  CHECK_THAT(refusal(scene, folder.path()), Contains("/play/from") && Contains("ended"));
  // Reverse play starts at the end.
  scene["play"] = {{"speed", -1}};
  CHECK(built(scene, folder.path()).play.begin == 0.5);
  // A note reports a memory budget that is too small for the speed.
  scene["play"] = {{"speed", 20}};
  scene["volumes"]["ball"]["frames"]["budget_mb"] = 1000.0;
  CHECK(built(scene, folder.path()).notes.empty());
  CHECK(built(scene, folder.path()).sequences.at("ball")->neededFor(20.0) == 16);
  // Searches for the smallest accepted budget, to within 5 %.
  double& budget = scene["volumes"]["ball"]["frames"]["budget_mb"].get_ref<double&>();
  double refused = 0.1;
  double accepted = 1000.0;
  while (accepted > 1.05 * refused) {
    budget = std::sqrt(refused * accepted);
    (refusal(scene, folder.path()) == "taken" ? accepted : refused) = budget;
  }
  budget = accepted;
  const BuiltScene little = built(scene, folder.path());
  CHECK(little.sequences.at("ball")->state().slots == 5);
  REQUIRE(little.notes.size() == 1);
  CHECK_THAT(little.notes[0], Contains("5 of the sequence's 6 frames") && Contains("needs 6"));
  scene["play"] = Json::object();
  scene["volumes"]["ball"] = {{"file", "ball_000.vdb"}};
  CHECK(refusal(scene, folder.path()) == "taken");
  scene["play"] = {{"speed", 2}};
  CHECK_THAT(refusal(scene, folder.path()), Contains("/play") && Contains("no sequence"));
}

TEST_CASE("an invalid sequence is rejected with its path in the scene file", "[scene][sequence]") {
  const TemporaryFolder folder;
  writeBalls(folder.path());
  const auto with = [&](const char* path, const Json& value) {
    Json scene = ballScene();
    scene[Json::json_pointer(path)] = value;
    return refusal(scene, folder.path());
  };
  CHECK(with("/volumes/ball/frames/rate", 25) == "taken");
  CHECK_THAT(with("/volumes/ball/frames", Json::object()), Contains("/volumes/ball/frames"));
  CHECK_THAT(with("/volumes/ball/frames/rate", 0), Contains("/volumes/ball/frames/rate"));
  CHECK_THAT(with("/volumes/ball/frames", {{"times", {0, 1}}}),
             Contains("/volumes/ball") && Contains("6 frames and 2 times"));
  CHECK_THAT(with("/volumes/ball/frames/budget_mb", 0.01),
             Contains("/volumes/ball") && Contains("of its frames"));
  CHECK_THAT(with("/volumes/ball/window", {{"budget_mb", 100}}), Contains("/volumes/ball/window"));
  CHECK_THAT(with("/volumes/ball/instances", {{{"fit", 0.1}}}), Contains("/volumes/ball"));
  CHECK_THAT(with("/volumes/ball/frames", {{"times", {0, 1, 2, 3, 4, 5}}, {"repeat", true}}),
             Contains("6 frames and 6 times: give 7"));
  CHECK_THAT(with("/volumes/ball/file", "none_%03d.vdb"),
             Contains("/volumes/ball") && Contains("no frame"));
  // A file name with a frame pattern requires "frames".
  Json scene = ballScene();
  scene["volumes"]["ball"].erase("frames");
  CHECK_THAT(refusal(scene, folder.path()),
             Contains("/volumes/ball/file") && Contains("\"frames\""));
  std::filesystem::remove(folder / "ball_003.vdb");
  CHECK_THAT(refusal(ballScene(), folder.path()), Contains("ball_003.vdb"));
}

TEST_CASE("a scene is rejected if a field of a sequence has to be computed at load",
          "[scene][sequence]") {
  const TemporaryFolder folder;
  for (int i = 0; i < 3; ++i) {
    writeVdb(folder / ("flow_" + std::to_string(i) + ".vdb"),
             {makeGrid<openvdb::Vec3SGrid>(
                 8, openvdb::math::Transform::createLinearTransform(1.0),
                 [i](const openvdb::Vec3d& p) { return openvdb::Vec3f(p.x() + i, 0.0F, 1.0F); },
                 "flow")});
  }
  Json scene = Json::parse(R"({
    "palpate": 1,
    "volumes": {"flow": {"file": "flow_%d.vdb", "frames": {"rate": 10}}},
    "fields": {"speed": {"magnitude": "flow"}},
    "modes": [{"mode": "follow", "of": "flow", "strength": 1, "by": "speed"}]})");
  CHECK(refusal(scene, folder.path()) == "taken");
  scene["modes"][0] = {{"mode", "isosurface"}, {"of", "speed"}, {"value", 4}, {"strength", 1}};
  CHECK_THAT(refusal(scene, folder.path()), Contains("/fields/speed") && Contains("sequence"));
}

TEST_CASE(
    "an edit of a scene keeps a sequence of unchanged frames and a coarse scene has the first "
    "frame",
    "[scene][sequence]") {
  const TemporaryFolder folder;
  writeBalls(folder.path());
  SceneCache cache;
  const BuiltScene first = built(ballScene(), folder.path(), &cache);
  Json scene = ballScene();
  scene["play"] = {{"speed", 2}};
  scene["modes"][0]["strength"] = 5;
  const BuiltScene second = built(scene, folder.path(), &cache);
  CHECK(second.sequences.at("ball") == first.sequences.at("ball"));
  CHECK(second.scene->shape == first.scene->shape);
  scene["volumes"]["ball"]["frames"]["rate"] = 20;
  CHECK(built(scene, folder.path(), &cache).sequences.at("ball") != first.sequences.at("ball"));
  const SceneSpec still = coarsely(parseScene(scene.dump(), "scene.json", folder.path()), second);
  const BuiltScene at_rest = buildScene(still);
  CHECK(at_rest.sequences.empty());
  CHECK(surfaceAt(at_rest, 0.3) == Approx(10.0).margin(0.02));
}

}  // namespace palpate::sequence_test
