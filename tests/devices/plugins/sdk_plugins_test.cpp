/// Tests the plug-ins for manufacturers' SDKs through their C interface. Stubs replace the SDKs.
#include <HD/hd.h>
#include <array>
#include <chrono>
#include <cstddef>
#include <dhdc.h>
#include <falcon/core/FalconDevice.h>
#include <functional>
#include <limits>
#include <string>
#include <thread>

#include <catch2/catch.hpp>

#include "tests/devices/plugins/plugin_host.h"
#include "tests/support/counters.h"

using palpate::test::CountScope;
using palpate::test::Other;
using palpate::test::PluginHost;

namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr int kTurns = 4;  // cycles of the SDK's loop after which an order has reached the motors

using Vec = std::array<double, 3>;

/// Access to a stub. It converts frames and units independently of the plug-in.
struct Sdk {
  const char* name;
  const char* serial;
  const char* no_serial;
  void (*plug)();
  Gate& (*gate)();
  void (*place)(const Vec& p_W);
  Vec (*force_W)();
  void (*lose)();
  void (*never_ready)();
  int (*open)();
  Vec limits;  // force, stiffness, radius
};

const Sdk kOpenHaptics = {
    "openhaptics",
    "T-77",
    "Right",
    &stub_hd::plugAnew,
    []() -> Gate& { return stub_hd::arm().gate; },
    [](const Vec& p) {
      // The stub's workspace goes from -50 to 70 mm in y, so its middle is at 10 mm.
      stub_hd::arm().position[0] = 1e3 * p[0];
      stub_hd::arm().position[1] = 1e3 * p[2] + 10.0;
      stub_hd::arm().position[2] = -1e3 * p[1];
    },
    [] {
      const double* f = stub_hd::arm().force;
      return Vec{f[0], -f[2], f[1]};
    },
    [] { stub_hd::arm().lost = true; },
    [] { stub_hd::arm().calibration = HD_CALIBRATION_NEEDS_MANUAL_INPUT; },
    [] { return stub_hd::arm().open; },
    // The plug-in's table has 3.3 N for the Touch. The API's nominal force, 3 N, is less.
    {3.0, 400.0, 0.075},
};
const Sdk kDhd = {
    "dhd",
    "4711",
    "4712",
    &stub_dhd::plugAnew,
    []() -> Gate& { return stub_dhd::arm().gate; },
    [](const Vec& p) {
      stub_dhd::arm().position[0] = -p[1];
      stub_dhd::arm().position[1] = p[0];
      stub_dhd::arm().position[2] = p[2];
    },
    [] {
      const double* f = stub_dhd::arm().force;
      return Vec{f[1], -f[0], f[2]};
    },
    [] { stub_dhd::arm().lost = true; },
    [] { stub_dhd::arm().reset = false; },
    [] { return stub_dhd::arm().open; },
    {12.0, 5000.0, 0.075},
};
const Sdk kNifalcon = {
    "nifalcon",
    "0",
    "1",
    &stub_nifalcon::plugAnew,
    []() -> Gate& { return stub_nifalcon::arm().gate; },
    [](const Vec& p) {
      stub_nifalcon::arm().position = {p[0], p[2], 0.11 - p[1]};
    },
    [] {
      const auto& m = stub_nifalcon::arm().motors;
      return Vec{m[0] / 1e3, -m[2] / 1e3, m[1] / 1e3};
    },
    [] {
      stub_nifalcon::arm().lost = true;
      PluginHost::now() += 200 * kMs;
    },
    [] { stub_nifalcon::arm().homes_after = -1; },
    [] { return stub_nifalcon::arm().open; },
    {8.0, 800.0, 0.04},
};

const Sdk& anySdk() {
  const int i = GENERATE(0, 1, 2);
  const Sdk& sdk = i == 0 ? kOpenHaptics : i == 1 ? kDhd : kNifalcon;
  CAPTURE(sdk.name);
  return sdk;
}

std::string fileOf(const Sdk& sdk) {
  return std::string(PALPATE_STUBBED_PLUGINS "/") + sdk.name + ".so";
}

/// An arm of a stub, opened through its plug-in. After ready(), the SDK's loop runs only during
/// turn(), until gone() or Gate::release() lets it run freely.
class Bench {
 public:
  explicit Bench(const Sdk& which) : sdk(which), fresh_(which.plug), host(fileOf(which)) {}
  ~Bench() { sdk.gate().release(); }

