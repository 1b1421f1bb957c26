/// Tests arms whose weight exceeds their friction: the self-test measures the weight, and the
/// motors carry it.
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/devices/arm/self_test.h"
#include "palpate/devices/hid/hid_device.h"
#include "palpate/devices/hid/profile_facts.h"
#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/safety/limit_force.h"
#include "tests/support/random.h"

namespace palpate::gravity_test {
using Catch::Contains;

namespace {

constexpr double kRate = 1000.0;
constexpr double kCount = 2e-5;   // [rad] per count
constexpr double kTorque = 1e-5;  // [N m] per count
constexpr double kG = 9.80665;

std::atomic<std::int64_t> virtual_now{1000000000};
std::int64_t virtualNow() noexcept {
  return virtual_now;
}

ReportField int32(const char* name, std::size_t i) {
  ReportField field;
  field.name = name;
  field.bit = static_cast<std::uint32_t>(32 * i);
  field.bits = 32;
  return field;
}

/// Returns a profile with the kinematics and about the lengths of WoodenHaptics, and with 32-bit
/// fields for input and output.
HidProfile woody() {
  HidProfile profile;
  profile.name = "heavy";
  HidReportSpec input;
  HidReportSpec output;
  input.size = output.size = 12;
  for (std::size_t i = 0; i < 3; ++i) {
    const std::array names{"a", "b", "c"};
    ReportField in = int32(names[i], i);
    in.scale = kCount;
    in.least = -2e9;
    in.most = 2e9;
    input.fields.push_back(in);
    ReportField out = int32(names[i], i);
    out.scale = 1.0 / kTorque;
    out.least = -1.0 / kTorque;  // 1 N m
    out.most = 1.0 / kTorque;
    output.fields.push_back(out);
    HidJoint joint;
    joint.from = {0, i};
    joint.to = i;
    profile.joints.push_back(joint);
  }
  profile.joints[2].home = M_PI / 2;
  profile.joints[1].home = 0.3;
  profile.input = {input};
  profile.output = output;
  profile.output_rate = 1e9;  // so high that no force waits in virtual time
  profile.kinematics = makeCapstanArm(0.08, 0.2, 0.2);
  profile.origin_D = profile.kinematics->at({0.0, 0.3, M_PI / 2}).position_D;
  profile.limits = {5.0, 2000.0, 1000.0, 5.0, 0.1, 0.05, 3.0, 0.0, 0.0};
  return profile;
}

/// Simulates the arm that sends the reports. The tip moves like SimulatedDevice, under the links'
/// weight and the motors' torques.
class HeavyArm {
 public:
  HeavyArm(const HidProfile& profile, const ArmParams& params, std::vector<HidMass> masses)
      : profile_(profile),
        tip_(params, {0.0, 0.0}, {[](double) { return Vec3(0, 0, 0); }, 1e9}, kRate) {
    profile_.masses = std::move(masses);
    for (std::size_t i = 0; i < 3; ++i) joints_[i] = profile_.joints[i].home;
  }
  /// Returns the weight at the tip in the current pose.
  [[nodiscard]] Vec3 weight() const {
    return -forceOf(profile_, profile_.kinematics->at(joints_), carryingTorques(profile_, joints_));
  }
  void step() {
    Joints torques{};
    {
      const std::lock_guard lock(mutex_);
      for (std::size_t i = 0; i < 3; ++i) torques[i] = kTorque * sent_[i];
    }
    const ArmPose pose = profile_.kinematics->at(joints_);
    const Vec3 motors = forceOf(profile_, pose, torques);
    tip_.write(motors + weight());
    // Solves for the joint angles at the tip's position, by Newton's method.
    for (int i = 0; i < 4; ++i) {
      const ArmPose here = profile_.kinematics->at(joints_);
      Mat3 jacobian;
      for (int j = 0; j < 3; ++j) jacobian.col(j) = here.jacobian[static_cast<std::size_t>(j)];
      const Vec3 turn =
          jacobian.inverse() * (tip_.position() + profile_.origin_D - here.position_D);
      for (std::size_t j = 0; j < 3; ++j) joints_[j] += turn[static_cast<Eigen::Index>(j)];
    }
  }
  [[nodiscard]] std::array<std::byte, 12> report() const {
    std::array<std::byte, 12> bytes{};
    for (std::size_t i = 0; i < 3; ++i) {
      const double raw = (joints_[i] - profile_.joints[i].home) / kCount;
      putRaw(bytes, profile_.input[0].fields[i], raw);
    }
    return bytes;
  }
  void take(std::span<const std::byte> report) {
    const std::lock_guard lock(mutex_);
    for (std::size_t i = 0; i < 3; ++i) {
      sent_[i] = rawOf(report.subspan(1), profile_.output->fields[i]);
    }
  }
  [[nodiscard]] Vec3 motors() {
    const std::lock_guard lock(mutex_);
    return {sent_[0], sent_[1], sent_[2]};
  }
  std::atomic<bool> waits{true};  ///< A report is waiting to be read.

