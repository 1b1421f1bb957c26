/// Tests which facts and readings of plug-ins palpate accepts, and how it reacts to their faults.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <memory>
#include <string>
#include <thread>
#include <unistd.h>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/devices/plugins/plugin_arm.h"
#include "palpate/devices/plugins/plugin_library.h"
#include "palpate/devices/plugins/plugin_link.h"
#include "palpate/devices/plugins/plugin_process.h"
#include "palpate/devices/plugins/seqlock.h"
#include "palpate/engine/error.h"
#include "palpate/engine/loop/haptic_loop.h"
#include "palpate/engine/loop/haptic_thread.h"
#include "tests/fuzz/plugin_entry.h"
#include "tests/support/random.h"

namespace palpate::plugin_test {
using namespace palpate::test;

namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();

palpate_plugin_facts goodFacts() {
  palpate_plugin_facts facts{};
  facts.size = sizeof(facts);
  facts.has = PALPATE_PLUGIN_FORCE | PALPATE_PLUGIN_ORIENTATION | PALPATE_PLUGIN_GRIPPER;
  facts.force = 5.0;
  facts.stiffness = 800.0;
  facts.damping = 5.0;
  facts.workspace_radius = 0.1;
  facts.rate = 1000.0;
  facts.joints = 2;
  facts.buttons = 3;
  std::strcpy(facts.button[1], "dark");
  std::strcpy(facts.source, "a test");
  return facts;
}

std::int64_t the_time = 0;
std::int64_t testTime() noexcept {
  return the_time;
}

/// A port that returns the values that the test sets.
struct FakePort final : PluginPort {
  palpate_plugin_facts told = goodFacts();
  PluginNews next;
  std::vector<PluginOrder> orders;
  bool there = true;
  double weight = 5.0;
  bool takes = true;  ///< True: orders are taken at once.
  std::uint32_t opened = 1;

  [[nodiscard]] const palpate_plugin_facts& facts() const noexcept override { return told; }
  [[nodiscard]] std::string version() const override { return "1"; }
  [[nodiscard]] std::string serial() const override { return "S"; }
  [[nodiscard]] double carries() const noexcept override { return weight; }
  [[nodiscard]] std::uint32_t openings() const noexcept override { return opened; }
  [[nodiscard]] bool read(PluginNews& news) noexcept override {
    if (there) news = next;
    return there;
  }
  void write(const PluginOrder& order) noexcept override {
    orders.push_back(order);
    if (takes) next.written = order.number;
  }
};

/// An arm on a FakePort, with a clock that the test sets.
struct Fake {
  FakePort* port;
  std::unique_ptr<PluginArm> arm;

  explicit Fake(const palpate_plugin_facts& facts = goodFacts(), bool tested = true) {
    auto made = std::make_unique<FakePort>();
    port = made.get();
    port->told = facts;
    ArmHost host;
    host.now = testTime;
    the_time = 1'000'000'000;
    arm = std::make_unique<PluginArm>(std::move(made), "plugin:fake", tested, host);
    port->next.reading.state = PALPATE_PLUGIN_READY;
  }
  /// Advances the clock by 1 ms and reads a new position at `x` [m].
  HandState fresh(double x = 0.0) {
    the_time += 1'000'000;
    port->next.reading.taken = the_time;
    port->next.reading.position[0] = x;
    return arm->read();
  }
  HandState later(double seconds) {
    the_time += static_cast<std::int64_t>(1e9 * seconds);
    return arm->read();
  }
};

bool refused(const palpate_plugin_facts& facts, const std::string& words) {
  try {
    (void)infoFor(facts, "plugin:fake", true);
    return false;
  } catch (const DeviceError& error) {
    return std::string(error.what()).find(words) != std::string::npos;
  }
}

}  // namespace

TEST_CASE("the limits of a plug-in's arm are those in its facts", "[plugin]") {
  palpate_plugin_facts facts = goodFacts();
  const DeviceInfo info = infoFor(facts, "plugin:fake", true);
  CHECK(info.limits.peak == 5.0);
  CHECK(info.limits.slew == 2000.0);
  CHECK(info.max_stiffness == 800.0);
  CHECK(info.output_rate == 1000.0);
  CHECK(info.watch.stale == 0.05);
  CHECK(info.handle.orientation);
  CHECK_FALSE(info.handle.velocity);
  CHECK(info.handle.joints == 2);
  CHECK(info.handle.buttons == std::vector<std::string>{"button 1", "dark", "button 3"});
  const DeviceInfo held = infoFor(facts, "plugin:fake", false);
  CHECK(held.limits.peak == kUntestedForce);
  CHECK(held.max_stiffness == kUntestedStiffness);

  facts.has = 0;
  facts.force = facts.stiffness = 0.0;
  CHECK_FALSE(infoFor(facts, "plugin:fake", false).hand);
}

