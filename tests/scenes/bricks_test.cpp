/// Tests scenes with volumes in bricks: forces, refused settings, and the fault when a folder
/// disappears.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <thread>

#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>

#include "palpate/engine/loop/haptic_loop.h"
#include "palpate/engine/tick/step.h"
#include "palpate/samplers/bricks/write_bricks.h"
#include "palpate/scenes/library/scene_cache.h"
#include "palpate/scenes/library/scene_file.h"
#include "tests/support/built_scene.h"
#include "tests/support/fine_head.h"
#include "tests/support/formula_bricks.h"
#include "tests/support/scenes.h"
#include "tests/support/vdb_grids.h"

namespace palpate::bricks_test {
using namespace palpate::test;
using Catch::Contains;
using Json = nlohmann::json;
namespace fs = std::filesystem;

namespace {

/// Writes a volume whose values are the depth [mm] in a ball of radius 60 mm, in a cube of 128 mm
/// with voxels of 0.5 mm.
void writeBall(const fs::path& folder) {
  BrickInput ball = formulaBricks("density", {255, 255, 255}, [](const VoxelAt& at) {
    return 60.0 - (0.5 * Vec3(at[0], at[1], at[2]) - Vec3::Constant(63.75)).norm();
  });
  ball.linear = 0.5 * Mat3::Identity();
  (void)writeBricks(folder / "ball.bricks", ball);
}

Json ballJson(const std::string& file) {
  Json scene = Json::parse(R"({
    "palpate": 1, "coupling": {"stiffness": 500},
    "volumes": {"ball": {"place": {"unit": "mm"}}},
    "modes": [{"name": "skin", "mode": "isosurface", "of": "ball", "value": 0, "solid": "above",
               "strength": 6, "friction": 0.3}]})");
  scene["volumes"]["ball"]["file"] = file;
  return scene;
}

SceneSpec specOf(const Json& scene, const fs::path& folder) {
  SceneSpec spec = parseScene(scene.dump(), "scene.json", folder);
  spec.waits = true;
  return spec;
}

/// A scene with the reader and the proxy of one hand.
struct Touching {
  explicit Touching(BuiltScene of, const ForceLimits& limits = {20.0, 2000.0})
      : built(std::move(of)), state(std::make_unique<ProxyState>(limits)) {}
  BuiltScene built;
  std::unique_ptr<Reader> reader = std::make_unique<Reader>();
  std::unique_ptr<ProxyState> state;

  StepReport tick(const Vec3& hand) {
    return hapticStep(*built.scene, *reader, {hand}, *state, 1e-3);
  }
};

bool same(const StepReport& a, const StepReport& b) {
  return a.force == b.force && a.proxy == b.proxy && a.wanted == b.wanted;
}

}  // namespace

TEST_CASE("a scene of bricks gives the same forces as its volume in memory", "[scene][bricks]") {
  const TemporaryFolder folder;
  writeBall(folder.path());
  SceneSpec in_memory = specOf(ballJson("ball.bricks"), folder.path());
  in_memory.volumes.at("ball").volume = loadBricks(folder / "ball.bricks");
  Touching whole(buildScene(in_memory));
  Touching bricks(buildScene(specOf(ballJson("ball.bricks"), folder.path())));
  REQUIRE(bricks.built.windows.count("ball") == 1);
  CHECK(whole.built.windows.empty());
  const Placement a = whole.built.placements.at("ball");
  const Placement b = bricks.built.placements.at("ball");
  CHECK(a == b);
  CHECK(whole.built.bounds.lower == bricks.built.bounds.lower);
  int held = 0;
  int other = 0;
  int coarse = 0;
  for (int i = 0; i < 2000; ++i) {
    const double angle = 0.002 * i;
    const Vec3 hand = (0.065 - 1e-5 * std::min(i, 1000)) *
                      Vec3(std::cos(angle), std::sin(angle), 0.3).normalized();
    const StepReport of_whole = whole.tick(hand);
    const StepReport of_bricks = bricks.tick(hand);
    other += same(of_whole, of_bricks) ? 0 : 1;
    coarse += of_bricks.coarse ? 1 : 0;
    held += of_whole.wanted.norm() > 0.0 ? 1 : 0;
  }
  CHECK(held > 1000);
  CHECK(other == 0);
  CHECK(coarse == 0);
  CHECK(bricks.built.windows.at("ball")->state().fetched > 8);
  // If a user opens the folder itself, palpate guesses a scene from its coarsest level.
  const SceneSpec guessed = openScene(folder / "ball.bricks/");
  REQUIRE(guessed.volumes.size() == 1);
  CHECK(guessed.volumes.begin()->second.file == folder / "ball.bricks");
  CHECK_FALSE(guessed.graph.modes.empty());
  CHECK(buildScene(guessed).windows.size() == 1);
  // An edited scene uses the same window.
  SceneCache cache;
  const BuiltScene one = buildScene(specOf(ballJson("ball.bricks"), folder.path()), {}, &cache);
  Json harder = ballJson("ball.bricks");
  harder["modes"][0]["strength"] = 7;
  const BuiltScene two = buildScene(specOf(harder, folder.path()), {}, &cache);
  CHECK(one.windows.at("ball") == two.windows.at("ball"));
  CHECK(one.scene->shape == two.scene->shape);
}

