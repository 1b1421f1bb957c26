/// Tests the sample plug-in through its C interface only.
#include <cstddef>

#include <catch2/catch.hpp>

#include "palpate/devices/arm/self_test.h"
#include "palpate/engine/safety/limit_force.h"
#include "tests/devices/plugins/plugin_host.h"
#include "tests/support/counters.h"

using palpate::test::CountScope;
using palpate::test::Other;
using palpate::test::PluginHost;

namespace {

const std::string kSample = PALPATE_PLUGINS "/sample.so";
constexpr std::int64_t kMillisecond = 1'000'000;

/// Advances the clock by `ms` [ms], in steps of 1 ms. Each step reads, then writes the force (x, y,
/// z) [N].
void goOn(PluginHost& host, int ms, double x, double y, double z) {
  for (int i = 0; i < ms; ++i) {
    PluginHost::now() += kMillisecond;
    REQUIRE(host.read() == PALPATE_PLUGIN_OK);
    REQUIRE(host.write(x, y, z) == PALPATE_PLUGIN_OK);
  }
}

/// Returns the displacement along x that the force causes [m], without the simulated hand's motion.
double pushed(const PluginHost& host) {
  const double t = 1e-9 * static_cast<double>(host.reading.taken - 1000 * kMillisecond);
  return host.reading.position[0] - 0.02 * std::sin(0.5 * t);
}

}  // namespace

TEST_CASE("the sample plug-in opens each of its two arms once and refuses other serial numbers",
          "[plugin]") {
  PluginHost host(kSample);
  CHECK(host.entry->size == sizeof(palpate_plugin_entry));
  CHECK(host.entry->major == PALPATE_PLUGIN_MAJOR);
  CHECK(host.entry->minor == PALPATE_PLUGIN_MINOR);
  host.begin();
  CHECK(host.entry->factory("palpate.other/1") == nullptr);
  palpate_plugin_found found[2] = {};
  found[0].size = found[1].size = sizeof found[0];
  CHECK(host.arms->find(found, 1) == 2);
  CHECK(std::string(found[1].serial).empty());
  CHECK(host.arms->find(found, 2) == 2);
  CHECK(std::string(found[0].serial) == "S1");
  CHECK(std::string(found[1].serial) == "S2");

  CHECK_FALSE(host.open("S3"));
  CHECK(host.errorIsALine("sample"));
  REQUIRE(host.open("S2"));
  palpate_plugin_device* second = host.arm;
  CHECK_FALSE(host.open("S2"));
  CHECK(host.errorIsALine("sample"));
  REQUIRE(host.open(""));
  CHECK(host.arm != second);
  second->close(second);
  palpate_plugin_device* first = host.arm;
  REQUIRE(host.open("S2"));
  first->close(first);
}

TEST_CASE("the sample plug-in gives 1000 readings per second of the host's clock", "[plugin]") {
  PluginHost host(kSample);
  REQUIRE(host.open("S1"));
  CHECK(host.read() == PALPATE_PLUGIN_NOTHING);
  PluginHost::now() += kMillisecond + 1000;
  REQUIRE(host.read() == PALPATE_PLUGIN_OK);
  CHECK(host.reading.taken == PluginHost::now() - 1000);
  CHECK(host.reading.state == 0U);  // not prepared
  CHECK(host.read() == PALPATE_PLUGIN_NOTHING);
  REQUIRE(host.prepare() == PALPATE_PLUGIN_OK);
  PluginHost::now() += kMillisecond;
  REQUIRE(host.read() == PALPATE_PLUGIN_OK);
  CHECK(host.reading.state == PALPATE_PLUGIN_READY);
  // After an hour without reads, the plug-in must answer at once with a current reading. It
  // simulates only the end of that hour, so the displacement has not yet decayed.
  goOn(host, 1000, 0.6, 0.0, 0.0);
  PluginHost::now() += 3600 * 1000 * kMillisecond;
  REQUIRE(host.read() == PALPATE_PLUGIN_OK);
  CHECK(PluginHost::now() - host.reading.taken < kMillisecond);
  CHECK(std::abs(pushed(host)) > 1e-4);
}

TEST_CASE("the sample plug-in simulates a moving handle and a velocity that matches its positions",
          "[plugin]") {
  PluginHost host(kSample);
  REQUIRE(host.open("S1"));
  REQUIRE(host.prepare() == PALPATE_PLUGIN_OK);
  goOn(host, 500, 0.5, 0.0, 0.0);
  const palpate_plugin_reading before = host.reading;
  goOn(host, 1, 0.5, 0.0, 0.0);
  for (int i = 0; i < 3; ++i) {
    const double speed = (host.reading.position[i] - before.position[i]) / 1e-3;
    CHECK(host.reading.velocity[i] == Approx(speed).margin(1e-3));
  }
  double length = 0.0;
  for (const double q : host.reading.orientation) length += q * q;
  CHECK(length == Approx(1.0));
  CHECK(host.reading.orientation[3] > 0.01);
  CHECK(host.reading.gripper > 0.0);
  CHECK(host.reading.buttons == 0U);
  goOn(host, 1000, 0.5, 0.0, 0.0);
  CHECK(host.reading.buttons == 1U);
  goOn(host, 1000, 0.5, 0.0, 0.0);
  CHECK(host.reading.buttons == 2U);
}

