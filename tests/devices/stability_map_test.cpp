/// Tests maps of stability over coupling stiffness and damping: the engine agrees with the formula,
/// and other methods oscillate at settings at which the engine is stable.
#include "palpate/devices/simulated/stability_map.h"

#include <algorithm>
#include <cmath>
#include <string>

#include <catch2/catch.hpp>

#include "palpate/bench/methods/map_methods.h"
#include "palpate/devices/simulated/stability.h"
#include "tests/support/scenes.h"

namespace palpate::stability_map_test {

namespace {

constexpr int kSize = 33;
constexpr double kLeast = 50.0;
constexpr double kMost = 2e4;
constexpr double kMostDamping = 50.0;

StabilityMap mapOf(const MapSetting& setting, const MapContact& contact, const MapMethod& method) {
  return drawMap(setting, contact, method, kSize, kLeast, kMost, kMostDamping);
}

const MapMethod& named(const std::vector<MapMethod>& methods, const std::string& name) {
  const auto found = std::find_if(methods.begin(), methods.end(),
                                  [&](const MapMethod& m) { return m.name == name; });
  REQUIRE(found != methods.end());
  return *found;
}

std::shared_ptr<const Scene> wallScene() {
  return test::ballScene(makeSphere(Vec3(0, 0, -10.0), 10.0), 5.0);
}

}  // namespace

TEST_CASE(
    "the engine's stability limit on a wall and in a trough is 0.8 to 1.25 times the formula's",
    "[stability]") {
  const MapSetting setting;
  std::vector<std::pair<MapContact, MapMethod>> tried;
  for (const MapContact& contact : {wallContact(), troughContact(20.0)}) {
    tried.emplace_back(contact, solverOver(contact));
  }
  tried.emplace_back(wallContact(), wholeTick(wallScene(), Vec3(0, 0, 0.005)));
  for (const auto& [contact, method] : tried) {
    const StabilityMap map = mapOf(setting, contact, method);
    CAPTURE(method.name, contact.primitives.size());
    REQUIRE(map.cells.size() == static_cast<std::size_t>(kSize * kSize));
    CHECK(map.tried < kSize * kSize / 2);
    const auto n = static_cast<std::size_t>(kSize);
    for (std::size_t row = 0; row < n; ++row) {
      // Skips high damping, at which encoder steps matter: the formula ignores them.
      if (map.damping[row] > 5.0) continue;
      const double stable =
          stableStiffness(setting.arm, setting.grip, setting.rate, map.damping[row]);
      for (std::size_t column = 0; column < n; ++column) {
        const MapCell& cell = map.cells[row * n + column];
        CAPTURE(map.stiffness[column], map.damping[row], stable, cell.swing);
        if (map.stiffness[column] < 0.8 * stable) CHECK(cell.outcome == MapOutcome::kRests);
        if (map.stiffness[column] > 1.25 * stable) CHECK(cell.outcome != MapOutcome::kRests);
        // Below the passive stiffness the device gives no energy, whatever the hand does.
        const double passive = passiveStiffness(setting.arm, setting.rate, map.damping[row]);
        if (map.stiffness[column] < passive) CHECK_FALSE(cell.active);
      }
    }
  }
}

TEST_CASE("other methods oscillate at coupling settings at which the engine is stable",
          "[stability]") {
  const MapSetting setting;
  const MapContact trough = troughContact(20.0);
  const auto methods = methodsOver(trough);
  CHECK(methods.size() == 7);
  const auto rests = [&](const std::string& name, double stiffness, double damping) {
    const MapFeel feel = named(methods, name).make(stiffness, damping, 1.0 / setting.rate);
    return tryCoupling(setting, trough, feel).outcome == MapOutcome::kRests;
  };
  // A method without a proxy has a force jump at the surface, for any coupling.
  for (const double stiffness : {50.0, 200.0, 1000.0, 3000.0}) {
    for (const double damping : {0.0, 0.5, 5.0}) {
      CHECK_FALSE(rests("force function", stiffness, damping));
      CHECK(rests("palpate", stiffness, damping));
    }
  }
  // If a solver's results jump from tick to tick, the damping makes soft couplings oscillate. Wrong
  // results of a solver make stiff couplings unstable.
  struct Shaken {
    const char* method;
    std::vector<double> stiffness;
    std::vector<double> damping;
  };
  for (const Shaken& s : {Shaken{"Euler, adaptive step", {20.0, 25.0, 31.0}, {4.0, 5.8, 10.0}},
                          Shaken{"Euler, fixed step", {350.0, 500.0, 720.0}, {22.0, 32.0, 45.0}},
                          Shaken{"constraint approach", {9000.0, 10000.0}, {15.0, 21.0, 40.0}}}) {
    int shaken = 0;
    for (const double stiffness : s.stiffness) {
      for (const double damping : s.damping) {
        shaken += rests(s.method, stiffness, damping) ? 0 : 1;
        CAPTURE(stiffness, damping);
        CHECK(rests("palpate", stiffness, damping));
      }
    }
    CAPTURE(s.method, shaken);
    CHECK(shaken >= 3);
  }
}

TEST_CASE("a stability map has the same outcomes as a trial of each of its cells", "[stability]") {
  const MapSetting setting;
  const MapContact wall = wallContact();
  const MapMethod method = solverOver(wall);
  const StabilityMap map = mapOf(setting, wall, method);
  long other = 0;
  for (std::size_t i = 0; i < map.cells.size(); ++i) {
    const auto n = static_cast<std::size_t>(kSize);
    const MapCell cell = tryCoupling(
        setting, wall, method.make(map.stiffness[i % n], map.damping[i / n], 1.0 / setting.rate));
    other += static_cast<long>(cell.outcome != map.cells[i].outcome);
  }
  CHECK(other == 0);
}

}  // namespace palpate::stability_map_test