  void open() { REQUIRE(host.open("")); }
  void ready() {
    open();
    REQUIRE(host.prepare() == PALPATE_PLUGIN_OK);
    sdk.gate().hold();
  }
  void turn(int turns = kTurns) { sdk.gate().turn(turns); }

  /// Returns the motors' force in W [N] after kTurns cycles of the SDK's thread.
  Vec given() {
    turn();
    return sdk.force_W();
  }

  /// Waits until the arm is reported as gone. Returns false if this takes more than about 10 s of
  /// real time.
  bool gone() {
    sdk.gate().release();
    for (int i = 0; i < 10000; ++i) {
      if (host.read() == PALPATE_PLUGIN_GONE) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return false;
  }

  const Sdk& sdk;

 private:
  // Declared before `host`: resets the stub's arm before `host` loads the plug-in.
  struct Fresh {
    explicit Fresh(void (*plug)()) { plug(); }
  } fresh_;

 public:
  PluginHost host;
};

void same(const Vec& a, const Vec& b) {
  for (std::size_t i = 0; i < 3; ++i) {
    CAPTURE(i);
    CHECK(a[i] == Approx(b[i]).margin(1e-9));
  }
}

Vec positionOf(const palpate_plugin_reading& r) {
  return {r.position[0], r.position[1], r.position[2]};
}

}  // namespace

TEST_CASE("an SDK's plug-in has the current version and struct sizes, and only the factory of arms",
          "[plugin]") {
  Bench bench(anySdk());
  const palpate_plugin_entry& entry = *bench.host.entry;
  CHECK(entry.size == sizeof entry);
  CHECK(entry.major == PALPATE_PLUGIN_MAJOR);
  CHECK(entry.minor == PALPATE_PLUGIN_MINOR);
  CHECK(std::string(entry.licence).find("needs") != std::string::npos);
  bench.host.begin();
  CHECK(bench.host.arms->size == sizeof(palpate_plugin_factory));
  CHECK(entry.factory("palpate.other/1") == nullptr);
  bench.open();
  CHECK(bench.host.arm->size == sizeof(palpate_plugin_device));
  CHECK(bench.host.arm->extension(bench.host.arm, "palpate.other/1") == nullptr);
}

TEST_CASE("an SDK's plug-in that lists an arm leaves the arm open or closed as before",
          "[plugin]") {
  Bench bench(anySdk());
  bench.host.begin();
  palpate_plugin_found found{};
  found.size = sizeof found;
  CHECK(bench.host.arms->find(&found, 0) == 1);
  CHECK(std::string(found.model).empty());
  CHECK(bench.host.arms->find(&found, 1) == 1);
  CHECK(found.size == sizeof found);
  CHECK_FALSE(std::string(found.model).empty());
  // libnifalcon does not report serial numbers.
  const std::string serial = &bench.sdk == &kNifalcon ? "" : bench.sdk.serial;
  CHECK(found.serial == serial);
  CHECK(bench.sdk.open() == 0);
  bench.open();
  CHECK(bench.host.arms->find(&found, 1) == 1);
  CHECK(found.serial == serial);
  CHECK(bench.sdk.open() == 1);
}

TEST_CASE("an SDK's plug-in refuses an unknown serial number and an arm that is already open",
          "[plugin]") {
  Bench bench(anySdk());
  CHECK_FALSE(bench.host.open(bench.sdk.no_serial));
  CAPTURE(bench.host.error);
  CHECK(bench.host.errorIsALine(bench.sdk.name));
  CHECK_FALSE(bench.host.open((bench.sdk.serial + std::string("x")).c_str()));
  CHECK(bench.host.errorIsALine(bench.sdk.name));
  CHECK(bench.sdk.open() == 0);
  REQUIRE(bench.host.open(bench.sdk.serial));
  palpate_plugin_device* arm = bench.host.arm;
  CHECK_FALSE(bench.host.open(bench.sdk.serial));
  CHECK(bench.host.errorIsALine(bench.sdk.name));
  arm->close(arm);
  CHECK(bench.sdk.open() == 0);
  REQUIRE(bench.host.open(""));
}

