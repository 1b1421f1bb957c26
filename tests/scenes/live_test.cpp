/// Compares the numbers that a window reads from shared memory with the loop's own numbers.
#include "palpate/scenes/library/live.h"

#include <array>
#include <atomic>
#include <fcntl.h>
#include <string>
#include <sys/mman.h>
#include <thread>
#include <unistd.h>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "palpate/scenes/apps/common/touch.h"
#include "palpate/scenes/library/build_scene.h"
#include "tests/support/counters.h"

namespace palpate::live_test {

namespace {

/// Returns a scene with a ball of radius 4 cm with friction, and a viscosity mode.
SceneSpec ballAndDrag() {
  SceneSpec spec;
  spec.volumes["ball"].field = makeSphere(Vec3::Zero(), 0.04);
  ModeSpec skin;
  skin.name = "skin";
  skin.kind = ModeKind::kIsosurface;
  skin.of = "ball";
  skin.solid = Solid::kBelow;
  skin.strength = 3.0;
  skin.friction = 0.3;
  ModeSpec drag;
  drag.name = "drag";
  drag.kind = ModeKind::kViscosity;
  drag.of = "ball";
  drag.strength = 0.2;
  spec.graph.modes = {drag, skin};
  return spec;
}

}  // namespace

TEST_CASE(
    "a reader of the shared memory gets whole values and never an older one after a newer one",
    "[live]") {
  struct Value {
    std::array<std::uint64_t, 40> all{};
  };
  Published<Value> published;
  Value seen;
  CHECK_FALSE(published.read(seen));
  std::atomic<bool> done{false};
  std::uint64_t last = 0;
  std::uint64_t torn = 0;
  std::uint64_t older = 0;
  std::thread reader([&] {
    Value value;
    while (!done) {
      if (!published.read(value)) continue;
      for (const std::uint64_t one : value.all) torn += one != value.all[0] ? 1U : 0U;
      older += value.all[0] < last ? 1U : 0U;
      last = value.all[0];
    }
  });
  constexpr std::uint64_t kWrites = 200000;
  Value value;
  for (std::uint64_t i = 1; i <= kWrites; ++i) {
    value.all.fill(i);
    published.write(value);
  }
  done = true;
  reader.join();
  CHECK(torn == 0);
  CHECK(older == 0);
  REQUIRE(published.read(seen));
  CHECK(seen.all[0] == kWrites);
}

TEST_CASE("the shared memory has the same loads of primitives as the command explain", "[live]") {
  const BuiltScene built = buildScene(ballAndDrag());
  LiveShare share;
  LiveWriter writer(share.block(), 100.0);  // every tick is written in full
  writer.expect(*built.scene);
  Reader reader;
  ProxyState state;
  Telemetry tick;
  tick.scene = built.scene->id;
  for (int i = 0; i < 30; ++i) {
    tick.probe = {1e-4 * i, 0.0, 0.041 - 1e-4 * i};
    tick.report = hapticStep(*built.scene, reader, {tick.probe}, state, 1e-3);
    tick.tick = i + 1;
    tick.time = 1e-3 * i;
    const test::CountScope scope;
    writer.take(tick, state);
    const test::Counts counts = test::CountScope::counts();
    CHECK((counts.allocations == 0 && counts.locks == 0));
  }
  LiveScene names;
  REQUIRE(share.block().scene.read(names));
  REQUIRE(names.mode_count == 2);
  CHECK(std::string(names.modes[0].name.data()) == "drag");
  CHECK(std::string(names.modes[1].name.data()) == "skin");
  CHECK(names.modes[1].dial.mode == 1);
  CHECK(names.modes[1].dial.factor == 1.0F);
  LiveTick told;
  REQUIRE(share.block().tick.read(told));
  CHECK(told.tick == 30);
  std::size_t next = 0;
  std::size_t frictions = 0;
  for (std::size_t mode = 0; mode < 2; ++mode) {
    for (const cli::Load& load : cli::loadsOf(state, tick.report, mode)) {
      REQUIRE(next < told.primitive_count);
      const LivePrimitive& primitive = told.primitives[next++];
      CHECK(primitive.mode == mode);
      CHECK(primitive.kind == load.primitive.kind);
      CHECK(primitive.friction == load.friction);
      CHECK(primitive.strength == load.primitive.strength);
      CHECK(Vec3(primitive.force[0], primitive.force[1], primitive.force[2]) == load.force);
      frictions += load.friction ? 1U : 0U;
    }
  }
  CHECK(next == told.primitive_count);
  CHECK(next == 3);
  CHECK(frictions == 1);
  LiveRow row;
  REQUIRE(share.block().rows[30].read(row));
  CHECK(row.force == Approx(tick.report.force.norm()));
  CHECK(row.apart == Approx((tick.probe - tick.report.proxy).norm()));

  const LiveShare other(dup(share.descriptor()));
  LiveTick same;
  REQUIRE(other.block().tick.read(same));
  CHECK(same.tick == 30);
}

TEST_CASE("shared memory of another layout is rejected, and the loop's own cannot be truncated",
          "[live]") {
  CHECK_THROWS_AS(LiveShare(dup(0)), Error);
  LiveShare share;
  CHECK(ftruncate(share.descriptor(), 0) != 0);
  const auto refusal = [](int descriptor) {
    try {
      const LiveShare taken(descriptor);
    } catch (const Error& error) {
      CHECK(fcntl(descriptor, F_GETFD) == -1);  // it is closed
      return error.reason();
    }
    return std::string("none");
  };
  const std::string other = "the loop belongs to another version of palpate";
  const int shorter = memfd_create("shorter", MFD_CLOEXEC);
  const std::array<std::uint64_t, 3> head{LiveBlock::kMagic, LiveBlock::kLayout, 0};
  REQUIRE(write(shorter, head.data(), sizeof head) == sizeof head);
  CHECK(refusal(shorter) == other);
  share.block().layout = LiveBlock::kLayout + 1;
  CHECK(refusal(dup(share.descriptor())) == other);
  share.block().magic = 7;
  CHECK_THAT(refusal(dup(share.descriptor())), Catch::Contains("is not the memory of a loop"));
}

}  // namespace palpate::live_test
