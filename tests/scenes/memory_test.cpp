/// Tests that the loop and its scene survive the load of another scene in which an allocation
/// fails.
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
#include "palpate/engine/loop/haptic_loop.h"
#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/scene_cache.h"
#include "palpate/scenes/library/scene_file.h"
#include "tests/support/counters.h"
#include "tests/support/random.h"
#include "tests/support/scenes.h"
#include "tests/support/vdb_files.h"

namespace palpate::memory_test {
using palpate::test::FailScope;
namespace fs = std::filesystem;

TEST_CASE("a scene load that runs out of memory leaves the force of the current scene unchanged",
          "[fault]") {
  if (!FailScope::works()) return;
  const fs::path folder =
      fs::temp_directory_path() / ("palpate-memory-" + std::to_string(::getpid()));
  fs::create_directories(folder);
  test::writeTestVolumes(folder);
  const fs::path file = folder / "scene.json";
  std::ofstream(file)
      << R"({"palpate": 1, "volumes": {"ball": {"file": "ball.vdb", "place": {"fit": 0.1}}},
    "modes": [{"mode": "isosurface", "of": "ball", "value": 0, "strength": 2, "solid": "below"}]})";
  // With a cache, as for a watched file, the next scene shares parts of the last one.
  SceneCache cache;
  const auto load = [&](SceneCache* kept) {
    return buildScene(openScene(file), nullptr, kept).scene;
  };

  test::TestDevice device;
  HapticLoop loop(device, 1000.0);
  loop.publish(load(&cache));
  TickTime time;
  const auto tick = [&](double z) {
    device.hand.position = Vec3(0, 0, z);
    time.now += time.dt;
    loop.tick(time);
  };
  for (int i = 0; i < 1500; ++i) tick(0.06);
  double z = 0.06;
  while (z > 0.0 && device.sent.norm() < 1.0) tick(z -= 1e-4);
  for (int i = 0; i < 500; ++i) tick(z);
  const Vec3 before = device.sent;
  REQUIRE(before.norm() > 0.9);

  long all = 0;
  for (int i = 0; i < 2; ++i) {  // the first pass creates data that later loads share
    const FailScope none(-1);
    REQUIRE(load(nullptr) != nullptr);
    all = FailScope::seen();
  }
  // Lets each of the first 200 allocations fail, then every `step`-th.
  long refused = 0;
  long told = 0;
  long loaded = 0;
  const long step = std::max(1L, all / test::cases(300));
  for (long n = 1; n <= all; n += n < 200 ? 1 : step) {
    CAPTURE(n, all);
    // Declared outside the FailScope, because freeing OpenVDB's trees allocates memory.
    std::shared_ptr<const Scene> scene;
    try {
      const FailScope fails(n);
      // Every second load shares its volume with the current scene.
      scene = load(n % 2 == 0 ? &cache : nullptr);
      tick(z);
      ++loaded;
    } catch (const std::bad_alloc&) {
      ++refused;
    } catch (const std::exception& error) {
      ++told;
    }
    tick(z);
    REQUIRE(device.sent == before);
    REQUIRE(loop.latest().fault == Fault::kNone);
  }
  std::printf(
      "%ld allocations; with one failing, %ld loads ended with bad_alloc, %ld with another error, "
      "%ld succeeded\n",
      all, refused, told, loaded);
  // More than a quarter of the loads must have ended with bad_alloc.
  CHECK(refused > (refused + told + loaded) / 4);
  // If a stream gets no memory, the load reports an unreadable file instead.
  CHECK(told <= 2);
  CHECK(load(&cache) != nullptr);
  fs::remove_all(folder);
}

}  // namespace palpate::memory_test
