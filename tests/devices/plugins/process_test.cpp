/// Tests the loading of plug-ins, and running them in a separate process or in the program's.
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <limits>
#include <memory>
#include <string>
#include <thread>
#include <unistd.h>
#include <utility>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/devices/plugins/plugin_library.h"
#include "palpate/devices/plugins/plugin_process.h"
#include "palpate/devices/plugins/plugin_server.h"
#include "palpate/engine/error.h"
#include "palpate/engine/loop/haptic_thread.h"
#include "tests/devices/plugins/odd_arm.h"
#include "tests/support/scenes.h"

namespace palpate::process_test {
using namespace palpate::test;

namespace {

const std::filesystem::path kPlugins = PALPATE_PLUGIN_TESTS;
const std::filesystem::path kOdd = kPlugins / "odd.so";
const std::filesystem::path kOther = kPlugins / "other.so";
const std::filesystem::path kNone = kPlugins / "none.so";
const std::filesystem::path kProgram = PALPATE_PLUGIN_PROGRAM;

/// The simulated arm in memory that the plug-in's process shares.
class Bench {
 public:
  Bench() {
    std::string name = "/tmp/palpate_odd_XXXXXX";
    const int made = mkstemp(name.data());
    close(made);
    file_ = name;
    setenv(OddArm::kFile, file_.c_str(), 1);
    arm_ = OddArm::at(file_.c_str());
  }
  Bench(const Bench&) = delete;
  Bench& operator=(const Bench&) = delete;
  ~Bench() { std::filesystem::remove(file_); }
  OddArm* operator->() const { return arm_; }
  OddArm& operator*() const { return *arm_; }

