/// Tests cache warm-ups: a warm-up must compute like the next tick, but change no state and have no
/// effect on the hand.
#include "palpate/engine/loop/cache_warmup.h"

#include <cmath>
#include <cstring>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/engine/loop/haptic_loop.h"
#include "tests/support/counters.h"
#include "tests/support/random.h"
#include "tests/support/scenes.h"

namespace palpate::cache_warmup_test {
using palpate::test::ballField;
using palpate::test::ballScene;
using palpate::test::ballSpec;
using palpate::test::TestDevice;

namespace {

constexpr double kDt = 1e-3;
/// Time that is left for a warm-up [s]. A tick takes less than a quarter of this time, unless the
/// machine pauses.
constexpr double kLead = 1.0;

/// Returns a scene with a ball with friction and a drag, a moving ball, and parts.
std::shared_ptr<const Scene> richScene() {
  GraphSpec spec = ballSpec();
  spec.modes[0].friction = 0.5;
  spec.modes[0].viscosity = 0.3;
  spec.modes.push_back(ballSpec(1.5).modes[0]);
  spec.modes[1].of = "other";
  const std::vector<Keyframe> keyframes{{0.0, {1, 0, 0, 0}, {0, 0, 0}},
                                        {1.0, {1, 0, 0, 0}, {0, 0.01, 0}},
                                        {2.0, {1, 0, 0, 0}, {0, 0, 0}}};
  spec.motions["other"] = std::make_shared<const Motion>(keyframes, true);
  std::vector<Part> parts;
  for (const double x : {-0.05, 0.05}) {
    parts.push_back(makePart(ballSpec(2.0), {{"ball", makeSphere({x, 0, 0}, 0.025)}}));
  }
  return makeScene(spec, {{"ball", ballField()}, {"other", makeSphere({0, 0.035, 0}, 0.02)}}, {},
                   {}, std::move(parts));
}

/// Returns the position of a hand that moves about the ball at the origin, presses into it, and
/// sometimes goes through it.
Vec3 handAt(double t) {
  const Vec3 out(std::sin(0.7 * t), std::sin(1.3 * t), 1.0);
  return (0.0315 - (0.0045 + 0.003 * std::sin(0.9 * t)) * std::sin(9.0 * t)) * out.normalized();
}

bool same(const StepReport& a, const StepReport& b) {
  return a.force == b.force && a.wanted == b.wanted && a.proxy == b.proxy && a.energy == b.energy &&
         a.iterations == b.iterations && a.samples == b.samples && a.substeps == b.substeps &&
         a.primitives == b.primitives && a.parts == b.parts && a.status == b.status &&
         a.injected == b.injected;
}

}  // namespace

TEST_CASE("a cache warm-up changes no report and writes nothing to the device", "[loop][warmup]") {
  const std::shared_ptr<const Scene> scene = richScene();
  TestDevice plain_device;
  TestDevice device;
  for (TestDevice* each : {&plain_device, &device}) {
    each->about.limits.tank.use = TankUse::kAct;
    each->about.limits.tank.arm.viscous = 1.0;
  }
  HapticLoop plain(plain_device, 1.0 / kDt);
  HapticLoop loop(device, 1.0 / kDt);
  CHECK_FALSE(loop.warmUp(kDt, kLead));
  loop.prepareWarmup();
  plain.publish(scene);
  loop.publish(scene);
  int warmups = 0;
  int held = 0;
  TickTime time;
  time.dt = kDt;
  for (int i = 0; i < 5000; ++i) {
    time.now += kDt;
    plain_device.hand.position = device.hand.position = handAt(time.now);
    {
      const test::CountScope scope;
      warmups += loop.warmUp(kDt, kLead) ? 1 : 0;
      loop.tick(time);
      REQUIRE(test::CountScope::counts().allocations == 0);
      REQUIRE(test::CountScope::counts().locks == 0);
    }
    plain.tick(time);
    const StepReport& report = loop.latest().report;
    REQUIRE(same(report, plain.latest().report));
    held += report.primitives > 0 ? 1 : 0;
  }
  CHECK(device.writes == plain_device.writes);
  CHECK(warmups > 4900);
  CHECK(held > 1000);
}

TEST_CASE("a cache warm-up predicts the proxy and contacts of over 98 % of the ticks",
          "[loop][warmup]") {
  const std::shared_ptr<const Scene> scene = richScene();
  Reader reader;
  ProxyState state;
  CacheWarmup warmup(state.limits());
  int warmups = 0;
  int alike = 0;
  int alike_in_contact = 0;
  int in_contact = 0;
  int yields = 0;
  int before = 0;
  for (int i = 0; i < 5000; ++i) {
    const HandState hand{handAt(kDt * i)};
    const bool did = warmup.run(*scene, state, kDt);
    const StepReport report = hapticStep(*scene, reader, hand, state, kDt);
    warmup.look(hand, report);
    yields += report.primitives < before ? 1 : 0;
    before = report.primitives;
    if (!did) continue;
    ++warmups;
    const StepReport& warmed = warmup.warmed();
    const bool about =
        warmed.primitives == report.primitives && (warmed.proxy - report.proxy).norm() < 1e-5;
    alike += about ? 1 : 0;
    in_contact += report.primitives > 0 ? 1 : 0;
    alike_in_contact += about && report.primitives > 0 ? 1 : 0;
  }
  CHECK(warmups == 4998);
  CHECK(yields > 5);
  CHECK(in_contact > 1000);
  CHECK(alike > 0.99 * warmups);
  CHECK(alike_in_contact > 0.98 * in_contact);
}

TEST_CASE("after a wrong prediction the cache warm-up starts again at the real proxy",
          "[loop][warmup]") {
  // The surface holds the proxy, although the predicted position of the hand is deep behind it.
  GraphSpec spec = ballSpec(1.0);
  spec.modes[0].depth_voxels = 0.01;  // a proxy at this depth counts as inside
  const auto scene = makeScene(spec, {{"ball", ballField()}});
  Reader reader;
  ProxyState state;
  CacheWarmup warmup(state.limits());
  const auto tick = [&](double z) {
    const HandState hand{Vec3(0, 0, z)};
    const bool did = warmup.run(*scene, state, kDt);
    const StepReport report = hapticStep(*scene, reader, hand, state, kDt);
    warmup.look(hand, report);
    return did && (warmup.warmed().proxy - report.proxy).norm() < 1e-4;
  };
  for (int i = 0; i < 5; ++i) tick(0.035);
  for (const double z : {0.0335, 0.0305}) tick(z);
  // The hand slows down, but the prediction moves on by 3 mm, deep into the ball.
  CHECK_FALSE(tick(0.0288));
  for (int i = 0; i < 3; ++i) tick(0.0288);
  CHECK(tick(0.0288));
  CHECK(state.primitives().size() == 1);
}

TEST_CASE("a cache warm-up does not call a user-defined mode", "[loop][warmup]") {
  GraphSpec spec;
  spec.modes.resize(1);
  spec.modes[0].kind = ModeKind::kUser;
  const auto calls = std::make_shared<int>(0);
  spec.modes[0].user = {
      [](void* state, const ModeInput& input, PrimitiveSet& set) noexcept {
        ++*static_cast<int*>(state);
        return set.tryAdd({PrimitiveKind::kPoint, input.proxy, Vec3::UnitX(), 0.5});
      },
      calls,
      {"ball"}};
  TestDevice device;
  HapticLoop loop(device, 1.0 / kDt);
  loop.prepareWarmup();
  loop.publish(makeScene(spec, {{"ball", ballField()}}));
  TickTime time;
  for (int i = 0; i < 10; ++i) loop.tick(time);
  const int before = *calls;
  CHECK(before > 0);
  CHECK_FALSE(loop.warmUp(kDt, kLead));
  CHECK(*calls == before);
}

TEST_CASE("a cache warm-up is skipped without a scene or enough time or after a force cut",
          "[loop][warmup]") {
  TestDevice device;
  device.hand.position = {0, 0, 0.04};
  HapticLoop loop(device, 1.0 / kDt);
  loop.prepareWarmup();
  CHECK_FALSE(loop.warmUp(kDt, kLead));  // there is no scene yet
  loop.publish(ballScene(ballField()));
  TickTime time;
  loop.tick(time);
  CHECK_FALSE(loop.warmUp(kDt, kLead));  // two positions are needed to predict the hand
  loop.tick(time);
  CHECK(loop.warmUp(kDt, kLead));
  // A tick takes more than a quarter of this time, so the warm-up is skipped.
  CHECK_FALSE(loop.warmUp(kDt, 1e-12));
  loop.cut();
  loop.tick(time);
  CHECK_FALSE(loop.warmUp(kDt, kLead));
  loop.clear();
  loop.tick(time);
  loop.tick(time);
  CHECK(loop.warmUp(kDt, kLead));
}

}  // namespace palpate::cache_warmup_test
