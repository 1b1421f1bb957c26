/// Tests the driver of arms of USB's PID class on simulated devices with several kinds of firmware.
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

#include "palpate/devices/hid/pid_device.h"
#include "palpate/devices/simulated/stability.h"
#include "palpate/engine/error.h"
#include "tests/fuzz/pid_entry.h"
#include "tests/support/counters.h"
#include "tests/support/pid_model.h"
#include "tests/support/random.h"

namespace palpate::pid_test {
using namespace std::chrono_literals;
using Catch::Contains;
using test::PidModel;
using test::PidShape;

namespace {

/// The clock of devices and drivers. Tests advance it, and each write advances it by Wire::takes.
std::atomic<std::int64_t> virtual_now{1000000000};
std::int64_t virtualNow() noexcept {
  return virtual_now;
}
double seconds() {
  return 1e-9 * static_cast<double>(virtual_now);
}
void pass(double time) {
  virtual_now += std::llround(1e9 * time);
}

/// A device and its connection to the driver.
class Wire {
 public:
  explicit Wire(PidShape shape = {}) : model(shape), raw(static_cast<std::size_t>(shape.axes)) {}
  void say(std::vector<std::byte> report) {
    const std::lock_guard lock(mutex);
    waits.push_back(std::move(report));
  }
  double share(int axis) {
    const std::lock_guard lock(mutex);
    return model.share(axis, seconds());
  }
  int playing() {
    const std::lock_guard lock(mutex);
    return model.playing(seconds());
  }
  long outputs() {
    const std::lock_guard lock(mutex);
    return model.outputs();
  }

  std::mutex mutex;
  PidModel model;
  std::vector<int> raw;  ///< Reported position, in counts.
  std::uint32_t buttons = 0;
  std::deque<std::vector<std::byte>> waits;
  std::vector<std::byte> fixed;  ///< If not empty, sent instead of `raw`; does not allocate.
  double takes = 0.0;            ///< Duration of a write [s].
  double strongest = 0.0;        ///< Largest share of its full force that a motor has had.
  double together = 0.0;         ///< Largest sum of all motors' shares.
  bool there = true;
};

class WirePort final : public ReportPort {
 public:
  explicit WirePort(Wire& wire) : wire_(wire) {}
  [[nodiscard]] ReadStatus read(std::span<std::byte> to, std::size_t& size) noexcept override {
    const std::lock_guard lock(wire_.mutex);
    if (!wire_.there) return ReadStatus::kGone;
    std::vector<std::byte> report;
    if (!wire_.waits.empty()) {
      report = wire_.waits.front();
      wire_.waits.pop_front();
    } else if (!(asked_ = !asked_)) {
      return ReadStatus::kNothing;
    } else if (!wire_.fixed.empty()) {
      size = wire_.fixed.size();
      std::copy_n(wire_.fixed.begin(), size, to.begin());
      return ReadStatus::kReport;
    } else {
      report = wire_.model.input(wire_.raw, wire_.buttons);
    }
    size = std::min(report.size(), to.size());
    std::copy_n(report.begin(), size, to.begin());
    return ReadStatus::kReport;
  }
  [[nodiscard]] bool write(std::span<const std::byte> report) noexcept override {
    return take(report);
  }
  [[nodiscard]] bool sendFeature(std::span<const std::byte> report) noexcept override {
    return take(report);
  }
  [[nodiscard]] bool getFeature(std::span<std::byte> report, std::size_t& size) noexcept override {
    const std::lock_guard lock(wire_.mutex);
    const auto answer = wire_.model.feature(std::to_integer<int>(report[0]));
    size = std::min(answer.size(), report.size());
    std::copy_n(answer.begin(), size, report.begin());
    return wire_.there && size > 0;
  }
  [[nodiscard]] int guardDescriptor() const noexcept override { return 0; }

