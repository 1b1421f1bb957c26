/// Checks how a loop reacts to a faulty device: the fault, the time until the force is zero, and
/// that the fault stays until it is cleared. Prints the ticks of the table in docs/loop.md. Only
/// reads and writes that hang are measured with the real clock.
#include "palpate/devices/simulated/faulty_device.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/loop/haptic_loop.h"
#include "tests/support/scenes.h"

namespace palpate::faulty_device_test {
using palpate::test::ballField;
using palpate::test::ballScene;
using palpate::test::ballSpec;

namespace {

constexpr double kRate = 1000.0;
constexpr double kBegin = 2.0;  // [s]
constexpr double kEnd = 3.5;
constexpr double kClear = 4.5;
constexpr double kSeconds = 7.0;

/// Returns a hand that presses on the ball until the injected trouble ends, and again before and
/// after the fault is cleared. In between the hand leaves the ball, because a surface does not hold
/// a proxy that starts inside its solid.
std::unique_ptr<Device> pressing() {
  ArmParams arm;
  arm.hand = true;
  const Vec3 out(0.0, 0.0, 0.045);
  const Vec3 in(0.0, 0.0, 0.018);
  std::vector<PathPoint> path{{0.0, out}, {0.2, out}, {1.2, in}, {kEnd, in}};
  for (const double again : {kEnd, kClear}) {
    path.push_back({again + 0.1, in});
    path.push_back({again + 0.4, out});
    path.push_back({again + 0.7, in});
  }
  path.push_back({kSeconds, in});
  return std::make_unique<SimulatedDevice>(arm, GripParams{}, alongPath(path), kRate);
}

/// Wraps the pressing hand and stores the force that the device receives.
struct Arrived final : Device {
  explicit Arrived(Vec3& force) : inner(pressing()), last(force) {}
  [[nodiscard]] const DeviceInfo& info() const noexcept override { return inner->info(); }
  [[nodiscard]] HandState read() noexcept override { return inner->read(); }
  void write(const Vec3& force) noexcept override {
    last = force;
    inner->write(force);
  }
  std::unique_ptr<Device> inner;
  Vec3& last;
};

/// Runs the ticks of a hand that presses on a ball. `within` becomes false if the loop's force
/// exceeds the device's limits.
class Pressed {
 public:
  explicit Pressed(std::unique_ptr<Device> device)
      : device_(std::move(device)), loop_(*device_, kRate) {
    loop_.publish(ballScene(field_));
  }
  void tick(double late = 0.0, bool real = false) {
    TickTime time;
    time.dt = 1.0 / kRate + late;
    time.now = now_ += time.dt;
    time.late = late;
    time.real = real;
    loop_.tick(time);
    const Vec3 before = force;
    told = loop_.latest();
    force = told.report.force;
    const ForceLimits& limits = device_->info().limits;
    const double grown = force.norm() - before.norm();
    within = within && force.allFinite() && force.norm() <= limits.peak * (1.0 + 1e-12) &&
             grown <= limits.slew * std::max(0.0, time.dt) + 1e-9;
  }
  [[nodiscard]] HapticLoop& loop() { return loop_; }
  [[nodiscard]] const FieldPtr& field() const { return field_; }

  Telemetry told;
  Vec3 force = Vec3::Zero();
  bool within = true;

