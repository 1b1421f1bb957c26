/// Tests a window of bricks. The window must equal the whole volume where its bricks are in memory.
/// Elsewhere, its samples are coarse.
#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <limits>
#include <memory>
#include <string>
#include <thread>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/engine/tick/step.h"
#include "palpate/samplers/bricks/brick_field.h"
#include "palpate/samplers/bricks/bricks_about.h"
#include "palpate/samplers/bricks/hand_report.h"
#include "palpate/samplers/bricks/write_bricks.h"
#include "palpate/samplers/grid/make_volume.h"
#include "palpate/samplers/retries.h"
#include "tests/support/counters.h"
#include "tests/support/formula_bricks.h"
#include "tests/support/random.h"
#include "tests/support/thinned.h"
#include "tests/support/vdb_grids.h"

namespace palpate::window_test {
using namespace palpate::test;
using Catch::Contains;

namespace {

constexpr double kVoxel = 1e-3;  // [m]

/// Returns a dense volume of n^3 voxels of 1 mm. The volume is so rough that coarse levels differ
/// from it. If `holes` is true, a box of voxels is missing.
std::shared_ptr<const Volume> bumpy(int n, bool holes = false) {
  const auto grid = makeGrid<openvdb::FloatGrid>(
      n, openvdb::math::Transform::createLinearTransform(1.0), [](const openvdb::Vec3d& p) {
        return static_cast<float>(std::sin(0.21 * p.x()) * std::cos(0.17 * p.y()) +
                                  std::sin(0.13 * p.z() + 0.05 * p.x()) + 0.01 * p.y());
      });
  if (holes) {
    grid->insertMeta(kMetaInactiveIsMissing, openvdb::BoolMetadata(true));
    for (auto at = openvdb::CoordBBox({50, 52, 54}, {91, 83, 75}).begin(); at; ++at) {
      grid->tree().setValueOff(*at, grid->background());
    }
  }
  return makeVolume(*grid);
}

Placement placed() {
  Placement place;
  place.scale = kVoxel;
  return place;
}

std::uint64_t budgetOf(std::uint64_t bricks) {
  constexpr std::uint64_t kBesides = 2;  // memory of one fetch [bricks]
  return (bricks + kBesides) * ((BrickFormat{}.bytes() + 63) / 64 * 64) + (64U << 10U);
}

std::shared_ptr<BrickWindow> windowOf(const std::filesystem::path& folder, std::uint64_t bricks,
                                      double horizon = 0.25) {
  return std::make_shared<BrickWindow>(std::make_unique<PosixBricks>(folder),
                                       WindowParams{budgetOf(bricks), horizon, false});
}

/// The fields of a window and of its whole volume, each with a cache.
struct Both {
  std::shared_ptr<const ScalarField> whole;
  std::shared_ptr<const ScalarField> window;
  std::unique_ptr<FieldCache> whole_cache = std::make_unique<FieldCache>();
  std::unique_ptr<FieldCache> window_cache = std::make_unique<FieldCache>();