 private:
  HidProfile profile_;
  SimulatedDevice tip_;
  Joints joints_{};
  std::mutex mutex_;
  std::array<double, 3> sent_{};
};

class Port final : public ReportPort {
 public:
  explicit Port(HeavyArm& arm) : arm_(arm) {}
  [[nodiscard]] ReadStatus read(std::span<std::byte> to, std::size_t& size) noexcept override {
    if (!arm_.waits.exchange(false)) return ReadStatus::kNothing;
    const auto report = arm_.report();
    size = report.size();
    std::copy(report.begin(), report.end(), to.begin());
    return ReadStatus::kReport;
  }
  [[nodiscard]] bool write(std::span<const std::byte> report) noexcept override {
    arm_.take(report);
    return true;
  }
  [[nodiscard]] bool sendFeature(std::span<const std::byte>) noexcept override { return true; }

 private:
  HeavyArm& arm_;
};

void awaitWrites(const HidDevice& device, std::int64_t count) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(600);
  while (device.writes().count < count) {
    if (std::chrono::steady_clock::now() > end) FAIL("a write did not come in 600 s");
    std::this_thread::yield();
  }
}

struct Run {
  SelfTestResult result;
  std::string words;
  Vec3 weight = Vec3::Zero();  ///< Weight at the start [N].
  double farthest = 0.0;       ///< [m]
};

HidHost inVirtualTime() {
  HidHost host;
  host.now = virtualNow;
  host.carries = 3.0;
  return host;
}

/// Runs the self-test like `palpate devices --test`. A hand holds the arm for the first second.
Run tried(const HidProfile& profile, const std::vector<HidMass>& masses) {
  ArmParams params;
  params.mass = 0.15;
  params.viscous = 0.5;
  params.coulomb = 0.05;
  params.encoder = 0.0;  // the joints' counts are the encoder steps
  params.delay = 1e-3;
  HeavyArm arm(profile, params, masses);
  HidDevice device(profile, std::make_unique<Port>(arm), false, inVirtualTime());
  SelfTestParams of;
  of.down = -Vec3::UnitZ();
  SelfTest test(of);
  LimiterState limiter;
  const ForceLimits limits{of.force, 100.0};
  Run run;
  run.weight = arm.weight();
  std::int64_t count = device.writes().count;
  for (int i = 0; i < 60000 && !test.done(); ++i) {
    arm.waits = true;
    virtual_now += 1000000;
    const HandState hand = device.read();
    const Vec3 wanted = test.next(hand, i / kRate, limiter.sent);
    device.carry(hand.ready);
    device.write(limitForce(wanted, hand.position, 1.0 / kRate, limits, limiter).force);
    awaitWrites(device, ++count);
    if (i > 1000) arm.step();
    run.farthest = std::max(run.farthest, hand.position.norm());
  }
  run.result = test.result();
  for (const std::string& problem : run.result.problems) run.words += problem + "; ";
  return run;
}

}  // namespace