TEST_CASE("a scene setting that bricks do not support is rejected with its path",
          "[scene][bricks]") {
  const TemporaryFolder folder;
  writeBall(folder.path());
  writeVdb(folder / "ball.vdb", {makeBall(10.0, 1.0)});
  CHECK(refusal(ballJson("ball.bricks"), folder.path()) == "taken");
  const auto with = [&](const char* key, const Json& value, const char* file = "ball.bricks") {
    Json scene = ballJson(file);
    scene["volumes"]["ball"][key] = value;
    return refusal(scene, folder.path());
  };
  const std::string at = "/volumes/ball/";
  CHECK_THAT(with("smooth", 2), Contains(at + "smooth") && Contains("before you write the bricks"));
  CHECK_THAT(with("interpolation", "cubic"), Contains(at + "interpolation"));
  CHECK_THAT(with("axial", true), Contains(at + "axial"));
  CHECK_THAT(with("grid", "other"), Contains("the bricks hold the grid \"density\""));
  CHECK(with("grid", "density") == "taken");
  CHECK_THAT(with("window", {{"budget_mb", 20}}),
             Contains("holds") && Contains("to 47 MiB or more"));
  CHECK(with("window", {{"budget_mb", 64}}) == "taken");
  CHECK_THAT(with("window", {{"budget_mb", 64}}, "ball.vdb"),
             Contains(at + "window") && Contains("palpate brick"));
  CHECK_THAT(with("window", {{"budget_mb", 0}}), Contains(at + "window/budget_mb"));
  Json many = ballJson("ball.bricks");
  many["volumes"]["ball"].erase("place");
  many["volumes"]["ball"]["instances"] = Json::parse(R"([{"scale": 0.001}])");
  CHECK_THAT(refusal(many, folder.path()), Contains(at + "instances"));
  // A mode that needs a derived field would need the whole volume.
  Json derived = ballJson("ball.bricks");
  derived["fields"] =
      Json::parse(R"({"steep": {"gradient": "ball"}, "how": {"magnitude": "steep"}})");
  derived["modes"][0]["of"] = "how";
  CHECK_THAT(refusal(derived, folder.path()),
             Contains("/fields/") && Contains("before you write the bricks"));
  fs::remove(brickManifestFile(folder / "ball.bricks"));
  CHECK_THAT(refusal(ballJson("ball.bricks"), folder.path()),
             Contains("/volumes/ball") && Contains("unfinished"));
}

