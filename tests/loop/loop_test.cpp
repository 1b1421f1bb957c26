/// Tests the forces that the loop sends, for any input, in virtual time.
#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/engine/loop/haptic_loop.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "tests/support/counters.h"
#include "tests/support/random.h"
#include "tests/support/scenes.h"

namespace palpate::loop_test {
using palpate::test::ballField;
using palpate::test::ballScene;
using palpate::test::Random;
using palpate::test::TestDevice;

namespace {

constexpr double kDt = 1e-3;

/// A loop whose clock the test sets.
struct Rig {
  TestDevice device;
  HapticLoop loop;
  TickTime time;

  std::atomic<std::uint64_t> guard{0};
  std::atomic<bool> punctual{true};
  bool guarded = true;

  explicit Rig(double heartbeat = 0.0)
      : loop(device, 1.0 / kDt, nullptr, heartbeat,
             {nullptr, nullptr, &guard, nullptr, &punctual}) {}

  const Telemetry& tick(double late = 0.0) {
    time.dt = kDt + late;
    time.now += time.dt;
    time.setLate(late, kDt);
    if (guarded) ++guard;
    loop.tick(time);
    return loop.latest();
  }
  const Telemetry& run(double seconds) {
    for (int i = 1; i < static_cast<int>(std::lround(seconds / kDt)); ++i) tick();
    return tick();
  }
  /// Moves the hand to `to` [m] at about 0.5 m/s, then keeps it there for `seconds`.
  const Telemetry& go(const Vec3& to, double seconds) {
    const Vec3 from = device.hand.position;
    const int n = std::max(1, static_cast<int>((to - from).norm() / (0.5 * kDt)));
    for (int i = 1; i <= n; ++i) {
      device.hand.position = from + (to - from) * (static_cast<double>(i) / n);
      tick();
    }
    return run(seconds);
  }
};

const Vec3 kOut(0, 0, 0.04);
const Vec3 kPressed(0, 0, 0.027);

/// A ball whose data can become unavailable, like a volume on a server.
class Fetched final : public ScalarField {
 public:
  explicit Fetched(std::shared_ptr<const ScalarField> of)
      : ScalarField(of->frame()), of_(std::move(of)) {}
  void reset(FieldCache& cache) const noexcept override { of_->reset(cache); }
  [[nodiscard]] ScalarSample sample(const Vec3& p, FieldCache& cache) const noexcept override {
    return of_->sample(p, cache);
  }
  bool attend(const Attention& at, FieldCache& /*cache*/) const noexcept override {
    told = at.probe;
    return false;
  }
  [[nodiscard]] bool attends() const noexcept override { return true; }
  [[nodiscard]] bool lost() const noexcept override { return gone; }
  bool gone = false;
  mutable Vec3 told = Vec3::Zero();