TEST_CASE("an SDK's plug-in reports the arm's limits and their source", "[plugin]") {
  Bench bench(anySdk());
  bench.open();
  const palpate_plugin_facts facts = bench.host.facts();
  CHECK((facts.has & PALPATE_PLUGIN_FORCE) != 0U);
  CHECK(facts.force == bench.sdk.limits[0]);
  CHECK(facts.stiffness == bench.sdk.limits[1]);
  CHECK(facts.workspace_radius == bench.sdk.limits[2]);
  CHECK(facts.damping > 0.0);
  CHECK(facts.rate == 1000.0);
  CHECK(std::string(facts.source).find("CHAI3D 3.3.0") != std::string::npos);
}

TEST_CASE("an SDK's plug-in gives each position once, in metres in world space, with its time",
          "[plugin]") {
  Bench bench(anySdk());
  bench.ready();
  const Vec p = {0.01, 0.02, -0.03};
  bench.sdk.place(p);
  PluginHost::now() += 3 * kMs;
  bench.turn();
  REQUIRE(bench.host.read() == PALPATE_PLUGIN_OK);
  same(positionOf(bench.host.reading), p);
  CHECK(bench.host.reading.taken == PluginHost::now());
  CHECK(bench.host.reading.state == PALPATE_PLUGIN_READY);
  bench.host.reading.position[0] = 7.0;
  CHECK(bench.host.read() == PALPATE_PLUGIN_NOTHING);
  CHECK(bench.host.reading.position[0] == 7.0);
}

TEST_CASE("an SDK's plug-in sends forces in the SDK's axes except between a stop and a zero force",
          "[plugin]") {
  Bench bench(anySdk());
  bench.ready();
  const Vec f = {1.0, -2.0, 0.5};
  same(bench.given(), {0.0, 0.0, 0.0});
  CHECK(bench.host.write(f[0], f[1], f[2]) == PALPATE_PLUGIN_OK);
  same(bench.given(), f);
  bench.host.arm->stop(bench.host.arm);
  same(bench.given(), {0.0, 0.0, 0.0});
  CHECK(bench.host.write(f[0], f[1], f[2]) == PALPATE_PLUGIN_OK);
  same(bench.given(), {0.0, 0.0, 0.0});
  CHECK(bench.host.write(0.0, 0.0, 0.0) == PALPATE_PLUGIN_OK);
  same(bench.given(), {0.0, 0.0, 0.0});
  CHECK(bench.host.write(f[0], f[1], f[2]) == PALPATE_PLUGIN_OK);
  same(bench.given(), f);
  // A zero directly after a stop must not release an older force.
  bench.host.arm->stop(bench.host.arm);
  CHECK(bench.host.write(0.0, 0.0, 0.0) == PALPATE_PLUGIN_OK);
  same(bench.given(), {0.0, 0.0, 0.0});
}

TEST_CASE("an SDK's plug-in ends a force that is not renewed for 50 ms", "[plugin]") {
  Bench bench(anySdk());
  bench.ready();
  CHECK(bench.host.write(1.0, 0.0, 0.0) == PALPATE_PLUGIN_OK);
  PluginHost::now() += 49 * kMs;
  same(bench.given(), {1.0, 0.0, 0.0});
  PluginHost::now() += 2 * kMs;
  same(bench.given(), {0.0, 0.0, 0.0});
  CHECK(bench.host.write(1.0, 0.0, 0.0) == PALPATE_PLUGIN_OK);
  same(bench.given(), {1.0, 0.0, 0.0});
}

TEST_CASE("an SDK's plug-in reports a lost arm as gone and can still stop and close it",
          "[plugin]") {
  Bench bench(anySdk());
  bench.ready();
  CHECK(bench.host.write(1.0, 0.0, 0.0) == PALPATE_PLUGIN_OK);
  bench.turn();
  bench.sdk.lose();
  REQUIRE(bench.gone());
  CHECK(bench.host.write(1.0, 0.0, 0.0) == PALPATE_PLUGIN_GONE);
  bench.host.arm->stop(bench.host.arm);
  bench.host.arm->close(bench.host.arm);
  bench.host.arm = nullptr;
  CHECK(bench.sdk.open() == 0);
}