TEST_CASE("invalid facts of a plug-in are refused with a one-line message that names them",
          "[plugin]") {
  const auto with = [](double palpate_plugin_facts::*member, double value) {
    palpate_plugin_facts facts = goodFacts();
    facts.*member = value;
    return facts;
  };
  for (const double bad : {0.0, -1.0, kNan, kInf, 1e9}) {
    CHECK(refused(with(&palpate_plugin_facts::force, bad), "force ="));
    CHECK(refused(with(&palpate_plugin_facts::stiffness, bad), "stiffness ="));
    CHECK(refused(with(&palpate_plugin_facts::workspace_radius, bad), "workspace_radius ="));
    CHECK(refused(with(&palpate_plugin_facts::rate, bad), "rate ="));
  }
  for (const double bad : {-1.0, kNan, kInf, 1e12}) {
    CHECK(refused(with(&palpate_plugin_facts::slew, bad), "slew ="));
    CHECK(refused(with(&palpate_plugin_facts::damping, bad), "damping ="));
    CHECK(refused(with(&palpate_plugin_facts::output_rate, bad), "output_rate ="));
    CHECK(refused(with(&palpate_plugin_facts::stale, bad), "stale ="));
    CHECK(refused(with(&palpate_plugin_facts::speed, bad), "speed ="));
    CHECK(refused(with(&palpate_plugin_facts::continuous, bad), "continuous ="));
    CHECK(refused(with(&palpate_plugin_facts::heating, bad), "heating ="));
    CHECK(refused(with(&palpate_plugin_facts::watchdog, bad), "watchdog ="));
    CHECK(refused(with(&palpate_plugin_facts::resolution, bad), "resolution ="));
  }
  CHECK(refused(with(&palpate_plugin_facts::continuous, 1.0), "only one of continuous"));
  palpate_plugin_facts facts = goodFacts();
  facts.joints = 7;
  CHECK(refused(facts, "7 joints"));
  facts = goodFacts();
  facts.buttons = 33;
  CHECK(refused(facts, "33 buttons"));
}

TEST_CASE("a plug-in arm's fingerprint depends on version, facts and carried weight", "[plugin]") {
  palpate_plugin_facts facts = goodFacts();
  const ArmIdentity arm = identityOf(facts, 2.0, "plugin:fake", "1", "S");
  CHECK(identityOf(facts, 2.0, "plugin:fake", "1", "S").fingerprint == arm.fingerprint);
  CHECK(identityOf(facts, 2.0, "plugin:fake", "2", "S").fingerprint != arm.fingerprint);
  CHECK(identityOf(facts, 3.0, "plugin:fake", "1", "S").fingerprint != arm.fingerprint);
  facts.force = 6.0;
  CHECK(identityOf(facts, 2.0, "plugin:fake", "1", "S").fingerprint != arm.fingerprint);
}

TEST_CASE("the state of the hand is taken from the plug-in's reading", "[plugin]") {
  Fake fake;
  CHECK_FALSE(fake.arm->read().ready);
  CHECK_FALSE(fake.arm->whyNotReady().empty());
  fake.port->next.reading.buttons = 0xFFFFFFFAU;
  fake.port->next.reading.orientation[0] = 0.6;
  fake.port->next.reading.orientation[2] = -0.8;
  fake.port->next.reading.gripper = 0.3;
  fake.port->next.reading.joints[1] = 1.5;
  fake.port->next.reading.joints[2] = 7.0;
  HandState hand = fake.fresh(0.01);
  CHECK(hand.ready);
  CHECK(hand.age == 0.0);
  CHECK(hand.position.x() == 0.01);
  CHECK(hand.handle.buttons == 2);  // the fourth button's bit is dropped: the arm has three
  CHECK(hand.handle.orientation[2] == Approx(-0.8));
  CHECK(hand.handle.gripper == 0.3);
  CHECK(hand.handle.joints[1] == 1.5);
  CHECK(hand.handle.joints[2] == 0.0);  // dropped: the arm has two joints
  hand = fake.later(0.001);
  CHECK(hand.age == Approx(0.001));
  // An invalid orientation, gripper or joint keeps its last value.
  for (double& q : fake.port->next.reading.orientation) q = kNan;
  fake.port->next.reading.gripper = kInf;
  fake.port->next.reading.joints[1] = kNan;
  hand = fake.fresh(0.01);
  CHECK(hand.handle.orientation[2] == Approx(-0.8));
  CHECK(hand.handle.gripper == 0.3);
  CHECK(hand.handle.joints[1] == 1.5);
  for (double& q : fake.port->next.reading.orientation) q = 0.0;
  CHECK(fake.fresh(0.01).handle.orientation[0] == Approx(0.6));
}