 private:
  FieldPtr field_ = ballField();
  std::unique_ptr<Device> device_;
  HapticLoop loop_;
  double now_ = 0.0;
};

struct Expected {
  Trouble trouble;
  Fault fault;  ///< kNone: no fault is expected.
  double zero;  ///< Time from the start of the trouble to zero force [s]; infinity: the force stays
                ///< on.
  const char* why;  ///< Name of the limit that applies.
};
constexpr double kNever = std::numeric_limits<double>::infinity();
constexpr double kTick = 1.0 / kRate;

const std::vector<Expected> kExpected{
    {Trouble::kLate, Fault::kStale, 0.05 + kTick, "WatchLimits::stale"},
    {Trouble::kEarly, Fault::kNone, kNever, "none: a negative age is not stale"},
    {Trouble::kRepeated, Fault::kNone, kNever, "none: the position changes every 4 ticks"},
    {Trouble::kFrozen, Fault::kNone, 1.0 + kTick, "StillFade"},
    {Trouble::kJumping, Fault::kJump, 0.0, "5 m/s"},
    {Trouble::kNotFinite, Fault::kNotFinite, 0.0, "at once"},
    {Trouble::kRunaway, Fault::kOverSpeed, 0.07, "braked, 50 ms"},
    {Trouble::kUnwritten, Fault::kWrite, kTick, "first error"},
    {Trouble::kBlocked, Fault::kWrite, kTick, "20 ms"},
    {Trouble::kHung, Fault::kLate, 0.0, "5 ms"},
    {Trouble::kGone, Fault::kGone, 0.0, "at once"},
    {Trouble::kHot, Fault::kTemperature, 0.0, "at once"},
    {Trouble::kUnpowered, Fault::kPower, 0.0, "at once"},
    {Trouble::kSwitch, Fault::kSwitch, 0.0, "at once"},
    {Trouble::kReleased, Fault::kNone, 0.0, "at once"},
};

}  // namespace

TEST_CASE("each simulated trouble of a device causes its fault, or none, within its time limit",
          "[fault]") {
  REQUIRE(kExpected.size() == kTroubles);
  std::printf("trouble    cause        zero after ticks by\n");
  for (const Expected& expected : kExpected) {
    CAPTURE(wordFor(expected.trouble));
    CHECK(troubleOf(wordFor(expected.trouble)) == expected.trouble);
    Vec3 arrived = Vec3::Zero();
    // Reads and writes that hang take real time, so such a trouble lasts only ten ticks.
    const double end = needsClock(expected.trouble) ? kBegin + 0.01 : kEnd;
    Pressed pressed(std::make_unique<FaultyDevice>(std::make_unique<Arrived>(arrived),
                                                   expected.trouble, kRate, kBegin, end));
    // If the device no longer receives writes, only the guardian can set the force to zero, through
    // its own descriptor.
    const bool lost = expected.trouble == Trouble::kUnwritten || expected.trouble == Trouble::kGone;
    const auto ticks = [](double seconds) { return std::lround(seconds * kRate); };
    double before = 0.0;
    Fault fault = Fault::kNone;
    // Time from the start of the trouble to the last tick with a force [s].
    double latest = -1.0;
    double back = 0.0;
    for (long i = 0; i < ticks(kSeconds); ++i) {
      if (i == ticks(kClear)) pressed.loop().clear();
      const double t = static_cast<double>(i) / kRate;
      // Only troubles that need the real clock use it: on a busy machine other ticks would be late
      // too.
      pressed.tick(0.0, needsClock(expected.trouble) && t >= kBegin && t < end);
      const double force = pressed.force.norm();
      if (i == ticks(kBegin) - 1) before = force;
      if (t >= kBegin && t < end) {
        if (fault == Fault::kNone) fault = pressed.told.fault;
        if (force > 0.0) latest = t - kBegin;
        if (lost) REQUIRE(arrived.norm() == Approx(before));
        if (!lost) REQUIRE(arrived.norm() == force);
      }
      // The fault stays latched after its cause has ended.
      if (expected.fault != Fault::kNone && t >= end && t < kClear) {
        REQUIRE(force == 0.0);
        REQUIRE(pressed.told.fault == expected.fault);
      }
      if (i == ticks(kSeconds) - 1) back = force;
    }
    const double zero = latest < 0.0 ? 0.0 : latest + kTick;
    CHECK(pressed.within);
    CHECK(before > 1.0);
    CHECK(fault == expected.fault);
    CHECK(back > 1.0);
    if (std::isfinite(expected.zero)) {
      CHECK(zero <= expected.zero + 1e-9);
      std::printf("%-10s %-12s %-16.0f %s\n", wordFor(expected.trouble), wordFor(fault),
                  kRate * zero, expected.why);
    } else {
      CHECK(zero >= kEnd - kBegin - 1e-9);
      std::printf("%-10s %-12s %-16s %s\n", wordFor(expected.trouble), wordFor(fault), "stays",
                  expected.why);
    }
  }
}

TEST_CASE("a simulated trouble is refused for a real arm", "[fault]") {
  struct Real final : Device {
    DeviceInfo about;
    [[nodiscard]] const DeviceInfo& info() const noexcept override { return about; }
    [[nodiscard]] HandState read() noexcept override { return {}; }
    void write(const Vec3& /*force*/) noexcept override {}
    [[nodiscard]] ZeroForce zeroForce() const noexcept override { return {1, {}, 1}; }
  };
  CHECK_THROWS_WITH(FaultyDevice(std::make_unique<Real>(), Trouble::kFrozen, kRate, kBegin),
                    Catch::Contains("cannot be applied to a real arm"));
}

TEST_CASE("a jump of the clock cuts the force or increases the force by at most 0.2 N", "[fault]") {
  for (const double leap : {0.0051, 0.1, 3600.0, -0.0005, -0.01, -3600.0}) {
    CAPTURE(leap);
    Pressed pressed(pressing());
    for (int i = 0; i < 2000; ++i) pressed.tick();
    REQUIRE(pressed.force.norm() > 1.0);
    const double before = pressed.force.norm();
    // A clock that jumps forward makes a tick late. A backward jump gives a negative duration,
    // which does not count as late.
    pressed.tick(leap);
    CHECK(pressed.told.fault == (leap > 0.0 ? Fault::kLate : Fault::kNone));
    if (leap > 0.0) CHECK(pressed.force.norm() == 0.0);
    for (int i = 0; i < 500; ++i) {
      pressed.tick();
      if (leap < 0.0) REQUIRE(pressed.force.norm() < before + 0.2);
    }
    CHECK(pressed.within);
  }
}

TEST_CASE("publishing a scene in every tick causes no force jump", "[fault]") {
  Pressed pressed(pressing());
  for (int i = 0; i < 2000; ++i) pressed.tick();
  const double before = pressed.force.norm();
  REQUIRE(before > 1.0);
  double least = before;
  double most = before;
  // Every tick gets another scene: first with changed numbers, then with changed volumes. After a
  // change of volumes the force grows from zero.
  for (int i = 0; i < 2000; ++i) {
    const bool edit = i < 1400;
    pressed.loop().publish(ballScene(edit ? pressed.field() : ballField(), 3.0 + 0.1 * (i % 5)));
    pressed.tick();
    CHECK(pressed.told.fault == Fault::kNone);
    if (!edit) continue;
    least = std::min(least, pressed.force.norm());
    most = std::max(most, pressed.force.norm());
  }
  CHECK(pressed.within);
  CHECK(least > 0.9 * before);
  CHECK(most < 1.1 * before);
  // If every scene has a new volume, the engagement restarts each time: the force stays below 0.1
  // N.
  CHECK(pressed.force.norm() < 0.1);
  for (int i = 0; i < 2000; ++i) pressed.tick();
  // Once the scene stays the same, the full force returns.
  CHECK(std::abs(pressed.force.norm() - before) < 0.1 * before);
}

}  // namespace palpate::faulty_device_test