TEST_CASE("an SDK's plug-in passes a NaN position on and replaces a NaN force by zero",
          "[plugin]") {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  Bench bench(anySdk());
  bench.ready();
  bench.sdk.place({nan, 0.01, 0.0});
  bench.turn();
  REQUIRE(bench.host.read() == PALPATE_PLUGIN_OK);
  CHECK(std::isnan(bench.host.reading.position[0]));
  bench.sdk.place({0.01, 0.01, 0.0});
  bench.turn();
  REQUIRE(bench.host.read() == PALPATE_PLUGIN_OK);
  CHECK(bench.host.reading.position[0] == Approx(0.01));

  CHECK(bench.host.write(1.0, 0.0, 0.0) == PALPATE_PLUGIN_OK);
  bench.turn();
  CHECK(bench.host.write(1.0, nan, 0.0) == PALPATE_PLUGIN_FAILED);
  same(bench.given(), {0.0, 0.0, 0.0});
  CHECK(bench.host.write(1.0, 0.0, 0.0) == PALPATE_PLUGIN_OK);
  same(bench.given(), {0.0, 0.0, 0.0});
}

TEST_CASE("an SDK's plug-in sets the force to zero when it closes an arm", "[plugin]") {
  Bench bench(anySdk());
  bench.ready();
  CHECK(bench.host.write(1.0, 0.0, 0.0) == PALPATE_PLUGIN_OK);
  bench.turn();
  bench.sdk.gate().release();
  bench.host.arm->close(bench.host.arm);
  bench.host.arm = nullptr;
  same(bench.sdk.force_W(), {0.0, 0.0, 0.0});
  CHECK(bench.sdk.open() == 0);
}

TEST_CASE("an SDK's plug-in accepts smaller and larger structs of older and newer hosts",
          "[plugin]") {
  Bench bench(anySdk());
  palpate_plugin_host old = PluginHost::whole();
  old.size = offsetof(palpate_plugin_host, now);
  CHECK(bench.host.entry->init(&old) != 0);
  CHECK(PluginHost::said().size() == 1U);
  Other<palpate_plugin_host> newer_host(sizeof(palpate_plugin_host) + 32);
  const palpate_plugin_host whole = PluginHost::whole();
  std::memcpy(newer_host.bytes + 4, reinterpret_cast<const char*>(&whole) + 4, sizeof whole - 4);
  REQUIRE(bench.host.entry->init(newer_host.get()) == 0);

  bench.ready();
  bench.sdk.place({0.01, 0.02, -0.03});
  bench.turn();
  palpate_plugin_device* arm = bench.host.arm;
  constexpr std::size_t kRoom = offsetof(palpate_plugin_reading, orientation);
  Other<palpate_plugin_reading> smaller(kRoom);
  CHECK(arm->read(arm, smaller.get()) == PALPATE_PLUGIN_OK);
  CHECK(smaller.get()->size == kRoom);
  same(positionOf(*smaller.get()), {0.01, 0.02, -0.03});
  CHECK(smaller.untouchedFrom(kRoom));
  bench.turn();
  Other<palpate_plugin_reading> larger(sizeof(palpate_plugin_reading) + 32);
  CHECK(arm->read(arm, larger.get()) == PALPATE_PLUGIN_OK);
  CHECK(larger.get()->size == sizeof(palpate_plugin_reading) + 32);
  CHECK(larger.untouchedFrom(sizeof(palpate_plugin_reading)));
  constexpr std::size_t kFacts = offsetof(palpate_plugin_facts, joints);
  Other<palpate_plugin_facts> facts(kFacts);
  CHECK(arm->facts(arm, facts.get()) == PALPATE_PLUGIN_OK);
  CHECK(facts.get()->force == bench.sdk.limits[0]);
  CHECK(facts.untouchedFrom(kFacts));
  // The struct ends before its third number, which therefore counts as zero.
  palpate_plugin_force force = {offsetof(palpate_plugin_force, force) + 16, 0, {1.0, 2.0, 3.0}, {}};
  CHECK(arm->write(arm, &force) == PALPATE_PLUGIN_OK);
  same(bench.given(), {1.0, 2.0, 0.0});
  // The plug-in must not write beyond a struct that ends before `model`.
  Other<palpate_plugin_found> found(offsetof(palpate_plugin_found, model));
  CHECK(bench.host.arms->find(found.get(), 1) == 1);
  CHECK(found.untouchedFrom(offsetof(palpate_plugin_found, model)));
}