TEST_CASE("the speed limit of a plug-in's arm uses its positions instead of its reported velocity",
          "[plugin]") {
  palpate_plugin_facts facts = goodFacts();
  facts.has |= PALPATE_PLUGIN_VELOCITY;
  Fake fake(facts);
  HandWatch watch;
  fake.port->next.reading.velocity[0] = 4.9;
  HandState hand = fake.fresh();
  double t = 0.0;
  for (int i = 0; i < 100; ++i) {
    hand = fake.fresh();
    CHECK(watch.look(hand, t += 0.001) == Fault::kNone);
    CHECK_FALSE(hand.too_fast);
    CHECK(hand.velocity.norm() == 0.0);
  }
  CHECK(hand.handle.velocity[0] == 4.9);
  // An invalid velocity is replaced by the previous one.
  fake.port->next.reading.velocity[1] = kNan;
  fake.port->next.reading.velocity[0] = 1.0;
  CHECK(fake.fresh().handle.velocity[0] == 4.9);
  // The plug-in reports zero velocity while the arm moves away. The loop must use the positions.
  fake.port->next.reading.velocity[0] = fake.port->next.reading.velocity[1] = 0.0;
  Fault fault = Fault::kNone;
  bool braked = false;
  for (int i = 1; i < 100 && fault == Fault::kNone; ++i) {
    hand = fake.fresh(0.004 * i);
    fault = watch.look(hand, t += 0.001);
    braked = braked || hand.too_fast;
  }
  CHECK(braked);
  CHECK(fault == Fault::kOverSpeed);
}

TEST_CASE("a plug-in's reading with a wrong time still becomes stale", "[plugin]") {
  const std::int64_t last = std::numeric_limits<std::int64_t>::max();
  const std::int64_t first = std::numeric_limits<std::int64_t>::min();
  for (const std::int64_t taken : {last, first, std::int64_t{-5}, std::int64_t{0}}) {
    Fake fake;
    (void)fake.fresh();
    fake.port->next.reading.taken = taken;
    HandState hand = fake.later(0.001);
    // A time in the future counts as now. A zero or negative time counts as old.
    CHECK((hand.age == 0.0) == (taken > 0));
    hand = fake.later(0.06);
    HandWatch watch(fake.arm->info().watch);
    CHECK(watch.look(hand, 0.0) == Fault::kStale);
  }
}

TEST_CASE("a plug-in's position that repeats in new readings counts as standing still",
          "[plugin]") {
  Fake fake;
  (void)fake.fresh(0.01);
  HandState hand;
  for (int i = 0; i < 600; ++i) hand = fake.fresh(0.01);
  CHECK(hand.still == Approx(0.6));
  CHECK(fake.fresh(0.011).still == 0.0);
}

TEST_CASE("the state that a plug-in reports makes the arm not ready or sets a fault", "[plugin]") {
  palpate_plugin_facts facts = goodFacts();
  facts.has |= PALPATE_PLUGIN_DEADMAN;
  Fake fake(facts);
  const auto with = [&](std::uint32_t state) {
    fake.port->next.reading.state = state;
    return fake.fresh();
  };
  constexpr std::uint32_t kGood = PALPATE_PLUGIN_READY | PALPATE_PLUGIN_HELD;
  CHECK(with(kGood).ready);
  CHECK_FALSE(with(PALPATE_PLUGIN_READY).ready);
  CHECK(fake.arm->whyNotReady().find("hold it") != std::string::npos);
  CHECK_FALSE(with(PALPATE_PLUGIN_HELD).ready);
  CHECK(fake.arm->whyNotReady().find("home the arm") != std::string::npos);
  CHECK(with(kGood | PALPATE_PLUGIN_HOT).fault == Fault::kTemperature);
  CHECK(with(kGood | PALPATE_PLUGIN_UNPOWERED).fault == Fault::kPower);
  CHECK(with(kGood | PALPATE_PLUGIN_OPEN).fault == Fault::kSwitch);
  CHECK(with(kGood).fault == Fault::kNone);
  fake.port->next.read = PALPATE_PLUGIN_GONE;
  CHECK(fake.later(0.001).fault == Fault::kGone);
  fake.port->next.read = -1000;
  CHECK(fake.later(0.001).fault == Fault::kGone);
  fake.port->next.read = PALPATE_PLUGIN_OK;
  fake.port->there = false;
  CHECK(fake.later(0.001).fault == Fault::kGone);
  fake.port->there = true;
  // The position from before the interruption must not be used.
  CHECK_FALSE(fake.arm->read().ready);
  CHECK(with(kGood).ready);
  fake.port->next.wrote = PALPATE_PLUGIN_FAILED;
  CHECK(with(kGood).fault == Fault::kWrite);
}