 private:
  std::shared_ptr<const ScalarField> of_;
};

}  // namespace

TEST_CASE("a hand gets no force without a scene or inside a solid that a new scene puts around it",
          "[loop]") {
  Rig rig;
  rig.device.hand.position = kPressed;
  CHECK(rig.run(0.2).report.force == Vec3::Zero());
  CHECK(rig.device.writes == 200);
  const FieldPtr ball = ballField();
  // The ball appears around the hand. The hand rests inside and leaves without a force.
  rig.loop.publish(ballScene(ball));
  CHECK(rig.run(2.0).report.force.norm() < 1e-6);
  CHECK(rig.go(kOut, 0.1).report.force == Vec3::Zero());
  CHECK(rig.go(kPressed, 0.1).report.force.z() == Approx(1.5).margin(0.01));
  CHECK(rig.device.sent == rig.loop.latest().report.force);
}

TEST_CASE(
    "a new scene's force engages over half a second, and after an edit it grows by at most the "
    "peak in 50 ms",
    "[loop][safety]") {
  const FieldPtr ball = ballField();
  {
    Rig rig;
    rig.device.hand.position = kOut;
    rig.loop.publish(ballScene(ball));
    rig.run(1.0);
    const double before = rig.go(kPressed, 0.2).report.force.norm();
    CHECK(before == Approx(1.5).margin(0.01));
    rig.loop.publish(ballScene(ballField(), 2.0));
    double last = rig.tick().report.force.norm();
    CHECK(last < 1e-12);
    double most = 0.0;
    int ticks = 0;
    while (last < 1.49 && ++ticks < 3000) {
      const double force = rig.tick().report.force.norm();
      most = std::max(most, force - last);
      last = force;
    }
    // The hand presses from the start, so the engagement waits for the whole kEngageWait.
    CHECK(kDt * ticks == Approx(kEngageWait + kEngage).margin(0.02));
    CHECK(most < 1.1 * 1.5 * kDt / kEngage + 1e-9);
  }
  // After an edit the force stays on, and grows by at most the peak in kEngageEdit.
  const auto stiff = [&](double k) {
    GraphSpec spec;
    spec.modes.resize(1);
    spec.modes[0].kind = ModeKind::kIsosurface;
    spec.modes[0].of = "ball";
    spec.modes[0].solid = Solid::kBelow;
    spec.modes[0].strength = 6.0;
    CouplingParams coupling;
    coupling.stiffness = k;
    return makeScene(spec, {{"ball", ball}}, coupling);
  };
  Rig rig;
  rig.device.hand.position = kOut;
  rig.loop.publish(stiff(500.0));
  rig.run(1.0);
  rig.go(kPressed, 0.2);
  double last = rig.device.sent.norm();
  REQUIRE(last == Approx(1.5).margin(0.01));
  const double pace = rig.device.about.limits.peak / kEngageEdit * kDt;
  rig.loop.publish(stiff(1000.0));
  for (int i = 0; i < 60; ++i) {
    const double force = rig.tick().report.force.norm();
    REQUIRE(force > last - 1e-6);
    REQUIRE(force < last + pace * (1.0 + 1e-9));
    last = force;
    // A second edit comes before the first edit has taken full effect.
    if (i == 48) rig.loop.publish(stiff(1900.0));
  }
  CHECK(rig.run(0.1).report.force.norm() == Approx(5.7).margin(0.05));
  // A slider changes the scene in every tick. The force must not oscillate.
  double least = 1e9;
  double most = 0.0;
  for (int i = 0; i < 500; ++i) {
    rig.loop.publish(stiff(1900.0 + 0.001 * (i % 2)));
    const double force = rig.tick().report.force.norm();
    least = std::min(least, force);
    most = std::max(most, force);
  }
  CHECK(most - least < 1e-3);
}

TEST_CASE("a fault cuts the force and stays latched until it is cleared", "[loop][safety][fault]") {
  const FieldPtr ball = ballField();
  const auto expect = [&](Fault cause, const auto& cause_it, const auto& mend,
                          double heartbeat = 0.0) {
    CAPTURE(wordFor(cause));
    Rig rig(heartbeat);
    rig.device.hand.position = kOut;
    rig.loop.publish(ballScene(ball));
    rig.loop.beat();
    for (int i = 0; i < 800; ++i) {
      rig.loop.beat();
      rig.tick();
    }
    rig.device.hand.position = kOut;
    for (int i = 0; i < 100; ++i) {
      rig.loop.beat();
      rig.device.hand.position.z() -= (kOut.z() - kPressed.z()) / 100.0;
      rig.tick();
    }
    REQUIRE(rig.device.sent.norm() > 1.0);
    cause_it(rig);
    CHECK(rig.device.sent == Vec3::Zero());
    CHECK(rig.loop.latest().fault == cause);
    CHECK(rig.loop.latest().report.status == StepStatus::kFault);
    // The fault stays latched after its cause has ended.
    mend(rig);
    for (int i = 0; i < 500; ++i) {
      rig.loop.beat();
      rig.tick();
      REQUIRE(rig.device.sent == Vec3::Zero());
    }
    CHECK(rig.loop.latest().fault == cause);
    rig.loop.clear();
    rig.loop.beat();
    CHECK(rig.tick().report.force == Vec3::Zero());
    CHECK(rig.loop.latest().fault == Fault::kNone);
  };
  const auto nothing = [](Rig&) {};
  const auto report = [&](Fault fault) {
    expect(
        fault,
        [=](Rig& rig) {
          rig.device.hand.fault = fault;
          rig.tick();
        },
        [](Rig& rig) { rig.device.hand.fault = Fault::kNone; });
  };
  for (const Fault fault : {Fault::kWrite, Fault::kGone, Fault::kMiscounted, Fault::kTemperature,
                            Fault::kPower, Fault::kSwitch})
    report(fault);
  expect(
      Fault::kNotFinite,
      [](Rig& rig) {
        rig.device.hand.position.y() = NAN;
        rig.tick();
      },
      [](Rig& rig) { rig.device.hand.position = kPressed; });
  expect(
      Fault::kJump,
      [](Rig& rig) {
        rig.device.hand.position.x() += 0.01;
        rig.tick();
      },
      [](Rig& rig) { rig.device.hand.position = kPressed; });
  expect(
      Fault::kLate, [](Rig& rig) { rig.tick(0.0051); }, nothing);
  expect(
      Fault::kStale,
      [](Rig& rig) {
        rig.device.hand.age = 0.06;
        rig.tick();
      },
      [](Rig& rig) { rig.device.hand.age = 0.0; });
  expect(
      Fault::kStopped,
      [](Rig& rig) {
        rig.loop.cut();
        rig.tick();
      },
      nothing);
  expect(
      Fault::kHeartbeat, [](Rig& rig) { rig.run(0.11); }, nothing, 0.1);
  expect(
      Fault::kUnguarded,
      [](Rig& rig) {
        rig.guarded = false;
        rig.run(kUnguardedTime - 0.01);
        REQUIRE(rig.device.sent.norm() > 1.0);
        rig.run(0.02);
      },
      [](Rig& rig) { rig.guarded = true; });
  expect(
      Fault::kOverSpeed,
      [](Rig& rig) {
        // The hand moves too fast for longer than 50 ms, but its position does not jump.
        for (int i = 0; i < 80; ++i) {
          rig.device.hand.position.x() += 0.0035;
          rig.tick();
        }
      },
      [](Rig& rig) { rig.device.hand.position = kPressed; });
}

TEST_CASE("a lost volume cuts the force until it returns and the fault is cleared",
          "[loop][safety][fault]") {
  const auto ball = std::make_shared<Fetched>(std::get<0>(ballField()));
  Rig rig;
  rig.device.hand.position = kOut;
  rig.loop.publish(ballScene(std::shared_ptr<const ScalarField>(ball)));
  rig.run(1.0);
  CHECK(rig.go(kPressed, 0.2).report.force.norm() > 1.0);
  CHECK(ball->told == rig.device.hand.position);
  ball->gone = true;
  rig.tick();
  CHECK(rig.device.sent == Vec3::Zero());
  CHECK(rig.loop.latest().fault == Fault::kVolume);
  rig.loop.clear();
  rig.tick();
  CHECK(rig.loop.latest().fault == Fault::kVolume);
  ball->gone = false;
  rig.tick();
  CHECK(rig.loop.latest().fault == Fault::kVolume);
  rig.loop.clear();
  rig.tick();
  CHECK(rig.loop.latest().fault == Fault::kNone);
  CHECK(rig.device.sent == Vec3::Zero());
}

TEST_CASE("a force that was cut for lateness returns by itself at most three times a minute",
          "[loop][safety][fault]") {
  const FieldPtr ball = ballField();
  constexpr double kAfter = 2.0;  // [s]
  const auto pressed = [&](Rig& rig, double after) {
    if (after > 0.0) rig.loop.reengageAfter(after);
    rig.device.hand.position = kOut;
    rig.loop.publish(ballScene(ball));
    rig.run(1.0);
    REQUIRE(rig.go(kPressed, 0.2).report.force.norm() > 1.0);
  };
  const auto late = [](Rig& rig) { CHECK(rig.tick(0.01).fault == Fault::kLate); };
  {
    Rig rig;
    pressed(rig, kAfter);
    late(rig);
    CHECK(rig.run(1.5).fault == Fault::kLate);
    late(rig);  // this late tick restarts the waiting time
    CHECK(rig.run(1.9).fault == Fault::kLate);
    CHECK(rig.device.sent == Vec3::Zero());
    CHECK(rig.run(0.2).fault == Fault::kNone);
    // As after clear(), the proxy starts at the hand. The hand gets no force until it enters the
    // ball again.
    CHECK(rig.device.sent == Vec3::Zero());
    rig.go(kOut, 0.1);
    CHECK(rig.go(kPressed, 2.0).report.force.norm() > 1.0);
    // The loop allows three automatic returns per minute. These are the second and the third; the
    // fourth must wait.
    for (int i = 0; i < 2; ++i) {
      late(rig);
      CHECK(rig.run(kAfter + 0.1).fault == Fault::kNone);
    }
    late(rig);
    CHECK(rig.run(kAfter + 0.1).fault == Fault::kLate);
    CHECK(rig.run(Reengagement::kWithin).fault == Fault::kNone);
  }
  {
    Rig rig;  // by default, the force does not return by itself
    pressed(rig, 0.0);
    late(rig);
    CHECK(rig.run(10.0).fault == Fault::kLate);
  }
  {
    Rig rig;  // tests a cut after the whole program was stopped
    pressed(rig, kAfter);
    CHECK(rig.tick(0.6).fault == Fault::kLate);
    CHECK(rig.run(10.0).fault == Fault::kLate);
    rig.loop.clear();
    CHECK(rig.run(1.0).fault == Fault::kNone);
    late(rig);
    CHECK(rig.run(kAfter + 0.1).fault == Fault::kNone);
  }
  // After other faults the force does not return by itself. This also applies to faults that occur
  // while the force is off, and to faults whose cause has ended.
  const std::vector<std::function<void(Rig&)>> others{[](Rig& rig) { rig.loop.cut(); },
                                                      [](Rig& rig) {
                                                        rig.device.hand.fault = Fault::kTemperature;
                                                        rig.tick();
                                                        rig.device.hand.fault = Fault::kNone;
                                                      },
                                                      [](Rig& rig) {
                                                        rig.device.hand.position.x() += 0.02;
                                                        rig.tick();
                                                        rig.device.hand.position = kPressed;
                                                      },
                                                      [](Rig& rig) {
                                                        rig.guarded = false;
                                                        rig.run(kUnguardedTime + 0.01);
                                                        rig.guarded = true;
                                                      }};
  for (const auto& other : others) {
    for (const bool both : {true, false}) {
      Rig rig;
      pressed(rig, kAfter);
      if (both) late(rig);
      other(rig);
      CHECK(rig.run(kAfter + 3.0).fault != Fault::kNone);
      CHECK(rig.device.sent == Vec3::Zero());
      rig.loop.clear();
      CHECK(rig.run(kAfter).fault == Fault::kNone);
    }
  }
  // A cut by the guardian counts as lateness, too.
  TestDevice device;
  std::atomic<std::uint32_t> cuts{0};
  HapticLoop loop(device, 1000.0, nullptr, 0.0, {nullptr, nullptr, nullptr, &cuts});
  loop.reengageAfter(kAfter);
  TickTime time;
  const auto run = [&](double seconds) {
    for (int i = 0; i < static_cast<int>(seconds / kDt); ++i) {
      time.now += kDt;
      loop.tick(time);
    }
    return loop.latest().fault;
  };
  CHECK(run(0.1) == Fault::kNone);
  ++cuts;
  CHECK(run(1.9) == Fault::kLate);
  CHECK(run(0.2) == Fault::kNone);
  for (const double bad : {-1.0, 61.0, std::nan("")}) {
    CHECK_THROWS_AS(loop.reengageAfter(bad), DeviceError);
  }
}

TEST_CASE("clear() cancels only the cuts and stops that were ordered before it", "[loop][safety]") {
  TestDevice device;
  device.hand.position = kOut;
  std::atomic<std::uint64_t> heart{0};
  std::atomic<std::uint32_t> stops{0};
  std::atomic<std::uint32_t> cuts{0};
  HapticLoop loop(device, 1000.0, nullptr, 0.0, {&heart, &stops, nullptr, &cuts});
  TickTime time;
  const auto tick = [&] {
    time.now += kDt;
    loop.tick(time);
    return loop.latest().fault;
  };
  CHECK(tick() == Fault::kNone);
  // If the guardian had to set the force to zero, the loop was late, even if the loop's own clock
  // shows no delay.
  ++cuts;
  CHECK(tick() == Fault::kLate);
  loop.clear();
  CHECK(tick() == Fault::kNone);
  // A stop between clear() and the next tick must not be lost.
  loop.clear();
  ++stops;
  CHECK(tick() == Fault::kStopped);
  loop.clear();
  loop.cut();
  CHECK(tick() == Fault::kStopped);
  loop.clear();
  CHECK(tick() == Fault::kNone);
  // If a device fails after another fault, the guardian must still set the device's force to zero.
  loop.cut();
  (void)tick();
  device.hand.fault = Fault::kWrite;
  (void)tick();
  const std::uint64_t stood = heart;
  for (int i = 0; i < 10; ++i) (void)tick();
  CHECK(heart == stood);
  device.hand.fault = Fault::kNone;
  loop.clear();
  CHECK(tick() == Fault::kNone);
  CHECK(heart == stood + 1);
}

TEST_CASE("without a guardian process the force stays off after clear()", "[loop][safety]") {
  Rig rig;
  rig.device.hand.position = kOut;
  rig.loop.publish(ballScene(ballField()));
  rig.run(1.0);
  rig.guarded = false;
  rig.run(kUnguardedTime + 0.01);
  CHECK(rig.loop.latest().fault == Fault::kUnguarded);
  for (int i = 0; i < 1000; ++i) {
    if (rig.loop.latest().fault != Fault::kNone) rig.loop.clear();
    rig.device.hand.position = kOut + (kPressed - kOut) * std::min(1.0, i / 50.0);
    rig.tick();
    REQUIRE(rig.device.sent == Vec3::Zero());
  }
  rig.guarded = true;
  rig.loop.clear();
  rig.tick();
  CHECK(rig.loop.latest().fault == Fault::kNone);
}

TEST_CASE(
    "if a device takes fewer forces per second than the loop sends, the tank's delay includes the "
    "wait",
    "[loop]") {
  struct Sink final : public TickSink {
    void take(const Telemetry&, const ProxyState& state) noexcept override {
      arm = state.limits().tank.arm;
    }
    ArmDissipation arm;
  };
  TestDevice device;
  device.about.limits.tank.use = TankUse::kAct;
  ArmDissipation& known = device.about.limits.tank.arm;
  known.viscous = 0.5;
  known.delay = 2e-3;
  known.doubt = 0.5e-3;
  const auto at = [&](double takes, double rate) {
    device.about.output_rate = takes;
    Sink sink;
    HapticLoop loop(device, rate, &sink);
    loop.tick({});
    return sink.arm;
  };
  for (const double takes : {0.0, 1000.0, 2000.0}) {
    CHECK(at(takes, 1000.0).delay == 2e-3);
    CHECK(at(takes, 1000.0).doubt == 0.5e-3);
  }
  // At 800 forces per second, a force can wait up to 1.25 ms, and the tank assumes a delay of 0.25
  // to 3.75 ms. At 200 per second, a force can wait up to 5 ms, and the tank assumes 0 to 7.5 ms.
  CHECK(at(800.0, 1000.0).delay == Approx(2e-3));
  CHECK(at(800.0, 1000.0).doubt == Approx(1.75e-3));
  CHECK(at(200.0, 1000.0).delay == Approx(3.75e-3));
  CHECK(at(200.0, 1000.0).doubt == Approx(3.75e-3));
  // At 20 forces per second, more delayed forces can be pending than the tank can store.
  CHECK_THROWS_AS(at(20.0, 2000.0), DeviceError);
  for (const double bad : {-1.0, std::nan(""), static_cast<double>(INFINITY)}) {
    CHECK_THROWS_AS(at(bad, 1000.0), DeviceError);
  }
}

TEST_CASE("motors count as fully heated when the loop starts", "[loop][safety]") {
  TestDevice device;
  device.about.limits.continuous = 1.0;
  device.about.limits.heating = 2.0;
  device.hand.position = kOut;
  HapticLoop loop(device, 1000.0);
  loop.publish(ballScene(ballField(), 6.0));
  TickTime time;
  double heat = 1.0;
  double most = 0.0;
  for (int i = 0; i < 6000; ++i) {
    time.now += kDt;
    heat += -std::expm1(-kDt / 2.0) * (device.sent.squaredNorm() - heat);
    REQUIRE(heat <= 1.0 + 1e-9);
    // The hand presses as soon as the loop has engaged, leaves the ball, and presses again.
    const bool pressed = (i > 550 && i < 1500) || i > 4000;
    double& z = device.hand.position.z();
    z += std::clamp((pressed ? test::kBallRadius - 0.008 : kOut.z()) - z, -5e-4, 5e-4);
    loop.tick(time);
    REQUIRE(loop.latest().fault == Fault::kNone);
    most = std::max(most, device.sent.norm());
  }
  CHECK(most > 3.0);
}

TEST_CASE("invalid device limits are refused", "[loop][safety]") {
  for (const double bad : {0.0, -1.0, std::nan(""), static_cast<double>(INFINITY)}) {
    for (double WatchLimits::*limit :
         {&WatchLimits::stale, &WatchLimits::max_speed, &WatchLimits::late}) {
      TestDevice device;
      device.about.watch.*limit = bad;
      CHECK_THROWS_AS(HapticLoop(device, 1000.0), DeviceError);
    }
    for (double ForceLimits::*limit : {&ForceLimits::peak, &ForceLimits::slew}) {
      TestDevice device;
      device.about.limits.*limit = bad;
      CHECK_THROWS_AS(HapticLoop(device, 1000.0), DeviceError);
    }
    TestDevice device;
    device.about.limits.continuous = 2.0;
    device.about.limits.heating = bad;
    CHECK_THROWS_AS(HapticLoop(device, 1000.0), DeviceError);
    device.about.limits.continuous = bad;
    device.about.limits.heating = 1.0;
    if (bad != 0.0) CHECK_THROWS_AS(HapticLoop(device, 1000.0), DeviceError);
    device.about.limits.continuous = 0.0;
    if (bad != 0.0) CHECK_THROWS_AS(HapticLoop(device, 1000.0, nullptr, bad), DeviceError);
  }
}

TEST_CASE("ticks that are late by less than the limit are counted and keep their force",
          "[loop][safety]") {
  Rig rig;
  rig.device.hand.position = kOut;
  rig.loop.publish(ballScene(ballField()));
  rig.run(1.0);
  rig.go(kPressed, 0.1);
  for (int i = 0; i < 50; ++i) rig.tick(0.004);
  CHECK(rig.loop.latest().fault == Fault::kNone);
  CHECK(rig.loop.latest().late_ticks == 50);
  // A tick counts as late from one period on.
  rig.tick(0.9 * kDt);
  CHECK(rig.loop.latest().late_ticks == 50);
  rig.tick(kDt);
  CHECK(rig.loop.latest().late_ticks == 51);
  CHECK(rig.device.sent.norm() == Approx(1.5).margin(0.01));
}

TEST_CASE(
    "an open dead-man switch cuts the force, and a closed one restores it after the engagement",
    "[loop][safety]") {
  Rig rig;
  rig.device.hand.position = kOut;
  rig.loop.publish(ballScene(ballField()));
  rig.run(1.0);
  CHECK(rig.go(kPressed, 0.1).report.force.norm() > 1.0);
  rig.device.hand.ready = false;
  CHECK(rig.tick().report.force == Vec3::Zero());
  CHECK(rig.run(1.0).report.force == Vec3::Zero());
  CHECK(rig.loop.latest().fault == Fault::kNone);
  rig.device.hand.ready = true;
  CHECK(rig.tick().report.force == Vec3::Zero());
  CHECK(rig.run(0.9).report.force == Vec3::Zero());
  CHECK(rig.run(0.7).report.force.norm() == Approx(1.5).margin(0.01));
}

TEST_CASE("a blocked write is a fault, and stops the heartbeat for the guardian",
          "[loop][safety]") {
  TestDevice device;
  device.hand.position = kOut;
  std::atomic<std::uint64_t> heart{0};
  std::atomic<std::uint32_t> stops{0};
  HapticLoop loop(device, 1000.0, nullptr, 0.0, {&heart, &stops});
  TickTime time;
  const auto tick = [&] {
    time.now += kDt;
    loop.tick(time);
  };
  for (int i = 0; i < 10; ++i) tick();
  CHECK(heart == 10);
  time.real = true;
  device.write_ms = 25;
  tick();
  time.real = false;
  device.write_ms = 0;
  tick();
  CHECK(loop.latest().fault == Fault::kWrite);
  CHECK(heart == 10);  // the heartbeat has stopped, so the guardian sends zero
  // A stop by the guardian is latched like other faults, and one clear() ends it.
  loop.clear();
  tick();
  CHECK(loop.latest().fault == Fault::kNone);
  ++stops;
  tick();
  CHECK(loop.latest().fault == Fault::kStopped);
  loop.clear();
  tick();
  CHECK(loop.latest().fault == Fault::kNone);
}

TEST_CASE("a tick that lasts too long ends with zero force and a late fault", "[loop][safety]") {
  struct Hanging final : public ScalarField {
    std::shared_ptr<const ScalarField> ball = std::get<0>(ballField());
    std::atomic<bool>* hang;
    explicit Hanging(std::atomic<bool>* h)
        : ScalarField(std::get<0>(ballField())->frame()), hang(h) {}
    void reset(FieldCache& cache) const noexcept override { ball->reset(cache); }
    [[nodiscard]] ScalarSample sample(const Vec3& p, FieldCache& cache) const noexcept override {
      if (hang->load()) std::this_thread::sleep_for(std::chrono::milliseconds(8));
      return ball->sample(p, cache);
    }
  };
  std::atomic<bool> hang{false};
  Rig rig;
  rig.device.hand.position = kOut;
  rig.loop.publish(ballScene(FieldPtr(std::make_shared<const Hanging>(&hang))));
  rig.run(1.0);
  rig.go(kPressed, 0.1);
  REQUIRE(rig.device.sent.norm() > 1.0);
  hang = true;
  rig.time.real = true;
  rig.tick();
  rig.time.real = false;
  CHECK(rig.device.sent == Vec3::Zero());
  hang = false;
  rig.tick();
  CHECK(rig.device.sent == Vec3::Zero());
  CHECK(rig.loop.latest().fault == Fault::kLate);
}

TEST_CASE("a position jump or the homing of an arm puts no energy into the tank",
          "[loop][safety]") {
  // The position changes at once for one of three reasons: the arm is homed, its position jumps, or
  // the arm returns at another position.
  for (const int how : {0, 1, 2}) {
    CAPTURE(how);
    Rig rig;
    rig.device.about.limits.tank.use = TankUse::kAct;
    rig.device.about.limits.tank.arm = {0.5, 0.02, 1e-5, 1e-3, 0.0, 0.0, 0.0};
    HapticLoop loop(rig.device, 1.0 / kDt, nullptr, 0.0, {nullptr, nullptr, &rig.guard});
    loop.publish(ballScene(ballField()));
    const auto run = [&](int ticks) {
      for (int i = 0; i < ticks; ++i) {
        rig.time.now += kDt;
        ++rig.guard;
        loop.tick(rig.time);
      }
    };
    rig.device.hand.position = Vec3(0, 0, 0.2);
    run(100);
    CHECK(loop.latest().report.energy == 0.0);
    if (how == 0) rig.device.hand.ready = false;
    if (how == 2) rig.device.hand.fault = Fault::kGone;
    run(1);
    rig.device.hand.position = Vec3(0, 0.2, 0);
    run(5);
    CHECK(loop.latest().report.energy == 0.0);
    rig.device.hand.ready = true;
    rig.device.hand.fault = Fault::kNone;
    loop.clear();
    run(100);
    CHECK(loop.latest().report.energy == 0.0);
    // Real motion of the hand puts in energy.
    for (int i = 0; i < 100; ++i) {
      rig.device.hand.position.z() += 5e-4;
      run(1);
    }
    CHECK(loop.latest().report.energy > 1e-3);
  }
}

TEST_CASE("a dead-man switch that closes between two position readings releases no energy",
          "[loop][safety]") {
  // An arm that reports 125 positions per second moves at 2 m/s. The hand moved a part of the path
  // between two positions before the switch closed.
  constexpr double kViscous = 0.5;
  constexpr int kEvery = 8;
  TestDevice device;
  device.about.limits.tank.use = TankUse::kAct;
  device.about.limits.tank.arm = {kViscous, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
  HapticLoop loop(device, 1.0 / kDt);
  GraphSpec spec;
  spec.modes.resize(1);
  spec.modes[0].kind = ModeKind::kForce;
  spec.modes[0].of = "ball";
  spec.modes[0].strength = 3.0;
  loop.publish(makeScene(spec, {{"ball", ballField()}}, {}));
  Vec3 hand(0, 0.2, 0);
  TickTime time;
  time.dt = kDt;
  double energy = 0.0;
  double least = 0.0;
  int tick = 0;
  const auto go = [&](int ticks, auto speed) {
    for (int end = tick + ticks; tick < end; ++tick) {
      device.hand.age = kDt * (tick % kEvery);
      if (tick % kEvery == 0) device.hand.position = hand;
      time.now += kDt;
      loop.tick(time);
      const Vec3 v = speed(device.sent);
      hand += kDt * v;
      if (device.hand.ready) energy += kDt * (kViscous * v.squaredNorm() - device.sent.dot(v));
      least = std::min(least, energy);
    }
  };
  const auto sweep = [](const Vec3&) { return Vec3(2, 0, 0); };
  device.hand.ready = false;
  go(kEvery * 12 + kEvery - 1, sweep);
  device.hand.ready = true;
  go(2, sweep);
  CHECK(loop.latest().report.energy == 0.0);
  go(2000, [](const Vec3&) { return Vec3(Vec3::Zero()); });
  energy = least = 0.0;
  go(2000, [&](const Vec3& force) { return Vec3(force / (2.0 * kViscous)); });
  CHECK(loop.latest().fault == Fault::kNone);
  CHECK(least >= -1e-12);
}

namespace {

/// A scene with a force of 3 N everywhere, and an arm with viscous friction and an active tank.
/// Counts the energy that the hand puts in.
struct Windy {
  static constexpr double kViscous = 0.5;
  TestDevice device;
  std::unique_ptr<HapticLoop> loop;
  TickTime time;
  double x = 0.0;       ///< Position of the hand [m].
  double put_in = 0.0;  ///< Energy that the hand has put in [J].
  double least = 0.0;   ///< Smallest `put_in` so far [J].

  Windy() {
    TankParams& tank = device.about.limits.tank;
    tank.use = TankUse::kAct;
    tank.arm = {kViscous, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    time.dt = kDt;
    loop = std::make_unique<HapticLoop>(device, 1.0 / kDt);
    GraphSpec spec;
    spec.modes.resize(1);
    spec.modes[0].kind = ModeKind::kForce;
    spec.modes[0].of = "wind";
    spec.modes[0].strength = 3.0;
    const FieldFrame frame{1e-3, 1.0, {Vec3::Constant(-10.0), Vec3::Constant(10.0)}, 1};
    const FieldPtr wind = makeVectorField(frame, [](const Vec3&) {
      return VectorSample{Vec3::UnitX(), Mat3::Zero(), true};
    });
    loop->publish(makeScene(spec, {{"wind", wind}}, {}));
  }
  /// Runs a tick, then moves the hand at `speed` [m/s]. Without `speed`, the hand moves with the
  /// force at the speed that extracts the most energy.
  void tick(std::optional<double> speed) {
    time.now += kDt;
    loop->tick(time);
    const double force = device.sent.x();
    const double v = speed.value_or(force / (2.0 * kViscous));
    put_in += kDt * (kViscous * v * v - force * v);
    least = std::min(least, put_in);
    x += kDt * v;
  }
};

}  // namespace

TEST_CASE("homing an arm or clearing a fault puts no energy into the tank", "[loop][safety]") {
  // The positions before the arm is ready, or during the fault, are wrong by 10 cm. The hand rests.
  for (const bool homed : {true, false}) {
    for (const int not_ready : {1, 2, 15}) {
      CAPTURE(homed, not_ready);
      Windy arm;
      const auto read = [&](double elsewhere) {
        arm.device.hand.position = Vec3(arm.x, elsewhere, 0.0);
      };
      for (int i = 0; i < not_ready; ++i) {
        read(0.1);
        if (homed) arm.device.hand.ready = false;
        if (!homed) arm.device.hand.fault = Fault::kPower;
        arm.tick(0.0);
      }
      arm.device.hand.ready = true;
      arm.device.hand.fault = Fault::kNone;
      if (!homed) arm.loop->clear();
      for (int i = 0; i < 2000; ++i) {
        read(0.0);
        arm.tick(0.0);
      }
      CHECK(arm.loop->latest().fault == Fault::kNone);
      CHECK(arm.loop->latest().report.energy == 0.0);
      for (int i = 0; i < 1000; ++i) {
        read(0.0);
        arm.tick({});
      }
      CHECK(arm.least >= -1e-12);
    }
  }
}

TEST_CASE("while an arm is not ready its speed is watched but position jumps are allowed",
          "[loop][safety]") {
  Windy arm;
  arm.device.hand.ready = false;
  for (int i = 0; i < 10; ++i) {
    arm.device.hand.position = Vec3(0.0, i < 5 ? 0.0 : 0.1, 0.0);
    arm.tick(0.0);
  }
  CHECK(arm.loop->latest().fault == Fault::kNone);
  // The switch closes during a fast motion. The loop brakes the motion from the first tick.
  for (int i = 0; i < 30; ++i) {
    arm.device.hand.position.x() += 4.0 * kDt;
    arm.device.hand.ready = i >= 20;
    arm.tick(0.0);
    if (i >= 20) CHECK(arm.loop->latest().input.hand.too_fast);
  }
}

TEST_CASE("a repeated position that is older in each tick does not count as a new position",
          "[loop][safety]") {
  // The arm reports 125 positions per second. Its switch closes between two positions of a motion.
  Windy arm;
  constexpr int kEvery = 8;
  int tick = 0;
  const auto go = [&](int ticks, std::optional<double> speed) {
    for (int end = tick + ticks; tick < end; ++tick) {
      if (tick % kEvery == 0) arm.device.hand.position = Vec3(arm.x, 0.0, 0.0);
      arm.device.hand.age = kDt * (tick % kEvery);
      arm.tick(speed);
      CHECK(arm.loop->latest().report.fresh == (tick % kEvery == 0));
    }
  };
  arm.device.hand.ready = false;
  go(kEvery + kEvery - 1, 2.0);
  arm.device.hand.ready = true;
  go(1, 2.0);
  arm.put_in = arm.least = 0.0;
  go(2000, 0.0);
  go(1000, {});
  CHECK(arm.loop->latest().fault == Fault::kNone);
  CHECK(arm.least >= -1e-12);
}

TEST_CASE("ticks of 1.19 periods put the tank into no debt, ticks of 1.5 periods do",
          "[loop][safety]") {
  // The force may use all energy in the tank, and the hand extracts as much as it can.
  struct Debt final : TickSink {
    double debt = 0.0;
    void take(const Telemetry& /*tick*/, const ProxyState& state) noexcept override {
      debt = state.limiter().tank.debt();
    }
  };
  const auto owed = [](double longest) {
    constexpr double kViscous = 0.5;
    TestDevice device;
    device.about.limits.tank.use = TankUse::kAct;
    device.about.limits.tank.arm = {kViscous, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    Debt sink;
    HapticLoop loop(device, 1.0 / kDt, &sink);
    GraphSpec spec;
    spec.modes.resize(1);
    spec.modes[0].kind = ModeKind::kForce;
    spec.modes[0].of = "ball";
    spec.modes[0].strength = 1.0;
    loop.publish(makeScene(spec, {{"ball", ballField()}}, {}));
    device.hand.position = {0.05, 0, 0};
    TickTime time;
    for (int i = 0; i < 3000; ++i) {
      // Every second tick is long, and the mean period is kDt.
      time.dt = i % 2 == 0 ? longest : 2.0 * kDt - longest;
      time.now += time.dt;
      // The hand moves back and forth until the force has grown, then with the force.
      const Vec3 sweep(0, i / 50 % 2 == 0 ? 0.1 : -0.1, 0);
      device.hand.position += time.dt * (i < 2000 ? sweep : Vec3(device.sent / (2.0 * kViscous)));
      loop.tick(time);
    }
    CHECK(loop.latest().fault == Fault::kNone);
    return sink.debt;
  };
  CHECK(owed(kDt) == 0.0);
  CHECK(owed(1.19 * kDt) == 0.0);
  CHECK(owed(1.5 * kDt) > 0.0);
}

TEST_CASE("the energy tank counts only the share of the force that the motors gave",
          "[loop][safety]") {
  const auto pressed = [](double share) {
    TestDevice device;
    device.about.limits.tank.use = TankUse::kObserve;
    device.about.limits.tank.arm = {0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    device.share = share;
    device.hand.position = kOut;
    HapticLoop loop(device, 1.0 / kDt);
    loop.publish(ballScene(ballField()));
    TickTime time;
    const auto go = [&](const Vec3& to, int ticks) {
      const Vec3 from = device.hand.position;
      for (int i = 1; i <= ticks; ++i) {
        device.hand.position = from + (to - from) * (static_cast<double>(i) / ticks);
        time.dt = kDt;
        time.now += kDt;
        loop.tick(time);
      }
    };
    go(kOut, 1000);
    const Vec3 at = {0, 0, test::kBallRadius};
    go(at, 100);
    const double before = loop.latest().report.energy;
    go(kPressed, 500);
    return loop.latest().report.energy - before;
  };
  const double all = pressed(1.0);
  CHECK(all > 1e-4);
  CHECK(pressed(0.25) == Approx(0.25 * all).epsilon(0.1));
  CHECK(pressed(0.0) == Approx(0.0).margin(0.1 * all));
}

TEST_CASE("a scene that is withdrawn and published again starts with the proxy at the hand",
          "[loop]") {
  Rig rig;
  const auto scene = ballScene(ballField());
  rig.device.hand.position = kOut;
  rig.loop.publish(scene);
  rig.run(1.0);
  rig.go(kPressed, 0.1);
  rig.loop.publish(nullptr);
  rig.tick();
  rig.go({0, 0.04, 0}, 0.0);
  rig.loop.publish(scene);
  CHECK((rig.tick().report.proxy - rig.device.hand.position).norm() < 1e-9);
  CHECK(rig.run(2.0).report.force == Vec3::Zero());
}

TEST_CASE("a device that replays a path without a hand gets force without an engagement",
          "[loop]") {
  TestDevice device;
  device.about.hand = false;
  device.hand.position = kOut;
  HapticLoop loop(device, 1000.0);
  loop.publish(ballScene(ballField()));
  TickTime time;
  for (int i = 0; i <= 30; ++i) {
    device.hand.position = kOut + (kPressed - kOut) * (i / 30.0);
    time.now += kDt;
    loop.tick(time);
  }
  CHECK(device.sent.norm() > 0.5);
}

TEST_CASE("under random events the force is finite, bounded, slew-limited, and no tick allocates",
          "[loop][safety][fault]") {
  // The test publishes and withdraws scenes, moves the hand, makes ticks late, and causes and
  // clears faults, all at random. PALPATE_CASES sets the number of ticks.
  const long ticks = test::cases(1000000);
  Random random(8);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto fetched = std::make_shared<Fetched>(std::get<0>(ballField()));
  const FieldPtr ball = std::shared_ptr<const ScalarField>(fetched);
  const FieldPtr rubbish = FieldPtr(makeScalarField(
      FieldFrame{1e-3, 1.0, {Vec3::Constant(-0.05), Vec3::Constant(0.05)}}, [&](const Vec3& p) {
        // Some positions have invalid values, and the hand can pass through them.
        const double n = std::fmod(std::abs(1e5 * p.x()), 50.0);
        const double bad = n < 0.05 ? nan : n < 0.1 ? 1e308 : p.z();
        return ScalarSample{bad, {0, 0, 1}, true};
      }));
  const auto scene = [&]() -> std::shared_ptr<const Scene> {
    GraphSpec spec;
    const int count = 1 + random.integer(3);
    for (int i = 0; i < count; ++i) {
      ModeSpec mode;
      const std::array kinds{ModeKind::kIsosurface, ModeKind::kSurface, ModeKind::kForce,
                             ModeKind::kViscosity};
      mode.kind = kinds[static_cast<std::size_t>(random.integer(4))];
      mode.of = random.integer(6) == 0 ? "rubbish" : "ball";
      mode.strength = random.uniform(0.1, 30.0);
      mode.solid = Solid::kBelow;
      spec.modes.push_back(mode);
    }
    CouplingParams coupling;
    coupling.stiffness = random.logUniform(50.0, 5000.0);
    coupling.damping = random.integer(2) == 0 ? 0.0 : random.uniform(0.0, 5.0);
    return makeScene(spec,
                     {{"ball", random.integer(3) == 0 ? ballField() : ball}, {"rubbish", rubbish}},
                     coupling);
  };
  std::vector<std::shared_ptr<const Scene>> scenes;
  for (int i = 0; i < 200; ++i) scenes.push_back(scene());

  TestDevice device;
  device.about.limits.continuous = 6.0;
  device.about.limits.heating = 2.0;
  constexpr double kHeartbeat = 0.2;  // [s]
  std::atomic<std::uint64_t> guard{0};
  HapticLoop loop(device, 1000.0, nullptr, kHeartbeat, {nullptr, nullptr, &guard});
  const ForceLimits limits = device.about.limits;
  long silent = 0;     // number of further ticks without a heartbeat of the application
  long unguarded = 0;  // number of further ticks without a signal of the guardian
  long away = 0;       // number of further ticks without data of the fetched volume
  double ramp = 0.0;   // time since the last moment at which an engagement could start [s]
  TickTime time;
  Vec3 velocity = Vec3::Zero();
  Vec3 sent = Vec3::Zero();
  std::array<long, kFaults> faults{};
  std::array<long, kStepStatuses> statuses{};
  long allocations = 0;
  long felt = 0;
  double largest = 0.0;
  for (long i = 0; i < ticks; ++i) {
    const int event = random.integer(2000);
    device.hand.age = 0.0;
    device.hand.fault = Fault::kNone;
    double late = 0.0;
    bool lost = false;
    if (event < 4) {
      loop.publish(
          scenes[static_cast<std::size_t>(random.integer(static_cast<int>(scenes.size())))]);
    } else if (event == 4 && random.integer(4) == 0) {
      loop.publish(nullptr);
    } else if (event == 5) {
      device.hand.position = random.inCube(0.05);
      velocity.setZero();
    } else if (event == 6) {
      device.hand.age = random.uniform(0.0, 0.1);
    } else if (event == 7) {
      // Faults that devices report. Other events cause the remaining faults.
      const std::array reported{Fault::kWrite,       Fault::kGone,  Fault::kMiscounted,
                                Fault::kTemperature, Fault::kPower, Fault::kSwitch};
      device.hand.fault = reported[static_cast<std::size_t>(random.integer(6))];
    } else if (event == 8) {
      late = random.uniform(0.0, 0.01);
    } else if (event == 9) {
      device.hand.ready = !device.hand.ready;
    } else if (event == 10 && random.integer(5) == 0) {
      loop.cut();
    } else if (event == 11) {
      lost = true;
    } else if (event == 12 && random.integer(10) == 0) {
      silent = 300;
    } else if (event == 13 && random.integer(10) == 0) {
      unguarded = 300;
    } else if (event == 14 && random.integer(10) == 0) {
      away = 300;
    } else if (event < 32) {
      loop.clear();
      device.hand.ready = true;
    }
    if (silent-- <= 0) loop.beat();
    if (unguarded-- <= 0) ++guard;
    fetched->gone = away-- > 0;
    // The hand moves back and forth through all volumes, sometimes much too fast.
    velocity += kDt * (random.integer(3000) == 0 ? 4000.0 : 40.0) * random.inCube(1.0) -
                kDt * 60.0 * device.hand.position;
    velocity *= 0.999;
    if (random.integer(5000) == 0) velocity = 3.3 * random.direction();
    device.hand.position += kDt * velocity;
    const Vec3 keep = device.hand.position;
    if (lost) device.hand.position[random.integer(3)] = random.integer(2) == 0 ? nan : 1e9;

    time.dt = kDt + late;
    time.now += time.dt;
    time.setLate(late, kDt);
    {
      const test::CountScope scope;
      loop.tick(time);
      allocations += test::CountScope::counts().allocations;
    }
    device.hand.position = keep;

    const Vec3& force = device.sent;
    const double size = force.norm();
    if (!force.allFinite() || !(size <= limits.peak)) {
      FAIL("tick " << i
                   << ": the force [N] is not finite or above the peak: " << force.transpose());
    }
    if (size > sent.norm() + limits.slew * time.dt * (1.0 + 1e-9) + 1e-12) {
      FAIL("tick " << i << ": the force [N] grew faster than the slew limit, from " << sent.norm()
                   << " to " << size);
    }
    const Telemetry& told = loop.latest();
    if (told.fault != Fault::kNone && size != 0.0) FAIL("force after a fault, tick " << i);
    if (told.scene == 0 && size != 0.0) FAIL("force without a scene, tick " << i);
    if (!device.hand.ready && size != 0.0) FAIL("force with an open dead-man switch, tick " << i);
    // Sums the durations, because after hours the rounding of time.now would exceed the tolerance.
    ramp += time.dt;
    if (told.fault != Fault::kNone || told.scene == 0 || !device.hand.ready) ramp = 0.0;
    if (size > limits.peak * ramp / kEngage * (1.0 + 1e-9)) {
      FAIL("tick " << i << ": " << size << " N " << ramp << " s after a cut");
    }
    sent = force;
    largest = std::max(largest, size);
    felt += size > 0.0 ? 1 : 0;
    ++faults[static_cast<std::size_t>(told.fault)];
    ++statuses[static_cast<std::size_t>(told.report.status)];
    REQUIRE(told.tick == i + 1);
  }
  CHECK(allocations == 0);
  long sum = 0;
  for (const long n : statuses) sum += n;
  CHECK(sum == ticks);
  if (ticks >= 1000000) {
    CHECK(felt > ticks / 20);
    CHECK(largest > 0.8 * limits.peak);
    for (std::size_t f = 0; f < kFaults; ++f) {
      CAPTURE(wordFor(static_cast<Fault>(f)));
      CHECK(faults[f] > 0);
    }
  }
  std::string told = "ticks " + std::to_string(ticks) + ", with force " + std::to_string(felt);
  for (std::size_t f = 1; f < kFaults; ++f) {
    told += std::string(", ") + wordFor(static_cast<Fault>(f)) + " " + std::to_string(faults[f]);
  }
  WARN(told);
}

}  // namespace palpate::loop_test