TEST_CASE("an SDK's plug-in neither allocates nor locks in a tick", "[plugin][realtime]") {
  Bench bench(anySdk());
  bench.ready();
  int well = 0;
  for (int i = 0; i < 20; ++i) {
    bench.turn(1);
    const CountScope scope;
    well += bench.host.read() == PALPATE_PLUGIN_OK &&
            bench.host.write(0.1, 0.0, 0.0) == PALPATE_PLUGIN_OK;
    bench.host.arm->stop(bench.host.arm);
    const auto counts = CountScope::counts();
    REQUIRE(counts.allocations == 0);
    REQUIRE(counts.locks == 0);
  }
  CHECK(well >= 19);
}

TEST_CASE("preparing an SDK's arm that is never ready ends when the program ends", "[plugin]") {
  Bench bench(anySdk());
  bench.sdk.never_ready();
  bench.open();
  std::thread user([] {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    PluginHost::ends() = true;
  });
  const int result = bench.host.prepare();
  user.join();
  CHECK(result == PALPATE_PLUGIN_FAILED);
  CHECK(bench.host.errorIsALine(bench.sdk.name));
  REQUIRE(PluginHost::said().size() == 1U);
}

TEST_CASE("OpenHaptics: the plug-in reads orientation, velocity and buttons in world space",
          "[plugin]") {
  Bench bench(kOpenHaptics);
  bench.ready();
  stub_hd::Arm& arm = stub_hd::arm();
  // A quarter turn about the API's y axis, which is W's z: x to -z, z to x. Column-major.
  const double turned[16] = {0, 0, -1, 0, 0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1};
  std::copy(turned, turned + 16, arm.transform);
  arm.velocity[2] = -250.0;
  arm.buttons = 2;
  bench.turn();
  REQUIRE(bench.host.read() == PALPATE_PLUGIN_OK);
  const palpate_plugin_reading& r = bench.host.reading;
  CHECK(r.orientation[0] == Approx(std::sqrt(0.5)));
  CHECK(r.orientation[1] == Approx(0.0).margin(1e-12));
  CHECK(r.orientation[2] == Approx(0.0).margin(1e-12));
  CHECK(r.orientation[3] == Approx(std::sqrt(0.5)));
  CHECK(r.velocity[1] == Approx(0.25));
  CHECK(r.buttons == 2U);
  CHECK(arm.outside == 0);
}

TEST_CASE("OpenHaptics: the plug-in reads all queued errors and reports each by its kind",
          "[plugin]") {
  Bench bench(kOpenHaptics);
  bench.ready();
  CHECK(bench.host.write(0.1, 0.0, 0.0) == PALPATE_PLUGIN_OK);
  stub_hd::arm().fails = {HD_WARM_MOTORS, HD_EXCEEDED_MAX_FORCE};
  bench.turn(1);
  REQUIRE(bench.host.read() == PALPATE_PLUGIN_OK);
  CHECK(bench.host.reading.state == (PALPATE_PLUGIN_READY | PALPATE_PLUGIN_HOT));
  CHECK(bench.host.write(0.1, 0.0, 0.0) == PALPATE_PLUGIN_FAILED);
  bench.turn(1);
  REQUIRE(bench.host.read() == PALPATE_PLUGIN_OK);
  CHECK(bench.host.reading.state == PALPATE_PLUGIN_READY);
  CHECK(bench.host.write(0.1, 0.0, 0.0) == PALPATE_PLUGIN_OK);
  // The plug-in must find the error that means a lost device among other errors.
  stub_hd::arm().fails = {HD_WARM_MOTORS, HD_DEVICE_FAULT, HD_WARM_MOTORS};
  CHECK(bench.gone());
  same(bench.sdk.force_W(), {0.0, 0.0, 0.0});
}

TEST_CASE("OpenHaptics: prepare() waits until the stylus is in its inkwell", "[plugin]") {
  Bench bench(kOpenHaptics);
  stub_hd::arm().calibration = HD_CALIBRATION_NEEDS_MANUAL_INPUT;
  stub_hd::arm().style = HD_CALIBRATION_INKWELL;
  bench.open();
  std::thread user([] {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    stub_hd::arm().inkwell = true;
  });
  const int result = bench.host.prepare();
  user.join();
  CHECK(result == PALPATE_PLUGIN_OK);
  REQUIRE(PluginHost::said().size() == 1U);
  CHECK(PluginHost::said()[0].find("inkwell") != std::string::npos);
}