TEST_CASE("the sample plug-in's arm moves with the force until the arm is stopped", "[plugin]") {
  PluginHost host(kSample);
  REQUIRE(host.open("S1"));
  REQUIRE(host.prepare() == PALPATE_PLUGIN_OK);
  goOn(host, 1000, 0.6, 0.0, 0.0);
  CHECK(pushed(host) == Approx(0.02).margin(1e-4));  // 0.6 N / (30 N/m)
  host.arm->stop(host.arm);
  goOn(host, 1000, 0.6, 0.0, 0.0);
  CHECK(pushed(host) == Approx(0.0).margin(1e-4));
  goOn(host, 1, 0.0, 0.0, 0.0);
  goOn(host, 1000, 0.6, 0.0, 0.0);
  CHECK(pushed(host) == Approx(0.02).margin(1e-4));
}

TEST_CASE("the sample plug-in's arm S2 rests until a force pushes it and comes to rest afterwards",
          "[plugin]") {
  PluginHost host(kSample);
  REQUIRE(host.open("S2"));
  REQUIRE(host.prepare() == PALPATE_PLUGIN_OK);
  goOn(host, 1000, 0.0, 0.0, 0.0);
  for (const double x : host.reading.position) CHECK(x == 0.0);
  goOn(host, 100, 0.5, 0.0, 0.0);
  const double there = host.reading.position[0];
  CHECK(there > 5e-3);
  goOn(host, 2000, 0.0, 0.0, 0.0);
  CHECK(host.reading.position[0] > there);
  CHECK(std::abs(host.reading.velocity[0]) < 1e-6);
  CHECK(host.reading.position[2] == 0.0);  // S2 has no weight
}

TEST_CASE("the sample plug-in's arm S2 passes the self-test", "[plugin]") {
  PluginHost host(kSample);
  REQUIRE(host.open("S2"));
  REQUIRE(host.prepare() == PALPATE_PLUGIN_OK);
  palpate::SelfTest self(palpate::SelfTestParams{});
  palpate::LimiterState limiter;
  const palpate::ForceLimits limits{0.5, 100.0};
  for (int i = 0; i < 60000 && !self.done(); ++i) {
    PluginHost::now() += kMillisecond;
    REQUIRE(host.read() == PALPATE_PLUGIN_OK);
    palpate::HandState hand;
    hand.position = palpate::Vec3(host.reading.position);
    const palpate::Vec3 wanted = self.next(hand, 1e-3 * i, limiter.sent);
    const palpate::Vec3 force =
        palpate::limitForce(wanted, palpate::Vec3::Zero(), 1e-3, limits, limiter).force;
    REQUIRE(host.write(force.x(), force.y(), force.z()) == PALPATE_PLUGIN_OK);
  }
  REQUIRE(self.done());
  const palpate::SelfTestResult result = self.result();
  for (const std::string& problem : result.problems) UNSCOPED_INFO(problem);
  CHECK(result.problems.empty());
  for (const palpate::AxisResult& axis : result.axes) {
    CHECK(axis.mass == Approx(0.1).epsilon(0.1));
    CHECK(axis.viscous == Approx(1.0).epsilon(0.1));
  }
}

TEST_CASE("the sample plug-in's watchdog ends a force that is not renewed for 50 ms", "[plugin]") {
  PluginHost host(kSample);
  REQUIRE(host.open("S1"));
  REQUIRE(host.prepare() == PALPATE_PLUGIN_OK);
  CHECK(host.facts().watchdog == Approx(0.05));
  goOn(host, 1000, 0.6, 0.0, 0.0);
  for (int i = 0; i < 49; ++i) {
    PluginHost::now() += kMillisecond;
    REQUIRE(host.read() == PALPATE_PLUGIN_OK);
  }
  CHECK(pushed(host) == Approx(0.02).margin(1e-4));
  for (int i = 0; i < 1000; ++i) {
    PluginHost::now() += kMillisecond;
    REQUIRE(host.read() == PALPATE_PLUGIN_OK);
  }
  CHECK(pushed(host) == Approx(0.0).margin(1e-4));
}

