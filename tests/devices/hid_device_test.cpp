/// Tests a HID arm on a simulated device: its positions, forces, loss and return.
#include "palpate/devices/hid/hid_device.h"

#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <deque>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/devices/arm/pace.h"
#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/error.h"
#include "palpate/engine/loop/haptic_loop.h"
#include "palpate/engine/loop/haptic_thread.h"
#include "tests/support/counters.h"
#include "tests/support/random.h"
#include "tests/support/scenes.h"
#include "tests/support/thinned.h"

namespace palpate::hid_device_test {
using namespace std::chrono_literals;
using Catch::Contains;

namespace {

constexpr std::size_t kRing = 63;

/// A simulated device. A ring holds up to kRing unread reports and drops newer ones. A list holds
/// the reports that the host sent successfully.
class FakeArm {
 public:
  void give(const std::vector<std::byte>& report) {
    const std::lock_guard lock(mutex_);
    if (ring_.size() < kRing) ring_.push_back(report);
  }
  /// Adds a report with three signed counts and a state.
  void giveCounts(int a, int b, int c, int state = 1) {
    std::vector<std::byte> report(8);
    int k = 0;
    for (const int v : {a, b, c, state}) {
      report[static_cast<std::size_t>(k++)] = static_cast<std::byte>(v & 255);
      report[static_cast<std::size_t>(k++)] = static_cast<std::byte>(v >> 8 & 255);
    }
    give(report);
  }
  /// Returns the number of writes that succeeded.
  [[nodiscard]] long written() const { return written_; }
  std::vector<std::vector<std::byte>> sent() {
    const std::lock_guard lock(mutex_);
    return sent_;
  }
  /// Returns the values of the three motors in the last report [counts]; zeros before the first.
  std::array<int, 3> driven() {
    const std::lock_guard lock(mutex_);
    std::array<int, 3> out{};
    if (sent_.empty()) return out;
    for (std::size_t i = 0; i < 3; ++i) {
      out[i] = static_cast<std::int16_t>(static_cast<unsigned>(sent_.back()[1 + 2 * i]) |
                                         static_cast<unsigned>(sent_.back()[2 + 2 * i]) << 8U);
    }
    return out;
  }

  std::atomic<bool> there{true};
  std::atomic<bool> holds{false};    ///< Writes block while this is true.
  std::atomic<bool> holding{false};  ///< A write is blocked.
  std::atomic<int> fails{0};         ///< Number of further writes that fail.
  std::atomic<bool> answers{false};  ///< Each successful write adds a report.
  /// Counts and state of a report that every second read adds; empty: none.
  std::vector<int> again;

 private:
  friend class FakePort;
  std::mutex mutex_;
  std::deque<std::vector<std::byte>> ring_;
  std::vector<std::vector<std::byte>> sent_;
  std::atomic<long> written_{0};
};

/// Blocks the writes of an arm until letGo() or the destructor. Declare it after the device, so
/// that its destructor unblocks the device's writer before the device's destructor waits for that
/// writer.
class Held {
 public:
  explicit Held(FakeArm& arm) : arm_(arm) { arm_.holds = true; }
  ~Held() { letGo(); }
  Held(const Held&) = delete;
  Held& operator=(const Held&) = delete;
  void letGo() { arm_.holds = false; }

 private:
  FakeArm& arm_;
};

class FakePort final : public ReportPort {
 public:
  explicit FakePort(FakeArm& arm) : arm_(arm) {}
  [[nodiscard]] ReadStatus read(std::span<std::byte> to, std::size_t& size) noexcept override {
    if (!arm_.there) return ReadStatus::kGone;
    if (!arm_.again.empty() && (asked_ = !asked_)) {
      arm_.giveCounts(arm_.again[0], arm_.again[1], arm_.again[2], arm_.again[3]);
    }
    const std::lock_guard lock(arm_.mutex_);
    if (arm_.ring_.empty()) return ReadStatus::kNothing;
    const auto& report = arm_.ring_.front();
    size = std::min(report.size(), to.size());
    std::copy_n(report.begin(), size, to.begin());
    arm_.ring_.pop_front();
    return ReadStatus::kReport;
  }
  [[nodiscard]] bool write(std::span<const std::byte> report) noexcept override {
    while (arm_.holds) {
      arm_.holding = true;
      std::this_thread::sleep_for(1ms);
    }
    arm_.holding = false;
    if (!arm_.there || (arm_.fails > 0 && arm_.fails-- > 0)) return false;
    {
      const std::lock_guard lock(arm_.mutex_);
      arm_.sent_.emplace_back(report.begin(), report.end());
    }
    ++arm_.written_;
    if (arm_.answers) arm_.giveCounts(0, 0, 0);
    return true;
  }
  [[nodiscard]] bool sendFeature(std::span<const std::byte> report) noexcept override {
    return write(report);
  }