TEST_CASE("OpenHaptics: an unknown model gets the API's nominal limits", "[plugin]") {
  Bench bench(kOpenHaptics);
  stub_hd::arm().model = "Touch X";
  bench.open();
  const palpate_plugin_facts facts = bench.host.facts();
  CHECK(facts.force == 3.0);
  CHECK(facts.stiffness == Approx(500.0));  // 0.5 N/mm
  CHECK(facts.damping == Approx(2.0));
  CHECK(facts.workspace_radius == Approx(0.035));
  CHECK(std::string(facts.source).find("NOMINAL") != std::string::npos);
}

TEST_CASE("OpenHaptics: an arm other than the default is opened by its configured name",
          "[plugin]") {
  Bench bench(kOpenHaptics);
  REQUIRE(bench.host.open("Left"));
  CHECK(stub_hd::arm().open == 1);
}

TEST_CASE("OpenHaptics: an arm that opens with an error is closed again", "[plugin]") {
  Bench bench(kOpenHaptics);
  stub_hd::arm().opening = {HD_COMM_ERROR};
  CHECK_FALSE(bench.host.open(GENERATE("", "T-77", "Left")));
  CHECK(stub_hd::arm().open == 0);
}

TEST_CASE("OpenHaptics: the motors are off if the scheduler does not start", "[plugin]") {
  Bench bench(kOpenHaptics);
  stub_hd::arm().starting = {HD_COMM_ERROR};
  bench.open();
  CHECK(bench.host.prepare() == PALPATE_PLUGIN_FAILED);
  CHECK_FALSE(stub_hd::arm().enabled);
  stub_hd::arm().starting.clear();
  CHECK(bench.host.prepare() == PALPATE_PLUGIN_OK);
}

TEST_CASE("DHD: a reading that the SDK marks as old is not returned as a new reading", "[plugin]") {
  Bench bench(kDhd);
  bench.ready();
  bench.turn();
  REQUIRE(bench.host.read() == PALPATE_PLUGIN_OK);
  stub_dhd::arm().old = true;
  PluginHost::now() += 3 * kMs;
  bench.turn();
  CHECK(bench.host.read() == PALPATE_PLUGIN_NOTHING);
  stub_dhd::arm().old = false;
  bench.turn();
  CHECK(bench.host.read() == PALPATE_PLUGIN_OK);
  CHECK(bench.host.reading.taken == PluginHost::now());
}

TEST_CASE("DHD: handle, velocity, gripper and buttons are read in world space, torques stay zero",
          "[plugin]") {
  Bench bench(kDhd);
  bench.ready();
  stub_dhd::Arm& arm = stub_dhd::arm();
  // Half a turn about the SDK's x axis, which is W's -y.
  arm.turned[1][1] = arm.turned[2][2] = -1.0;
  arm.velocity[0] = -0.25;
  arm.gripper = 0.3;
  arm.buttons = 1;
  bench.turn();
  REQUIRE(bench.host.read() == PALPATE_PLUGIN_OK);
  const palpate_plugin_reading& r = bench.host.reading;
  CHECK(std::abs(r.orientation[2]) == Approx(1.0));
  CHECK(r.velocity[1] == Approx(0.25));
  CHECK(r.gripper == Approx(0.3));
  CHECK(r.buttons == 1U);
  CHECK(bench.host.write(1.0, 0.0, 0.0) == PALPATE_PLUGIN_OK);
  bench.turn();
  CHECK(arm.rest == 0.0);
  // If the SDK cannot compute a velocity yet, the arm does not count as lost.
  arm.no_speed = true;
  bench.turn();
  CHECK(bench.host.read() == PALPATE_PLUGIN_OK);
  CHECK(r.velocity[1] == Approx(0.25));
  const std::uint32_t has = bench.host.facts().has;
  CHECK((has & PALPATE_PLUGIN_ORIENTATION) != 0U);
  CHECK((has & PALPATE_PLUGIN_GRIPPER) != 0U);
}

