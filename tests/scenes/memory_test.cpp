/// A scene is loaded where there is no memory for it.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <memory>
#include <new>
#include <string>
#include <unistd.h>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/engine/haptic_loop.h"
#include "palpate/scenes/build_scene.h"
#include "palpate/scenes/scene_file.h"
#include "tests/support/counters.h"
#include "tests/support/random.h"
#include "tests/support/scenes.h"
#include "tests/support/vdb_files.h"

using namespace palpate;
using palpate::test::FailScope;
namespace fs = std::filesystem;

TEST_CASE("memory that is not there while a scene is loaded leaves the one that is felt",
          "[fault]") {
  if (!FailScope::works()) return;
  const fs::path folder =
      fs::temp_directory_path() / ("palpate-memory-" + std::to_string(::getpid()));
  fs::create_directories(folder);
  test::writeTestVolumes(folder);
  const fs::path file = folder / "scene.json";
  std::ofstream(file) << R"({"palpate": 1, "volumes": {"ball": {"file": "ball.vdb"}},
    "modes": [{"mode": "isosurface", "of": "ball", "value": 0, "strength": 2, "solid": "below"}]})";
  const auto load = [&] { return buildScene(openScene(file)).scene; };

  test::TestDevice device;
  HapticLoop loop(device, 1000.0);
  loop.publish(test::ballScene(test::ballField()));
  TickTime time;
  const auto tick = [&](double z) {
    device.hand.position = Vec3(0, 0, z);
    time.now += time.dt;
    loop.tick(time);
  };
  for (int i = 0; i < 1500; ++i) tick(0.04);
  for (int i = 0; i < 100; ++i) tick(0.04 - 1.3e-4 * i);
  for (int i = 0; i < 100; ++i) tick(0.027);
  const Vec3 before = device.sent;
  REQUIRE(before.norm() > 1.0);

  long all = 0;
  for (int i = 0; i < 2; ++i) {  // the first one makes what all share
    const FailScope none(-1);
    REQUIRE(load() != nullptr);
    all = FailScope::seen();
  }
  // Each of the first, then one of so many.
  long refused = 0;
  long told = 0;
  long loaded = 0;
  const long step = std::max(1L, all / test::cases(300));
  for (long n = 1; n <= all; n += n < 200 ? 1 : step) {
    CAPTURE(n, all);
    std::shared_ptr<const Scene> scene;  // outlives the scope: OpenVDB's trees take memory to go
    try {
      const FailScope fails(n);
      scene = load();
      ++loaded;
    } catch (const std::bad_alloc&) {
      ++refused;
    } catch (const std::exception& error) {
      ++told;
    }
    tick(0.027);
    REQUIRE(device.sent == before);
    REQUIRE(loop.latest().fault == Fault::kNone);
  }
  std::printf(
      "of %ld allocations: %ld loads without one were refused, %ld told by an error, %ld did "
      "without\n",
      all, refused, told, loaded);
  CHECK(refused > all / 2);
  // And once there is, it is loaded.
  CHECK(load() != nullptr);
  fs::remove_all(folder);
}