TEST_CASE("a force that the plug-in does not take within 20 ms is a fault", "[plugin]") {
  Fake fake;
  (void)fake.fresh();
  fake.arm->write(Vec3(1.0, 2.0, 3.0));
  CHECK(fake.port->orders.back().force.force[2] == 3.0);
  CHECK(fake.port->orders.back().force.torque[0] == 0.0);
  CHECK(fake.fresh().fault == Fault::kNone);
  fake.port->takes = false;
  Fault fault = Fault::kNone;
  int ticks = 0;
  for (; ticks < 100 && fault == Fault::kNone; ++ticks) {
    fake.arm->write(Vec3(1.0, 0.0, 0.0));
    fault = fake.fresh().fault;
  }
  CHECK(fault == Fault::kWrite);
  CHECK(ticks >= 20);
  CHECK(ticks <= 23);  // 20 ms and one period
  fake.arm->write(Vec3(kNan, 0.0, 0.0));
  CHECK(fake.port->orders.back().force.force[0] == 0.0);
}

TEST_CASE("a force that a plug-in's process withheld is reported once as a late fault",
          "[plugin]") {
  Fake fake;
  CHECK(fake.fresh().fault == Fault::kNone);
  fake.port->next.withheld = 1;
  CHECK(fake.fresh().fault == Fault::kLate);
  CHECK(fake.fresh().fault ==
        Fault::kNone);  // the arm reports the fault once, and the loop latches it
}

TEST_CASE("a plug-in's gravity compensation grows over half a second and ends immediately",
          "[plugin]") {
  Fake fake;
  (void)fake.fresh();
  fake.arm->carry(true);
  const auto carried = [&] {
    fake.arm->write(Vec3::Zero());
    return fake.port->orders.back().carry;
  };
  for (int i = 0; i < 250; ++i) (void)fake.fresh();
  CHECK(carried() == Approx(0.5).margin(0.01));
  for (int i = 0; i < 400; ++i) (void)fake.fresh();
  CHECK(carried() == 1.0);
  fake.port->next.reading.state = 0;  // not ready
  (void)fake.fresh();
  CHECK(carried() == 0.0);
  fake.port->next.reading.state = PALPATE_PLUGIN_READY;
  for (int i = 0; i < 300; ++i) (void)fake.fresh();
  CHECK(carried() > 0.5);
  fake.arm->carry(false);
  CHECK(carried() == 0.0);
}

TEST_CASE("an untested arm of a plug-in has at most 1 N of its weight compensated", "[plugin]") {
  Fake fake(goodFacts(), false);
  (void)fake.fresh();
  fake.arm->carry(true);
  for (int i = 0; i < 1000; ++i) (void)fake.fresh();
  fake.arm->write(Vec3::Zero());
  CHECK(fake.port->orders.back().carry == Approx(0.2));  // share of 5 N
}

TEST_CASE("the share of the force that a plug-in reports as given is limited to 0 to 1",
          "[plugin]") {
  Fake fake;
  for (const auto& [said, taken] : std::vector<std::pair<double, double>>{
           {1.0, 1.0}, {0.4, 0.4}, {2.0, 1.0}, {-1.0, 0.0}, {kNan, 0.0}}) {
    fake.port->next.given = said;
    (void)fake.fresh();
    CHECK(fake.arm->given() == taken);
  }
}

