/// Tests BroadPhase, the tree that finds the boxes near a hand.
#include "palpate/engine/scene/broad_phase.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include <catch2/catch.hpp>

#include "tests/support/counters.h"
#include "tests/support/random.h"

namespace palpate::broad_phase_test {
using palpate::test::CountScope;
using palpate::test::Random;

namespace {

Box boxAt(const Vec3& centre, const Vec3& half) {
  return {centre - half, centre + half};
}

/// Returns random boxes whose centres lie in a cube with an edge of 1 m. Some boxes have the same
/// centre, and some are flat.
std::vector<Box> someBoxes(std::size_t count, Random& random) {
  std::vector<Box> boxes;
  const Vec3 heap = random.inCube(0.5);
  for (std::size_t i = 0; i < count; ++i) {
    const double size = random.logUniform(1e-4, 0.1);
    Vec3 half(random.uniform(0.1, 1.0), random.uniform(0.1, 1.0), random.uniform(0.1, 1.0));
    if (i % 17 == 0) half[random.integer(3)] = 0.0;
    boxes.push_back(boxAt(i % 5 == 0 ? heap : random.inCube(0.5), size * half));
  }
  return boxes;
}

bool meet(const Box& a, const Box& b) {
  return (a.lower.array() <= b.upper.array()).all() && (a.upper.array() >= b.lower.array()).all();
}

std::vector<std::uint32_t> found(const BroadPhase& tree, const Box& query) {
  std::vector<std::uint32_t> all(tree.size());
  all.resize(tree.meeting(query, all));
  std::sort(all.begin(), all.end());
  return all;
}

/// Requires that the tree finds every box that overlaps the query, and no box twice. Each found box
/// must be within 1 um of the query, because the tree stores floats.
void compare(const BroadPhase& tree, const std::vector<Box>& boxes, const Box& query) {
  const auto all = found(tree, query);
  REQUIRE(std::adjacent_find(all.begin(), all.end()) == all.end());
  const Vec3 coarse = Vec3::Constant(1e-6);
  for (std::size_t i = 0; i < boxes.size(); ++i) {
    const bool here = std::binary_search(all.begin(), all.end(), static_cast<std::uint32_t>(i));
    if (meet(boxes[i], query)) REQUIRE(here);
    if (here) REQUIRE(meet({boxes[i].lower - coarse, boxes[i].upper + coarse}, query));
  }
}

}  // namespace

TEST_CASE("the box tree finds the same boxes as a search through all boxes", "[broad]") {
  Random random(1);
  for (const std::size_t count : {0U, 1U, 2U, 3U, 7U, 64U, 1000U}) {
    std::vector<Box> boxes = someBoxes(count, random);
    BroadPhase tree(boxes);
    REQUIRE(tree.size() == count);
    for (int i = 0; i < 200; ++i) {
      compare(tree, boxes, boxAt(random.inCube(0.6), random.logUniform(1e-6, 0.3) * Vec3::Ones()));
    }
    // All boxes move. After refit(), the tree must find the boxes at their new positions.
    for (Box& box : boxes) {
      const Vec3 by = random.inCube(0.2);
      box = {box.lower + by, box.upper + by};
    }
    const CountScope scope;
    tree.refit(boxes);
    REQUIRE(CountScope::counts().allocations == 0);
    for (int i = 0; i < 100; ++i) {
      compare(tree, boxes, boxAt(random.inCube(0.7), random.logUniform(1e-6, 0.3) * Vec3::Ones()));
    }
  }
}

TEST_CASE("the box tree finds a box that the query touches but never an empty or non-finite box",
          "[broad]") {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double inf = std::numeric_limits<double>::infinity();
  std::vector<Box> boxes{boxAt({0.1, 0.2, 0.3}, {0.1, 0.1, 0.1}),
                         Box{},
                         boxAt({nan, 0, 0}, {1, 1, 1}),
                         {Vec3::Constant(-inf), Vec3::Constant(inf)}};
  BroadPhase tree(boxes);
  const Vec3 corner = boxes[0].upper;
  CHECK(found(tree, {corner, corner}) == std::vector<std::uint32_t>{0});
  CHECK(found(tree, boxAt({0, 0, 0}, {1, 1, 1})) == std::vector<std::uint32_t>{0});
  CHECK(found(tree, Box{}).empty());
  CHECK(found(tree, boxAt({nan, 0, 0}, {1, 1, 1})).empty());
  CHECK(found(tree, {Vec3::Constant(-inf), Vec3::Constant(inf)}).empty());
  // A box becomes empty, then gets its old extent.
  const Box was = boxes[0];
  boxes[0] = Box{};
  tree.refit(boxes);
  CHECK(found(tree, boxAt({0, 0, 0}, {1, 1, 1})).empty());
  boxes[0] = was;
  tree.refit(boxes);
  CHECK(found(tree, {corner, corner}) == std::vector<std::uint32_t>{0});
  CHECK(BroadPhase().meeting(boxAt({0, 0, 0}, {1, 1, 1}), {}) == 0);
}

TEST_CASE("a hand that moves 0.2 mm per tick searches the box tree in less than 2 % of the ticks",
          "[broad]") {
  Random random(2);
  const std::vector<Box> boxes = someBoxes(3000, random);
  const BroadPhase tree(boxes);
  NearBoxes near(0.01);
  Vec3 hand = Vec3::Zero();
  long asked = 0;
  constexpr long kTicks = 20000;
  std::vector<std::uint32_t> now;
  const CountScope scope;
  for (long i = 0; i < kTicks; ++i) {
    hand += 2e-4 * random.inCube(1.0) - 1e-3 * hand;  // steps of 0.19 mm on average
    const Box query = boxAt(hand, Vec3::Constant(1e-3));
    const auto all = near.near(tree, query);
    asked += near.asked() ? 1 : 0;
    REQUIRE(near.complete());
    REQUIRE(std::is_sorted(all.begin(), all.end()));
    for (std::size_t b = 0; b < boxes.size(); b += 7) {
      if (!meet(boxes[b], query)) continue;
      REQUIRE(std::binary_search(all.begin(), all.end(), static_cast<std::uint32_t>(b)));
    }
  }
  CHECK(asked < kTicks / 50);
  CHECK(asked > 0);
}

TEST_CASE(
    "the box tree reports its result as incomplete if more boxes than the limit are near the hand",
    "[broad]") {
  std::vector<Box> boxes(NearBoxes::kMost + 1, boxAt(Vec3::Zero(), Vec3::Ones()));
  NearBoxes near;
  BroadPhase heap(boxes);
  const Box query = boxAt(Vec3::Zero(), Vec3::Constant(1e-3));
  CHECK(near.near(heap, query).size() == NearBoxes::kMost);
  CHECK_FALSE(near.complete());
  // All boxes but the first are in the margin around the query, and outside of the query.
  for (std::size_t i = 1; i < boxes.size(); ++i) boxes[i] = boxAt({0.005, 0, 0}, {1e-4, 1, 1});
  heap.refit(boxes);
  near.forget();
  CHECK(near.near(heap, query).size() == 1);
  CHECK(near.complete());
  CHECK(near.near(heap, boxAt({0.005, 0, 0}, Vec3::Constant(1e-3))).size() == NearBoxes::kMost);
}

}  // namespace palpate::broad_phase_test