  Both(const std::shared_ptr<const Volume>& volume, const std::shared_ptr<BrickWindow>& bricks)
      : whole(std::get<0>(makeVdbField(volume, placed()))),
        window(std::get<0>(makeBrickField(bricks, placed()))) {
    whole->reset(*whole_cache);
    window->reset(*window_cache);
  }
  [[nodiscard]] ScalarSample ofWindow(const Vec3& p) const {
    return window->sample(p, *window_cache);
  }
  [[nodiscard]] bool same(const Vec3& p, const ScalarSample& at) const {
    const ScalarSample of = whole->sample(p, *whole_cache);
    return std::memcmp(&of.value, &at.value, sizeof of.value) == 0 && of.gradient == at.gradient &&
           of.inside == at.inside;
  }
};

}  // namespace

TEST_CASE("a window equals the whole volume to the last bit where its bricks are present",
          "[bricks]") {
  const TemporaryFolder folder;
  const bool holes = GENERATE(false, true);
  CAPTURE(holes);
  const auto volume = bumpy(150, holes);
  (void)writeBricks(folder / "bricks", brickInput(volume));
  const auto window = windowOf(folder / "bricks", 60);
  const Both both(volume, window);
  window->aim(0, {Vec3::Constant(75.0), Vec3::Constant(75.0), Vec3::Zero()});
  REQUIRE(window->settle(20.0));
  CHECK(window->state().failed == 0);
  CHECK(window->takeTroubles().empty());
  Random random(3);
  long fine = 0;
  for (int i = 0; i < 20000; ++i) {
    // The bounds include the distance at which a tick reads. Beyond the bounds, the grid has no
    // data.
    const Box& box = both.window->frame().bounds;
    const Vec3 p = (kVoxel * (Vec3::Constant(75.0) + random.inCube(90.0)))
                       .cwiseMax(box.lower)
                       .cwiseMin(box.upper);
    const ScalarSample at = both.ofWindow(p);
    REQUIRE_FALSE(at.coarse);
    REQUIRE(both.same(p, at));
    ++fine;
    if (i % 20 != 0) continue;
    CHECK(both.window->value(p, *both.window_cache) == both.whole->value(p, *both.whole_cache));
    CHECK(both.window->cellGradient(p, *both.window_cache) ==
          both.whole->cellGradient(p, *both.whole_cache));
    CHECK(both.window->gradientJacobian(p, *both.window_cache) ==
          both.whole->gradientJacobian(p, *both.whole_cache));
    const Vec3 q = p + kVoxel * random.inCube(60.0);
    const Crossing a = both.window->firstFall(p, q, 0.3, 1.0, *both.window_cache);
    const Crossing b = both.whole->firstFall(p, q, 0.3, 1.0, *both.whole_cache);
    CHECK((a.found == b.found && a.share == b.share && a.cells == b.cells));
  }
  CHECK(fine == 20000);
  CHECK(both.window->frame().bounds.lower == both.whole->frame().bounds.lower);
  CHECK(both.window->frame().bounds.upper == both.whole->frame().bounds.upper);
  CHECK(both.window->frame().voxel == both.whole->frame().voxel);
}

TEST_CASE("a flow in bricks is read and traced as the whole flow is, to the last bit", "[bricks]") {
  const TemporaryFolder folder;
  const auto grid = makeGrid<openvdb::Vec3SGrid>(
      140, openvdb::math::Transform::createLinearTransform(1.0), [](const openvdb::Vec3d& p) {
        return openvdb::Vec3f(static_cast<float>(std::sin(0.05 * p.y())),
                              static_cast<float>(std::cos(0.04 * p.z()) + 0.2),
                              static_cast<float>(std::sin(0.06 * p.x()) + 0.3));
      });
  const auto volume = makeVolume(*grid);
  (void)writeBricks(folder / "bricks", brickInput(volume));
  BrickFormat format;
  format.vector = true;
  const auto window = std::make_shared<BrickWindow>(
      std::make_unique<PosixBricks>(folder / "bricks"), WindowParams{60 * format.bytes()});
  window->aim(0, {Vec3::Constant(70.0), Vec3::Constant(70.0), Vec3::Zero()});
  REQUIRE(window->settle(20.0));
  const auto whole = std::get<1>(makeVdbField(volume, placed()));
  const auto bricks = std::get<1>(makeBrickField(window, placed()));
  const auto a_cache = std::make_unique<FieldCache>();
  const auto b_cache = std::make_unique<FieldCache>();
  whole->reset(*a_cache);
  bricks->reset(*b_cache);
  Random random(5);
  int samples = 0;
  for (int i = 0; i < 3000; ++i) {
    const Vec3 p = kVoxel * (Vec3::Constant(69.5) + random.inCube(69.5));
    const VectorSample a = whole->sample(p, *a_cache);
    const VectorSample b = bricks->sample(p, *b_cache);
    REQUIRE_FALSE(b.coarse);
    REQUIRE((a.value == b.value && a.jacobian == b.jacobian && a.inside == b.inside));
    TraceOrder order;
    order.length = kVoxel * random.uniform(-6.0, 6.0);
    order.hand = kVoxel * random.inCube(6.0);
    const Trace along_a = whole->trace(p, order, *a_cache);
    const Trace along_b = bricks->trace(p, order, *b_cache);
    REQUIRE(along_a.position == along_b.position);
    REQUIRE(along_a.direction == along_b.direction);
    REQUIRE(along_a.samples == along_b.samples);
    samples += along_a.samples;
  }
  CHECK(samples > 10000);
}

namespace {

/// Place near the middle of the volume of `holed`, where eight bricks meet, in index space.
const Vec3 kMiddle(65.0, 0.0, 64.0);

/// The fields of a volume and of a window with all its bricks, each with a cache.
template <class Field>
struct Pair {
  std::shared_ptr<const Field> whole;
  std::shared_ptr<const Field> bricks;
  std::unique_ptr<FieldCache> whole_cache = std::make_unique<FieldCache>();
  std::unique_ptr<FieldCache> bricks_cache = std::make_unique<FieldCache>();