TEST_CASE("mutated readings of a plug-in give a finite hand position or a fault", "[plugin]") {
  const long count = cases(20000);
  Random random(7);
  palpate_plugin_facts facts = goodFacts();
  facts.has |= PALPATE_PLUGIN_VELOCITY | PALPATE_PLUGIN_DEADMAN;
  PluginFuzz fuzz(facts);
  for (long i = 0; i < count; ++i) {
    PluginNews& news = fuzz.news();
    if (i % 3 == 0) {
      news = {};
      news.reading.state = PALPATE_PLUGIN_READY | PALPATE_PLUGIN_HELD;
      news.reading.taken = fuzzTime();
      news.written = static_cast<std::uint32_t>(i);
    }
    auto bytes = std::as_writable_bytes(std::span(&news, 1));
    const int changes = random.integer(6);
    for (int k = 0; k < changes; ++k) {
      bytes[static_cast<std::size_t>(random.integer(static_cast<int>(bytes.size())))] =
          static_cast<std::byte>(random.integer(256));
    }
    const std::string wrong = fuzz.tick();
    REQUIRE(wrong.empty());
  }
  CHECK(fuzz.passed() > count / 10);
}

TEST_CASE("mutated facts of a plug-in never give invalid limits", "[plugin]") {
  const long count = cases(20000);
  Random random(13);
  long taken = 0;
  for (long i = 0; i < count; ++i) {
    palpate_plugin_facts facts = goodFacts();
    // Mutates the numbers only: most of the bytes are texts.
    auto bytes = std::as_writable_bytes(std::span(&facts, 1));
    const int numbers = static_cast<int>(offsetof(palpate_plugin_facts, button));
    const int changes = random.integer(4);
    for (int k = 0; k < changes; ++k) {
      bytes[static_cast<std::size_t>(random.integer(numbers))] =
          static_cast<std::byte>(random.integer(256));
    }
    try {
      const DeviceInfo info = infoFor(facts, "plugin:fake", true);
      ++taken;
      bool good = info.limits.peak > 0.0 && info.limits.peak <= 1e3 && info.limits.slew > 0.0;
      good = good && info.max_stiffness > 0.0 && std::isfinite(info.max_stiffness);
      good = good && info.workspace_radius > 0.0 && info.handle.buttons.size() <= 32;
      good = good && info.handle.joints <= kMostJoints && info.watch.stale <= 0.5;
      REQUIRE(good);
      (void)limitsInLoop(info, 1000.0);
    } catch (const DeviceError& error) {
      REQUIRE(std::string(error.what()).find("plugin:fake: ") == 0);
    }
  }
  CHECK(taken > count / 10);
}

TEST_CASE("mutated messages of a plug-in's process never crash their reader", "[plugin]") {
  const long count = cases(20000);
  Random random(11);
  long taken = 0;
  for (long i = 0; i < count; ++i) {
    PluginMessage message;
    message.kind = static_cast<std::uint32_t>(random.integer(6));
    message.size = static_cast<std::uint32_t>(random.integer(1 + PluginMessage::kMostBytes));
    std::vector<std::byte> bytes(PluginMessage::kHead + message.size);
    std::memcpy(bytes.data(), &message, bytes.size());
    const int changes = random.integer(8);
    for (int k = 0; k < changes; ++k) {
      const auto at = static_cast<std::size_t>(random.integer(k % 2 == 0 ? 8 : 64)) % bytes.size();
      bytes[at] = static_cast<std::byte>(random.integer(256));
    }
    if (random.integer(4) == 0) bytes.resize(static_cast<std::size_t>(random.integer(6000)));
    bool is = false;
    const std::string wrong = fuzzPluginMessage(bytes, is);
    REQUIRE(wrong.empty());
    taken += static_cast<long>(is);
  }
  CHECK(taken > count / 20);
  CHECK_FALSE(pluginMessageOf({}).has_value());
}

TEST_CASE("the reader of a seqlock gets whole values, and never an older one after a newer one",
          "[plugin]") {
  struct Value {
    std::array<std::uint64_t, 16> all{};
  };
  Seqlock<Value> lock;
  std::atomic<bool> over{false};
  std::thread writer([&] {
    Value value;
    for (std::uint64_t i = 1; !over; ++i) {
      value.all.fill(i);
      lock.store(value);
    }
  });
  const long count = cases(20000);
  Value value;
  bool whole = true;
  bool rises = true;
  std::uint64_t last = 0;
  long seen = 0;
  // The writer thread may start later than the reader.
  while (seen < count) {
    if (!lock.load(value)) continue;
    ++seen;
    whole = whole && std::all_of(value.all.begin(), value.all.end(),
                                 [&](std::uint64_t x) { return x == value.all[0]; });
    rises = rises && value.all[0] >= last;
    last = value.all[0];
  }
  over = true;
  writer.join();
  CHECK(whole);
  CHECK(rises);
}

}  // namespace palpate::plugin_test