TEST_CASE(
    "the self-test measures a heavy arm's weight, and the arm passes with gravity compensation",
    "[hid][gravity][release]") {
  const Run light = tried(woody(), {});
  CAPTURE(light.words);
  REQUIRE(light.result.problems.empty());

  // First the weight at the tip is about 0.3 N, which the self-test can hold with its 0.5 N. Then
  // it is five times as large, which is too much.
  for (const double scale : {1.0, 5.0}) {
    CAPTURE(scale);
    const std::vector<HidMass> masses{{0.02 * scale, std::nullopt, Vec3::Zero()},
                                      {0.015 * scale, 2, {0.1, 0.01, 0.0}},
                                      {0.03 * scale, 1, {0.1, 0.0, 0.02}}};
    const Run falls = tried(woody(), masses);
    CAPTURE(falls.words, falls.weight.transpose());
    CHECK(falls.farthest < 0.06);
    CHECK(falls.result.held == (scale == 1.0));
    const double weight = falls.weight.norm();
    // If the self-test could not hold the arm, the measured weight is too small by the friction,
    // 0.05 N.
    CHECK(falls.result.weight + (falls.result.held ? 0.0 : 0.05) == Approx(weight).epsilon(0.1));
    WARN("weight " << weight << " N, found " << falls.result.weight
                   << (falls.result.held ? "" : " and what friction holds"));
    CHECK_THAT(falls.words, Contains("the released arm moves in direction"));
    for (const AxisResult& axis : falls.result.axes) {
      CHECK(axis.driven);  // the arm has motors, but the test ended before the pushes
      CHECK_FALSE(axis.pushed);
    }

    HidProfile carried = woody();
    carried.masses = masses;
    CHECK((factsOf(carried).carried_W + falls.weight).norm() < 1e-3 * weight);
    const Run good = tried(carried, masses);
    CAPTURE(good.words);
    REQUIRE(good.result.problems.empty());
    for (std::size_t a = 0; a < 3; ++a) {
      const AxisResult& axis = good.result.axes[a];
      const AxisResult& free = light.result.axes[a];
      REQUIRE(axis.fitted);
      CHECK(axis.pushed);
      WARN("scale " << scale << ", axis " << a << ": b " << axis.viscous << " (" << free.viscous
                    << " without weight), c " << axis.coulomb << " (" << free.coulomb << "), bias "
                    << axis.bias);
      CHECK(axis.viscous == Approx(free.viscous).margin(0.03));
      CHECK(axis.coulomb == Approx(free.coulomb).margin(0.01));
      CHECK(std::abs(axis.bias) < 0.02);
    }
  }
}

TEST_CASE(
    "gravity compensation acts only while the arm may be driven and within its motors' limits",
    "[hid][gravity][safety]") {
  HidProfile profile = woody();
  profile.masses = {{0.1, std::nullopt, Vec3::Zero()}};
  HeavyArm arm(profile, ArmParams{}, {});
  bool tested = true;
  const auto open = [&] {
    arm.waits = true;
    return std::make_unique<HidDevice>(profile, std::make_unique<Port>(arm), tested,
                                       inVirtualTime());
  };
  auto device = open();
  std::int64_t count = 0;
  /// Returns the motors' torques after a number of ticks. `may` permits the motors to carry the
  /// weight.
  const auto after = [&](int ticks, bool may, const Vec3& force = Vec3::Zero()) {
    for (int i = 0; i < ticks; ++i) {
      arm.waits = true;
      virtual_now += 1000000;
      (void)device->read();
      device->carry(may);
      device->write(force);
      awaitWrites(*device, ++count);
    }
    return Vec3(kTorque * arm.motors());
  };
  const Joints home{0.0, 0.3, M_PI / 2};
  const Joints all = carryingTorques(profile, home);
  const Vec3 whole(all[0], all[1], all[2]);
  CHECK(whole.norm() > 0.1 * kG * 0.19);
  CHECK(after(1, false).norm() == 0.0);
  // The torques that carry the weight grow linearly over 0.5 s, and drop to zero within one tick.
  Vec3 last = after(1, true);
  for (int i = 0; i < 499; ++i) {
    const Vec3 now = after(1, true);
    REQUIRE((now - last).norm() <= 1.1 * whole.norm() / 500.0 + 3.0 * kTorque);
    last = now;
  }
  CHECK((after(2, true) - whole).norm() < 3.0 * kTorque);
  CHECK(after(1, false).norm() == 0.0);
  CHECK(after(1, true).norm() < 0.01 * whole.norm());
  (void)after(500, true);
  // The device adds the force to the weight's torques. If a motor cannot give both, the device
  // reduces the force.
  const Vec3 push(0.0, 0.0, 2.0);
  const ArmPose pose = profile.kinematics->at(home);
  const auto torquesOf = [&](const Vec3& force) {
    return Vec3(pose.jacobian[0].dot(force), pose.jacobian[1].dot(force),
                pose.jacobian[2].dot(force));
  };
  CHECK((after(1, true, push) - whole - torquesOf(push)).norm() < 5.0 * kTorque);
  CHECK(device->given() == 1.0);
  const Vec3 most = after(1, true, 10.0 * push);
  CHECK(device->given() < 0.5);
  CHECK(most.cwiseAbs().maxCoeff() <= 1.0 + kTorque);
  CHECK((most - whole - device->given() * torquesOf(10.0 * push)).norm() < 5.0 * kTorque);
  // If no report comes for longer than HidLimits::stale, the motors stop carrying the weight.
  // Afterwards their torques grow from zero again.
  (void)after(10, true);
  for (int i = 0; i < 60; ++i) {
    virtual_now += 1000000;
    (void)device->read();
    device->carry(true);
    device->write(Vec3::Zero());
    awaitWrites(*device, ++count);
  }
  CHECK(arm.motors().norm() == 0.0);
  CHECK(after(2, true).norm() < 0.01 * whole.norm());
  (void)after(500, true);
  // The weight's torques also start from zero if carrying is forbidden and permitted again between
  // two reads.
  device->carry(false);
  CHECK(after(1, true).norm() < 0.01 * whole.norm());
  (void)after(500, true);
  device.reset();
  CHECK(arm.motors().norm() == 0.0);
  // The motors of an untested arm carry at most ArmHost::carries at the tip, here 3 N.
  tested = false;
  profile.masses[0].mass = 1.0;
  device = open();
  count = 0;
  const Vec3 held = after(520, true);
  const Vec3 tip = forceOf(profile, pose, {held.x(), held.y(), held.z()});
  CHECK(tip.norm() == Approx(3.0).epsilon(1e-2));
}