TEST_CASE("DHD: an arm without a wrist reports no orientation", "[plugin]") {
  Bench bench(kDhd);
  stub_dhd::arm().type = DHD_DEVICE_OMEGA3;
  bench.ready();
  CHECK((bench.host.facts().has & (PALPATE_PLUGIN_ORIENTATION | PALPATE_PLUGIN_GRIPPER)) == 0U);
  stub_dhd::arm().turned[1][1] = stub_dhd::arm().turned[2][2] = -1.0;
  bench.turn();
  REQUIRE(bench.host.read() == PALPATE_PLUGIN_OK);
  CHECK(bench.host.reading.orientation[0] == 1.0);
}

TEST_CASE("DHD: a model with unknown limits is refused", "[plugin]") {
  Bench bench(kDhd);
  stub_dhd::arm().type = DHD_DEVICE_SIGMA331;
  CHECK_FALSE(bench.host.open(""));
  CHECK(bench.host.errorIsALine("dhd"));
  CHECK(bench.host.error.find("sigma.7") != std::string::npos);
  CHECK(stub_dhd::arm().open == 0);
}

TEST_CASE("DHD: opening an arm sets its watchdog and leaves expert mode", "[plugin]") {
  Bench bench(kDhd);
  bench.open();
  CHECK(stub_dhd::arm().watchdog == 240);
  CHECK_FALSE(stub_dhd::arm().expert);
  CHECK(bench.host.facts().watchdog == Approx(0.03));
}

TEST_CASE("DHD: lost power, an open switch and a lost home are reported as the arm's state",
          "[plugin]") {
  Bench bench(kDhd);
  bench.ready();
  stub_dhd::arm().power = false;
  stub_dhd::arm().force_on = false;
  stub_dhd::arm().reset = false;
  bench.turn(40);  // the plug-in reads the state only once in several cycles
  REQUIRE(bench.host.read() == PALPATE_PLUGIN_OK);
  CHECK(bench.host.reading.state == (PALPATE_PLUGIN_UNPOWERED | PALPATE_PLUGIN_OPEN));
}

TEST_CASE("DHD: gravity compensation changes with the next write and ends with a stop",
          "[plugin]") {
  Bench bench(kDhd);
  bench.ready();
  const auto* weight = static_cast<const palpate_plugin_weight*>(
      bench.host.arm->extension(bench.host.arm, PALPATE_PLUGIN_WEIGHT));
  REQUIRE(weight != nullptr);
  const stub_dhd::Arm& arm = stub_dhd::arm();
  weight->carry(bench.host.arm, 0.5);
  bench.turn();
  CHECK_FALSE(arm.carries);
  CHECK(bench.host.write(0.1, 0.0, 0.0) == PALPATE_PLUGIN_OK);
  bench.turn();
  CHECK(arm.carries);
  CHECK(arm.gravity == Approx(0.5 * 9.81));
  weight->carry(bench.host.arm, 1.0);
  CHECK(bench.host.write(0.1, 0.0, 0.0) == PALPATE_PLUGIN_OK);
  bench.turn();
  CHECK(arm.gravity == Approx(9.81));
  bench.host.arm->stop(bench.host.arm);
  bench.turn();
  CHECK_FALSE(arm.carries);
}

TEST_CASE(
    "DHD: after one failed call the arm is gone and gets neither force nor gravity compensation",
    "[plugin]") {
  Bench bench(kDhd);
  bench.ready();
  const auto* weight = static_cast<const palpate_plugin_weight*>(
      bench.host.arm->extension(bench.host.arm, PALPATE_PLUGIN_WEIGHT));
  weight->carry(bench.host.arm, 1.0);
  CHECK(bench.host.write(1.0, 0.0, 0.0) == PALPATE_PLUGIN_OK);
  same(bench.given(), {1.0, 0.0, 0.0});
  stub_dhd::arm().fails = 1;
  REQUIRE(bench.gone());
  bench.host.arm->close(bench.host.arm);
  bench.host.arm = nullptr;
  CHECK(stub_dhd::arm().force_at_stop == 0.0);
  CHECK_FALSE(stub_dhd::arm().carries);
}