  Pair(const std::shared_ptr<const Volume>& volume, const std::shared_ptr<BrickWindow>& window,
       const Sampling& sampling = {})
      : whole(std::get<std::shared_ptr<const Field>>(makeVdbField(volume, placed(), sampling))),
        bricks(std::get<std::shared_ptr<const Field>>(
            makeBrickField(window, placed(), sampling.slope_reach))) {
    whole->reset(*whole_cache);
    bricks->reset(*bricks_cache);
  }
  /// Calls `of` with each field and its cache. Returns both results.
  template <class Of>
  [[nodiscard]] auto both(const Of& of) const {
    return std::make_pair(of(*whole, *whole_cache), of(*bricks, *bricks_cache));
  }
};

/// Returns a volume about the corner of eight bricks, with active tiles and with holes: boxes,
/// single voxels and inactive voxels that have a value.
template <class GridT>
std::shared_ptr<const Volume> holed(const std::string& inactive, bool level_set, Random& random) {
  openvdb::initialize();
  const auto grid = GridT::create();
  const openvdb::Coord low(55, -9, 50);
  const openvdb::Coord high(75, 12, 79);
  const auto value = [&] {
    if constexpr (std::is_arithmetic_v<typename GridT::ValueType>) {
      return static_cast<float>(random.uniform(-1.0, 1.0));
    } else {
      return openvdb::Vec3f(openvdb::Vec3d(random.inCube(1.0).data()));
    }
  };
  if (level_set) {
    grid->setGridClass(openvdb::GRID_LEVEL_SET);
    grid->tree().root().setBackground(value(), true);
  }
  for (auto at = openvdb::CoordBBox(low, high).begin(); at; ++at) {
    if (random.uniform() < 0.97) grid->tree().setValue(*at, value());
    if (random.uniform() < 0.02) grid->tree().setValueOff(*at, value());
  }
  for (int n = 0; n < 6; ++n) {
    const auto within = [&](int a) { return low[a] + random.integer(high[a] - low[a]); };
    const openvdb::Coord at(within(0), within(1), within(2));
    grid->fill({at, at.offsetBy(4)}, grid->background(), false);
  }
  grid->fill({openvdb::Coord(56, 0, 64), openvdb::Coord(63, 7, 71)}, value(), true);
  grid->fill({openvdb::Coord(64, -8, 56), openvdb::Coord(71, -1, 63)}, value(), false);
  if (inactive == "missing") grid->insertMeta(kMetaInactiveIsMissing, openvdb::BoolMetadata(true));
  if (inactive == "outside") {
    grid->insertMeta(kMetaImportedFrom, openvdb::StringMetadata("mesh"));
  }
  return makeVolume(*grid);
}

/// Writes a volume as bricks, and returns a window with all of them.
template <class Field>
Pair<Field> pairOf(const std::filesystem::path& folder, const std::shared_ptr<const Volume>& volume,
                   const Sampling& sampling) {
  (void)writeBricks(folder, brickInput(volume));
  BrickFormat format;
  format.vector = true;
  const auto window = std::make_shared<BrickWindow>(std::make_unique<PosixBricks>(folder),
                                                    WindowParams{40 * format.bytes(), 0.25, false});
  window->aim(0, {kMiddle, kMiddle, Vec3::Zero()});
  REQUIRE(window->settle(20.0));
  return {volume, window, sampling};
}

/// Reports a hand in the volume, so that the field of the window reads by its fast path.
template <class Field>
void attend(const Pair<Field>& pair) {
  std::this_thread::sleep_for(std::chrono::milliseconds(15));  // all bricks have faded in
  (void)pair.bricks->attend({kVoxel * kMiddle, kVoxel * kMiddle, 1e-3}, *pair.bricks_cache);
}

/// Returns a place in or near the data, often on voxels, or not finite.
Vec3 somePlace(Random& random, int i) {
  Vec3 p_I =
      kMiddle + Vec3(0.0, 1.5, 0.5) + random.inCube(1.0).cwiseProduct(Vec3(13.0, 13.5, 17.5));
  if (i % 5 == 0) p_I[i % 3] = std::round(p_I[i % 3]);
  if (i % 25 == 0) p_I = p_I.array().round();
  if (i % 500 == 0) p_I[i % 3] = std::numeric_limits<double>::quiet_NaN();
  return kVoxel * p_I;
}

/// Compares readings at random places. Returns the number of readings that differ. Adds the number
/// of places with data to `within`.
int differences(const Pair<ScalarField>& pair, Random& random, int& within) {
  int count = 0;
  const auto same = [&](const auto& of) { count += of.first == of.second ? 0 : 1; };
  for (int i = 1; i < 2000; ++i) {
    const Vec3 p = somePlace(random, i);
    const Vec3 q = p + kVoxel * random.inCube(9.0);
    const auto read = pair.both([&](const ScalarField& field, FieldCache& cache) {
      const ScalarSample s = field.sample(p, cache);
      return std::make_tuple(s.value, s.gradient, s.inside, s.coarse);
    });
    same(read);
    within += std::get<2>(read.first) ? 1 : 0;
    same(pair.both([&](const ScalarField& field, FieldCache& cache) {
      return std::make_tuple(field.value(p, cache), field.cellGradient(p, cache),
                             field.gradientJacobian(p, cache));
    }));
    same(pair.both([&](const ScalarField& field, FieldCache& cache) {
      const Crossing c = field.firstFall(p, q, 0.1, i % 2 == 0 ? 1.0 : -1.0, cache);
      return std::make_tuple(c.found, c.share, c.cells, c.behind);
    }));
  }
  return count;
}
int differences(const Pair<VectorField>& pair, Random& random, int& within) {
  int count = 0;
  const auto same = [&](const auto& of) { count += of.first == of.second ? 0 : 1; };
  for (int i = 1; i < 2000; ++i) {
    const Vec3 p = somePlace(random, i);
    const auto read = pair.both([&](const VectorField& field, FieldCache& cache) {
      const VectorSample s = field.sample(p, cache);
      return std::make_tuple(s.value, s.jacobian, s.inside, s.coarse);
    });
    same(read);
    within += std::get<2>(read.first) ? 1 : 0;
    TraceOrder order;
    order.length = kVoxel * random.uniform(-3.0, 3.0);
    order.hand = kVoxel * random.inCube(3.0);
    if (i % 8 != 1) continue;
    same(pair.both([&](const VectorField& field, FieldCache& cache) {
      const Trace t = field.trace(p, order, cache);
      return std::make_tuple(t.position, t.direction, t.length, t.samples);
    }));
  }
  return count;
}

}  // namespace

TEST_CASE("bricks equal the volume to the last bit beside holes, tiles and the ends of the data",
          "[bricks]") {
  const TemporaryFolder folder;
  const std::string inactive = GENERATE("background", "missing", "outside");
  CAPTURE(inactive);
  Random random(7);
  Sampling sampling;
  sampling.slope_reach = inactive == "missing" ? 0.5 : 0.8;
  const auto compare = [&](const auto& pair) {
    int within = 0;
    CHECK(differences(pair, random, within) == 0);
    attend(pair);
    CHECK(differences(pair, random, within) == 0);
    CHECK((within > 400 && within < 3900));
    pair.bricks->leave(*pair.bricks_cache);
  };
  compare(pairOf<ScalarField>(folder / "fog", holed<openvdb::FloatGrid>(inactive, false, random),
                              sampling));
  compare(pairOf<ScalarField>(folder / "set", holed<openvdb::FloatGrid>(inactive, true, random),
                              sampling));
  compare(pairOf<VectorField>(folder / "flow", holed<openvdb::Vec3SGrid>(inactive, false, random),
                              sampling));
}

TEST_CASE("where bricks are missing, values are coarse and continuous, and become fine gradually",
          "[bricks]") {
  const TemporaryFolder folder;
  const auto volume = bumpy(300);
  (void)writeBricks(folder / "bricks", brickInput(volume));
  const auto window = windowOf(folder / "bricks", 8 + 27, 0.0);
  const Both both(volume, window);
  const Vec3 centre = kVoxel * Vec3::Constant(60.0);
  window->aim(0, {centre / kVoxel, centre / kVoxel, Vec3::Zero()});
  REQUIRE(window->settle(20.0));
  CHECK(window->state().bytes <= 1.1 * static_cast<double>(budgetOf(8 + 27)));
  // The point of reading moves away from the hand in steps of 0.02 voxel. The value must not jump.
  double jump = 0.0;
  long coarse = 0;
  long same = 0;
  ScalarSample last = both.ofWindow(centre);
  for (int i = 1; i < 10000; ++i) {
    const Vec3 p = centre + kVoxel * 0.02 * i * Vec3(0.9, 0.3, 0.1);
    const ScalarSample at = both.ofWindow(p);
    jump = std::max(jump, std::abs(at.value - last.value));
    last = at;
    coarse += at.coarse ? 1 : 0;
    if (at.coarse) continue;
    REQUIRE(both.same(p, at));
    ++same;
  }
  CAPTURE(jump, coarse, same);
  CHECK(coarse > 1000);
  CHECK(same > 1000);
  CHECK(jump < 0.05);  // the data change by up to 0.01, and levels differ by up to 1
  // Across faces of bricks, present or missing, the value must change no more than the data.
  Random random(6);
  double step = 0.0;
  for (int i = 0; i < 2000; ++i) {
    Vec3 p = Vec3::Constant(100.0) + random.inCube(100.0);
    const Eigen::Index axis = random.integer(3);
    p[axis] = 64.0 * (1 + random.integer(3));
    const Vec3 little = 1e-5 * Vec3::Unit(axis);
    step = std::max(step, std::abs(both.ofWindow(kVoxel * (p + little)).value -
                                   both.ofWindow(kVoxel * (p - little)).value));
  }
  CHECK(step < 1e-4);  // two successive levels differ by about 1e-2
  // The hand moves to a position with coarse values. In each tick, the value approaches the fine
  // value by a limited step.
  const Vec3 there = centre + kVoxel * Vec3(160.0, 40.0, 20.0);
  REQUIRE(both.ofWindow(there).coarse);
  double excess = -1.0;
  bool fine = false;
  double value = both.ofWindow(there).value;
  auto last_tick = std::chrono::steady_clock::now();
  for (int tick = 0; tick < 4000 && !fine; ++tick) {
    both.window->attend({there, there, 1e-3}, *both.window_cache);
    const std::chrono::duration<double> since = std::chrono::steady_clock::now() - last_tick;
    last_tick += std::chrono::duration_cast<std::chrono::steady_clock::duration>(since);
    const ScalarSample at = both.ofWindow(there);
    // Levels differ by up to 1 and fade in within 10 ms. Two levels can fade in at once.
    excess = std::max(excess, std::abs(at.value - value) - 1.5 * (since.count() + 1e-3) / 0.01);
    value = at.value;
    fine = !at.coarse;
    both.window->leave(*both.window_cache);
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  CHECK(fine);
  CHECK(both.same(there, both.ofWindow(there)));
  CHECK(excess < 0.0);
}

TEST_CASE(
    "a sample that is not marked coarse equals the whole volume even while bricks are evicted",
    "[bricks][host]") {
  const TemporaryFolder folder;
  const auto volume = bumpy(300);
  (void)writeBricks(folder / "bricks", brickInput(volume));
  const auto window = windowOf(folder / "bricks", 8 + 27, 0.0);
  const Both both(volume, window);
  std::atomic<bool> stop{false};
  // A hand that jumps makes the window evict bricks all the time.
  std::thread leaper([&] {
    Random random(9);
    while (!stop) {
      const Vec3 at = Vec3::Constant(150.0) + random.inCube(150.0);
      window->aim(1, {at, at, Vec3::Zero()});
      std::this_thread::sleep_for(std::chrono::milliseconds(7));
    }
  });
  Random random(4);
  long fine = 0;
  long wrong = 0;
  const CountScope scope;
  const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(20);
  for (int i = 0; std::chrono::steady_clock::now() < until; ++i) {
    if (i >= (kSanitized ? 30000 : 300000) && i % 1000 == 0 && window->state().fetched > 200) break;
    const Vec3 p = kVoxel * (Vec3::Constant(150.0) + random.inCube(150.0));
    const ScalarSample at = both.ofWindow(p);
    if (at.coarse) continue;
    ++fine;
    if (!both.same(p, at)) ++wrong;
  }
  const auto counts = CountScope::counts();
  stop = true;
  leaper.join();
  CAPTURE(fine, wrong);
  CHECK(counts.allocations == 0);
  CHECK(fine > 1000);
  CHECK(wrong == 0);
  CHECK(window->state().fetched > 200);
}

TEST_CASE("bricks that a reader uses stay unchanged until the reader leaves", "[bricks]") {
  const TemporaryFolder folder;
  const auto volume = bumpy(300);
  (void)writeBricks(folder / "bricks", brickInput(volume));
  const auto window = windowOf(folder / "bricks", 8 + 27, 0.0);
  const Vec3 here = Vec3::Constant(40.0);
  window->aim(0, {here, here, Vec3::Zero()});
  REQUIRE(window->settle(20.0));
  const std::uint32_t side = window->enter();
  struct Seen {
    BrickWindow::Cell cell;
    float value;
  };
  std::vector<Seen> seen;
  for (int n = 0; n < 8; ++n) {
    const std::array<int, 3> at{20 + 64 * (n / 4), 20 + 64 * (n / 2 % 2), 20 + 64 * (n % 2)};
    const BrickWindow::Entry entry = window->entryAt(0, at[0], at[1], at[2]);
    REQUIRE(entry.kind() == BrickWindow::Entry::kSlot);
    seen.emplace_back();
    REQUIRE(window->cellAt(entry, 0, at, seen.back().cell));
    seen.back().value = *seen.back().cell.rows[0];
  }
  const auto same = [&] {
    return std::count_if(seen.begin(), seen.end(),
                         [](const Seen& of) { return *of.cell.rows[0] == of.value; });
  };
  // The hand jumps to the opposite end, where it needs all slots.
  const Vec3 there = Vec3::Constant(260.0);
  window->aim(0, {there, there, Vec3::Zero()});
  CHECK_FALSE(window->settle(0.5));
  CHECK(same() == 8);
  window->leave(side);
  CHECK(window->settle(20.0));
  CHECK(same() < 8);
}

TEST_CASE("a missing brick is reported in one line and replaced by coarser data", "[bricks]") {
  const TemporaryFolder folder;
  const auto volume = bumpy(150);
  const BrickReport report = writeBricks(folder / "bricks", brickInput(volume));
  const BrickId id{0, {1, 1, 1}};
  std::filesystem::remove(folder / "bricks" / brickObject(id, report.manifest.format()));
  const auto window = windowOf(folder / "bricks", 60);
  const Both both(volume, window);
  window->aim(0, {Vec3::Constant(75.0), Vec3::Constant(75.0), Vec3::Zero()});
  REQUIRE(window->settle(20.0));
  const auto troubles = window->takeTroubles();
  REQUIRE(troubles.size() == 1);
  CHECK_THAT(troubles[0], Contains("0/1.1.1"));
  CHECK(window->state().failed == 1);
  CHECK(both.ofWindow(kVoxel * Vec3::Constant(96.0)).coarse);
  CHECK_FALSE(both.ofWindow(kVoxel * Vec3::Constant(20.0)).coarse);
  CHECK_THROWS_WITH(windowOf(folder / "bricks", 3),
                    Contains("a window of") && Contains("increase the budget"));
  // A volume without stored bricks also needs memory, for its tables.
  (void)writeBricks(folder / "empty",
                    formulaBricks("empty", {63, 63, 63}, [](const VoxelAt&) { return 0; }));
  CHECK_THROWS_WITH(BrickWindow(std::make_unique<PosixBricks>(folder / "empty"), {1000}),
                    Contains("a window of") && Contains("increase the budget"));
}

TEST_CASE("a reader that waits for bricks gets fine values from the first tick on", "[bricks]") {
  const TemporaryFolder folder;
  const auto volume = bumpy(300);
  (void)writeBricks(folder / "bricks", brickInput(volume));
  WindowParams params{budgetOf(8 + 40), 0.25, false, true};
  const auto window =
      std::make_shared<BrickWindow>(std::make_unique<PosixBricks>(folder / "bricks"), params);
  const Both both(volume, window);
  for (int tick = 0; tick < 400; ++tick) {
    const Vec3 p = kVoxel * (Vec3::Constant(20.0) + 0.6 * tick * Vec3::Ones());
    both.window->attend({p, p, 1e-3}, *both.window_cache);
    const ScalarSample at = both.ofWindow(p);
    both.window->leave(*both.window_cache);
    CAPTURE(tick);
    REQUIRE_FALSE(at.coarse);
    REQUIRE(both.same(p, at));
  }
  CHECK(window->state().fetched > window->state().slots);
}

TEST_CASE("the bricks of a hand that moves back and forth stay in the window", "[bricks]") {
  const TemporaryFolder folder;
  (void)writeBricks(folder / "bricks", formulaBricks("ramp", {63 + 64 * 15, 127, 127},
                                                     [](const VoxelAt& at) { return at[0]; }));
  const auto window = windowOf(folder / "bricks", 8 + 40, 0.0);
  const auto go = [&](double x) {
    const Vec3 p(64.0 * x, 64.0, 64.0);
    window->aim(0, {p, p, Vec3::Zero()});
    REQUIRE(window->settle(20.0));
    return window->state().fetched;
  };
  // The first moves fill all slots and evict bricks. Then the hand moves back and forth over fewer
  // bricks than there are slots.
  for (const double x : {14.0, 12.0, 10.0, 8.0, 5.0, 3.0, 1.0}) (void)go(x);
  const std::uint64_t fetched = window->state().fetched;
  REQUIRE(fetched > window->state().slots);
  for (const double x : {3.0, 5.0, 3.0, 1.0}) CHECK(go(x) == fetched);
}

TEST_CASE(
    "a window loads the bricks at a proxy far from its hand, and reuses them 1 s after the last "
    "report",
    "[bricks][release]") {
  const TemporaryFolder folder;
  const auto volume = bumpy(300);
  (void)writeBricks(folder / "bricks", brickInput(volume));
  const auto window = windowOf(folder / "bricks", 8 + 40, 0.0);
  const Both both(volume, window);
  const Vec3 proxy = Vec3::Constant(30.0);
  const Vec3 probe = Vec3::Constant(270.0);
  // A surface holds the proxy far from the hand. The window must have the bricks of both positions.
  window->aim(0, {proxy, probe, Vec3::Zero()});
  REQUIRE(window->settle(20.0));
  CHECK_FALSE(both.ofWindow(kVoxel * proxy).coarse);
  const std::uint64_t fetched = window->state().fetched;
  // A resting hand calls aim() in each tick, but needs no new brick.
  for (int tick = 0; tick < 1000; ++tick) window->aim(0, {proxy, probe, Vec3::Zero()});
  REQUIRE(window->settle(20.0));
  CHECK(window->state().fetched == fetched);
  // If the first hand has not called aim() for 1 s, the second hand gets all slots.
  std::this_thread::sleep_for(std::chrono::milliseconds(1100));
  window->aim(1, {Vec3(270.0, 30.0, 30.0), Vec3(270.0, 30.0, 30.0), Vec3::Zero()});
  REQUIRE(window->settle(20.0));
  const Both next(volume, window);
  CHECK_FALSE(next.ofWindow(kVoxel * Vec3(270.0, 30.0, 30.0)).coarse);
  CHECK(next.ofWindow(kVoxel * proxy).coarse);
}

TEST_CASE("where finer bricks are missing a sample depends only on its position", "[bricks]") {
  // All levels of a ramp have the same values, so every difference shows a wrong sample.
  const TemporaryFolder folder;
  const BrickInput ramp =
      formulaBricks("ramp", {639, 255, 127}, [](const VoxelAt& at) { return at[1]; });
  const BrickReport report = writeBricks(folder / "bricks", ramp);
  REQUIRE(report.manifest.levels().size() == 3);
  // Beyond a common face of levels 0 and 1, the bricks of both levels are missing.
  std::vector<BrickId> missing{{1, {1, 0, 0}}, {1, {1, 1, 0}}};
  for (int n = 0; n < 8; ++n) missing.push_back({0, {2, n / 2, n % 2}});
  for (const BrickId& id : missing) {
    REQUIRE(std::filesystem::remove(folder / "bricks" / brickObject(id, report.manifest.format())));
  }
  const auto window = windowOf(folder / "bricks", 60, 0.0);
  const auto field = std::get<0>(makeBrickField(window, placed()));
  const auto cache = std::make_unique<FieldCache>();
  field->reset(*cache);
  window->aim(0, {Vec3(150.0, 60.0, 60.0), Vec3(150.0, 60.0, 60.0), Vec3::Zero()});
  REQUIRE(window->settle(20.0));
  // The point of reading moves back and forth in steps of 0.1 voxel, with readings at other points
  // in between. Each point must always have the same value.
  std::vector<double> there;
  double off = 0.0;
  double other = 0.0;
  bool blended = false;
  for (int way = 0; way < 2; ++way) {
    for (int i = 0; i < 600; ++i) {
      const double x = 110.0 + 0.1 * (way == 0 ? i : 599 - i);
      const ScalarSample at = field->sample(kVoxel * Vec3(x, 60.25, 60.0), *cache);
      off = std::max(off, std::abs(at.value - 60.25));
      off = std::max(off, std::abs(kVoxel * at.gradient.y() / kVoxel - 1.0));
      REQUIRE(at.inside);
      blended = blended || at.coarse;
      if (way == 0) {
        there.push_back(at.value);
      } else {
        other = std::max(other, std::abs(at.value - there[static_cast<std::size_t>(599 - i)]));
      }
      (void)field->sample(kVoxel * Vec3(300.0, 10.0, 10.0), *cache);
      (void)field->firstFall(kVoxel * Vec3(x, 60.0, 60.0), kVoxel * Vec3(x + 40.0, 60.0, 60.0), 0.5,
                             1.0, *cache);
    }
  }
  CHECK(blended);
  CHECK(off < 1e-4);
  CHECK(other == 0.0);
}

TEST_CASE("a wall in a loaded brick is found on a path that begins in a missing brick",
          "[bricks]") {
  const TemporaryFolder folder;
  const BrickInput wall = formulaBricks("wall", {319, 127, 127},
                                        [](const VoxelAt& at) { return at[0] == 142 ? 2.0 : 0.0; });
  const BrickReport report = writeBricks(folder / "bricks", wall);
  for (const int j : {0, 1}) {
    for (const int k : {0, 1}) {
      std::filesystem::remove(folder / "bricks" /
                              brickObject({0, {1, j, k}}, report.manifest.format()));
    }
  }
  const auto window = windowOf(folder / "bricks", 60, 0.0);
  const auto field = std::get<0>(makeBrickField(window, placed()));
  const auto cache = std::make_unique<FieldCache>();
  field->reset(*cache);
  window->aim(0, {Vec3(120.0, 60.0, 60.0), Vec3(120.0, 60.0, 60.0), Vec3::Zero()});
  REQUIRE(window->settle(20.0));
  for (double x = 100.0; x < 140.0; x += 0.5) {
    CAPTURE(x);
    const Crossing met = field->firstFall(kVoxel * Vec3(x, 60.0, 60.0),
                                          kVoxel * Vec3(150.0, 60.0, 60.0), 1.5, -1.0, *cache);
    CHECK(met.found);
  }
}

TEST_CASE(
    "the box around a brick excludes points near missing bricks, and contains a point that is not "
    "near one",
    "[bricks]") {
  Random random(11);
  const auto number = [](const std::array<int, 3>& off) {
    return static_cast<std::size_t>(9 * (off[0] + 1) + 3 * (off[1] + 1) + off[2] + 1);
  };
  const Vec3 first(64.0, -128.0, 0.0);
  constexpr double kFade = 4.0;
  int cut = 0;
  int held = 0;
  for (int trial = 0; trial < 3000; ++trial) {
    std::array<bool, 27> there{};
    for (bool& one : there) one = random.uniform(0.0, 1.0) > 0.03 * (trial % 10);
    const Vec3 p = first + Vec3::Constant(32.0) + random.inCube(32.0);
    const Box box = detail::bricksAbout(
        p, first, kFade, [&](const std::array<int, 3>& off) { return there[number(off)]; });
    bool far = true;
    bool all = true;
    for (int n = 0; n < 27; ++n) {
      const std::array<int, 3> off{n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1};
      if (n == 13 || there[number(off)]) continue;
      all = false;
      const Vec3 lower = first + 64.0 * Vec3(off[0], off[1], off[2]);
      const Vec3 upper = lower + Vec3::Constant(64.0);
      const Vec3 gap = (lower - box.upper).cwiseMax(box.lower - upper);
      CAPTURE(trial, n, p, box.lower, box.upper);
      REQUIRE(gap.maxCoeff() >= kFade);
      far = far && (p - upper).cwiseMax(lower - p).maxCoeff() > kFade;
    }
    const bool in = (p.array() >= box.lower.array()).all() && (p.array() < box.upper.array()).all();
    CAPTURE(trial, p, box.lower, box.upper);
    REQUIRE(in == far);
    if (all) REQUIRE(box.size() == Vec3::Constant(3 * 64.0 - 2 * kFade));
    cut += all ? 0 : 1;
    held += in ? 1 : 0;
  }
  CHECK(cut > 2000);
  CHECK(held > 1000);
}

namespace {

/// A source of bricks from a folder that reports a delay, or takes a time `each` for each brick.
/// Records the largest index along x of the requested bricks of level 0.
class SlowBricks final : public BrickSource {
 public:
  explicit SlowBricks(const std::filesystem::path& folder, double delay,
                      std::chrono::milliseconds each = {})
      : of_(folder), delay_(delay), each_(each) {}
  [[nodiscard]] const BrickManifest& manifest() const noexcept override { return of_.manifest(); }
  void want(std::vector<BrickWish> wishes) override {
    for (const BrickWish& wish : wishes) {
      if (wish.id.level == 0) farthest_ = std::max<int>(farthest_, wish.id.at[0]);
    }
    of_.want(std::move(wishes));
  }
  [[nodiscard]] std::optional<BrickArrival> next(std::span<std::byte> slot,
                                                 std::chrono::milliseconds patience) override {
    auto arrival = of_.next(slot, patience);
    if (arrival) std::this_thread::sleep_for(each_);
    return arrival;
  }
  [[nodiscard]] bool isThere() override { return of_.isThere(); }
  [[nodiscard]] BrickArrival read(const BrickId& id, std::span<std::byte> slot) override {
    return of_.read(id, slot);
  }
  [[nodiscard]] std::chrono::duration<double> delay() const override {
    return std::chrono::duration<double>(delay_);
  }
  [[nodiscard]] int farthest() const { return farthest_; }

 private:
  PosixBricks of_;
  double delay_;
  std::chrono::milliseconds each_;
  std::atomic<int> farthest_{0};
};

}  // namespace

TEST_CASE(
    "bricks that take a second to load are requested five bricks ahead of the hand instead of two",
    "[bricks]") {
  const TemporaryFolder folder;
  (void)writeBricks(folder / "bricks",
                    formulaBricks("ramp", {639, 63, 63}, [](const VoxelAt& at) { return at[0]; }));
  const auto farthest = [&](double delay) {
    auto source = std::make_unique<SlowBricks>(folder / "bricks", delay);
    const SlowBricks& of = *source;
    const BrickWindow window(std::move(source), {budgetOf(60), 0.1, false});
    // The hand moves at one brick per second.
    window.aim(0, {Vec3(32.0, 32.0, 32.0), Vec3(32.0, 32.0, 32.0), Vec3(64.0, 0.0, 0.0)});
    REQUIRE(window.settle(20.0));
    return of.farthest();
  };
  CHECK(farthest(0.0) == 2);
  CHECK(farthest(1.0) == 5);
}

TEST_CASE("a window continues to follow a hand that waits for its bricks for more than 1 s",
          "[bricks]") {
  const TemporaryFolder folder;
  const auto volume = bumpy(150);
  (void)writeBricks(folder / "bricks", brickInput(volume));
  // Fetching 27 bricks takes 1.6 s. The window stops following a hand that has not called aim() for
  // 1 s, unless a hand waits.
  const auto window = std::make_shared<BrickWindow>(
      std::make_unique<SlowBricks>(folder / "bricks", 0.0, std::chrono::milliseconds(60)),
      WindowParams{budgetOf(60), 0.25, false});
  window->aim(0, {Vec3::Constant(75.0), Vec3::Constant(75.0), Vec3::Zero()});
  REQUIRE(window->settle(20.0));
  CHECK(window->state().fetched == 27 + 8);
  const Both both(volume, window);
  for (const double x : {5.0, 75.0, 145.0}) {
    CHECK_FALSE(both.ofWindow(kVoxel * Vec3::Constant(x)).coarse);
  }
}

TEST_CASE("two hands that share a record do not mix their reports", "[bricks]") {
  const auto aimOf = [](double at) {
    return BrickWindow::Aim{Vec3::Constant(at), Vec3::Constant(at), Vec3::Constant(at)};
  };
  detail::HandReport report;
  CHECK_FALSE(report.read());
  REQUIRE(report.tryWrite(aimOf(1.0)));
  ++report.count;  // another hand has begun to write
  CHECK_FALSE(report.tryWrite(aimOf(2.0)));
  CHECK_FALSE(report.read());
  ++report.count;  // and has ended
  REQUIRE(report.read());
  CHECK(report.read()->proxy == Vec3::Constant(1.0));
  REQUIRE(report.tryWrite(aimOf(2.0)));
  CHECK(report.read()->velocity == Vec3::Constant(2.0));
}

TEST_CASE("a failed load is retried after 1 s, and then at intervals that double up to 32 s",
          "[bricks]") {
  using std::chrono::seconds;
  detail::Retries<int> of;
  const detail::Retries<int>::Clock::time_point begin;
  CHECK(of.may(7, begin));
  auto now = begin;
  for (const int wait : {1, 2, 4, 8, 16, 32, 32, 32}) {
    CHECK(of.failed(7, now) == (now == begin));
    CHECK_FALSE(of.may(7, now + seconds(wait) - std::chrono::milliseconds(1)));
    now += seconds(wait);
    CHECK(of.may(7, now));
    CHECK(of.due(now, [](int id) { return id == 7; }));
    CHECK_FALSE(of.due(now, [](int id) { return id != 7; }));
  }
  CHECK(of.size() == 1);
  of.had(7);
  CHECK(of.may(7, begin));
  CHECK(of.failed(7, now));
}

}  // namespace palpate::window_test