 private:
  FakeArm& arm_;
  bool asked_ = false;  ///< True in every second read, which adds FakeArm::again.
};

ReportField counts(const char* name, std::uint32_t bit) {
  ReportField field;
  field.name = name;
  field.bit = bit;
  field.least = -32768;
  field.most = 32767;
  return field;
}

/// Returns a profile with three sliding joints of 10 um per count and three motors of 1 mN per
/// count.
HidProfile slides() {
  HidProfile profile;
  profile.name = "slides";
  HidReportSpec input;
  input.size = 8;
  HidReportSpec output;
  output.size = 8;
  for (std::size_t i = 0; i < 3; ++i) {
    const std::array names{"a", "b", "c"};
    ReportField in = counts(names[i], static_cast<std::uint32_t>(16 * i));
    in.scale = 1e-5;
    in.wraps = true;
    input.fields.push_back(in);
    ReportField out = counts(names[i], static_cast<std::uint32_t>(16 * i));
    out.scale = 1000.0;
    out.least = -4000;
    out.most = 4000;
    output.fields.push_back(out);
    HidJoint joint;
    joint.from = {0, i};
    joint.to = i;
    profile.joints.push_back(joint);
  }
  input.fields.push_back(counts("state", 48));
  output.fields.push_back(counts("command", 48));
  profile.input = {input};
  profile.output = output;
  profile.kinematics = makeCartesian();
  profile.limits = {5.0, 2000.0, 1000.0, 5.0, 0.1, 0.05, 3.0, 0.0, 0.0};
  return profile;
}

/// Returns slides() with unsigned counters of 12 bits, which cover 4.1 cm of a workspace of 20 cm.
HidProfile narrowSlides() {
  HidProfile profile = slides();
  for (ReportField& field : profile.input[0].fields) {
    field.bits = 12;
    field.type = ReportField::Type::kUnsigned;
  }
  return profile;
}

/// Returns a step of a home sequence of slides() that waits until the state has the value `equals`.
HidStep waitForState(double equals, double seconds, const char* words = "") {
  HidStep wait;
  wait.kind = HidStep::Kind::kWait;
  wait.field = {0, 3};
  wait.equals = equals;
  wait.seconds = seconds;
  wait.words = words;
  return wait;
}

/// The clock from which the age of reports is computed. Only the test advances it, so the machine's
/// speed does not change an age.
std::atomic<std::int64_t> virtual_now{1000000000};
std::int64_t virtualNow() noexcept {
  return virtual_now;
}
void pass(double seconds) {
  virtual_now += std::llround(1e9 * seconds);
}
HidHost inVirtualTime(HidHost host = {}) {
  host.now = virtualNow;
  return host;
}

std::unique_ptr<HidDevice> open(FakeArm& arm, HidProfile profile = slides(), bool tested = true,
                                HidHost host = {}) {
  arm.giveCounts(0, 0, 0);
  host = inVirtualTime(std::move(host));
  return std::make_unique<HidDevice>(std::move(profile), std::make_unique<FakePort>(arm), tested,
                                     std::move(host));
}

template <class What>
void await(What what) {
  const auto end = std::chrono::steady_clock::now() + 600s;
  while (!what()) {
    if (std::chrono::steady_clock::now() > end) FAIL("the awaited state did not come in 600 s");
    std::this_thread::sleep_for(1ms);
  }
}

/// Runs a tick in virtual time and waits until its force has been sent.
void tickOut(HapticLoop& loop, const HidDevice& device, TickTime& time) {
  const std::int64_t before = device.writes().count;
  pass(time.dt);
  time.now += time.dt;
  loop.tick(time);
  const auto end = std::chrono::steady_clock::now() + 600s;
  while (device.writes().count == before) {
    if (std::chrono::steady_clock::now() > end) FAIL("the force was not sent in 600 s");
    std::this_thread::yield();
  }
}
/// An output rate so high that pacing delays no force, even if virtual time is faster than real
/// time.
constexpr double kAtOnce = 1e9;  // [Hz]

}  // namespace

TEST_CASE("a HID arm reports buttons, orientation, gripper and joints to the application",
          "[hid]") {
  FakeArm arm;
  HidProfile profile = slides();
  profile.handle.buttons = {{"one", {0, 3}, 1.0}, {"two", {0, 3}, 2.0}};
  HidTurn yaw;
  yaw.joint = 0;
  HidTurn roll;
  roll.from = {0, 3};
  roll.axis = Vec3::UnitX();
  roll.ratio = 2.0;
  roll.home = 0.25;
  profile.handle.orientation = {yaw, roll};
  profile.handle.gripper = roll;
  // The mount turns the arm by a quarter turn about z.
  profile.world_from_device << 0, -1, 0, 1, 0, 0, 0, 0, 1;
  const auto device = open(arm, profile);
  const HandleInfo& info = device->info().handle;
  CHECK(info.buttons == std::vector<std::string>{"one", "two"});
  CHECK(info.orientation);
  CHECK(info.gripper);
  CHECK(info.joints == 3);
  arm.giveCounts(3000, 0, 0, 2);
  const HandState hand = device->read();
  CHECK(hand.handle.buttons == 2);
  CHECK(hand.handle.joints[0] == Approx(0.03));
  CHECK(hand.handle.gripper == Approx(2.0 / 2.0 + 0.25));
  // The mount and joint a turn the handle about z. Then the handle turns about its own x axis.
  const double half_z = 0.5 * (0.5 * std::acos(-1.0) + 0.03);
  const double half_x = 0.5 * 1.25;
  CHECK(hand.handle.orientation[0] == Approx(std::cos(half_z) * std::cos(half_x)));
  CHECK(hand.handle.orientation[1] == Approx(std::cos(half_z) * std::sin(half_x)));
  CHECK(hand.handle.orientation[2] == Approx(std::sin(half_z) * std::sin(half_x)));
  CHECK(hand.handle.orientation[3] == Approx(std::sin(half_z) * std::cos(half_x)));
  arm.giveCounts(3000, 0, 0, 1);
  CHECK(device->read().handle.buttons == 1);
}

TEST_CASE("a NaN in a HID report leaves the gripper and the orientation unchanged", "[hid]") {
  FakeArm arm;
  HidProfile profile = slides();
  // Field `odd` is a float whose upper half is the state.
  ReportField odd = profile.input[0].fields[3];
  odd.name = "odd";
  odd.type = ReportField::Type::kFloat;
  odd.bit = 32;
  odd.bits = 32;
  profile.input[0].fields.push_back(odd);
  HidTurn turn;
  turn.from = {0, 4};
  profile.handle.gripper = turn;
  profile.handle.orientation = {turn};
  const auto device = open(arm, profile);
  arm.giveCounts(0, 0, 0, 0x3F80);  // 1.0
  CHECK(device->read().handle.gripper == 1.0);
  arm.giveCounts(0, 0, 0, 0x7FC0);  // not a number
  const Handle handle = device->read().handle;
  CHECK(handle.gripper == 1.0);
  CHECK(handle.orientation[3] == Approx(std::sin(0.5)));
}

TEST_CASE("a HID arm reads positions and sends forces in the profile's units and frame", "[hid]") {
  FakeArm arm;
  HidProfile profile = slides();
  profile.origin_D = {0.01, 0, 0};
  profile.world_from_device << 0, -1, 0, 1, 0, 0, 0, 0, 1;  // the arm's x is W's y
  const auto device = open(arm, profile);
  arm.giveCounts(3000, -2000, 1000);
  const HandState hand = device->read();
  CHECK((hand.position - Vec3(0.02, 0.02, 0.01)).norm() < 1e-12);
  CHECK(hand.ready);
  CHECK(hand.fault == Fault::kNone);
  CHECK(hand.age == 0.0);
  device->write({1.0, 2.0, -3.0});
  await([&] { return arm.driven() == std::array<int, 3>{2000, -1000, -3000}; });
  // One count of each joint moves the tip by 10 um.
  for (std::size_t i = 0; i < 3; ++i) CHECK(device->resolution()[i] == Approx(1e-5));
}

TEST_CASE("forces that would overheat a motor are scaled down and keep their direction", "[hid]") {
  // Continuous limits: 1 N for motor 0, 0.5 N for motor 1. Each motor's peak is 4 N.
  HidProfile profile = slides();
  profile.output_rate = kAtOnce;
  const std::array<double, 2> holds{1.0, 0.5};
  const std::array<double, 2> heating{2.0, 5.0};
  for (std::size_t i = 0; i < 2; ++i) {
    profile.joints[i].continuous = holds[i];
    profile.joints[i].heating = heating[i];
  }
  FakeArm arm;
  const auto device = open(arm, profile);
  // Computes the windings' heat from the sent forces. Each force is held until the next one. The
  // motors start at the limit of their heat.
  std::array<double, 2> heat{holds[0] * holds[0], holds[1] * holds[1]};
  std::array<double, 2> hottest{};
  std::array<int, 3> driven{};
  double share = 1.0;
  const auto step = [&](const Vec3& force, double dt) {
    pass(dt);
    for (std::size_t i = 0; i < 2; ++i) {
      const double sent = 1e-3 * driven[i];
      heat[i] += -std::expm1(-dt / heating[i]) * (sent * sent - heat[i]);
      hottest[i] = std::max(hottest[i], heat[i] / (holds[i] * holds[i]));
    }
    const long before = arm.written();
    device->write(force);
    while (arm.written() == before) std::this_thread::yield();
    driven = arm.driven();
    share = device->given();
    for (int a = 0; a < 3; ++a) {
      REQUIRE(std::abs(driven[static_cast<std::size_t>(a)] - 1e3 * share * force[a]) < 1.0 + 1e-6);
    }
  };

  // A hot motor gives at most its continuous force. A rest of 20 s cools the motor.
  step({2.5, 0.0, 2.0}, 0.0);
  CHECK(2.5 * share == Approx(1.0));
  step({0.4, 0.2, 0.0}, 1e-3);
  for (int i = 0; i < 40; ++i) step(Vec3::Zero(), 0.5);
  CHECK(heat[0] < 1e-3);

  // Under a constant load the force stays full at first, then falls gradually to the continuous
  // force.
  double last = 1.0;
  double steepest = 0.0;
  for (int i = 0; i < 12000; ++i) {
    step({2.5, 0.0, 2.0}, 1e-3);
    steepest = std::max(steepest, last - share);
    REQUIRE(share <= last + 1e-12);
    last = share;
    if (i == 150) REQUIRE(share == 1.0);
  }
  CHECK(steepest < 0.02);  // a constant 2.5 N would heat motor 0 to 6.25 times its limit
  CHECK(2.5 * share == Approx(1.0).epsilon(1e-3));
  CHECK(hottest[0] <= 1.0);
  CHECK(hottest[0] > 0.99);
  CHECK(device->writes().weakened > 0);

  // If the hot motor has no load, the other motors' force returns gradually.
  double quickest = 0.0;
  for (int i = 0; i < 600; ++i) {
    step({0.0, 0.1, 2.0}, 1e-3);
    quickest = std::max(quickest, share - last);
    last = share;
  }
  CHECK(share == 1.0);
  CHECK(quickest <= 1e-3 / kEngage + 1e-12);

  // Random forces, each held for a random time.
  test::Random random(11);
  const long cases = test::cases(20000);
  for (long i = 0; i < cases; ++i) {
    const double strength = random.integer(3) == 0 ? 1.0 : 5.0;
    step(strength * random.direction(), random.uniform(0.0, MotorHeat::kHold));
  }
  CHECK(hottest[0] <= 1.0);
  CHECK(hottest[1] <= 1.0);
  // The device sends zero instead of a NaN force.
  device->write({NAN, 0.0, 0.0});
  CHECK(device->given() == 0.0);
}

TEST_CASE("a HID arm uses the newest report and discards all reports if their ring overflows",
          "[hid]") {
  FakeArm arm;
  const auto device = open(arm);
  (void)device->read();
  for (int i = 1; i <= 40; ++i) arm.giveCounts(10 * i, 0, 0);
  CHECK(device->read().position.x() == Approx(0.004));
  CHECK(device->reads().passed_by >= 39);
  // Without a new report, the position stays the same and its age grows.
  pass(0.02);
  const HandState again = device->read();
  CHECK(again.position.x() == Approx(0.004));
  CHECK(again.age == Approx(0.02));
  // 300 reports arrive during a pause. The ring holds only the first 63, so all are outdated and
  // none is used.
  for (int i = 0; i < 300; ++i) arm.giveCounts(5 * i, 0, 0);
  const HandState stalled = device->read();
  CHECK(stalled.position.x() == Approx(0.004));
  CHECK(stalled.age == Approx(0.02));
  CHECK(stalled.ready);
  CHECK(device->reads().dropped == kRing);
  arm.giveCounts(1500, 0, 0);
  const HandState fresh = device->read();
  CHECK(fresh.position.x() == Approx(0.015));
  CHECK(fresh.age == 0.0);
  // After a pause longer than the largest age of a position, the arm is not ready until its next
  // report. If no report comes, the age counts from the read after the pause.
  pass(0.06);
  for (int i = 0; i < 100; ++i) arm.giveCounts(9 * i, 0, 0);
  const HandState back = device->read();
  CHECK_FALSE(back.ready);
  CHECK(back.position.x() == Approx(0.015));
  arm.giveCounts(1600, 0, 0);
  CHECK(device->read().ready);
  CHECK(device->read().position.x() == Approx(0.016));
  pass(0.06);
  CHECK(device->read().age == 0.0);
  pass(0.04);
  CHECK(device->read().age == Approx(0.04));
}

TEST_CASE("encoder counters that wrap around are unwrapped", "[hid]") {
  FakeArm arm;
  const auto device = open(arm);
  long count = 0;
  for (int i = 0; i < 400; ++i) {
    count += 997;
    arm.giveCounts(static_cast<std::int16_t>(count), static_cast<std::int16_t>(-count), 0);
    const HandState hand = device->read();
    REQUIRE(hand.position.x() == Approx(1e-5 * static_cast<double>(count)));
    REQUIRE(hand.position.y() == Approx(-1e-5 * static_cast<double>(count)));
  }
  CHECK(count > 5 * 65536);
}

TEST_CASE("HID reports that are too short are counted and ignored", "[hid]") {
  FakeArm arm;
  const auto device = open(arm);
  arm.giveCounts(100, 0, 0);
  (void)device->read();
  arm.give({});
  arm.give({std::byte{1}, std::byte{2}, std::byte{3}});
  CHECK(device->read().position.x() == Approx(1e-3));
  CHECK(device->reads().strange == 2);
  // A longer report is accepted. Only the profile's fields are read.
  arm.give(std::vector<std::byte>(4096, std::byte{0}));
  CHECK(device->read().position.x() == 0.0);
}

TEST_CASE("HID reports of different kinds are distinguished by their numbers", "[hid]") {
  FakeArm arm;
  HidProfile profile = slides();
  profile.input[0].id = 7;
  HidReportSpec buttons;
  buttons.id = 9;
  buttons.size = 1;
  ReportField flag = counts("hot", 0);
  flag.bits = 1;
  flag.type = ReportField::Type::kUnsigned;
  buttons.fields.push_back(flag);
  profile.input.push_back(buttons);
  profile.flags.push_back({{1, 0}, 1.0, HidFlag::Means::kHot});
  arm.give({std::byte{7}, std::byte{100}, std::byte{0}, std::byte{0}, std::byte{0}, std::byte{0},
            std::byte{0}, std::byte{0}, std::byte{0}});
  HidDevice device(profile, std::make_unique<FakePort>(arm), true, inVirtualTime());
  CHECK(device.read().position.x() == Approx(1e-3));
  arm.give({std::byte{9}, std::byte{1}});
  CHECK(device.read().fault == Fault::kTemperature);
  arm.give({std::byte{8}, std::byte{0}});
  CHECK(device.read().fault == Fault::kTemperature);
  // A report of the arm's state has no position, so the age of the position grows.
  pass(0.03);
  arm.give({std::byte{9}, std::byte{1}});
  CHECK(device.read().age == Approx(0.03));
  arm.give({std::byte{9}, std::byte{0}});
  const HandState hand = device.read();
  CHECK(hand.fault == Fault::kNone);
  CHECK(hand.position.x() == Approx(1e-3));
}

TEST_CASE("flags in a HID report set the arm's ready state and its faults", "[hid]") {
  FakeArm arm;
  HidProfile profile = slides();
  profile.flags = {{{0, 3}, 1.0, HidFlag::Means::kEnabled},
                   {{0, 3}, 2.0, HidFlag::Means::kUnpowered},
                   {{0, 3}, 3.0, HidFlag::Means::kOpen}};
  const auto device = open(arm, profile);
  const auto with = [&](int state) {
    arm.giveCounts(0, 0, 0, state);
    return device->read();
  };
  CHECK(with(1).ready);
  CHECK_FALSE(with(0).ready);
  CHECK(with(0).fault == Fault::kNone);
  CHECK(with(2).fault == Fault::kPower);
  CHECK(with(3).fault == Fault::kSwitch);
}

TEST_CASE("a force above a motor's limit is scaled down and keeps its direction", "[hid]") {
  FakeArm arm;
  const auto device = open(arm);
  device->write({2.0, -8.0, 1.0});  // 8 N, for a motor that gives at most 4 N
  await([&] { return arm.driven() == std::array<int, 3>{1000, -4000, 500}; });
  CHECK(device->writes().weakened == 1);
  CHECK(device->given() == Approx(0.5));
  // Forces are rounded towards zero counts.
  device->write({0.0019, -0.0019, 0.0});
  await([&] { return arm.driven() == std::array<int, 3>{1, -1, 0}; });
  CHECK(device->given() == 1.0);
  device->write({std::nan(""), 0, 1e300});
  await([&] { return arm.driven() == std::array<int, 3>{0, 0, 0}; });
  CHECK(device->given() == 0.0);
}

TEST_CASE("an arm whose joints do not fit its geometry is not ready and gets zero force", "[hid]") {
  FakeArm arm;
  HidProfile profile = slides();
  for (ReportField& field : profile.input[0].fields) field.scale = 1e-3;
  profile.kinematics = makeDelta(0.08, 0.03, 0.06, 0.1);
  const auto device = open(arm, profile);
  arm.giveCounts(900, 900, 900);
  CHECK(device->read().ready);
  device->write({0, 0, 1.0});
  await([&] { return arm.driven()[0] != 0; });
  arm.giveCounts(0, 0, 0);
  CHECK_FALSE(device->read().ready);
  device->write({0, 0, 1.0});
  await([&] { return arm.driven() == std::array<int, 3>{0, 0, 0}; });
}

TEST_CASE("an arm gets no force along a direction without a motor", "[hid]") {
  HidHost host;
  host.measured.viscous = 0.5;
  host.measured.coulomb = 0.5;
  const FieldPtr ball = test::ballField();
  for (const bool planar : {true, false}) {
    CAPTURE(planar);
    HidProfile profile = slides();
    if (planar) {
      profile.joints.resize(2);
      profile.kinematics = makePantograph({0.08, 0.1, 0.1, 0.08}, 0.05);
      profile.joints[0].home = M_PI / 2 - 0.3;
      profile.joints[1].home = M_PI / 2 + 0.3;
      profile.origin_D = profile.kinematics->at({M_PI / 2 - 0.3, M_PI / 2 + 0.3}).position_D;
    } else {
      profile.joints[2].to.reset();
    }
    profile.output_rate = kAtOnce;
    FakeArm arm;
    const auto device = open(arm, profile, true, host);
    arm.giveCounts(0, 0, 0);
    const HandState hand = device->read();
    CHECK((hand.drives - Vec3(1, 1, 0).asDiagonal().toDenseMatrix()).norm() < 1e-9);
    // The self-test measures no friction along a joint without a motor, so that arm gets no tank.
    CHECK((device->info().limits.tank.use != TankUse::kOff) == planar);
    device->write({1, 0, 0});
    await([&] { return arm.driven()[0] != 0; });
    const auto without = arm.driven();
    device->write({1, 0, 7});
    device->write({1, 0, 4});
    await([&] { return device->writes().count >= 2 && arm.driven() == without; });
    CHECK(device->given() == 1.0);
    // The loop limits the force to the axes that have motors. The hand presses into the ball beside
    // its pole, so a part of the force is along x.
    struct Held final : public Device {
      HidDevice& inner;
      DeviceInfo about;
      double at = 0.0;
      explicit Held(HidDevice& d) : inner(d), about(d.info()) { about.watch.late = 1e3; }
      [[nodiscard]] const DeviceInfo& info() const noexcept override { return about; }
      [[nodiscard]] HandState read() noexcept override {
        HandState hand = inner.read();
        hand.position = {0.005, 0, at};
        return hand;
      }
      void write(const Vec3& force) noexcept override { inner.write(force); }
    } held(*device);
    HapticLoop loop(held, 1000.0);
    loop.publish(test::ballScene(ball));
    TickTime time;
    time.dt = 1e-3;
    double along = 0.0;
    for (int i = 0; i < 2000; ++i) {
      arm.giveCounts(i % 2, 0, 0);
      held.at = std::max(test::kBallRadius + 0.01 - 1e-5 * i, test::kBallRadius - 0.004);
      tickOut(loop, *device, time);
      REQUIRE(loop.latest().fault == Fault::kNone);
      const Vec3 force = loop.latest().report.force;
      REQUIRE(force.z() == Approx(0.0).margin(1e-12));
      along = std::max(along, force.x());
    }
    CHECK(along > 0.05);
  }
}

TEST_CASE("a HID arm sends one report per force, and ticks continue while a write is blocked",
          "[hid]") {
  FakeArm arm;
  const auto device = open(arm);
  const std::size_t before = arm.sent().size();
  for (int i = 1; i <= 50; ++i) {
    device->write({0.01 * i, 0, 0});
    await([&] { return device->writes().count == i; });
  }
  CHECK(arm.sent().size() == before + 50);
  // A write blocks. The ticks continue, and the newest force is sent afterwards.
  Held held(arm);
  device->write({0, 0, 0.5});
  await([&] { return arm.holding.load(); });
  for (int i = 0; i < 200; ++i) device->write({0, 0.01 * i, 0});
  CHECK(arm.sent().size() == before + 50);
  held.letGo();
  await([&] { return arm.driven()[1] == 1990; });
  CHECK(arm.sent().size() == before + 52);
}

TEST_CASE("a HID arm keeps its limited output rate and sends the newest force last", "[hid]") {
  HidProfile profile = slides();
  profile.output_rate = 100.0;
  FakeArm arm;
  const auto device = open(arm, profile);
  CHECK(device->info().output_rate == 100.0);
  const auto began = std::chrono::steady_clock::now();
  for (int i = 1; i <= 500; ++i) {
    device->write({0.001 * i, 0, 0});
    std::this_thread::sleep_for(200us);
  }
  await([&] { return arm.driven()[0] == 500; });
  const std::chrono::duration<double> took = std::chrono::steady_clock::now() - began;
  CHECK(static_cast<double>(device->writes().count) <= 100.0 * took.count() + 2.0);
  // A zero force is sent without waiting for its time, also when the device is closed.
  profile.output_rate = 0.01;
  {
    FakeArm cut;
    const auto one = open(cut, profile);
    one->write({1, 0, 0});
    await([&] { return cut.driven()[0] == 1000; });
    const auto told = std::chrono::steady_clock::now();
    one->write(Vec3::Zero());
    await([&] { return cut.driven()[0] == 0; });
    CHECK(std::chrono::steady_clock::now() - told < 30s);
  }
  FakeArm slow;
  auto slower = open(slow, profile);
  slower->write({1, 0, 0});
  slower->write({2, 0, 0});
  const auto ends = std::chrono::steady_clock::now();
  slower.reset();
  CHECK(std::chrono::steady_clock::now() - ends < 30s);
  CHECK(slow.driven() == std::array<int, 3>{0, 0, 0});
}

TEST_CASE("a HID write that takes longer than 20 ms and one output period is a fault", "[hid]") {
  FakeArm arm;
  const auto device = open(arm);
  Held held(arm);
  device->write({1, 0, 0});
  await([&] { return arm.holding.load(); });
  pass(0.021);  // 20 ms and one period
  CHECK(device->read().fault == Fault::kNone);
  pass(0.001);
  CHECK(device->read().fault == Fault::kWrite);
  held.letGo();
  await([&] { return device->read().fault == Fault::kNone; });
}

TEST_CASE("a force that stays unsent for longer than 20 ms and one output period is a fault",
          "[hid][safety]") {
  // The writer waits 1000 s of real time before it sends a second force, so this force stays unsent
  // while virtual time passes.
  HidProfile profile = slides();
  profile.output_rate = 1e-3;
  FakeArm arm;
  const auto device = open(arm, profile);
  device->write({1, 0, 0});
  await([&] { return device->writes().count == 1; });
  const auto readFor = [&](double seconds) {
    HandState hand;
    for (int i = 0; i < std::lround(seconds / 0.04); ++i) {
      pass(0.04);
      arm.giveCounts(0, 0, 0);
      hand = device->read();
    }
    return hand;
  };
  CHECK(readFor(2000.0).fault == Fault::kNone);
  device->write({2, 0, 0});
  CHECK(readFor(1000.0).fault == Fault::kNone);
  CHECK(readFor(0.04).fault == Fault::kWrite);
  // After a pause between reads, the program cannot know whether a write was blocked.
  pass(0.1);
  CHECK(device->read().fault == Fault::kNone);
}

TEST_CASE("pacing delays a force at most as long as the energy tank assumes", "[hid][passivity]") {
  // Random ticks, each late by up to one period, some of them skipped. A writer sends the newest
  // force when Pace permits it. A replaced force counts as sent when the newer one is sent.
  test::Random random(7);
  const long cases = test::cases(2000);
  for (long i = 0; i < cases; ++i) {
    const double takes = random.logUniform(100.0, 5000.0);
    const double rate = i % 2 == 0 ? takes : takes * random.logUniform(0.2, 5.0);
    CAPTURE(takes, rate);
    const auto when = [&](double slot, double late) {
      return std::llround(1e9 * (slot + late) / rate);
    };
    const double typical = random.logUniform(0.01, 1.0);
    std::vector<std::int64_t> asked;
    for (int k = 0; k < 300; ++k) {
      if (random.integer(50) == 0) continue;
      const double late = typical * (random.integer(20) == 0 ? 0.99 : 0.1 * random.uniform(0, 1));
      asked.push_back(when(k, late));
    }
    Pace pace(takes, 0);  // the writer starts before the loop
    std::int64_t longest = 0;
    long gone = 0;
    for (std::size_t k = 0; k < asked.size(); ++gone) {
      const std::int64_t goes = std::max(asked[k], pace.from());
      longest = std::max(longest, goes - asked[k]);
      pace.go(goes);
      while (k < asked.size() && asked[k] <= goes) ++k;
    }
    // The pacing period that HapticLoop passes to the tank.
    const std::int64_t told = takes < rate ? std::llround(1e9 / takes) : 0;
    REQUIRE(longest <= told);
    const double seconds = 1e-9 * static_cast<double>(asked.back() - asked.front() + longest);
    REQUIRE(static_cast<double>(gone) <= seconds * takes * (1.0 + 1e-5) + 2.0);
  }
}

TEST_CASE("an arm that was unplugged gives positions and takes forces after it is plugged in again",
          "[hid]") {
  FakeArm arm;
  std::atomic<int> looked{0};
  const auto find = [&]() -> std::unique_ptr<ReportPort> {
    ++looked;
    if (!arm.there) return nullptr;
    arm.giveCounts(7, 0, 0);
    return std::make_unique<FakePort>(arm);
  };
  const auto device = open(arm, slides(), true, {{}, find});
  arm.giveCounts(30000, 0, 0);
  CHECK(device->read().position.x() == Approx(0.3));
  const std::uint32_t version = device->zeroForce().version;
  arm.there = false;
  CHECK(device->read().fault == Fault::kGone);
  device->write({1, 0, 0});
  await([&] { return looked > 1; });
  CHECK(device->read().fault == Fault::kGone);
  arm.there = true;
  await([&] { return device->read().fault == Fault::kNone; });
  CHECK(device->pluggings() == 2);
  CHECK(device->zeroForce().version != version);
  arm.giveCounts(20, 0, 0);
  const HandState hand = device->read();
  CHECK(hand.position.x() == Approx(2e-4));
  CHECK(hand.ready);
  device->write({0.5, 0, 0});
  await([&] { return arm.driven()[0] == 500; });
}

TEST_CASE("after a failed write the reads of a HID arm report it as gone", "[hid]") {
  FakeArm arm;
  const auto device = open(arm, slides(), true, {{}, [] { return std::unique_ptr<ReportPort>(); }});
  Held held(arm);
  device->write({1, 0, 0});
  await([&] { return arm.holding.load(); });
  arm.there = false;
  held.letGo();
  await([&] { return device->read().fault == Fault::kGone; });
}

TEST_CASE("an arm that takes its home from its pose at opening does not reconnect by itself",
          "[hid]") {
  FakeArm arm;
  HidProfile profile = slides();
  profile.home_at_open = true;
  profile.joints[2].home = 0.05;
  arm.giveCounts(1234, 50, -9);
  profile.input[0].fields[2].offset = 0.02;  // has no effect in the home pose
  const auto find = [&]() -> std::unique_ptr<ReportPort> {
    return std::make_unique<FakePort>(arm);
  };
  const auto device = open(arm, profile, true, {{}, find});
  // The last report before the opening sets the home pose.
  arm.giveCounts(0, 0, 0);
  CHECK((device->read().position - Vec3(0, 0, 0.05)).norm() < 1e-12);
  arm.giveCounts(100, 0, 0);
  CHECK((device->read().position - Vec3(1e-3, 0, 0.05)).norm() < 1e-12);
  arm.there = false;
  (void)device->read();
  arm.there = true;
  std::this_thread::sleep_for(150ms);
  CHECK(device->read().fault == Fault::kGone);
}

TEST_CASE("an output field without a motor has its rest value unless a command sets it", "[hid]") {
  HidProfile profile = slides();
  profile.output->fields[3].rest = 5.0;
  HidStep send;
  send.kind = HidStep::Kind::kSend;
  send.values = {{3, 1.0}};
  profile.open = {send};
  FakeArm arm;
  {
    const auto device = open(arm, profile);
    device->write({1.0, 0.0, 0.0});
    await([&] { return arm.driven() == std::array<int, 3>{1000, 0, 0}; });
    const ZeroForce zero = device->zeroForce();
    CHECK(zero.bytes[7] == std::byte{5});
  }
  int ones = 0;
  for (const auto& report : arm.sent()) {
    ones += report[7] == std::byte{1} ? 1 : 0;
    CHECK((report[7] == std::byte{1} || report[7] == std::byte{5}));
  }
  CHECK(ones == 1);
}

TEST_CASE("opening a HID arm fails if the arm does not reach the state that its profile waits for",
          "[hid]") {
  HidProfile profile = slides();
  HidStep send;
  send.kind = HidStep::Kind::kSend;
  send.values = {{3, 1.0}};
  const HidStep wait = waitForState(5, 0.2, "press the button");
  profile.home = {send, wait};
  {
    FakeArm arm;
    arm.giveCounts(0, 0, 0);
    CHECK_THROWS_WITH(HidDevice(profile, std::make_unique<FakePort>(arm), true),
                      Contains("it does not report state = 5") && Contains("press the button"));
    // The home sequence sent its command, and none of its reports drove a motor.
    bool commanded = false;
    for (const auto& report : arm.sent()) {
      commanded = commanded || report[7] == std::byte{1};
      for (std::size_t i = 1; i < 7; ++i) CHECK(report[i] == std::byte{0});
    }
    CHECK(commanded);
  }
  {
    // A button that was already pressed before the request does not count as an answer.
    FakeArm pressed;
    profile.home[1].seconds = 0.2;
    for (int i = 0; i < 3; ++i) pressed.giveCounts(0, 0, 0, 5);
    pressed.again = {0, 0, 0, 5};
    CHECK_THROWS_WITH(HidDevice(profile, std::make_unique<FakePort>(pressed), true),
                      Contains("it reported state = 5 from the start: release its button or switch "
                               "first; then press the button"));
    // Without a request to the user, the state may already be set at the start.
    profile.home[1].words.clear();
    CHECK_NOTHROW(HidDevice(profile, std::make_unique<FakePort>(pressed), true));
    profile.home[1].words = "press the button";
  }
  profile.home[1].seconds = 20.0;
  FakeArm arm;
  arm.giveCounts(0, 0, 0);
  std::thread button([&] {
    std::this_thread::sleep_for(50ms);
    arm.giveCounts(0, 0, 0, 5);
  });
  std::vector<std::string> said;
  const HidDevice device(profile, std::make_unique<FakePort>(arm), true,
                         {{[&](const std::string& words) { said.push_back(words); }}});
  button.join();
  CHECK(said == std::vector<std::string>{"arm slides: press the button"});
}

TEST_CASE("the closing steps of a HID arm run in order even after a failed opening", "[hid]") {
  HidProfile profile = slides();
  HidStep pause;
  pause.seconds = 0.15;
  HidStep send;
  send.kind = HidStep::Kind::kSend;
  send.values = {{3, 9.0}};
  profile.close = {pause, send};
  const auto closed = [](FakeArm& arm) { return arm.sent().back()[7] == std::byte{9}; };
  FakeArm arm;
  auto device = open(arm, profile);
  device->write({1, 0, 0});
  const auto start = std::chrono::steady_clock::now();
  device.reset();
  CHECK(std::chrono::steady_clock::now() - start >= 150ms);
  CHECK(closed(arm));
  CHECK(arm.driven() == std::array<int, 3>{0, 0, 0});

  const HidStep wait = waitForState(5, 60.0, "press the button");
  profile.home = {wait};
  FakeArm stopped;
  stopped.giveCounts(0, 0, 0);
  std::atomic<bool> stop{false};
  std::thread user([&] {
    std::this_thread::sleep_for(50ms);
    stop = true;
  });
  const auto began = std::chrono::steady_clock::now();
  CHECK_THROWS_AS(HidDevice(profile, std::make_unique<FakePort>(stopped), true,
                            {{nullptr, [&] { return stop.load(); }}}),
                  DeviceError);
  CHECK(std::chrono::steady_clock::now() - began < 30s);  // the profile allows 60 s
  user.join();
  CHECK(closed(stopped));
  // Opening stops with an error if the program is stopped before the first report.
  profile.home.clear();
  FakeArm silent;
  CHECK_THROWS_WITH(HidDevice(profile, std::make_unique<FakePort>(silent), true,
                              {{nullptr, [] { return true; }}}),
                    Contains("the program was stopped before the arm was ready"));
  CHECK(closed(silent));
}

TEST_CASE("a closing command is sent even if the wait before it times out", "[hid]") {
  HidProfile profile = slides();
  const HidStep wait = waitForState(7, 0.05);
  HidStep off;
  off.kind = HidStep::Kind::kSend;
  off.values = {{3, 9.0}};
  profile.close = {wait, off};
  FakeArm arm;
  open(arm, profile).reset();
  CHECK(arm.sent().back()[7] == std::byte{9});
}

TEST_CASE("closing a HID arm switches its amplifier off even if up to four writes fail",
          "[hid][safety]") {
  HidProfile profile = slides();
  HidStep off;
  off.kind = HidStep::Kind::kSend;
  off.values = {{3, 9.0}};
  profile.close = {off};
  for (const int fails : {1, 2, 3, 4}) {
    CAPTURE(fails);
    FakeArm arm;
    auto device = open(arm, profile);
    arm.fails = fails;
    device.reset();
    REQUIRE(arm.written() > 0);
    CHECK(arm.sent().back()[7] == std::byte{9});
  }
}

TEST_CASE("a report with a repeated sequence number is not a new position", "[hid]") {
  HidProfile profile = slides();
  profile.input[0].sequence = 3;
  FakeArm arm;
  const auto device = open(arm, profile);
  arm.giveCounts(100, 0, 0, 2);
  CHECK(device->read().age == 0.0);
  // The firmware hangs but keeps sending the same report.
  for (int i = 1; i <= 51; ++i) {
    pass(1e-3);
    arm.giveCounts(100, 0, 0, 2);
    const HandState hand = device->read();
    CHECK(hand.still == 0.0);
    CHECK(hand.age == Approx(1e-3 * i));
  }
  CHECK(device->reads().repeated == 51);
  CHECK(device->reads().strange == 0);
  arm.giveCounts(100, 0, 0, 3);
  CHECK(device->read().age == 0.0);
}

TEST_CASE("the state of a switch expires when its HID report stops arriving", "[hid]") {
  // Report 1 has the positions. Report 2 has the dead-man switch, whose state expires after 0.3 s.
  HidProfile profile = slides();
  profile.input[0].id = 1;
  HidReportSpec switches;
  switches.id = 2;
  switches.size = 2;
  switches.stale = 0.3;
  switches.fields.push_back(counts("held", 0));
  profile.input.push_back(switches);
  profile.output->id = 1;
  HidFlag held;
  held.field = {1, 0};
  held.means = HidFlag::Means::kEnabled;
  profile.flags.push_back(held);
  FakeArm arm;
  const auto giveSwitch = [&](int value) {
    arm.give({std::byte{2}, static_cast<std::byte>(value), std::byte{0}});
  };
  const auto givePlace = [&] { arm.give(std::vector<std::byte>(9, std::byte{1})); };
  givePlace();
  const HidHost host = inVirtualTime();
  HidDevice device(profile, std::make_unique<FakePort>(arm), true, host);
  // The arm is not ready, because the state of the switch is not yet known.
  givePlace();
  CHECK_FALSE(device.read().ready);
  CHECK_THAT(device.whyNotReady(), Contains("the report with held does not arrive"));
  giveSwitch(1);
  CHECK(device.read().ready);
  for (const double stops : {0.29, 0.31}) {
    for (double t = 0.0; t < stops; t += 0.01) {
      pass(0.01);
      givePlace();
      (void)device.read();
    }
    CHECK(device.read().fault == (stops < 0.3 ? Fault::kNone : Fault::kStale));
    giveSwitch(1);
    CHECK(device.read().fault == Fault::kNone);
  }
  giveSwitch(0);
  CHECK_FALSE(device.read().ready);
  giveSwitch(1);
  CHECK(device.read().ready);
  // After a pause between reads, the last state of the switch may be outdated.
  pass(0.06);
  givePlace();
  (void)device.read();
  givePlace();
  CHECK_FALSE(device.read().ready);
  CHECK_THAT(device.whyNotReady(), Contains("the report with held does not arrive"));
  giveSwitch(1);
  CHECK(device.read().ready);
}

TEST_CASE("the force of a HID arm fades while the arm keeps sending the same counts",
          "[hid][safety]") {
  // The firmware repeats its last counts, and the reports have no number that reveals the
  // repetition. To the loop this looks like a hand that rests in the ball.
  FakeArm arm;
  HidProfile profile = slides();
  profile.output_rate = kAtOnce;
  profile.limits.force = 8.0;
  HidHost host;
  host.measured.coulomb = 0.1;
  const auto device = open(arm, profile, true, host);
  HapticLoop loop(*device, 1000.0);
  loop.publish(test::ballScene(test::ballField(), 5.0));
  TickTime time;
  time.dt = 1e-3;
  int z = 4000;
  const auto tick = [&] {
    arm.giveCounts(0, 0, z);
    tickOut(loop, *device, time);
    return loop.latest().report;
  };
  for (int i = 0; i < 1000; ++i) (void)tick();
  for (; z > 2200; z -= 5) (void)tick();
  for (int i = 0; i < 400; ++i) (void)tick();
  REQUIRE(tick().force.norm() > 3.5);
  int ticks = 0;
  while (tick().force.norm() > 0.0 && ticks < 5000) ++ticks;
  CHECK(ticks < 700);
  CHECK(loop.latest().fault == Fault::kNone);
  CHECK(loop.latest().report.moving == 0.0);
  // When the arm moves again, the force returns gradually.
  double last = 0.0;
  z -= 1;
  for (int i = 0; i < 600; ++i) {
    const double force = tick().force.norm();
    CHECK(force - last < 0.02);
    last = force;
    if (i % 100 == 0) z -= 1;
  }
  CHECK(last > 3.5);
  // If the force is below the friction, the arm can rest without a hand. So the force does not
  // fade.
  for (; z < 2990; z += 5) (void)tick();
  for (int i = 0; i < 1500; ++i) (void)tick();
  CHECK(loop.latest().report.force.norm() > 0.02);
  CHECK(loop.latest().report.force.norm() < 0.1);
  CHECK(loop.latest().report.moving == 1.0);
}

namespace {

/// A simulated arm. If `tells` is true, the arm reports for how long its counters have been
/// constant.
class Counting final : public Device {
 public:
  Counting(SimulatedDevice& arm, double friction, bool tells)
      : arm_(arm), info_(arm.info()), tells_(tells) {
    info_.limits.friction = friction;
  }
  [[nodiscard]] const DeviceInfo& info() const noexcept override { return info_; }
  [[nodiscard]] HandState read() noexcept override {
    HandState hand = arm_.read();
    still_ = hand.position == last_ ? still_ + 1e-3 : 0.0;
    last_ = hand.position;
    if (tells_) hand.still = still_;
    return hand;
  }
  void write(const Vec3& force) noexcept override { arm_.write(force); }