 private:
  std::string file_;
  OddArm* arm_;
};

std::string refusal(const std::function<void()>& act) {
  try {
    act();
    return {};
  } catch (const Error& error) {
    return error.what();
  }
}

/// Returns a serial number that no test in another process uses.
std::string oddly(const std::string& kind) {
  return kind + "#" + std::to_string(getpid());
}

std::unique_ptr<PluginArm> openOdd(const std::string& kind, const ArmHost& host = {}) {
  return std::make_unique<PluginArm>(openPluginProcess(kOdd, oddly(kind), host, kProgram),
                                     "plugin:odd", true, host);
}

/// Returns true as soon as the condition holds; false if it does not hold within `seconds` [s].
bool within(double seconds, const std::function<bool()>& is) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(seconds);
  while (!is()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return true;
}

constexpr double kLong = 20.0;  // [s]; time limit of a step, generous for a busy machine

HandState tick(PluginArm& arm, const Vec3& force) {
  const HandState hand = arm.read();
  arm.write(force);
  std::this_thread::sleep_for(std::chrono::milliseconds(1));
  return hand;
}

}  // namespace

TEST_CASE("unusable plug-in libraries and arms are refused with the reason", "[plugin]") {
  CHECK(refusal([] { PluginLibrary library(kNone, {}); }).find("no symbol palpate_plugin") !=
        std::string::npos);
  CHECK(refusal([] { PluginLibrary library(kOther, {}); }).find("with version 2.0") !=
        std::string::npos);
  CHECK_FALSE(refusal([] { PluginLibrary library("/nowhere/x.so", {}); }).empty());
  const Bench bench;
  const PluginLibrary library(kOdd, {});
  CHECK(library.what() == "arms with troubles");
  CHECK(library.find().size() > 20);
  CHECK(library.only("good") == "good");
  CHECK(library.only("made up").empty());
  CHECK(refusal([] {
          PluginLibrary again(kOdd, {});
        }).find("another hand already runs this plug-in") != std::string::npos);
  CHECK(refusal([&] { (void)library.only(""); }).find("plugin:odd@good, plugin:odd@mute") !=
        std::string::npos);
  CHECK(refusal([&] { (void)library.open("nobody"); }).find("no arm of that number") !=
        std::string::npos);
  CHECK(refusal([&] {
          (void)library.open("mute").facts();
        }).find("does not report its properties") != std::string::npos);
  CHECK(bench->closes == 1);
}

TEST_CASE(
    "an arm with an incomplete struct is refused after it was stopped and, if possible, closed",
    "[plugin]") {
  struct Incomplete {
    const char* serial;
    const char* why;
    std::uint32_t closes;  ///< 0: the struct has no function to close the arm.
  };
  const Incomplete one = GENERATE(Incomplete{"small", "which is too small", 1},
                                  Incomplete{"tiny", "which is too small", 0},
                                  Incomplete{"readless", "the function read of its", 1},
                                  Incomplete{"closeless", "the function close of its", 0});
  CAPTURE(one.serial);
  const Bench bench;
  const PluginLibrary library(kOdd, {});
  CHECK(refusal([&] { (void)library.open(one.serial); }).find(one.why) != std::string::npos);
  CHECK(bench->opens == 1);
  CHECK(bench->stops == 1);
  CHECK(bench->closes == one.closes);
}

TEST_CASE("plug-ins load only from their folders and only if no other user can write there",
          "[plugin]") {
  const Bench bench;
  const std::filesystem::path folder =
      std::filesystem::temp_directory_path() / ("palpate_plugins_" + std::to_string(getpid()));
  std::filesystem::create_directories(folder);
  std::filesystem::copy_file(kOdd, folder / "odd.so");
  // Sets the permissions explicitly, because they depend on the user's umask.
  std::filesystem::permissions(folder, std::filesystem::perms(0755));
  std::filesystem::permissions(folder / "odd.so", std::filesystem::perms(0755));
  setenv("PALPATE_PLUGINS", folder.c_str(), 1);
  CHECK(pluginFile("odd") == folder / "odd.so");
  CHECK(refusal([] { (void)pluginFile("other"); }).find("use ") != std::string::npos);
  for (const char* name : {"../odd", "/etc/passwd", "", "-x", "a b"}) {
    CHECK_FALSE(refusal([&] { (void)pluginFile(name); }).empty());
  }
  namespace fs = std::filesystem;
  fs::permissions(folder, fs::perms::others_write, fs::perm_options::add);
  CHECK(refusal([] { (void)pluginFile("odd"); }).find("other users can write") !=
        std::string::npos);
  fs::permissions(folder, fs::perms::others_write, fs::perm_options::remove);
  fs::permissions(folder / "odd.so", fs::perms::others_write, fs::perm_options::add);
  CHECK(refusal([] { (void)pluginFile("odd"); }).find("chmod go-w") != std::string::npos);
  unsetenv("PALPATE_PLUGINS");
  fs::remove_all(folder);

  CHECK(parsePluginName("plugin:dhd@12").value().serial == "12");
  CHECK(parsePluginName("plugin-inside:dhd").value().inside);
  CHECK_FALSE(parsePluginName("hid:dhd").has_value());
}

TEST_CASE("an arm in a plug-in's own process can be read and driven", "[plugin]") {
  Bench bench;
  bench->position[2] = 0.02;
  auto arm = openOdd("good");
  HandState hand;
  REQUIRE(within(kLong, [&] { return (hand = tick(*arm, Vec3::Zero())).ready; }));
  CHECK(hand.position.z() == 0.02);
  CHECK(hand.handle.buttons == 1);
  CHECK(hand.handle.orientation[3] == Approx(0.8));
  CHECK(hand.handle.gripper == 0.25);
  CHECK(hand.fault == Fault::kNone);
  int wrong = 0;
  for (int i = 1; i <= 100; ++i) {
    const Vec3 force(0.01 * i, -0.02 * i, 0.005);
    (void)arm->read();
    arm->write(force);
    const bool came = within(kLong, [&] { return bench->force[0] == force.x(); });
    wrong += static_cast<int>(!came || bench->force[1] != force.y());
  }
  CHECK(wrong == 0);
  arm->carry(true);
  REQUIRE(within(kLong, [&] {
    (void)tick(*arm, Vec3(0.1, 0.0, 0.0));
    return bench->carried > 0.1;
  }));
  arm.reset();
  CHECK(bench->norm() == 0.0);
  CHECK(bench->carried == 0.0);
  CHECK(bench->closes == 1);
}

TEST_CASE("a plug-in's force ends if the program stops sending forces", "[plugin]") {
  Bench bench;
  auto arm = openOdd("good");
  REQUIRE(within(kLong, [&] { return tick(*arm, Vec3::Zero()).ready; }));
  (void)tick(*arm, Vec3(0.5, 0.0, 0.0));
  CHECK(within(kLong, [&] { return bench->stops > 0 && bench->norm() == 0.0; }));
  // After a stop, forces are blocked until the program has written zero.
  (void)tick(*arm, Vec3(0.5, 0.0, 0.0));
  std::this_thread::sleep_for(std::chrono::milliseconds(5));
  CHECK(bench->norm() == 0.0);
  CHECK(within(kLong, [&] { return arm->read().fault == Fault::kLate; }));
  CHECK(within(kLong, [&] {
    (void)tick(*arm, Vec3::Zero());
    (void)tick(*arm, Vec3(0.25, 0.0, 0.0));
    return bench->force[0] == 0.25;
  }));
}

TEST_CASE("a zero message from the guardian ends a plug-in's force", "[plugin]") {
  Bench bench;
  auto arm = openOdd("good");
  REQUIRE(within(kLong, [&] { return tick(*arm, Vec3::Zero()).ready; }));
  const ZeroForce zero = arm->zeroForce();
  REQUIRE(zero.descriptor >= 0);
  std::atomic<bool> over{false};
  // Orders continue, so a lack of orders cannot be the reason why the force ends.
  std::thread haptic([&] {
    while (!over) (void)tick(*arm, Vec3(0.5, 0.0, 0.0));
  });
  CHECK(within(kLong, [&] { return bench->force[0] == 0.5; }));
  CHECK(::write(zero.descriptor, zero.bytes.data(), zero.bytes.size()) == 4);
  CHECK(within(kLong, [&] { return bench->norm() == 0.0; }));
  std::this_thread::sleep_for(std::chrono::milliseconds(10));
  CHECK(bench->norm() == 0.0);
  over = true;
  haptic.join();
}

TEST_CASE("a stop during a write leaves neither force nor gravity compensation on a plug-in's arm",
          "[plugin]") {
  // If `trips` is set, carry() calls stop(), as if from another thread.
  static struct {
    double force, share, next;
    bool stopped, trips;
    PluginServer* server;
  } arm;
  arm = {};
  palpate_plugin_device device{};
  device.size = sizeof(device);
  device.write = [](palpate_plugin_device*, const palpate_plugin_force* force) {
    const bool zero = force->force[0] == 0.0;
    if (zero) arm.stopped = false;
    if (arm.stopped) return static_cast<int>(PALPATE_PLUGIN_OK);
    arm.force = force->force[0];
    arm.share = arm.next;
    return static_cast<int>(PALPATE_PLUGIN_OK);
  };
  device.read = [](palpate_plugin_device*, palpate_plugin_reading*) {
    return static_cast<int>(PALPATE_PLUGIN_NOTHING);
  };
  device.stop = [](palpate_plugin_device*) {
    arm.stopped = true;
    arm.force = arm.share = 0.0;
  };
  device.close = [](palpate_plugin_device*) {};
  device.extension = [](palpate_plugin_device*, const char* name) -> const void* {
    static const palpate_plugin_weight weight{sizeof(weight), 0,
                                              [](palpate_plugin_device*, double share) {
                                                arm.next = share;
                                                if (std::exchange(arm.trips, false))
                                                  arm.server->stop();
                                              },
                                              5.0};
    return std::string(name) == PALPATE_PLUGIN_WEIGHT ? &weight : nullptr;
  };
  const auto link = std::make_unique<PluginLink>();
  const PluginDevice opened(&device, "plugin:test");
  PluginServer server(*link, opened, 1e-3, 8.0, kPluginSlew);
  arm.server = &server;
  const auto give = [&](double force, double carry, std::uint32_t number) {
    PluginOrder order;
    order.force.force[0] = force;
    order.carry = carry;
    order.number = number;
    link->order.store(order);
    ++link->orders;
    wakeWord(link->orders);
    return within(kLong, [&] {
      PluginNews news;
      return link->news.load(news) && news.written == number;
    });
  };
  std::thread haptic([&] { server.loop(); });
  // Share of the weight: its growth in one tick of 1 ms, a fifth of the growth that the server
  // permits at once.
  constexpr double kShare = 0.002;
  // First the weight alone, then the weight and a force. A stop during the order must end both.
  for (const double force : {0.0, 0.5}) {
    REQUIRE(give(0.0, 0.0, 1));
    arm.trips = true;
    REQUIRE(give(force, kShare, 2));
    CHECK(arm.force == 0.0);
    CHECK(arm.share == 0.0);
    // Both stay off until the program has written zero.
    REQUIRE(give(0.5, kShare, 3));
    CHECK(arm.force == 0.0);
    CHECK(arm.share == 0.0);
  }
  REQUIRE(give(0.0, 0.0, 4));
  REQUIRE(give(0.5, kShare, 5));
  CHECK(arm.share == kShare);
  server.end();
  wakeWord(link->orders);
  haptic.join();
  CHECK(arm.force == 0.0);
}

TEST_CASE("a force above the peak or slew limit is not passed to a plug-in's arm", "[plugin]") {
  // The plug-in runs in the server's process and can overwrite an order in memory, so the server
  // checks each order again.
  static struct {
    std::vector<double> forces;
    double share;
  } arm;
  palpate_plugin_device device{};
  device.size = sizeof(device);
  device.write = [](palpate_plugin_device*, const palpate_plugin_force* force) {
    arm.forces.push_back(force->force[2]);
    return static_cast<int>(PALPATE_PLUGIN_OK);
  };
  device.read = [](palpate_plugin_device*, palpate_plugin_reading*) {
    return static_cast<int>(PALPATE_PLUGIN_NOTHING);
  };
  device.stop = [](palpate_plugin_device*) {};
  device.close = [](palpate_plugin_device*) {};
  device.extension = [](palpate_plugin_device*, const char*) -> const void* {
    static const palpate_plugin_weight weight{
        sizeof(weight), 0, [](palpate_plugin_device*, double share) { arm.share = share; }, 5.0};
    return &weight;
  };
  constexpr double kPeak = 8.0;
  constexpr double kSlew = 20.0;
  const PluginDevice opened(&device, "plugin:test");
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double inf = std::numeric_limits<double>::infinity();
  struct Case {
    double force;
    double carry;
    bool given;
  };
  // The limits permit 5 ms of growth at once: 0.1 N and 0.01 of the weight. Each second of delay on
  // a slow machine permits 20 N and twice the weight more.
  for (const Case& c : {Case{0.03, 0.0, true},
                        {-0.03, 0.01, true},
                        {0.03, 1.0, false},
                        {nan, 0.0, false},
                        {inf, 0.0, false},
                        {-7e194, 0.0, false},
                        {8.1, 0.0, false},
                        {7.9, 0.0, false},
                        {0.03, nan, false},
                        {0.03, 1.1, false}}) {
    CAPTURE(c.force, c.carry);
    arm = {};
    const auto link = std::make_unique<PluginLink>();
    PluginServer server(*link, opened, 1e-3, kPeak, kSlew);
    std::thread haptic([&] { server.loop(); });
    std::uint32_t number = 0;
    const auto order = [&](double force, double carry) {
      PluginOrder next;
      next.force.force[2] = force;
      next.carry = carry;
      next.number = ++number;
      link->order.store(next);
      ++link->orders;
      wakeWord(link->orders);
      PluginNews news;
      REQUIRE(within(kLong, [&] { return link->news.load(news) && news.written == number; }));
      return news;
    };
    CHECK(order(0.0, 0.0).withheld == 0);
    CHECK(order(c.force, c.carry).withheld == (c.given ? 0 : 1));
    // After a refused order, all forces are refused until an order is zero.
    CHECK(order(0.009, 0.0).withheld == (c.given ? 0 : 2));
    CHECK(order(0.0, 0.0).withheld == (c.given ? 0 : 2));
    CHECK(order(0.009, 0.0).withheld == (c.given ? 0 : 2));
    server.end();
    wakeWord(link->orders);
    haptic.join();
    for (const double force : arm.forces) {
      CHECK(std::abs(force) <= 0.03);
    }
    CHECK(arm.share == 0.0);
  }
}

TEST_CASE("a plug-in that hangs is distinguished from a machine that is late", "[plugin]") {
  static struct {
    std::atomic<bool> hangs;
    std::atomic<bool> hung;
  } arm;
  palpate_plugin_device device{};
  device.size = sizeof(device);
  device.write = [](palpate_plugin_device*, const palpate_plugin_force*) {
    return static_cast<int>(PALPATE_PLUGIN_OK);
  };
  device.read = [](palpate_plugin_device*, palpate_plugin_reading*) {
    arm.hung = arm.hangs.load();
    while (arm.hangs) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    return static_cast<int>(PALPATE_PLUGIN_NOTHING);
  };
  device.stop = [](palpate_plugin_device*) {};
  device.close = [](palpate_plugin_device*) {};
  device.extension = [](palpate_plugin_device*, const char*) -> const void* { return nullptr; };
  const PluginDevice opened(&device, "plugin:test");
  using Look = PluginServer::Look;
  constexpr std::int64_t kMs = 1000000;  // [ns]
  struct Case {
    // [ms]; times of calls of look(), since the last pass of loop()
    std::vector<std::int64_t> looks;
    bool blamed;
  };
  std::vector<std::int64_t> punctual;
  for (std::int64_t ms = 2; ms <= 18; ms += 2) punctual.push_back(ms);
  const Case cases[] = {
      {punctual, true},  // the plug-in hangs
      {{18}, false},     // the machine was late
      // The machine was late during a part of the time.
      {{2, 4, 14, 16, 18}, false},
      // The machine was late, and then the plug-in hung.
      {{18, 20, 22, 24, 26, 28, 30, 32, 34, 36}, true},
  };
  for (const Case& c : cases) {
    CAPTURE(c.looks);
    arm.hangs = arm.hung = false;
    const auto link = std::make_unique<PluginLink>();
    PluginServer server(*link, opened, 1e-3, 8.0, kPluginSlew);
    std::thread haptic([&] { server.loop(); });
    std::uint32_t number = 0;
    const auto order = [&](double force) {
      PluginOrder next;
      next.force.force[2] = force;
      next.number = ++number;
      link->order.store(next);
      ++link->orders;
      wakeWord(link->orders);
    };
    const auto news = [&] {
      PluginNews out;
      REQUIRE(within(kLong, [&] { return link->news.load(out) && out.written == number; }));
      return out;
    };
    order(0.0);
    CHECK(news().withheld == 0);
    order(0.1);
    CHECK(news().wrote == PALPATE_PLUGIN_OK);
    arm.hangs = true;
    REQUIRE(within(kLong, [] { return arm.hung.load(); }));
    // The test supplies the times, so a busy machine has no effect.
    const std::int64_t now = nowNs();
    CHECK(server.look(now) == Look::kTurns);
    int stops = 0;
    for (const std::int64_t ms : c.looks) {
      stops += server.look(now + ms * kMs) == Look::kStop ? 1 : 0;
    }
    CHECK(stops == 1);
    server.stop();
    order(0.1);
    arm.hangs = false;
    PluginNews after = news();
    CHECK(after.withheld >= 1);
    // If the plug-in hung, the server reports a failed write, which latches a fault. If the machine
    // was late, the server reports a good write.
    CHECK(after.wrote == (c.blamed ? -1 : static_cast<int>(PALPATE_PLUGIN_OK)));
    order(0.0);
    CHECK(news().wrote == PALPATE_PLUGIN_OK);
    const std::uint32_t before = after.withheld;
    order(0.1);
    after = news();
    CHECK(after.wrote == PALPATE_PLUGIN_OK);
    CHECK(after.withheld == before);
    server.end();
    wakeWord(link->orders);
    haptic.join();
  }
}

TEST_CASE("a failure to open a plug-in is reported with the reason", "[plugin]") {
  Bench bench;
  const auto said = [](const std::string& serial) {
    return refusal([&] { (void)openOdd(serial); });
  };
  CHECK(said("nobody").find("no arm of that number is plugged in") != std::string::npos);
  CHECK(said("unhomed").find("it finds no stop") != std::string::npos);
  CHECK(said("mute").find("does not report its properties") != std::string::npos);
  CHECK(said("limitless").find("force = nan") != std::string::npos);
  CHECK(said("stillborn").find("ended before its arm was ready") != std::string::npos);
  CHECK(refusal([] {
          (void)openPluginProcess(kOdd, "good", {}, "/nowhere/palpate-plugin");
        }).find("install this program again") != std::string::npos);
  // A user can end the program while it waits for the arm's button.
  std::atomic<bool> ends{false};
  ArmHost host;
  std::string words;
  host.say = [&](const std::string& line) {
    words = line;
    ends = true;
  };
  host.stop = [&] { return ends.load(); };
  CHECK(refusal([&] { (void)openOdd("slow", host); }).find("the program was stopped") !=
        std::string::npos);
  CHECK(words.find("press its button") != std::string::npos);
}

TEST_CASE("a plug-in runs inside the program only if its arm has a watchdog", "[plugin]") {
  Bench bench;
  CHECK(refusal([] { (void)openPluginInside(kOdd, "good", {}); }).find("no watchdog") !=
        std::string::npos);
  PluginArm arm(openPluginInside(kOdd, "inside", {}), "plugin:odd", true);
  CHECK(arm.zeroForce().descriptor == -1);
  bench->position[0] = 0.03;
  const HandState hand = arm.read();
  CHECK(hand.ready);
  CHECK(hand.position.x() == 0.03);
  arm.write(Vec3(0.0, 0.75, 0.0));
  CHECK(bench->force[1] == 0.75);
}

TEST_CASE("palpate restarts a plug-in's process that has exited", "[plugin]") {
  Bench bench;
  std::atomic<int> said{0};
  ArmHost host;
  host.say = [&](const std::string& words) {
    if (words.find("starts it again") != std::string::npos) ++said;
  };
  auto arm = openOdd("exit", host);
  REQUIRE(within(kLong, [&] { return tick(*arm, Vec3::Zero()).ready; }));
  const std::uint32_t version = arm->zeroForce().version;
  bench->trouble = 1;
  CHECK(within(kLong, [&] { return tick(*arm, Vec3::Zero()).fault == Fault::kGone; }));
  bench->trouble = 0;
  CHECK(within(kLong, [&] { return tick(*arm, Vec3::Zero()).ready; }));
  CHECK(said >= 1);
  CHECK(bench->opens == 2);
  const ZeroForce zero = arm->zeroForce();
  CHECK(zero.version != version);
  // The guardian's descriptor is now connected to the new process.
  const std::uint32_t stops = bench->stops;
  CHECK(::write(zero.descriptor, zero.bytes.data(), zero.bytes.size()) == 4);
  CHECK(within(kLong, [&] { return bench->stops > stops; }));
}

/// Checks that the loop has one of `faults` after the plug-in's trouble `kind`. Also checks that
/// the force is zero within `limit` [s] plus 10 ms, a time slice of the scheduler.
void checkTrouble(const char* kind, double limit, const std::vector<Fault>& faults) {
  Bench bench;
  bench->position[2] = 0.05;
  auto arm = openOdd(kind);
  LoopParams params;
  params.rate = 1000.0;
  HapticThread loop(*arm, params);
  loop.publish(ballScene(ballField()));
  CAPTURE(kind);
  // The hand trembles, because the force would fade at a constant position.
  std::atomic<bool> over{false};
  std::thread trembles([&] {
    for (int i = 0; !over; ++i) {
      bench->position[0] = 1e-6 * (i % 7);
      std::this_thread::sleep_for(std::chrono::milliseconds(3));
    }
  });
  // The hand moves into the ball. If the loop reported a late tick meanwhile, the hand tries again
  // from outside.
  CHECK(within(kLong, [&] {
    bench->position[2] = 0.05;
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    loop.clear();
    for (double z = 0.05; z > 0.025; z -= 0.0005) {
      bench->position[2] = z;
      std::this_thread::sleep_for(std::chrono::milliseconds(4));
    }
    return within(2.0, [&] { return bench->norm() > 0.5; });
  }));
  bench->trouble = 1;
  CHECK(within(kLong, [&] { return bench->zero_at != 0; }));
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  CHECK(bench->norm() == 0.0);
  const double took = 1e-9 * static_cast<double>(bench->zero_at - bench->trouble_at);
  const Fault fault = loop.latest().fault;
  std::printf("%-10s %-12s force off after %6.2f ms\n", kind, wordFor(fault), 1e3 * took);
  over = true;
  trembles.join();
  INFO("off after " << took << " s");
  CHECK(std::count(faults.begin(), faults.end(), fault) == 1);
  CHECK(took <= limit + 0.010);
}

// Limits: two ticks for a fault that the plug-in reports; two ticks and 50 ms for a stale arm;
// 20 ms for a crash; 25 ms for a call that hangs. After an exit (100 ms), and if stop() hangs too
// (150 ms), the next process sets the force to zero. Several faults can follow one trouble. The
// scheduler decides which of them the loop finds first.
constexpr double kTick = 0.002;  // [s]; two ticks at 1 kHz
#define PALPATE_TROUBLE(kind, limit, ...)                                              \
  TEST_CASE("the force ends in time after plug-in trouble: " kind, "[plugin][host]") { \
    checkTrouble(kind, limit, {__VA_ARGS__});                                          \
  }
PALPATE_TROUBLE("crash", 0.020, Fault::kGone, Fault::kStale, Fault::kWrite)
PALPATE_TROUBLE("abort", 0.020, Fault::kGone, Fault::kStale, Fault::kWrite)
PALPATE_TROUBLE("long", 0.020, Fault::kGone, Fault::kStale, Fault::kWrite)
PALPATE_TROUBLE("exit", 0.100, Fault::kGone)
PALPATE_TROUBLE("stack", 0.020, Fault::kGone, Fault::kStale, Fault::kWrite)
PALPATE_TROUBLE("deadlock", 0.150, Fault::kStale, Fault::kWrite, Fault::kGone)
PALPATE_TROUBLE("hang", 0.025, Fault::kStale, Fault::kWrite, Fault::kGone)
PALPATE_TROUBLE("stuck", 0.025, Fault::kStale, Fault::kWrite, Fault::kGone)
PALPATE_TROUBLE("refuse", kTick, Fault::kWrite)
PALPATE_TROUBLE("gone", kTick, Fault::kGone)
PALPATE_TROUBLE("nothing", 0.050 + kTick, Fault::kStale)
PALPATE_TROUBLE("dead", 0.050 + kTick, Fault::kStale)
PALPATE_TROUBLE("future", 0.050 + kTick, Fault::kStale)
PALPATE_TROUBLE("nan", kTick, Fault::kNotFinite)
PALPATE_TROUBLE("vast", kTick, Fault::kJump, Fault::kNotFinite)
PALPATE_TROUBLE("jump", kTick, Fault::kJump)
PALPATE_TROUBLE("hot", kTick, Fault::kTemperature)
PALPATE_TROUBLE("unpowered", kTick, Fault::kPower)
PALPATE_TROUBLE("open", kTick, Fault::kSwitch)
PALPATE_TROUBLE("held", kTick, Fault::kNone)
#undef PALPATE_TROUBLE

}  // namespace palpate::process_test