 private:
  bool take(std::span<const std::byte> report) noexcept {
    pass(wire_.takes);
    const std::lock_guard lock(wire_.mutex);
    if (!wire_.there) return false;
    wire_.model.output(report, seconds());
    double together = 0.0;
    for (int a = 0; a < 3; ++a) {
      together += std::abs(wire_.model.share(a, seconds()));
      wire_.strongest = std::max(wire_.strongest, std::abs(wire_.model.share(a, seconds())));
    }
    wire_.together = std::max(wire_.together, together);
    return true;
  }
  Wire& wire_;
  bool asked_ = false;  ///< True in every second read, which returns a report.
};

/// Returns a profile with 0.2 m and 8 N per axis. The y axis is inverted.
HidProfile stick(int axes) {
  HidProfile profile;
  profile.name = "stick";
  profile.source = "stick.json";
  std::vector<int> directions;
  for (int a = 0; a < axes; ++a) {
    const double sign = a == 1 ? -1.0 : 1.0;
    profile.pid.push_back({a, sign * 0.2, sign * 8.0});
    directions.push_back(a);
  }
  profile.kinematics = makeSlides(directions);
  profile.output.emplace();
  profile.output_rate = 1e9;  // so high that pacing never delays a force in virtual time
  profile.limits = {5.0, 2000.0, 1000.0, 5.0, 0.1, 0.05, 3.0, 0.0, 0.0};
  return profile;
}

std::unique_ptr<PidDevice> open(Wire& wire, bool tested = true, HidHost host = {},
                                double rate = 1e9, int axes = 0) {
  host.now = virtualNow;
  HidProfile profile = stick(axes == 0 ? static_cast<int>(wire.raw.size()) : axes);
  profile.output_rate = rate;
  return std::make_unique<PidDevice>(profile, wire.model.descriptor(),
                                     std::make_unique<WirePort>(wire), tested, std::move(host));
}

template <class What>
void await(What what) {
  const auto end = std::chrono::steady_clock::now() + 600s;
  while (!what()) {
    if (std::chrono::steady_clock::now() > end) FAIL("the awaited state did not come in 600 s");
    std::this_thread::sleep_for(100us);
  }
}

/// Writes a force and waits until it has been sent.
void send(PidDevice& device, const Vec3& force) {
  const std::int64_t before = device.traffic().writes;
  device.write(force);
  await([&] { return device.traffic().writes > before; });
}

std::string refusal(Wire& wire) {
  try {
    (void)open(wire);
  } catch (const DeviceError& error) {
    return error.what();
  }
  return "none";
}

PidMap mapOf(const PidModel& model) {
  const auto device = parseHidDescriptor(model.descriptor());
  REQUIRE(device);
  return readPidMap(*device, "arm");
}

}  // namespace

TEST_CASE("a PID device with one to three axes gives positions and takes forces", "[hid][pid]") {
  PidShape shape;
  shape.rhino = GENERATE(false, true);
  shape.axes = GENERATE(1, 2, 3);
  CAPTURE(shape.rhino, shape.axes);
  Wire wire(shape);
  {
    const auto device = open(wire);
    CHECK(wire.model.made() == shape.axes);
    CHECK(wire.playing() == shape.axes);
    CHECK(wire.model.active());
    CHECK(wire.model.gainShare() == 1.0);
    CHECK(wire.strongest == 0.0);
    CHECK(device->info().limits.peak == 5.0);
    CHECK(device->steps().size() == static_cast<std::size_t>(shape.axes));
    const double step = 0.2 / (2.0 * wire.model.full());
    CHECK(device->steps()[0] == Approx(step));

    (void)device->read();
    const std::vector<double> parts{0.5, -0.25, 1.0};
    Vec3 stands = Vec3::Zero();
    for (int a = 0; a < shape.axes; ++a) {
      wire.raw[static_cast<std::size_t>(a)] =
          static_cast<int>(std::lround(parts[static_cast<std::size_t>(a)] * wire.model.full()));
      stands[a] = (a == 1 ? -0.1 : 0.1) * parts[static_cast<std::size_t>(a)];
    }
    const HandState hand = device->read();
    CHECK((hand.position - stands).norm() < 2.0 * step);
    CHECK(hand.ready);
    CHECK(hand.fault == Fault::kNone);
    Vec3 along = Vec3::Zero();
    along.head(shape.axes).setOnes();
    CHECK(hand.drives.isApprox(Mat3(along.asDiagonal())));

    const Vec3 force(2.0, -1.0, 0.5);
    send(*device, force);
    for (int a = 0; a < shape.axes; ++a) {
      CAPTURE(a);
      // A direction field of 8 bits turns a force along x by 0.35 degrees.
      CHECK(wire.share(a) * (a == 1 ? -8.0 : 8.0) == Approx(force[a]).margin(0.02));
    }
    send(*device, Vec3::Zero());
    for (int a = 0; a < shape.axes; ++a) CHECK(wire.share(a) == 0.0);
    send(*device, {4.0, 0.0, 0.0});
  }
  CHECK(wire.model.made() == (shape.free ? 0 : shape.axes));
  CHECK(wire.playing() == 0);
  CHECK_FALSE(wire.model.active());
  CHECK(wire.model.strange() == 0);
}

TEST_CASE("palpate sends no report that the PID device lacks", "[hid][pid]") {
  PidShape shape;
  shape.rhino = GENERATE(false, true);
  const int without = GENERATE(0, 1, 2, 3, 4, 5, 6, 7);
  CAPTURE(shape.rhino, without);
  bool* all[] = {&shape.pool,    &shape.gain,  &shape.free,   &shape.create,
                 &shape.control, &shape.state, &shape.extras, &shape.duration};
  *all[without] = false;
  Wire wire(shape);
  if (!shape.control) wire.model.setActive(true);
  {
    const auto device = open(wire);
    CHECK(device->read().ready);
    send(*device, {2.0, -1.0, 0.0});
    CHECK(wire.share(0) * 8.0 == Approx(2.0).margin(0.02));
    CHECK(wire.share(1) * -8.0 == Approx(-1.0).margin(0.02));
    CHECK((device->zeroForce().descriptor < 0) == !shape.control);
    const std::string& source = device->info().source;
    CHECK((source.find("it has no guardian") == std::string::npos) == shape.control);
    CHECK((source.find("ends within 0.5 s") == std::string::npos) == !shape.duration);
    CHECK((source.find("effects have no duration") == std::string::npos) == shape.duration);
  }
  CHECK(wire.playing() == 0);
  CHECK(wire.model.strange() == 0);
}

TEST_CASE(
    "an effect is stopped individually if the PID device can neither free nor stop all effects",
    "[hid][pid]") {
  PidShape shape;
  shape.free = shape.control = false;
  Wire wire(shape);
  wire.model.setActive(true);
  {
    const auto device = open(wire);
    send(*device, {2.0, 0.0, 0.0});
    CHECK(wire.playing() == 2);
  }
  CHECK(wire.playing() == 0);
}

TEST_CASE("an untested PID device opens without force and with a tenth of its gain", "[hid][pid]") {
  PidShape shape;
  shape.rhino = GENERATE(false, true);
  shape.wakes_with = 4000;  // the firmware gives each new effect this magnitude
  Wire wire(shape);
  const auto device = open(wire, false);
  CHECK(wire.strongest == 0.0);
  CHECK(wire.model.gainShare() <= PidDevice::kUntestedGain);
  CHECK(wire.model.gainShare() > 0.09);
  CHECK(device->info().limits.peak == kUntestedForce);
  CHECK(device->info().max_stiffness <= kUntestedStiffness);
  CHECK_THAT(device->info().source, Contains("its gain is reduced to a tenth"));
  // The force does not exceed the requested one, even if the firmware ignores its gain.
  send(*device, {0.5, 0.0, 0.0});
  CHECK(8.0 * wire.share(0) == Approx(0.5 * wire.model.gainShare()).epsilon(0.03));
  CHECK(8.0 * wire.share(0) / wire.model.gainShare() <= 0.5);
  // During the self-test the gain is full.
  HidHost host;
  host.tests = true;
  Wire other(shape);
  const auto tested = open(other, false, host);
  CHECK(tested->info().limits.peak == kUntestedForce);
  send(*tested, {0.5, 0.0, 0.0});
  CHECK(8.0 * other.share(0) == Approx(0.5).epsilon(0.03));
}

TEST_CASE("a PID device that cannot create its effects is refused with the reason", "[hid][pid]") {
  PidShape shape;
  shape.rhino = GENERATE(false, true);
  {
    shape.load_status = 2;
    Wire wire(shape);
    CHECK_THAT(refusal(wire), Contains("arm stick: it has no memory left for an effect: "));
    // If opening fails, the driver disables the actuators again.
    CHECK_FALSE(wire.model.active());
  }
  {
    shape.load_status = 3;
    Wire wire(shape);
    CHECK_THAT(refusal(wire),
               Contains("it cannot create a constant force: it reports that the effect failed:"));
  }
  {
    shape.load_status = 0;
    Wire wire(shape);
    CHECK_THAT(refusal(wire),
               Contains("it does not report the index of the effect: plug it in again"));
  }
  {
    shape.load_status = 1;
    shape.load_zero = true;
    Wire wire(shape);
    CHECK_THAT(refusal(wire), Contains("it has given the effect the index 0"));
  }
  {
    shape.load_zero = false;
    shape.load_refused = 1000;
    Wire wire(shape);
    CHECK_THAT(refusal(wire),
               Contains("it does not answer the request for the index of the effect"));
  }
  {
    shape.load_refused = 5;  // the driver retries for a slow device
    Wire wire(shape);
    CHECK(refusal(wire) == "none");
  }
  {
    // The driver ignores outdated status reports of the previous effect, so each force acts along
    // the right axis.
    PidShape late = shape;
    late.load_refused = 0;
    late.load_stale = 3;
    Wire wire(late);
    const auto device = open(wire);
    send(*device, {0.5, 0.0, 0.0});
    CHECK(8.0 * wire.share(0) == Approx(0.5).epsilon(0.03));
    CHECK(wire.share(1) == Approx(0.0).margin(1e-3));
  }
  {
    shape.at_once = 1;
    Wire wire(shape);
    CHECK_THAT(
        refusal(wire),
        Contains(
            "it plays at most 1 effects at the same time, and each axis needs one: remove axes"));
    shape.at_once = 0;  // the device does not report this number
    Wire other(shape);
    CHECK(refusal(other) == "none");
  }
}

TEST_CASE("PID effects have a finite duration and are renewed before it ends", "[hid][pid]") {
  PidShape shape;
  shape.rhino = GENERATE(false, true);
  shape.duration_bits = GENERATE(8, 16);
  shape.longest = GENERATE(1e9, 65.0);
  CAPTURE(shape.rhino, shape.duration_bits, shape.longest);
  Wire wire(shape);
  const auto device = open(wire);
  for (const std::int64_t raw : wire.model.durations()) {
    CHECK(raw > 0);
    CHECK(raw < (1 << shape.duration_bits) - 1);
    CHECK(raw == (shape.duration_bits == 8 ? 254 : 500));
  }
  // The force is held for 130 s.
  const Vec3 force(2.0, 1.0, 0.0);
  for (int i = 0; i < 6500; ++i) {
    send(*device, force);
    REQUIRE(wire.share(0) > 0.2);
    pass(0.02);
  }
  // The driver restarts an effect about four times per duration, not with every force.
  const double times =
      wire.model.starts() / 2.0 / (130.0 / (shape.duration_bits == 8 ? 0.254 : 0.5));
  CHECK(times > 3.0);
  CHECK(times < 4.6);
  pass(0.51);
  CHECK(wire.share(0) == 0.0);
  CHECK(wire.playing() == 0);
  send(*device, force);
  CHECK(wire.share(0) > 0.2);
}

TEST_CASE("a PID effect that cannot restart while it plays is restarted after its end",
          "[hid][pid]") {
  PidShape shape;
  shape.deaf_to_starts = true;
  Wire wire(shape);
  const auto device = open(wire);
  double without = 0.0;
  double longest = 0.0;
  for (int i = 0; i < 1000; ++i) {
    send(*device, {2.0, 0.0, 0.0});
    without = wire.share(0) > 0.2 ? 0.0 : without + 0.01;
    longest = std::max(longest, without);
    pass(0.01);
  }
  CHECK(longest <= 0.25 * PidPort::kDuration + 0.011);
}

TEST_CASE("a PID device is sent only the magnitudes that have changed", "[hid][pid]") {
  Wire wire;
  const auto device = open(wire);
  send(*device, {1.0, 1.0, 0.0});
  const auto sent = [&](const Vec3& force) {
    const long before = wire.outputs();
    send(*device, force);
    return wire.outputs() - before;
  };
  CHECK(sent({1.0, 1.0, 0.0}) == 0);
  CHECK(sent({1.0, 2.0, 0.0}) == 1);
  CHECK(sent({0.5, 2.0, 0.0}) == 1);
  CHECK(sent({0.0, 0.0, 0.0}) == 2);
  CHECK(sent({0.0, 0.0, 5.0}) == 0);  // the arm has no z axis
  CHECK(wire.share(0) == 0.0);
  CHECK(sent({NAN, 0.0, 0.0}) == 0);
}

TEST_CASE("a PID device gets a smaller force on one axis before a larger force on another axis",
          "[hid][pid]") {
  Wire wire;
  const auto device = open(wire);
  for (const Vec3& force : {Vec3(4, 0, 0), Vec3(0, 4, 0), Vec3(4, 0, 0)}) {
    send(*device, force);
    pass(0.2);  // an effect is renewed as well
  }
  CHECK(wire.together == Approx(0.5).margin(1e-3));
}

TEST_CASE("a PID device's lost power, open safety switch and stopped actuators are faults",
          "[hid][pid]") {
  Wire wire;
  const auto device = open(wire);
  const auto says = [&](bool active, bool power, bool safety) {
    wire.model.setActive(active);
    wire.model.setPower(power);
    wire.model.setSafety(safety);
    wire.say(wire.model.state());
    return device->read();
  };
  (void)device->read();
  // State bits that the device has never set are ignored.
  CHECK(says(true, false, false).fault == Fault::kNone);
  CHECK(device->read().ready);
  // The power returns. The device would apply the old force at once, so the force starts from zero
  // as after opening.
  const HandState powered = says(true, true, false);
  CHECK(powered.fault == Fault::kNone);
  CHECK_FALSE(powered.ready);
  CHECK(device->read().ready);
  CHECK(says(true, false, false).fault == Fault::kPower);
  CHECK(device->read().fault == Fault::kPower);
  CHECK(says(true, true, true).fault == Fault::kNone);
  CHECK(says(true, true, false).fault == Fault::kSwitch);
  CHECK(says(true, true, true).fault == Fault::kNone);
  CHECK(says(false, true, true).fault == Fault::kPower);
}

TEST_CASE("actuators that a guardian stopped are enabled again only at zero force", "[hid][pid]") {
  PidShape shape;
  shape.stops_deaf = true;
  Wire wire(shape);
  const auto device = open(wire);
  wire.say(wire.model.state());
  (void)device->read();
  (void)device->read();
  send(*device, {2.0, 0.0, 0.0});
  CHECK(wire.share(0) > 0.2);
  const ZeroForce zero = device->zeroForce();
  CHECK(zero.descriptor >= 0);
  {
    const std::lock_guard lock(wire.mutex);
    wire.model.output(zero.bytes, seconds());
  }
  CHECK(wire.share(0) == 0.0);
  wire.say(wire.model.state());
  CHECK(device->read().fault == Fault::kPower);
  // The actuators stay off while the written force is not zero.
  pass(2.0);
  send(*device, {2.0, 0.0, 0.0});
  CHECK_FALSE(wire.model.active());
  send(*device, Vec3::Zero());
  CHECK(wire.model.active());
  CHECK(wire.playing() == 2);
  wire.say(wire.model.state());
  CHECK(device->read().fault == Fault::kNone);
  send(*device, {2.0, 0.0, 0.0});
  CHECK(wire.share(0) > 0.2);
}

TEST_CASE("one control report stops the force of a PID device on all axes", "[hid][pid]") {
  PidShape shape;
  shape.rhino = GENERATE(false, true);
  Wire wire(shape);
  const auto device = open(wire);
  send(*device, {2.0, 1.0, 0.0});
  CHECK(wire.share(0) > 0.2);
  const ZeroForce zero = device->zeroForce();
  CHECK(zero.bytes.size() == 2);
  CHECK(std::to_integer<int>(zero.bytes[0]) == wire.model.id("control"));
  wire.model.output(zero.bytes, seconds());
  CHECK(wire.share(0) == 0.0);
  CHECK(wire.share(1) == 0.0);
  CHECK(wire.model.active());  // still enabled
}

TEST_CASE("the stiffness limit of a PID device follows from the time that its reports take",
          "[hid][pid]") {
  PidShape shape;
  shape.axes = 2;
  Wire wire(shape);
  wire.takes = 0.005;
  {
    const auto device = open(wire);
    CHECK(device->info().output_rate == Approx(100.0));  // two axes with reports of 5 ms each
    ArmParams arm;
    arm.viscous = PidDevice::kLikelyViscous;
    arm.delay = 0.011;
    // The coupling's damping may use half of the arm's friction.
    CHECK(device->info().max_damping == Approx(0.5 * arm.viscous));
    CHECK(device->info().max_stiffness == Approx(passiveStiffness(arm, 100.0, 0.5 * arm.viscous)));
    CHECK(device->info().max_stiffness < 20.0);
    CHECK(device->traits().stiffness == device->info().max_stiffness);
    CHECK_THAT(device->info().source,
               Contains("from 100 forces per second, a delay of 11 ms and a guessed friction"));
  }
  wire.takes = 0.0;
  // If reports take less time, the output rate is the profile's.
  CHECK(open(wire, true, {}, 500.0)->info().output_rate == 500.0);
  // If friction and delay were measured, they determine the limit.
  HidHost host;
  host.measured = {2.0, 0.1, 0.003, 0.001, 0.2};
  const auto device = open(wire, true, host, 500.0);
  ArmParams arm;
  arm.viscous = 2.0;
  arm.delay = 0.004;
  CHECK(device->info().max_stiffness == Approx(passiveStiffness(arm, 500.0, 1.0)));
  CHECK_THAT(device->info().source, Contains("a measured friction"));
}

TEST_CASE("a reconnected PID device gets its effects again", "[hid][pid]") {
  Wire wire;
  HidHost host;
  host.find = [&]() -> std::unique_ptr<ReportPort> {
    const std::lock_guard lock(wire.mutex);
    if (!wire.there) return nullptr;
    wire.model = PidModel(PidShape{});
    return std::make_unique<WirePort>(wire);
  };
  const auto device = open(wire, true, host);
  send(*device, {2.0, 0.0, 0.0});
  const std::uint32_t version = device->zeroForce().version;
  {
    const std::lock_guard lock(wire.mutex);
    wire.there = false;
  }
  CHECK(device->read().fault == Fault::kGone);
  {
    const std::lock_guard lock(wire.mutex);
    wire.there = true;
  }
  await([&] { return device->zeroForce().version != version; });
  CHECK(wire.playing() == 2);
  (void)device->read();
  CHECK(device->read().fault == Fault::kNone);
  send(*device, {1.0, 0.0, 0.0});
  CHECK(wire.share(0) == Approx(0.125).margin(1e-3));
  CHECK(wire.model.strange() == 0);
}

TEST_CASE("a PID device's buttons are reported", "[hid][pid]") {
  Wire wire;
  const auto device = open(wire);
  CHECK(device->info().handle.buttons.size() == 32);
  (void)device->read();
  wire.buttons = 0x80000005U;
  wire.say(wire.model.state());  // a state report, which has no positions
  CHECK(device->read().handle.buttons == 0x80000005U);
  wire.buttons = 0;
  CHECK(device->read().handle.buttons == 0);
}

TEST_CASE("reading and writing a PID device does not allocate", "[hid][pid][realtime]") {
  Wire wire;
  const auto device = open(wire);
  wire.fixed = wire.model.input(wire.raw);
  const test::CountScope scope;
  for (int i = 0; i < 100; ++i) {
    (void)device->read();
    device->write({0.01 * i, 0.0, 0.0});
  }
  CHECK(test::CountScope::counts().allocations == 0);
}

TEST_CASE("a PID descriptor without a required part is refused with the name of the part",
          "[hid][pid]") {
  const PidModel model(PidShape{});
  CHECK(mapOf(model).buttons.size() == 32);
  // Replaces the usage that identifies a report.
  const auto without = [&](int usage, int instead) {
    std::vector<std::byte> bytes = model.descriptor();
    for (std::size_t i = 0; i + 1 < bytes.size(); ++i) {
      const bool here = bytes[i] == std::byte{0x09} && std::to_integer<int>(bytes[i + 1]) == usage;
      if (here) bytes[i + 1] = static_cast<std::byte>(instead);
    }
    const auto device = parseHidDescriptor(bytes);
    REQUIRE(device);
    try {
      const PidMap map = readPidMap(*device, "arm");
      (void)describedBy(map, stick(2));
    } catch (const DeviceError& error) {
      return std::string(error.what());
    }
    return std::string("none");
  };
  CHECK_THAT(without(0x73, 0x01), Contains("no report for the magnitude of a constant force"));
  CHECK_THAT(without(0x70, 0x01), Contains("no report for the magnitude of a constant force"));
  CHECK_THAT(without(0x22, 0x01), Contains("no report for the magnitude of a constant force"));
  CHECK_THAT(without(0x77, 0x01), Contains("no report that starts and stops an effect"));
  CHECK_THAT(without(0x7B, 0x01), Contains("no report that starts and stops an effect"));
  CHECK_THAT(without(0x26, 0x01), Contains("its descriptor cannot set the type of an effect"));
  CHECK(without(0x31, 0x34) ==
        "stick.json: /pid/axes/1: the device does not report a position along y: remove "
        "this axis");
  CHECK(without(0x99, 0x01) == "none");

  // A magnitude field whose minimum is 0 could push in one direction only.
  std::vector<std::byte> bytes = model.descriptor();
  for (std::size_t i = 0; i + 4 < bytes.size(); ++i) {
    if (bytes[i] != std::byte{0x70} || bytes[i + 1] != std::byte{0x16}) continue;
    bytes[i + 2] = bytes[i + 3] = std::byte{0};
  }
  const auto pulls = parseHidDescriptor(bytes);
  REQUIRE(pulls);
  CHECK_THROWS_WITH(readPidMap(*pulls, "arm"),
                    Contains("its constant force cannot be both positive and negative"));
}

TEST_CASE("mutated PID descriptors and answers never crash the driver of PID devices",
          "[hid][pid][fuzz]") {
  test::Random random(11);
  std::vector<std::vector<std::byte>> seeds;
  for (const bool rhino : {false, true}) {
    for (const int axes : {1, 2, 3}) {
      PidShape shape;
      shape.rhino = rhino;
      shape.axes = axes;
      seeds.push_back(PidModel(shape).descriptor());
    }
  }
  const auto any = [&](std::size_t count) {
    return static_cast<std::size_t>(random.integer(static_cast<int>(count)));
  };
  long opened = 0;
  const long cases = test::cases(20000);
  for (long i = 0; i < cases; ++i) {
    std::vector<std::byte> descriptor = seeds[any(seeds.size())];
    for (std::size_t k = any(7); k > 0; --k) {
      descriptor[any(descriptor.size())] = static_cast<std::byte>(any(256));
    }
    if (any(8) == 0) descriptor.resize(any(descriptor.size()));
    if (any(16) == 0)
      descriptor.insert(descriptor.end(), any(300), static_cast<std::byte>(any(256)));
    // The bytes of the answers: first the pool report, then a block load report for each axis, then
    // input reports.
    std::vector<std::byte> says(any(400));
    for (std::byte& b : says) b = static_cast<std::byte>(any(256));
    if (any(4) != 0) {
      const std::vector<int> good{4, 19, 0, 1, 16, 3, 18, 1, 1, 3, 18, 2, 1};
      for (std::size_t k = 0; k < std::min(good.size(), says.size()); ++k) {
        if (any(20) != 0) says[k] = static_cast<std::byte>(good[k]);
      }
    }
    opened += static_cast<long>(test::fuzzPid(descriptor, says));
  }
  CHECK(20 * opened > cases - 100);
}

}  // namespace palpate::pid_test