TEST_CASE("an SDK's plug-in lists several arms in an array of the host's larger structs",
          "[plugin]") {
  struct Newer {
    palpate_plugin_found found;
    char more[24];
  };
  const Sdk& sdk = GENERATE(0, 1) == 0 ? kDhd : kNifalcon;
  Bench bench(sdk);
  bench.host.begin();
  stub_dhd::arm().count = 2;
  stub_nifalcon::arm().count = 2;
  Newer two[2] = {};
  for (Newer& one : two) {
    one.found.size = sizeof one;
    std::memset(one.more, 0x5a, sizeof one.more);
  }
  CHECK(bench.host.arms->find(&two[0].found, 2) == 2);
  for (const Newer& one : two) {
    CHECK_FALSE(std::string(one.found.model).empty());
    CHECK(one.found.size == sizeof one);
    CHECK(std::string(one.more, sizeof one.more) == std::string(24, 0x5a));
  }
}

TEST_CASE("nifalcon: the firmware is loaded again until the arm accepts it", "[plugin]") {
  Bench bench(kNifalcon);
  stub_nifalcon::arm().bad_loads = 3;
  bench.open();
  CHECK(bench.host.prepare() == PALPATE_PLUGIN_OK);
  CHECK(stub_nifalcon::arm().loads == 4);
}

TEST_CASE("nifalcon: an arm that never accepts its firmware is reported", "[plugin]") {
  Bench bench(kNifalcon);
  stub_nifalcon::arm().bad_loads = 1000;
  bench.open();
  CHECK(bench.host.prepare() == PALPATE_PLUGIN_FAILED);
  CHECK(bench.host.errorIsALine("nifalcon"));
}

TEST_CASE("nifalcon: an arm is ready only if all three motors are homed", "[plugin]") {
  Bench bench(kNifalcon);
  bench.ready();
  stub_nifalcon::arm().homed = 3;
  bench.turn();
  REQUIRE(bench.host.read() == PALPATE_PLUGIN_OK);
  CHECK(bench.host.reading.state == 0U);
}

TEST_CASE("nifalcon: a cycle without data gives no new reading and the arm stays open",
          "[plugin]") {
  Bench bench(kNifalcon);
  bench.ready();
  bench.turn();
  REQUIRE(bench.host.read() == PALPATE_PLUGIN_OK);
  stub_nifalcon::arm().quiet = true;
  PluginHost::now() += 90 * kMs;
  bench.turn();
  CHECK(bench.host.read() == PALPATE_PLUGIN_NOTHING);
  stub_nifalcon::arm().quiet = false;
  bench.turn();
  CHECK(bench.host.read() == PALPATE_PLUGIN_OK);
}

TEST_CASE("nifalcon: a stop sets the force to zero even if the kinematics fails", "[plugin]") {
  Bench bench(kNifalcon);
  bench.ready();
  CHECK(bench.host.write(1.0, 0.0, 0.0) == PALPATE_PLUGIN_OK);
  bench.turn();
  stub_nifalcon::arm().beyond = true;
  bench.host.arm->stop(bench.host.arm);
  same(bench.given(), {0.0, 0.0, 0.0});
}

TEST_CASE("nifalcon: an arm that cannot be opened is reported", "[plugin]") {
  Bench bench(kNifalcon);
  stub_nifalcon::arm().refuses = true;
  CHECK_FALSE(bench.host.open(""));
  CHECK(bench.host.errorIsALine("nifalcon"));
}

TEST_CASE("nifalcon: an exception in the library is reported or makes the arm gone", "[plugin]") {
  Bench bench(kNifalcon);
  stub_nifalcon::arm().throws = true;
  CHECK_FALSE(bench.host.open(""));
  CHECK(bench.host.errorIsALine("nifalcon"));
  CHECK(bench.host.error.find("no USB") != std::string::npos);
  stub_nifalcon::arm().throws = false;
  bench.open();
  stub_nifalcon::arm().throws = true;
  stub_nifalcon::arm().firmware = true;
  CHECK(bench.host.prepare() == PALPATE_PLUGIN_FAILED);
  CHECK(bench.host.errorIsALine("nifalcon"));
  stub_nifalcon::arm().throws = false;
  REQUIRE(bench.host.prepare() == PALPATE_PLUGIN_OK);
  stub_nifalcon::arm().throws = true;
  CHECK(bench.gone());
}

TEST_CASE("nifalcon: an arm number that does not exist is refused with the count of arms",
          "[plugin]") {
  Bench bench(kNifalcon);
  CHECK_FALSE(bench.host.open("1"));
  CHECK(bench.host.error.find("1 are plugged in") != std::string::npos);
}