TEST_CASE("gravity compensation plus an additional force never overheats a motor",
          "[hid][gravity][safety]") {
  HidProfile profile = woody();
  profile.masses = {{0.1, std::nullopt, Vec3::Zero()}, {0.05, 1, {0.1, 0.02, 0.0}}};
  profile.limits.force = 100.0;
  const ArmPose pose = profile.kinematics->at({0.0, 0.3, M_PI / 2});
  const Joints weight = carryingTorques(profile, {0.0, 0.3, M_PI / 2});
  test::Random random(17);
  for (const double holds : {0.35, 0.1}) {  // more and less than the weight needs
    CAPTURE(holds);
    for (HidJoint& joint : profile.joints) {
      joint.continuous = holds;
      joint.heating = 2.0;
    }
    HeavyArm arm(profile, ArmParams{}, {});
    HidDevice device(profile, std::make_unique<Port>(arm), true, inVirtualTime());
    std::int64_t count = 0;
    Vec3 heat = Vec3::Constant(holds * holds);  // the windings start hot
    Vec3 told = Vec3::Zero();
    double hottest = 0.0;
    double off = 0.0;  // largest error of the force that is added to the weight
    long whole = 0;    // number of ticks in which the whole weight was carried
    const long cases = test::cases(20000);
    for (long i = 0; i < cases; ++i) {
      const double dt = random.uniform(0.0, MotorHeat::kHold);
      arm.waits = true;
      virtual_now += std::llround(1e9 * dt);
      heat += -std::expm1(-dt / 2.0) * (told.cwiseAbs2() - heat);
      hottest = std::max(hottest, heat.maxCoeff() / (holds * holds));
      (void)device.read();
      device.carry(random.integer(3000) != 0);
      const Vec3 force = (random.integer(3) == 0 ? 2.0 : 8.0) * random.direction();
      device.write(force);
      awaitWrites(device, ++count);
      told = kTorque * arm.motors();
      REQUIRE(told.cwiseAbs().maxCoeff() <= 1.0 + 1e-9);
      // The torques are the sum of the weight's torques, times a share that grows, and the force's
      // torques.
      Vec3 carried = told;
      for (std::size_t j = 0; j < 3; ++j) {
        carried[static_cast<Eigen::Index>(j)] -= device.given() * pose.jacobian[j].dot(force);
      }
      const Vec3 all(weight[0], weight[1], weight[2]);
      const double share = carried.dot(all) / all.squaredNorm();
      off = std::max(off, (carried - share * all).norm());
      if (share > 0.999) ++whole;
      REQUIRE(share > -1e-3);
      REQUIRE(share * all.cwiseAbs().maxCoeff() <=
              std::min(1.001 * all.cwiseAbs().maxCoeff(), holds + 2.0 * kTorque));
    }
    CHECK(hottest <= 1.0);
    CHECK(off < 3.0 * kTorque);
    CHECK((whole > cases / 2) == (holds > 0.2));
  }
}

}  // namespace palpate::gravity_test