TEST_CASE("the sample plug-in's gravity compensation starts with the next write", "[plugin]") {
  PluginHost host(kSample);
  REQUIRE(host.open("S1"));
  REQUIRE(host.prepare() == PALPATE_PLUGIN_OK);
  const auto* weight = static_cast<const palpate_plugin_weight*>(
      host.arm->extension(host.arm, PALPATE_PLUGIN_WEIGHT));
  REQUIRE(weight != nullptr);
  CHECK(weight->size == sizeof *weight);
  CHECK(host.arm->extension(host.arm, "palpate.other/1") == nullptr);
  goOn(host, 1000, 0.0, 0.0, 0.0);
  CHECK(host.reading.position[2] == Approx(-0.01).margin(1e-4));  // 0.3 N / (30 N/m)
  weight->carry(host.arm, 1.0);
  PluginHost::now() += kMillisecond;
  REQUIRE(host.read() == PALPATE_PLUGIN_OK);
  CHECK(host.reading.position[2] == Approx(-0.01).margin(1e-4));
  goOn(host, 1000, 0.0, 0.0, 0.0);
  CHECK(host.reading.position[2] == Approx(0.0).margin(1e-4));
  host.arm->stop(host.arm);
  goOn(host, 1000, 0.1, 0.0, 0.0);
  CHECK(host.reading.position[2] == Approx(-0.01).margin(1e-4));
}

TEST_CASE("the sample plug-in's motors give only their continuous force when they are hot",
          "[plugin]") {
  PluginHost host(kSample);
  REQUIRE(host.open("S1"));
  REQUIRE(host.prepare() == PALPATE_PLUGIN_OK);
  const auto* heat =
      static_cast<const palpate_plugin_heat*>(host.arm->extension(host.arm, PALPATE_PLUGIN_HEAT));
  REQUIRE(heat != nullptr);
  goOn(host, 1000, 3.0, 0.0, 0.0);
  CHECK(heat->given(host.arm) == 1.0);
  CHECK(pushed(host) == Approx(0.1).margin(1e-3));
  // At twice the continuous force, the motors reach their limit after 20 s ln(4/3) = 5.8 s.
  goOn(host, 6000, 3.0, 0.0, 0.0);
  CHECK(heat->given(host.arm) == 0.5);
  CHECK(pushed(host) < 0.099);
}

TEST_CASE("the sample plug-in accepts smaller and larger structs of older and newer hosts",
          "[plugin]") {
  PluginHost host(kSample);
  palpate_plugin_host old = PluginHost::whole();
  old.size = offsetof(palpate_plugin_host, now);
  CHECK(host.entry->init(&old) != 0);
  CHECK(PluginHost::said().size() == 1U);
  Other<palpate_plugin_host> larger(sizeof(palpate_plugin_host) + 32);
  const palpate_plugin_host whole = PluginHost::whole();
  std::memcpy(larger.bytes + 4, reinterpret_cast<const char*>(&whole) + 4, sizeof whole - 4);
  CHECK(host.entry->init(larger.get()) == 0);

  REQUIRE(host.open("S1"));
  PluginHost::now() += kMillisecond;
  constexpr std::size_t kRoom = offsetof(palpate_plugin_reading, orientation);
  Other<palpate_plugin_reading> smaller(kRoom);
  CHECK(host.arm->read(host.arm, smaller.get()) == PALPATE_PLUGIN_OK);
  CHECK(smaller.get()->size == kRoom);
  CHECK(smaller.get()->taken == PluginHost::now());
  CHECK(smaller.untouchedFrom(kRoom));
  PluginHost::now() += kMillisecond;
  Other<palpate_plugin_reading> newer(sizeof(palpate_plugin_reading) + 32);
  CHECK(host.arm->read(host.arm, newer.get()) == PALPATE_PLUGIN_OK);
  CHECK(newer.get()->size == sizeof(palpate_plugin_reading) + 32);
  CHECK(newer.untouchedFrom(sizeof(palpate_plugin_reading)));
}

TEST_CASE("the sample plug-in neither allocates nor locks in a tick", "[plugin][realtime]") {
  PluginHost host(kSample);
  REQUIRE(host.open("S1"));
  REQUIRE(host.prepare() == PALPATE_PLUGIN_OK);
  int well = 0;
  {
    const CountScope scope;
    for (int i = 0; i < 1000; ++i) {
      PluginHost::now() += kMillisecond;
      well += host.read() == PALPATE_PLUGIN_OK && host.write(0.1, 0.0, 0.0) == PALPATE_PLUGIN_OK;
      host.arm->stop(host.arm);
    }
    const auto counts = CountScope::counts();
    CHECK(counts.allocations == 0);
    CHECK(counts.locks == 0);
  }
  CHECK(well == 1000);
}

TEST_CASE("preparing the sample plug-in's arm fails if the program ends", "[plugin]") {
  PluginHost host(kSample);
  REQUIRE(host.open("S1"));
  PluginHost::ends() = true;
  CHECK(host.prepare() == PALPATE_PLUGIN_FAILED);
  CHECK_FALSE(host.error.empty());
}