 private:
  SimulatedDevice& arm_;
  DeviceInfo info_;
  bool tells_;
  Vec3 last_ = Vec3::Zero();
  double still_ = 0.0;
};

/// Simulates a hand that presses on a ball with 3 N and then rests.
struct Holding {
  bool sways = true;  ///< The hand changes its force by up to 1.5 %, and trembles by 20 um at 9 Hz.
  double step = 1e-5, grip = 300.0, coulomb = 0.02;

  struct Held {
    std::vector<Vec3> places;  ///< Exact positions of the arm in each tick.
    long faded = 0;            ///< Number of ticks in which the force faded.
    double force = 0.0;        ///< Force at the end [N].
  };
  [[nodiscard]] Held play(const FieldPtr& ball, bool tells) const {
    constexpr double kForce = 3.0;  // [N]
    const CouplingParams coupling;
    const double depth = kForce / coupling.stiffness + kForce / grip;
    const auto at = [&](double t) {
      const double sway = kForce / grip * 0.01 * (std::sin(4.0 * t) + 0.5 * std::sin(14.0 * t)) +
                          2e-5 * std::sin(2.0 * M_PI * 9.0 * t);
      const double down = std::clamp(t - 0.5, 0.0, 1.0);
      return Vec3(0, 0, test::kBallRadius + 0.002 - down * (0.002 + depth) + (sways ? sway : 0.0));
    };
    ArmParams arm;
    arm.encoder = step;
    arm.coulomb = coulomb;
    SimulatedDevice simulated(arm, {grip, 2.0 * std::sqrt(0.1 * grip)}, {at, 8.0}, 1000.0);
    Counting device(simulated, coulomb, tells);
    HapticLoop loop(device, 1000.0);
    loop.publish(test::ballScene(ball, 8.0, coupling));
    TickTime time;
    time.dt = 1e-3;
    Held held;
    for (int i = 0; i < 8000; ++i) {
      time.now += 1e-3;
      loop.tick(time);
      held.places.push_back(simulated.position());
      held.faded += loop.latest().report.moving < 1.0 ? 1 : 0;
    }
    held.force = loop.latest().report.force.norm();
    return held;
  }
};

}  // namespace

TEST_CASE("the time of rest keeps growing while only a joint moves that does not move the tip",
          "[hid][safety]") {
  // A planar arm with a third joint that has no motor, like a wrist's. The last bit of this joint's
  // counter toggles.
  HidProfile profile = slides();
  profile.kinematics = makePantograph({0.08, 0.1, 0.1, 0.08}, 0.05);
  profile.joints[0].home = M_PI / 2 - 0.3;
  profile.joints[1].home = M_PI / 2 + 0.3;
  profile.joints[2].to.reset();
  FakeArm arm;
  const auto device = open(arm, profile);
  (void)device->read();
  HandState hand;
  for (int i = 0; i < 100; ++i) {
    pass(1e-3);
    arm.giveCounts(0, 0, i % 2);
    hand = device->read();
  }
  CHECK(hand.still == Approx(0.1));
  arm.giveCounts(1, 0, 0);
  CHECK(device->read().still == 0.0);
}

TEST_CASE(
    "a fading force moves a held arm by about a count plus friction over the hand's stiffness",
    "[hid][safety][release]") {
  // Friction holds the arm while the force fades. When the arm moves by one count, the force
  // returns.
  const FieldPtr ball = test::ballField();
  test::Thinned combinations(7);
  for (const bool sways : {true, false}) {
    for (const double step : {1e-5, 3e-5, 1e-4, 3e-4}) {
      for (const double grip : {100.0, 300.0, 1000.0}) {
        for (const double coulomb : {0.02, 0.2}) {
          if (!combinations.runs()) continue;
          const Holding hand{sways, step, grip, coulomb};
          const Holding::Held as_it_is = hand.play(ball, false);
          const Holding::Held fading = hand.play(ball, true);
          double moved = 0.0;
          for (std::size_t i = 0; i < fading.places.size(); ++i) {
            moved = std::max(moved, (fading.places[i] - as_it_is.places[i]).norm());
          }
          CAPTURE(sways, step, grip, coulomb, fading.faded, moved, grip * moved);
          CHECK(grip * moved <= 1.3 * coulomb + grip * step + 0.02);
          // The force does not fade if the hand's tremor moves the arm by at least a count.
          if (sways && step <= 1e-5 && coulomb <= 0.02) CHECK(fading.faded == 0);
          if (!sways) CHECK(fading.faded > 0);
        }
      }
    }
  }
}

TEST_CASE("a reconnected arm repeats its request for the user's action", "[hid]") {
  FakeArm arm;
  HidProfile profile = slides();
  const HidStep wait = waitForState(5, 20.0, "press the button");
  profile.home = {wait};
  std::mutex mutex;
  std::vector<std::string> said;
  arm.giveCounts(0, 0, 0);
  HidHost host;
  host.find = [&]() -> std::unique_ptr<ReportPort> {
    if (!arm.there) return nullptr;
    arm.giveCounts(0, 0, 0);
    return std::make_unique<FakePort>(arm);
  };
  host.say = [&](const std::string& words) {
    const std::lock_guard lock(mutex);
    said.push_back(words);
  };
  std::thread button([&] {
    std::this_thread::sleep_for(50ms);
    arm.giveCounts(0, 0, 0, 5);
  });
  HidDevice device(profile, std::make_unique<FakePort>(arm), true, host);
  button.join();
  arm.there = false;
  CHECK(device.read().fault == Fault::kGone);
  arm.there = true;
  int looks = 0;
  await([&] {
    arm.giveCounts(0, 0, 0, ++looks / 100 % 2 == 0 ? 0 : 5);
    return device.pluggings() == 2;
  });
  const std::lock_guard lock(mutex);
  CHECK(said == std::vector<std::string>(2, "arm slides: press the button"));
}

TEST_CASE("a counter that may have wrapped unnoticed is a fault and the arm is homed again",
          "[hid][safety]") {
  FakeArm arm;
  HidProfile profile = slides();
  for (ReportField& field : profile.input[0].fields) field.bits = 12;  // 2 cm in each direction
  profile.limits.speed = 0.5;
  HidStep home;
  home.seconds = 0.001;
  profile.home = {home};
  std::atomic<int> found{0};
  const auto find = [&]() -> std::unique_ptr<ReportPort> {
    ++found;
    arm.giveCounts(0, 0, 0);
    return std::make_unique<FakePort>(arm);
  };
  const auto device = open(arm, profile, true, {{}, find});
  arm.giveCounts(2000, 0, 0);
  CHECK(device->read().position.x() == Approx(0.02));
  device->write({1, 0, 0});
  await([&] { return arm.driven()[0] == 1000; });
  pass(0.02);
  arm.giveCounts(2040, 0, 0);
  CHECK(device->read().position.x() == Approx(0.0204));
  pass(0.1);
  arm.giveCounts(-2000, 0, 0);
  // Reports that arrived during the pause are ignored.
  CHECK(device->read().fault == Fault::kNone);
  arm.giveCounts(-2000, 0, 0);
  const HandState hand = device->read();
  CHECK(hand.fault == Fault::kMiscounted);
  CHECK(hand.position.x() == Approx(0.0204));
  await([&] { return device->pluggings() == 2; });
  CHECK(found == 1);
  CHECK(arm.driven() == std::array<int, 3>{0, 0, 0});
  arm.giveCounts(10, 0, 0);
  CHECK(device->read().position.x() == Approx(1e-4));
}

TEST_CASE(
    "after homing each counter that wraps is read as the position nearest to its home position",
    "[hid]") {
  // The arm starts near its home pose: joint a one count below 0, joint b three counts above 5 cm.
  HidProfile profile = narrowSlides();
  HidStep home;
  home.seconds = 0.001;
  profile.home = {home};
  profile.joints[1].home = 0.05;
  FakeArm arm;
  arm.giveCounts(-1, 3, 1000);
  const auto device =
      std::make_unique<HidDevice>(profile, std::make_unique<FakePort>(arm), true, inVirtualTime());
  arm.giveCounts(-1, 3, 1000);
  CHECK((device->read().position - Vec3(-1e-5, 0.05003, 1e-2)).norm() < 1e-12);
}

TEST_CASE("the first position of a homed arm is accepted 3 s after the opening", "[hid]") {
  HidProfile profile = narrowSlides();
  HidFlag homed;
  homed.field = {0, 3};
  profile.flags.push_back(homed);
  FakeArm arm;
  const auto device = open(arm, profile);
  // The program builds a scene without reading, while the hand moves away.
  pass(3.0);
  arm.giveCounts(-3, 1000, 3000);
  (void)device->read();
  arm.giveCounts(-3, 1000, 3000);
  const HandState hand = device->read();
  CHECK(hand.fault == Fault::kNone);
  CHECK(hand.ready);
  // The first reading of each counter counts as the position nearest to the middle of the
  // workspace.
  CHECK((hand.position - Vec3(-3e-5, 1e-2, -1.096e-2)).norm() < 1e-12);
  arm.giveCounts(-40, 1000, 3000);
  CHECK(device->read().position.x() == Approx(-4e-4));
  // After the first position, the device counts the wraps. In a pause of 0.2 s a counter can wrap
  // unnoticed, so the next report is a fault.
  pass(0.2);
  CHECK_FALSE(device->read().ready);
  arm.giveCounts(2000, 0, 0);
  CHECK(device->read().fault == Fault::kMiscounted);
}

TEST_CASE("an arm with a miscounted encoder gets zero force and its closing command",
          "[hid][safety]") {
  FakeArm arm;
  HidProfile profile = slides();
  for (ReportField& field : profile.input[0].fields) field.bits = 12;
  profile.home_at_open = true;
  HidStep send;
  send.kind = HidStep::Kind::kSend;
  send.values = {{3, 9.0}};
  profile.close = {send};
  std::mutex mutex;
  std::string said;
  HidHost host;
  host.say = [&](const std::string& words) {
    const std::lock_guard lock(mutex);
    said += words;
  };
  auto device = open(arm, profile, true, host);
  device->write({1, 0, 0});
  await([&] { return arm.driven()[0] == 1000; });
  arm.giveCounts(0, 0, 0);
  CHECK(device->read().fault == Fault::kNone);
  pass(0.15);
  CHECK_FALSE(device->read().ready);
  arm.giveCounts(-2000, 0, 0);
  CHECK(device->read().fault == Fault::kMiscounted);
  const bool at_once = GENERATE(false, true);
  if (!at_once) {
    await([&] { return arm.sent().back()[7] == std::byte{9}; });
    // The message for the user follows the command.
    await([&] {
      const std::lock_guard lock(mutex);
      return said.find("start the program again") != std::string::npos;
    });
  }
  device.reset();
  CHECK(arm.sent().back()[7] == std::byte{9});
  CHECK(arm.driven() == std::array<int, 3>{0, 0, 0});
}

TEST_CASE("a fault that an arm reports while it reconnects is not lost", "[hid]") {
  FakeArm arm;
  HidProfile profile = slides();
  profile.flags = {{{0, 3}, 3.0, HidFlag::Means::kHot}};
  const auto find = [&]() -> std::unique_ptr<ReportPort> {
    if (!arm.there) return nullptr;
    arm.giveCounts(0, 0, 0, 3);
    return std::make_unique<FakePort>(arm);
  };
  const auto device = open(arm, profile, true, {{}, find});
  CHECK(device->read().fault == Fault::kNone);
  arm.there = false;
  CHECK(device->read().fault == Fault::kGone);
  arm.there = true;
  await([&] { return device->pluggings() == 2; });
  CHECK(device->read().fault == Fault::kTemperature);
}

TEST_CASE("a counter is not unwrapped while the arm is not homed", "[hid]") {
  FakeArm arm;
  HidProfile profile = slides();
  profile.flags = {{{0, 3}, 1.0, HidFlag::Means::kHomed}};
  const auto device = open(arm, profile);
  const auto at = [&](int x, int state) {
    arm.giveCounts(x, 0, 0, state);
    return device->read();
  };
  CHECK_FALSE(at(30000, 0).ready);
  CHECK_THAT(device->whyNotReady(), Contains("not homed"));
  // Homing sets the counter to its value in the home pose. The device must not treat this jump as a
  // motion.
  CHECK(at(-20000, 1).position.x() == Approx(-0.2));
  CHECK(device->whyNotReady().empty());
}

TEST_CASE("a HID arm reports the reason why it is not ready", "[hid]") {
  FakeArm arm;
  HidProfile profile = slides();
  profile.flags = {{{0, 3}, 1.0, HidFlag::Means::kEnabled}};
  for (ReportField& field : profile.input[0].fields) field.scale = 1e-3;
  profile.input[0].fields[3].scale = 1.0;
  profile.kinematics = makeDelta(0.08, 0.03, 0.06, 0.1);
  const auto device = open(arm, profile);
  arm.giveCounts(900, 900, 900, 0);
  (void)device->read();
  CHECK_THAT(device->whyNotReady(), Contains("dead-man switch"));
  arm.giveCounts(0, 0, 0, 1);
  (void)device->read();
  CHECK_THAT(device->whyNotReady(), Contains("geometry"));
  arm.giveCounts(900, 900, 900, 1);
  (void)device->read();
  CHECK(device->whyNotReady().empty());
  pass(0.06);
  (void)device->read();
  CHECK_THAT(device->whyNotReady(), Contains("no position arrives"));
}

TEST_CASE("opening a HID arm polls for its first report and fails with a hint if none arrives",
          "[hid]") {
  HidProfile profile = slides();
  profile.firmware = "version 3";
  FakeArm silent;
  CHECK_THROWS_WITH(HidDevice(profile, std::make_unique<FakePort>(silent), true),
                    Contains("sends no report") && Contains("version 3"));
  FakeArm asked;
  asked.answers = true;
  HidDevice device(profile, std::make_unique<FakePort>(asked), true);
  CHECK(device.read().ready);
}

TEST_CASE("an untested HID arm is limited to 1 N and 100 N/m", "[hid][safety]") {
  FakeArm arm;
  const auto wild = open(arm, slides(), false);
  CHECK(wild->info().limits.peak == kUntestedForce);
  CHECK(wild->info().max_stiffness == kUntestedStiffness);
  CHECK_THAT(wild->info().source, Contains("untested"));
  const auto tame = open(arm, slides(), true);
  CHECK(tame->info().limits.peak == 5.0);
  CHECK(tame->info().max_stiffness == 1000.0);
}

TEST_CASE("under rate control a 3D mouse moves the hand within the workspace", "[hid]") {
  FakeArm arm;
  HidProfile profile = slides();
  profile.output.reset();
  for (HidJoint& joint : profile.joints) joint.to.reset();
  for (ReportField& field : profile.input[0].fields) field.scale = 1.0 / 350.0;
  profile.rate_control = 0.1;
  HidDevice device(profile, std::make_unique<FakePort>(arm), false, inVirtualTime());
  CHECK_FALSE(device.info().hand);
  CHECK(device.read().ready);
  arm.giveCounts(350, 0, -350);
  (void)device.read();
  const Vec3 before = device.read().position;
  for (int i = 0; i < 10; ++i) {
    pass(0.005);
    arm.giveCounts(350, 0, -350);
    (void)device.read();
  }
  const HandState hand = device.read();
  CHECK(hand.age == 0.0);
  CHECK(hand.position.x() - before.x() == Approx(0.1 * 0.05));
  CHECK(hand.position.z() - before.z() == Approx(before.x() - hand.position.x()));
  device.write({1, 2, 3});
  CHECK(arm.sent().empty());
  for (int i = 0; i < 90; ++i) {
    pass(0.02);
    arm.giveCounts(350, 0, -350);
    REQUIRE(device.read().position.norm() < 0.1 + 1e-12);
  }
  CHECK(device.read().position.norm() == Approx(0.1));
  // After a pause between reads, the position moves as in 20 ms, not as in the whole pause.
  arm.giveCounts(-350, 0, 350);
  (void)device.read();
  const Vec3 looked = device.read().position;
  pass(0.3);
  CHECK((device.read().position - looked).norm() < 0.1 * 2 * 0.021);
  // No further report arrives, although the last one did not report rest. The position is
  // extrapolated until that report is stale, then stays.
  arm.giveCounts(0, 350, 0);
  const Vec3 last = device.read().position;
  for (int i = 0; i < 200; ++i) {
    pass(0.004);
    const HandState quiet = device.read();
    CHECK(quiet.ready);
    CHECK((quiet.position - last).norm() <= 0.1 * 0.05 + 1e-12);
  }
  CHECK((device.read().position - last).norm() == Approx(0.1 * 0.05));
  pass(0.3);
  CHECK((device.read().position - last).norm() == Approx(0.1 * 0.05));
  // The next report's velocity counts from its arrival.
  arm.giveCounts(0, -350, 0);
  CHECK(device.read().position.y() == Approx(last.y() + 0.1 * 0.05));
  pass(0.01);
  CHECK(device.read().position.y() == Approx(last.y() + 0.1 * 0.04));
  arm.there = false;
  const Vec3 left = device.read().position;
  pass(0.05);
  CHECK(device.read().position == left);
}

TEST_CASE("reading and writing a HID arm does not allocate", "[hid]") {
  FakeArm arm;
  const auto device = open(arm);
  Vec3 sum = Vec3::Zero();
  long allocations = 0;
  for (int i = 0; i < 200; ++i) {
    arm.giveCounts(i, i, i);
    const test::CountScope scope;
    sum += device->read().position;
    device->write({0.001 * i, 0, 0});
    allocations += test::CountScope::counts().allocations;
  }
  // In the scope, this thread frees memory of the simulated arm's deque, but allocates none.
  CHECK(allocations == 0);
  CHECK(sum.allFinite());
}

TEST_CASE("a replugged HID arm gets force again only after the fault is cleared",
          "[hid][safety][host]") {
  FakeArm arm;
  int z = 4000;
  {
    const auto find = [&]() -> std::unique_ptr<ReportPort> {
      if (!arm.there) return nullptr;
      arm.giveCounts(0, 0, 4000);
      return std::make_unique<FakePort>(arm);
    };
    auto device = open(arm, slides(), true, {{}, find});
    arm.giveCounts(0, 0, z);
    struct Patient final : public Device {
      HidDevice& inner;
      DeviceInfo about;
      explicit Patient(HidDevice& d) : inner(d), about(d.info()) { about.watch.late = 1e3; }
      [[nodiscard]] const DeviceInfo& info() const noexcept override { return about; }
      [[nodiscard]] HandState read() noexcept override { return inner.read(); }
      void write(const Vec3& force) noexcept override { inner.write(force); }
    } patient(*device);
    LoopParams params;
    params.realtime = {0, -1, false, false};
    HapticThread hand(patient, params);
    hand.publish(test::ballScene(test::ballField()));
    // Waits for ticks instead of a time, because a busy machine may stop any process.
    const auto ticks = [&](std::int64_t count) {
      const std::int64_t last = hand.latest().tick + count;
      await([&] { return hand.latest().tick >= last; });
    };
    const auto move = [&](int to) {
      for (const int from = z; z != to;) {
        z += to < from ? std::max(to - z, -20) : std::min(to - z, 20);
        arm.giveCounts(0, 0, z);
        ticks(2);
      }
    };
    // If the machine stops the loop or the writer for longer than kWriteTime, the loop rightly cuts
    // the force with Fault::kWrite. The test tolerates this case.
    const auto stopped = [&] { return hand.latest().fault == Fault::kWrite; };
    const auto press = [&] {
      for (;;) {
        ticks(1000);  // longer than an engagement
        move(2700);
        await([&] { return arm.driven()[2] > 1000 || stopped(); });
        if (!stopped()) return;
        move(4000);
        hand.clear();
        await([&] { return hand.latest().fault == Fault::kNone; });
      }
    };
    press();
    arm.there = false;
    await([&] {
      if (stopped()) hand.clear();
      return hand.latest().fault == Fault::kGone;
    });
    CHECK(hand.latest().report.force == Vec3::Zero());
    z = 4000;
    arm.there = true;
    await([&] { return device->pluggings() == 2; });
    ticks(50);
    // The arm is connected again, but the force stays off until the program clears the fault.
    CHECK(hand.latest().fault == Fault::kGone);
    CHECK(arm.driven() == std::array<int, 3>{0, 0, 0});
    hand.clear();
    await([&] { return hand.latest().fault == Fault::kNone; });
    press();
    hand.stop();
  }
  CHECK(arm.driven() == std::array<int, 3>{0, 0, 0});
}

}  // namespace palpate::hid_device_test
