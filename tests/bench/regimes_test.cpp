/// Tests the cases of docs/stability.md, section 6, in which other methods fail and the engine does
/// not. Prints the numbers: palpate_map_tests "regime*".
#include <cmath>
#include <iostream>

#include <catch2/catch.hpp>

#include "tests/support/regime_rows.h"

namespace palpate::bench::regimes_test {

namespace {

void judge(const Regime& row) {
  std::cout << row.where << '\n';
  REQUIRE_FALSE(row.fails.empty());
  REQUIRE_FALSE(row.holds.empty());
  const auto print = [](const char* half, const Finding& f, const char* than) {
    std::cout << "  " << half << ": " << f.who << ", " << f.what << ": " << f.value << " (" << than
              << " " << f.bound << ")\n";
  };
  for (const Finding& f : row.fails) {
    print("fails", f, "at least");
    CAPTURE(f.who, f.what, f.value, f.bound);
    CHECK(f.fails());
  }
  for (const Finding& f : row.holds) {
    print("holds", f, "at most");
    CAPTURE(f.who, f.what, f.value, f.bound);
    CHECK(f.holds());
  }
}

}  // namespace

TEST_CASE("regime: weak constraints that are not orthogonal", "[stability]") {
  judge(weakConstraints());
}

TEST_CASE("regime: acute troughs, slots and corners", "[stability]") {
  judge(acuteWalls());
}

TEST_CASE("regime: strengths and stiffness of all sizes", "[stability]") {
  judge(extremeSprings());
}

TEST_CASE("regime: strikes and jumps", "[stability]") {
  judge(strikesAndJumps());
}

TEST_CASE("regime: steep and noisy data", "[stability]") {
  judge(steepAndNoisy());
}

TEST_CASE("regime: stiff, late and coarse", "[stability][release]") {
  judge(stiffAndLate());
}

TEST_CASE("regime: scenes that change under the hand", "[stability]") {
  judge(scenesThatChange());
}

TEST_CASE("regime: devices that are broken", "[stability][release]") {
  judge(brokenDevices());
}

}  // namespace palpate::bench::regimes_test