TEST_CASE(
    "a missing folder of bricks cuts the force until the folder is back and the fault is cleared",
    "[scene][bricks][safety]") {
  const TemporaryFolder folder;
  writeBall(folder.path());
  SceneSpec spec = specOf(ballJson("ball.bricks"), folder.path());
  spec.volumes.at("ball").budget_mb = 48.0;  // 36 bricks of 72, so distant bricks are not in memory
  const BuiltScene built = buildScene(spec);
  const auto& window = *built.windows.at("ball");
  TestDevice device;
  HapticLoop loop(device, 1000.0);
  loop.publish(built.scene);
  TickTime time;
  const auto go = [&](const Vec3& to, int ticks) {
    const Vec3 from = device.hand.position;
    for (int i = 1; i <= ticks; ++i) {
      device.hand.position = from + (to - from) * (static_cast<double>(i) / ticks);
      time.now += time.dt;
      loop.tick(time);
    }
    return loop.latest();
  };
  time.dt = 1e-3;
  device.hand.position = Vec3(0, 0, 0.07);
  (void)go(Vec3(0, 0, 0.07), 1000);
  CHECK(go(Vec3(0, 0, 0.055), 200).report.force.z() > 1.0);
  fs::copy(folder / "ball.bricks", folder / "away", fs::copy_options::recursive);
  fs::remove_all(folder / "ball.bricks");
  // Bricks in memory stay usable. The first brick that is not in memory causes the fault.
  Telemetry now = loop.latest();
  double step = 0.0;
  const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(20);
  for (int i = 0; now.fault == Fault::kNone && std::chrono::steady_clock::now() < until; ++i) {
    const double last = now.report.force.norm();
    const double angle = 3.0 * std::sin(0.001 * i);
    now = go(0.055 * Vec3(std::sin(angle), 0.0, std::cos(angle)), 1);
    step = std::max(step, now.report.force.norm() - last);
    std::this_thread::sleep_for(std::chrono::microseconds(200));
  }
  CHECK(now.fault == Fault::kVolume);
  CHECK(device.sent == Vec3::Zero());
  CHECK(step <= 2.0 + 1e-9);  // 2,000 N/s
  const auto troubles = window.takeTroubles();
  REQUIRE(troubles.size() == 1);
  CHECK_THAT(troubles[0], Contains("ball.bricks") && Contains("does not exist any more"));
  CHECK(window.state().gone);
  // If the fault is cleared while the folder is missing, the force is cut again.
  loop.clear();
  CHECK(go(Vec3(0, 0, 0.07), 200).fault == Fault::kVolume);
  fs::rename(folder / "away", folder / "ball.bricks");
  while (window.lost() && std::chrono::steady_clock::now() < until) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  REQUIRE_FALSE(window.lost());
  loop.clear();
  CHECK(go(Vec3(0, 0, 0.07), 1000).fault == Fault::kNone);
  now = go(Vec3(0, 0, 0.055), 200);
  CHECK(now.report.force.z() > 1.0);
  CHECK_FALSE(now.report.coarse);
  // The opposite side also holds the hand, once its bricks have arrived.
  (void)go(Vec3(0.09, 0, 0.09), 300);
  (void)go(Vec3(0.09, 0, -0.09), 300);
  (void)go(Vec3(0, 0, -0.07), 300);
  now = go(Vec3(0, 0, -0.055), 200);
  const auto later = std::chrono::steady_clock::now() + std::chrono::seconds(20);
  while (now.report.coarse && std::chrono::steady_clock::now() < later) {
    now = go(Vec3(0, 0, -0.055), 1);
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  CHECK(now.report.force.z() < -1.0);
  CHECK_FALSE(now.report.coarse);
}

// With sanitizers this test takes minutes. Other tests run the same code on small volumes.
#ifdef NDEBUG
TEST_CASE(
    "a volume 16 times as large as its window gives a hand that waits for bricks the same forces "
    "as the volume in memory",
    "[.][data][bricks]") {
  const char* data = std::getenv("PALPATE_DATA");
  REQUIRE(data != nullptr);
  const TemporaryFolder folder;
  const FineHead head(data, 0.3);
  (void)writeBricks(folder / "head", head.input());
  SceneSpec spec = specOf(ballJson("head"), folder.path());
  spec.graph.modes[0].value = 500.0;
  constexpr double kMegabyte = 1024.0 * 1024.0;
  const double whole = 4.0 * head.count(0) * head.count(1) * head.count(2) / kMegabyte;
  spec.volumes.at("ball").budget_mb = whole / 16.0;
  Touching bricks(buildScene(spec));
  const BrickWindow& window = *bricks.built.windows.at("ball");
  SceneSpec of_whole = spec;
  of_whole.volumes.at("ball").budget_mb.reset();
  of_whole.volumes.at("ball").volume = loadBricks(folder / "head");
  const auto feltWhole = [&] { return Touching(buildScene(of_whole)); };
  CHECK(static_cast<double>(window.state().bytes) <= 1.1 * whole / 16.0 * kMegabyte);

  // At 0.3 m/s the reader waits for the disk, so all bits are equal.
  Touching all = feltWhole();
  int held = 0;
  int other = 0;
  int coarse = 0;
  for (const Vec3& hand : head.way(0.9, 0.3e-3, 3.0)) {
    const StepReport a = all.tick(hand);
    const StepReport b = bricks.tick(hand);
    other += same(a, b) ? 0 : 1;
    coarse += b.coarse ? 1 : 0;
    held += a.wanted.norm() > 0.0 ? 1 : 0;
  }
  CHECK(held > 2000);
  CHECK(other == 0);
  CHECK(coarse == 0);
  CHECK(window.state().fetched > 2 * window.state().slots);  // bricks were evicted
  CHECK(window.state().failed == 0);

  // At 2 m/s the reader does not wait, and uses the bricks that are in memory.
  spec.waits = false;
  Touching fast(buildScene(spec));
  double step = 0.0;
  double last = 0.0;
  long ticks = 0;
  long felt = 0;
  auto next = std::chrono::steady_clock::now();
  for (const Vec3& hand : head.way(3.0, 2e-3, 3.0)) {
    const StepReport r = fast.tick(hand);
    REQUIRE(r.force.allFinite());
    step = std::max(step, r.force.norm() - last);
    last = r.force.norm();
    felt += last > 0.1 ? 1 : 0;
    ++ticks;
    next += std::chrono::milliseconds(1);
    std::this_thread::sleep_until(next);
  }
  CAPTURE(ticks, felt);
  CHECK(felt > ticks / 4);
  CHECK(step <= 2.0 + 1e-9);  // 2,000 N/s
}
#endif

}  // namespace palpate::bricks_test
