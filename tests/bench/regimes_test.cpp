/// Tests the regimes of docs/stability.md, section 6, in which other methods fail. To print the
/// numbers: palpate_map_tests "regime*".
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

TEST_CASE(
    "regime: with weak oblique constraints the engine stays in its bounds and another method does "
    "not",
    "[stability]") {
  judge(weakConstraints());
}

TEST_CASE(
    "regime: in troughs, slots and corners the engine stays in its bounds and another method does "
    "not",
    "[stability]") {
  judge(acuteWalls());
}

TEST_CASE(
    "regime: with strengths of all sizes the engine stays in its bounds and another method does "
    "not",
    "[stability]") {
  judge(extremeSprings());
}

TEST_CASE("regime: at strikes and jumps the engine stays in its bounds and another method does not",
          "[stability]") {
  judge(strikesAndJumps());
}

TEST_CASE(
    "regime: on steep and noisy data the engine stays in its bounds and another method does not",
    "[stability]") {
  judge(steepAndNoisy());
}

TEST_CASE(
    "regime: with stiff, late or coarse coupling the engine stays in its bounds and others do not",
    "[stability][release]") {
  judge(stiffAndLate());
}

TEST_CASE("regime: in changing scenes the engine stays in its bounds and another method does not",
          "[stability]") {
  judge(scenesThatChange());
}

TEST_CASE("regime: with broken devices the engine stays in its bounds and another method does not",
          "[stability][release]") {
  judge(brokenDevices());
}

}  // namespace palpate::bench::regimes_test
