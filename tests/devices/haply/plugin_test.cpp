/// Tests haply.so through its entry symbol, as a host does, against a mock of Haply's service.
/// The tests set the plug-in's clock: a timeout of 40 ms expires when a test advances the clock by
/// 40 ms. Only the helper process and the measurement use the real clock.
#include "palpate/devices/plugins/plugin.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <dlfcn.h>
#include <filesystem>
#include <functional>
#include <limits>
#include <mutex>
#include <netinet/in.h>
#include <numeric>
#include <string>
#include <sys/socket.h>
#include <thread>
#include <unistd.h>
#include <vector>

#include <catch2/catch.hpp>

#include "tests/devices/haply/mock_service.h"
#include "tests/support/counters.h"
#include "tests/support/random.h"

using namespace palpate::test;
using namespace std::chrono_literals;
using Catch::Contains;

namespace {

using Vec = std::array<double, 3>;
constexpr Vec kMiddle{0.0, -0.12, 0.15};  ///< Middle of the workspace, from the arm's base [m].
constexpr std::int64_t kMs = 1'000'000;   ///< [ns]

std::atomic<std::int64_t> clock_ns{1'000'000'000};
std::atomic<int> ends{0};
std::atomic<bool> real_clock{false};
std::mutex said_mutex;
std::vector<std::string> said_lines;

std::int64_t monotonic() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1'000'000'000LL + now.tv_nsec;
}

std::vector<std::string> said() {
  const std::lock_guard lock(said_mutex);
  return said_lines;
}

const palpate_plugin_host kHost{
    sizeof(palpate_plugin_host),
    [](const char* words) {
      const std::lock_guard lock(said_mutex);
      said_lines.emplace_back(words);
    },
    [] { return ends.load(); },
    [] { return real_clock ? monotonic() : clock_ns.load(); },
    [](const char*) -> const void* { return nullptr; },
};

/// Loads haply.so from BUILD/plugins. This program is in a folder below BUILD.
const palpate_plugin_entry& entry() {
  static const palpate_plugin_entry* const kEntry = [] {
    auto folder = std::filesystem::read_symlink("/proc/self/exe").parent_path();
    while (!std::filesystem::exists(folder / "plugins" / "haply.so") && folder != "/") {
      folder = folder.parent_path();
    }
    void* library = dlopen((folder / "plugins" / "haply.so").c_str(), RTLD_NOW | RTLD_LOCAL);
    if (library == nullptr) throw std::runtime_error(dlerror());
    return static_cast<const palpate_plugin_entry*>(dlsym(library, "palpate_plugin"));
  }();
  return *kEntry;
}

/// Returns true as soon as the condition holds; false if it does not hold within about 30 s.
bool eventually(const std::function<bool()>& is) {
  for (int i = 0; i < 30'000; ++i) {
    if (is()) return true;
    std::this_thread::sleep_for(1ms);
  }
  return false;
}

/// Initializes the plug-in for a service at the address `url`, and ends it in the destructor.
class Plugin {
 public:
  explicit Plugin(const std::string& url) {
    setenv("PALPATE_HAPLY_URL", url.c_str(), 1);
    // The plug-in must connect to the service directly and ignore this proxy, which does not exist.
    setenv("http_proxy", "127.0.0.1:1", 1);
    ends = 0;
    {
      const std::lock_guard lock(said_mutex);
      said_lines.clear();
    }
    code = entry().init(&kHost);
    arms = static_cast<const palpate_plugin_factory*>(entry().factory(PALPATE_PLUGIN_ARMS));
  }
  ~Plugin() { entry().end(); }
  Plugin(const Plugin&) = delete;
  Plugin& operator=(const Plugin&) = delete;

  int code = 0;
  const palpate_plugin_factory* arms = nullptr;
};

/// An open arm and its last reading. If opening fails, `device` is null and `error` has the reason.
class Hand {
 public:
  Hand(const Plugin& plugin, const char* serial)
      : device(plugin.arms->open(serial, error.data(), error.size())) {}
  ~Hand() { close(); }
  Hand(const Hand&) = delete;
  Hand& operator=(const Hand&) = delete;

  void close() {
    if (device != nullptr) device->close(device);
    device = nullptr;
  }
  int read() {
    reading.size = sizeof(reading);
    return device->read(device, &reading);
  }
  int write(const Vec& force) const {
    palpate_plugin_force all{};
    all.size = sizeof(all);
    std::copy(force.begin(), force.end(), all.force);
    return device->write(device, &all);
  }
  /// Reads until a new reading arrives. Returns false if none arrives.
  bool readNew() {
    return eventually([&] { return read() == PALPATE_PLUGIN_OK; });
  }
  [[nodiscard]] Vec position() const {
    return {reading.position[0], reading.position[1], reading.position[2]};
  }

  std::array<char, 512> error{};
  palpate_plugin_device* device;
  palpate_plugin_reading reading{};
};

/// Returns the last force that the service received for an arm; NaN if there is none.
Vec newest(const MockService& service, const std::string& id) {
  const auto told = service.told();
  const auto last =
      std::find_if(told.rbegin(), told.rend(), [&](const Told& t) { return t.id == id; });
  return last == told.rend() ? Vec{NAN, NAN, NAN} : last->force;
}

/// Waits until the service has received `messages` more messages. Returns false if they do not
/// come.
bool exchanged(const MockService& service, long messages) {
  const long before = service.heard().messages;
  return eventually([&] { return service.heard().messages >= before + messages; });
}

/// Writes a force again and again until the service has received it. Returns false if the service
/// does not receive it.
bool drives(const Hand& hand, const MockService& service, const std::string& id, const Vec& force) {
  return eventually([&] {
    hand.write(force);
    return newest(service, id) == force;
  });
}

/// Counts the non-zero forces for `id` in service.told(), from index `from` on.
long driven(const MockService& service, const std::string& id, std::size_t from = 0) {
  const auto told = service.told();
  long count = 0;
  for (std::size_t i = from; i < told.size(); ++i) {
    if (told[i].id == id && told[i].force != Vec{}) ++count;
  }
  return count;
}

void checkNear(const Vec& a, const Vec& b) {
  for (std::size_t i = 0; i < 3; ++i) CHECK(a[i] == Approx(b[i]).margin(1e-12));
}

}  // namespace

TEST_CASE("haply.so has the entry point and the struct sizes that the plug-in interface requires",
          "[haply][plugin]") {
  const palpate_plugin_entry& one = entry();
  CHECK(one.size == sizeof(palpate_plugin_entry));
  CHECK(one.major == PALPATE_PLUGIN_MAJOR);
  CHECK(one.minor <= PALPATE_PLUGIN_MINOR);
  CHECK(std::strlen(one.name) > 0);
  CHECK(one.factory("palpate.toasters/1") == nullptr);

  MockService service(Speaks::k35);
  const Plugin plugin(service.url());
  REQUIRE(plugin.code == 0);
  REQUIRE(plugin.arms != nullptr);
  Hand hand(plugin, "");
  INFO(hand.error.data());
  REQUIRE(hand.device != nullptr);
  // Before the first answer, prepare() prints no instruction to the user.
  std::array<char, 64> why{};
  CHECK(hand.device->prepare(hand.device, why.data(), why.size()) == PALPATE_PLUGIN_OK);
  CHECK(said().empty());
  palpate_plugin_facts facts{};
  facts.size = sizeof(facts);
  REQUIRE(hand.device->facts(hand.device, &facts) == PALPATE_PLUGIN_OK);
  CHECK(facts.has == (PALPATE_PLUGIN_FORCE | PALPATE_PLUGIN_ORIENTATION));
  CHECK(facts.force > 0.0);
  CHECK(facts.force <= 10.0);
  CHECK(facts.continuous <= facts.force);
  CHECK(facts.workspace_radius == 0.1);
  CHECK(facts.rate == 1000.0);
  CHECK(facts.joints == 3);
  CHECK(facts.buttons == 3);
  CHECK(std::string(facts.button[2]) == "c");
  CHECK_THAT(std::string(facts.source), Contains("assumed"));
  CHECK(hand.device->extension(hand.device, PALPATE_PLUGIN_HEAT) == nullptr);

  // A host of an older version gets only the fields for which its struct has room.
  REQUIRE(hand.readNew());
  palpate_plugin_reading older;
  std::memset(&older, 0x5a, sizeof(older));
  older.size = offsetof(palpate_plugin_reading, velocity);
  REQUIRE(eventually([&] { return hand.device->read(hand.device, &older) == PALPATE_PLUGIN_OK; }));
  CHECK(older.size == offsetof(palpate_plugin_reading, velocity));
  const auto* rest = reinterpret_cast<const unsigned char*>(&older) + older.size;
  CHECK(std::all_of(rest, reinterpret_cast<const unsigned char*>(&older + 1),
                    [](unsigned char c) { return c == 0x5a; }));
}

TEST_CASE("the Haply plug-in lists both arms by serial number with service versions 3.1 and 3.5",
          "[haply][plugin]") {
  const Speaks speaks = GENERATE(Speaks::k31, Speaks::k35);
  MockService service(speaks);
  const Plugin plugin(service.url());
  std::array<palpate_plugin_found, 3> found{};
  for (auto& one : found) one.size = sizeof(one);
  REQUIRE(plugin.arms->find(found.data(), 3) == 2);
  CHECK(std::string(found[0].serial) == "049D");
  CHECK(std::string(found[1].serial) == "04BA");
  CHECK_THAT(std::string(found[0].model), Contains("Inverse3"));
  CHECK(std::string(found[2].serial).empty());
  // find() counts arms for which the array has no room, but does not write them.
  found[1].serial[0] = '!';
  CHECK(plugin.arms->find(found.data(), 1) == 2);
  CHECK(found[1].serial[0] == '!');
}

TEST_CASE(
    "each of two Haply arms has its own readings and forces with service versions 3.1 and 3.5",
    "[haply][plugin]") {
  const Speaks speaks = GENERATE(Speaks::k31, Speaks::k35);
  CAPTURE(speaks == Speaks::k35);
  MockService service(speaks);
  const Plugin plugin(service.url());
  Hand second(plugin, "04BA");
  Hand first(plugin, "049D");
  REQUIRE(first.device != nullptr);
  REQUIRE(second.device != nullptr);
  std::array<Hand*, 2> hands{&first, &second};
  const std::array<std::string, 2> ids{"049D", "04BA"};

  Random random(3);
  std::array<std::vector<Vec>, 2> written;
  for (int i = 0; i < 40; ++i) {
    for (int k = 0; k < 2; ++k) {
      MockArm arm = service.arm(k);
      for (double& x : arm.position) x = random.uniform(-0.3, 0.3);
      for (double& v : arm.velocity) v = random.uniform(-2.0, 2.0);
      for (double& a : arm.degrees) a = random.uniform(-180.0, 180.0);
      const palpate::Vec3 axis = random.direction();
      const double half = random.uniform(0.0, 3.0);
      arm.orientation = {std::cos(half), axis.x() * std::sin(half), axis.y() * std::sin(half),
                         axis.z() * std::sin(half)};
      for (bool& b : arm.buttons) b = random.integer(2) == 1;
      service.set(k, arm);
      Hand& hand = *hands[static_cast<std::size_t>(k)];
      const auto& p = arm.position;
      REQUIRE(eventually([&] {
        return hand.read() == PALPATE_PLUGIN_OK &&
               std::abs(hand.reading.position[0] - (p[0] - kMiddle[0])) < 1e-12;
      }));
      checkNear(hand.position(), {p[0] - kMiddle[0], p[1] - kMiddle[1], p[2] - kMiddle[2]});
      for (std::size_t j = 0; j < 3; ++j) {
        CHECK(hand.reading.velocity[j] == Approx(arm.velocity[j]));
        CHECK(hand.reading.joints[j] == Approx(arm.degrees[j] * std::acos(-1.0) / 180.0));
        CHECK(((hand.reading.buttons >> j) & 1U) == (arm.buttons[j] ? 1U : 0U));
      }
      for (std::size_t j = 0; j < 4; ++j) {
        CHECK(hand.reading.orientation[j] == Approx(arm.orientation[j]).margin(1e-12));
      }
      CHECK(hand.reading.state == PALPATE_PLUGIN_READY);
      CHECK(hand.reading.taken == clock_ns);
    }
    for (std::size_t k = 0; k < 2; ++k) {
      const palpate::Vec3 d = random.direction() * random.uniform(0.1, 4.0);
      const Vec force{d.x(), d.y(), d.z()};
      written[k].push_back(force);
      REQUIRE(hands[k]->write(force) == PALPATE_PLUGIN_OK);
      REQUIRE(eventually([&] { return newest(service, ids[k]) == force; }));
    }
  }
  // Each non-zero force that the service received was written, and their order is kept.
  long mismatches = 0;
  for (const Told& told : service.told()) {
    if (told.force == Vec{}) continue;
    auto& expected = written[told.id == ids[0] ? 0 : 1];
    while (!expected.empty() && expected.front() != told.force) expected.erase(expected.begin());
    if (expected.empty() || (told.id != ids[0] && told.id != ids[1])) ++mismatches;
  }
  CHECK(mismatches == 0);
  // The plug-in connected once and sent only messages of the service's version. It introduced
  // itself once to version 3.5, and not to version 3.1.
  const Heard heard = service.heard();
  CHECK(heard.connections == 1);
  CHECK(heard.unknown == 0);
  CHECK(heard.introduced == (speaks == Speaks::k35 ? 1 : 0));
}

TEST_CASE("a Haply arm's positions are unchanged if their origin is in the middle of the workspace",
          "[haply][plugin]") {
  MockService service(Speaks::k35);
  MockArm arm = service.arm(0);
  arm.preset = "arm_front_centered";
  arm.position = {0.01, 0.02, 0.03};
  service.set(0, arm);
  const Plugin plugin(service.url());
  // The updates that the service sends before the arm is opened do not repeat the preset.
  Hand other(plugin, "04BA");
  REQUIRE(other.device != nullptr);
  REQUIRE(exchanged(service, 5));
  Hand hand(plugin, "049D");
  REQUIRE(hand.device != nullptr);
  REQUIRE(hand.readNew());
  checkNear(hand.position(), {0.01, 0.02, 0.03});
}

TEST_CASE("the Haply plug-in requests the list of arms if the service does not send it",
          "[haply][plugin]") {
  MockService service(Speaks::k35);
  service.shy(true);
  const Plugin plugin(service.url());
  Hand hand(plugin, "049D");
  REQUIRE(hand.device != nullptr);
  CHECK(hand.readNew());
  CHECK(service.heard().asked_for_all >= 1);
}

TEST_CASE("a Haply arm gets no force until it has sent a position", "[haply][plugin]") {
  MockService service(Speaks::k35);
  service.lie(Lie::kNoPosition);
  const Plugin plugin(service.url());
  Hand hand(plugin, "049D");
  REQUIRE(hand.device != nullptr);
  for (int i = 0; i < 5; ++i) {
    CHECK(hand.write({1.0, 0.0, 0.0}) == PALPATE_PLUGIN_GONE);
    CHECK(hand.read() == PALPATE_PLUGIN_GONE);
    REQUIRE(exchanged(service, 3));
  }
  CHECK(driven(service, "049D") == 0);
  CHECK(newest(service, "049D") == Vec{});
}

TEST_CASE("the Haply plug-in refuses an unusable arm or service with a one-line message",
          "[haply][plugin]") {
  const auto refused = [](MockService& service, const char* serial) {
    const Plugin plugin(service.url());
    const Hand hand(plugin, serial);
    CHECK(hand.device == nullptr);
    const std::string words(hand.error.data());
    CHECK(words.find('\n') == std::string::npos);
    return words;
  };
  SECTION("wrong serial number, preset, basis or model") {
    MockService service(Speaks::k35);
    CHECK_THAT(refused(service, "FFFF"), Contains("no Inverse3 FFFF") && Contains("049D 04BA"));
    MockArm arm = service.arm(0);
    arm.preset = "led_front";
    service.set(0, arm);
    CHECK_THAT(refused(service, "049D"), Contains("arm_front_centered"));
    arm.preset = "defaults";
    arm.basis = "XZY";
    service.set(0, arm);
    CHECK_THAT(refused(service, "049D"), Contains("set its basis to XYZ"));
    arm.basis = "XYZ";
    arm.type = "minverse";
    service.set(0, arm);
    CHECK_THAT(refused(service, "049D"), Contains("Minverse"));
    service.lie(Lie::kEmptyLists);
    CHECK_THAT(refused(service, ""), Contains("plug one in"));
  }
  SECTION("a service of version 3.0") {
    MockService service(Speaks::k30);
    CHECK_THAT(refused(service, ""), Contains("3.0") && Contains("3.1 or newer"));
    const Plugin plugin(service.url());
    palpate_plugin_found found{};
    found.size = sizeof(found);
    CHECK(plugin.arms->find(&found, 1) < 0);
    CHECK(service.told().empty());
  }
  SECTION("no service") {
    MockService service(Speaks::k35);
    service.end();
    CHECK_THAT(refused(service, ""), Contains("no service answers at " + service.url()) &&
                                         Contains("start the Haply Hub"));
    const Plugin plugin(service.url());
    CHECK(plugin.arms->find(nullptr, 0) < 0);
  }
  SECTION("a service that does not answer") {
    MockService service(Speaks::k35);
    service.mute(true);
    CHECK_THAT(refused(service, ""), Contains("restart the Haply Hub"));
  }
  SECTION("a port that accepts a connection but never answers") {
    const int listener = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    sockaddr_in at{};
    at.sin_family = AF_INET;
    at.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof(at);
    REQUIRE(bind(listener, reinterpret_cast<const sockaddr*>(&at), size) == 0);
    REQUIRE(listen(listener, 4) == 0);
    REQUIRE(getsockname(listener, reinterpret_cast<sockaddr*>(&at), &size) == 0);
    const Plugin plugin("ws://127.0.0.1:" + std::to_string(ntohs(at.sin_port)));
    const Hand hand(plugin, "");
    CHECK(hand.device == nullptr);
    CHECK_THAT(std::string(hand.error.data()), Contains("restart the Haply Hub"));
    ::close(listener);
  }
  SECTION("more open hands than the limit") {
    MockService service(Speaks::k35);
    const Plugin plugin(service.url());
    const Hand a(plugin, "");
    const Hand b(plugin, "");
    const Hand c(plugin, "");
    const Hand d(plugin, "");
    CHECK(d.device != nullptr);
    const Hand e(plugin, "");
    CHECK(e.device == nullptr);
    CHECK_THAT(std::string(e.error.data()), Contains("close one"));
  }
}

TEST_CASE("the Haply plug-in uses only a local service unless PALPATE_HAPLY_ANYWHERE is set",
          "[haply][plugin]") {
  for (const char* url :
       {"ws://192.168.1.7:10001", "ws://haply.example", "ws://127.0.0.1.example:1",
        "ws://localhost.example:1", "ws://[::2]:10001", "http://localhost:10001",
        "ws://localhost:0", "ws://localhost:65536", "ws://localhost:1x", "ws://:10001",
        "localhost:10001"}) {
    CAPTURE(url);
    const Plugin plugin(url);
    CHECK(plugin.code != 0);
    REQUIRE(said().size() == 1);
    CHECK_THAT(said()[0], Contains(url) && Contains("PALPATE_HAPLY_URL"));
  }
  for (const char* url : {"ws://localhost", "ws://127.0.0.1:10001/", "ws://[::1]:10001/x"}) {
    CAPTURE(url);
    const Plugin plugin(url);
    CHECK(plugin.code == 0);
    CHECK(said().empty());
  }
  setenv("PALPATE_HAPLY_ANYWHERE", "1", 1);
  CHECK(Plugin("ws://192.168.1.7:10001").code == 0);
  unsetenv("PALPATE_HAPLY_ANYWHERE");
}

TEST_CASE("a read of a Haply arm without a new message gives no reading and keeps the last time",
          "[haply][plugin]") {
  MockService service(Speaks::k35);
  const Plugin plugin(service.url());
  Hand hand(plugin, "049D");
  REQUIRE(hand.device != nullptr);
  REQUIRE(hand.readNew());
  service.lie(Lie::kDrops);
  // Waits until messages that were already sent have arrived.
  REQUIRE(exchanged(service, 3));
  while (hand.read() == PALPATE_PLUGIN_OK) {
  }
  clock_ns += 10 * kMs;
  const auto before = hand.reading;
  REQUIRE(exchanged(service, 3));
  CHECK(hand.read() == PALPATE_PLUGIN_NOTHING);
  CHECK(hand.reading.taken == before.taken);
  CHECK(hand.reading.taken == clock_ns - 10 * kMs);
  service.lie(Lie::kNone);
  REQUIRE(hand.readNew());
  CHECK(hand.reading.taken == clock_ns);
}

TEST_CASE("after stop() a Haply arm gets no force until a zero force has been written",
          "[haply][plugin]") {
  const Speaks speaks = GENERATE(Speaks::k31, Speaks::k35);
  MockService service(speaks);
  const Plugin plugin(service.url());
  Hand hand(plugin, "049D");
  Hand other(plugin, "04BA");
  REQUIRE(hand.device != nullptr);
  REQUIRE(hand.readNew());
  REQUIRE(other.readNew());
  REQUIRE(drives(hand, service, "049D", {1.0, 2.0, 3.0}));
  REQUIRE(drives(other, service, "04BA", {0.0, 0.0, 1.0}));
  std::thread([&] { hand.device->stop(hand.device); }).join();
  REQUIRE(eventually([&] { return newest(service, "049D") == Vec{}; }));
  // Writes twenty forces without advancing the test's clock.
  const std::size_t from = service.told().size();
  for (int i = 0; i < 20; ++i) {
    hand.write({1.0, 0.1 * i, 0.0});
    REQUIRE(exchanged(service, 3));
  }
  CHECK(driven(service, "049D", from) == 0);
  CHECK(newest(service, "04BA") == Vec{0.0, 0.0, 1.0});
  hand.write({});
  CHECK(drives(hand, service, "049D", {1.0, 0.0, 0.0}));
  // The test calls stop() between a zero force and the next force.
  hand.write({});
  hand.device->stop(hand.device);
  REQUIRE(eventually([&] { return newest(service, "049D") == Vec{}; }));
  const std::size_t again = service.told().size();
  hand.write({1.0, 0.0, 0.0});
  REQUIRE(exchanged(service, 5));
  CHECK(driven(service, "049D", again) == 0);
}

TEST_CASE("helper process: calls stop() and exits at once", "[.victim]") {
  real_clock = true;
  const Plugin plugin(std::getenv("PALPATE_HAPLY_URL"));
  Hand hand(plugin, "049D");
  REQUIRE(hand.device != nullptr);
  REQUIRE(hand.readNew());
  for (int i = 0; i < 20; ++i) {
    hand.write({1.0, 0.0, 0.0});
    std::this_thread::sleep_for(1ms);
  }
  hand.device->stop(hand.device);
  _exit(0);
}

TEST_CASE("a program that exits right after stop() leaves no force on a Haply arm",
          "[haply][plugin]") {
  MockService service(Speaks::k35);
  setenv("PALPATE_HAPLY_URL", service.url().c_str(), 1);
  const std::string self = std::filesystem::read_symlink("/proc/self/exe").string();
  for (int i = 1; i <= 5; ++i) {
    REQUIRE(std::system((self + " '[.victim]' >/dev/null").c_str()) == 0);
    REQUIRE(eventually([&] { return service.heard().ended == i; }));
    CHECK(driven(service, "049D") > 0);
    CHECK(newest(service, "049D") == Vec{});
    service.forget();
  }
}

TEST_CASE("a Haply arm's force ends after 40 ms if the program does not write it again",
          "[haply][plugin]") {
  MockService service(Speaks::k35);
  const Plugin plugin(service.url());
  Hand hand(plugin, "049D");
  REQUIRE(hand.device != nullptr);
  REQUIRE(hand.readNew());
  REQUIRE(drives(hand, service, "049D", {0.0, 0.0, 2.0}));
  // Advances the clock in small steps and awaits a reading after each: 30 ms without a message
  // would end the force.
  const auto step = [&](std::int64_t ms) {
    clock_ns += ms * kMs;
    const std::int64_t at = clock_ns;
    return eventually([&] { return hand.read() == PALPATE_PLUGIN_OK && hand.reading.taken == at; });
  };
  REQUIRE(step(20));
  REQUIRE(step(19));
  REQUIRE(exchanged(service, 5));
  CHECK(newest(service, "049D") == Vec{0.0, 0.0, 2.0});
  REQUIRE(step(1));
  CHECK(eventually([&] { return newest(service, "049D") == Vec{}; }));
  // The arm was never reported as gone, so no zero is needed before the next force.
  CHECK(drives(hand, service, "049D", {0.0, 0.0, 1.0}));
}

TEST_CASE("the Haply plug-in never sends an invalid force or a force above the limit",
          "[haply][plugin]") {
  MockService service(Speaks::k35);
  const Plugin plugin(service.url());
  Hand hand(plugin, "049D");
  REQUIRE(hand.device != nullptr);
  REQUIRE(hand.readNew());
  REQUIRE(drives(hand, service, "049D", {1.0, 0.0, 0.0}));
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double inf = std::numeric_limits<double>::infinity();
  for (const Vec& force : {Vec{nan, 0.0, 0.0}, Vec{0.0, nan, 0.0}, Vec{0.0, 0.0, nan},
                           Vec{0.0, inf, 0.0}, Vec{1.7e308, 1.7e308, 0.0}}) {
    CAPTURE(force[0]);
    REQUIRE(drives(hand, service, "049D", {1.0, 0.0, 0.0}));
    CHECK(hand.write(force) == PALPATE_PLUGIN_FAILED);
    CHECK(eventually([&] { return newest(service, "049D") == Vec{}; }));
  }
  CHECK(hand.write({0.0, 30.0, 40.0}) == PALPATE_PLUGIN_OK);
  REQUIRE(eventually([&] { return newest(service, "049D") != Vec{}; }));
  checkNear(newest(service, "049D"), {0.0, 2.4, 3.2});
}

TEST_CASE("a Haply arm's force ends 30 ms after its last valid message", "[haply][plugin]") {
  const Lie lie =
      GENERATE(Lie::kDrops, Lie::kNaN, Lie::kHuge, Lie::kOverflows, Lie::kStrings, Lie::kNoPosition,
               Lie::kNoState, Lie::kOtherIds, Lie::kBadIds, Lie::kDeep, Lie::kLong, Lie::kBinary,
               Lie::kHalf, Lie::kEmptyLists, Lie::kNotJson);
  CAPTURE(static_cast<int>(lie));
  MockService service(Speaks::k35);
  const Plugin plugin(service.url());
  Hand hand(plugin, "049D");
  REQUIRE(hand.device != nullptr);
  REQUIRE(hand.readNew());
  REQUIRE(drives(hand, service, "049D", {1.0, 0.0, 0.0}));
  service.lie(lie);
  REQUIRE(exchanged(service, 3));
  while (hand.read() == PALPATE_PLUGIN_OK) {
  }
  const std::int64_t taken = hand.reading.taken;
  // For 29 ms without messages the force stays on.
  clock_ns += 29 * kMs;
  hand.write({1.0, 0.0, 0.0});
  REQUIRE(exchanged(service, 3));
  CHECK(hand.read() == PALPATE_PLUGIN_NOTHING);
  CHECK(newest(service, "049D") == Vec{1.0, 0.0, 0.0});
  // After 30 ms the arm counts as gone.
  clock_ns += 1 * kMs;
  REQUIRE(eventually([&] { return newest(service, "049D") == Vec{}; }));
  CHECK(hand.read() == PALPATE_PLUGIN_GONE);
  CHECK(hand.write({1.0, 0.0, 0.0}) == PALPATE_PLUGIN_GONE);
  CHECK(hand.reading.taken == taken);
  const std::size_t from = service.told().size();
  // The arm returns. Its forces are not sent until a zero is written.
  service.lie(Lie::kNone);
  REQUIRE(hand.readNew());
  CHECK(hand.reading.taken == clock_ns);
  for (int i = 0; i < 5; ++i) {
    CHECK(hand.write({1.0, 0.0, 0.0}) == PALPATE_PLUGIN_OK);
    REQUIRE(exchanged(service, 3));
  }
  CHECK(driven(service, "049D", from) == 0);
  hand.write({});
  CHECK(drives(hand, service, "049D", {1.0, 0.0, 0.0}));
  CHECK(service.heard().connections == 1);
}

TEST_CASE(
    "after Haply's service hangs up or restarts no force is sent until a zero force is written",
    "[haply][plugin]") {
  const bool hangs_up = GENERATE(false, true);
  MockService service(Speaks::k35);
  const Plugin plugin(service.url());
  Hand hand(plugin, "049D");
  REQUIRE(hand.device != nullptr);
  REQUIRE(hand.readNew());
  REQUIRE(drives(hand, service, "049D", {1.0, 0.0, 0.0}));
  if (hangs_up) {
    service.hangUp();
  } else {
    service.end();
    // The arm is reported as gone at once, without a timeout.
    REQUIRE(eventually([&] { return hand.read() == PALPATE_PLUGIN_GONE; }));
    CHECK(hand.read() == PALPATE_PLUGIN_GONE);
    CHECK(hand.write({1.0, 0.0, 0.0}) == PALPATE_PLUGIN_GONE);
    service.begin();
  }
  REQUIRE(eventually([&] { return service.heard().connections >= 2; }));
  // If the client did not read while the arm was gone, its first read after the return gives GONE.
  REQUIRE(eventually([&] { return hand.write({1.0, 0.0, 0.0}) == PALPATE_PLUGIN_OK; }));
  CHECK((hand.read() == PALPATE_PLUGIN_GONE) == hangs_up);
  REQUIRE(hand.readNew());
  for (int i = 0; i < 5; ++i) {
    hand.write({1.0, 0.0, 0.0});
    REQUIRE(exchanged(service, 3));
  }
  const auto told = service.told();
  CHECK(std::none_of(told.begin(), told.end(),
                     [](const Told& t) { return t.connection >= 2 && t.force != Vec{}; }));
  CHECK(newest(service, "049D") == Vec{});
  hand.write({});
  CHECK(drives(hand, service, "049D", {1.0, 0.0, 0.0}));
}

TEST_CASE("closing a Haply arm sets its force to zero and keeps the other arm's force",
          "[haply][plugin]") {
  MockService service(Speaks::k35);
  const Plugin plugin(service.url());
  Hand hand(plugin, "049D");
  Hand other(plugin, "04BA");
  REQUIRE(hand.device != nullptr);
  REQUIRE(hand.readNew());
  REQUIRE(other.readNew());
  REQUIRE(drives(other, service, "04BA", {0.0, 1.0, 0.0}));
  REQUIRE(drives(hand, service, "049D", {1.0, 0.0, 0.0}));
  hand.close();
  CHECK(newest(service, "049D") == Vec{});
  const auto count = [&] {
    const auto told = service.told();
    return std::count_if(told.begin(), told.end(), [](const Told& t) { return t.id == "049D"; });
  };
  // Messages from before the close can still arrive. After four messages this arm gets no more, and
  // the other arm keeps its force.
  REQUIRE(exchanged(service, 4));
  CHECK(newest(service, "049D") == Vec{});
  const auto before = count();
  REQUIRE(exchanged(service, 5));
  CHECK(newest(service, "04BA") == Vec{0.0, 1.0, 0.0});
  CHECK(count() == before);
  other.close();
  CHECK(newest(service, "04BA") == Vec{});
  // An arm that is opened again starts in its initial state, on a new connection.
  Hand again(plugin, "049D");
  REQUIRE(again.device != nullptr);
  REQUIRE(again.readNew());
  CHECK(drives(again, service, "049D", {0.0, 1.0, 0.0}));
  CHECK(service.heard().connections == 2);
}

TEST_CASE("forces and stops reach Haply's service even if its answers are 3 ms late",
          "[haply][plugin]") {
  MockService service(Speaks::k35);
  service.delay(3 * kMs);
  const Plugin plugin(service.url());
  Hand hand(plugin, "049D");
  REQUIRE(hand.device != nullptr);
  REQUIRE(hand.readNew());
  CHECK(drives(hand, service, "049D", {1.0, 0.0, 0.0}));
  for (int i = 0; i < 20; ++i) REQUIRE(hand.readNew());
  hand.device->stop(hand.device);
  CHECK(eventually([&] { return newest(service, "049D") == Vec{}; }));
  CHECK(service.heard().connections == 1);
  // The test closes the arm while an answer is due. The plug-in still sends the zero.
  for (int i = 0; i < 10; ++i) {
    Hand other(plugin, "04BA");
    REQUIRE(other.device != nullptr);
    REQUIRE(other.readNew());
    REQUIRE(drives(other, service, "04BA", {0.0, 1.0, 0.0}));
    other.close();
    CHECK(newest(service, "04BA") == Vec{});
  }
  // The plug-in closes the connection only after the service has answered the last message.
  hand.close();
  REQUIRE(eventually([&] { return service.heard().ended == 1; }));
  CHECK(service.heard().cut_off == 0);
}

TEST_CASE("prepare() waits until the Haply arm is ready and reports why it is not ready",
          "[haply][plugin]") {
  MockService service(Speaks::k35);
  MockArm arm = service.arm(0);
  arm.calibrated = false;
  arm.ready = false;
  arm.powered = false;
  service.set(0, arm);
  const Plugin plugin(service.url());
  Hand hand(plugin, "049D");
  REQUIRE(hand.device != nullptr);
  REQUIRE(hand.readNew());
  CHECK(hand.reading.state == PALPATE_PLUGIN_UNPOWERED);
  std::array<char, 256> error{};
  int code = 1;
  std::thread preparing(
      [&] { code = hand.device->prepare(hand.device, error.data(), error.size()); });
  const auto hears = [&](const char* words) {
    return eventually([&] {
      const auto lines = said();
      return !lines.empty() && lines.back().find(words) != std::string::npos;
    });
  };
  CHECK(hears("power supply"));
  arm.powered = true;
  service.set(0, arm);
  CHECK(hears("inkwell"));
  arm.calibrated = true;
  service.set(0, arm);
  CHECK(hears("not ready"));
  arm.ready = true;
  service.set(0, arm);
  preparing.join();
  CHECK(code == PALPATE_PLUGIN_OK);
  CHECK(error[0] == '\0');
  CHECK(driven(service, "049D") == 0);
  REQUIRE(eventually([&] {
    return hand.read() == PALPATE_PLUGIN_OK && hand.reading.state == PALPATE_PLUGIN_READY;
  }));
  // The arm is ready only if each of these conditions holds.
  for (bool MockArm::*const missing : {&MockArm::calibrated, &MockArm::ready, &MockArm::powered}) {
    arm.*missing = false;
    service.set(0, arm);
    CHECK(eventually([&] {
      return hand.read() == PALPATE_PLUGIN_OK && (hand.reading.state & PALPATE_PLUGIN_READY) == 0;
    }));
    arm.*missing = true;
    service.set(0, arm);
    CHECK(eventually([&] {
      return hand.read() == PALPATE_PLUGIN_OK && hand.reading.state == PALPATE_PLUGIN_READY;
    }));
  }
  // With a scale of 10, the arm's positions are not in metres of hand motion, so the arm is not
  // ready.
  arm.scale = 10.0;
  service.set(0, arm);
  CHECK(eventually([&] { return hand.read() == PALPATE_PLUGIN_OK && hand.reading.state == 0; }));
  // prepare() fails at once if the program is ending.
  arm.calibrated = false;
  service.set(0, arm);
  REQUIRE(exchanged(service, 3));
  ends = 1;
  CHECK(hand.device->prepare(hand.device, error.data(), error.size()) == PALPATE_PLUGIN_FAILED);
  CHECK_THAT(std::string(error.data()), Contains("inkwell"));
}

TEST_CASE("reading and writing a Haply arm does not allocate, lock or throw",
          "[haply][plugin][realtime]") {
  MockService service(Speaks::k35);
  const Plugin plugin(service.url());
  Hand hand(plugin, "049D");
  REQUIRE(hand.device != nullptr);
  REQUIRE(hand.readNew());
  long read = 0;
  Counts counts;
  {
    const CountScope scope;
    for (int i = 0; i < 1000 || read < 20; ++i) {
      if (hand.read() == PALPATE_PLUGIN_OK) ++read;
      hand.write({0.0, 0.0, 0.001 * (i % 1000)});
      if (i % 50 == 0) hand.device->stop(hand.device);
      hand.write({});
    }
    counts = CountScope::counts();
  }
  CHECK(counts.allocations == 0);
  CHECK(counts.locks == 0);
  CHECK(counts.exceptions == 0);
}

TEST_CASE("readings and forces of a busy Haply arm are never torn between two threads",
          "[haply][host]") {
  MockService service(Speaks::k35);
  const Plugin plugin(service.url());
  Hand hand(plugin, "049D");
  REQUIRE(hand.device != nullptr);
  std::atomic<bool> over{false};
  std::thread moves([&] {
    for (int i = 0; !over; ++i) {
      MockArm arm = service.arm(0);
      const double x = 1e-4 * (i % 1000);
      arm.position = {x + kMiddle[0], x + kMiddle[1], x + kMiddle[2]};
      service.set(0, arm);
      std::this_thread::sleep_for(100us);
    }
  });
  std::thread stops([&] {
    while (!over) {
      hand.device->stop(hand.device);
      std::this_thread::sleep_for(5ms);
    }
  });
  long torn = 0;
  long read = 0;
  for (int i = 0; i < 100'000 && read < 300; ++i) {
    if (hand.read() == PALPATE_PLUGIN_OK) {
      ++read;
      const Vec p = hand.position();
      if (std::abs(p[0] - p[1]) > 1e-9 || std::abs(p[0] - p[2]) > 1e-9) ++torn;
    }
    const double f = 1e-3 * (i % 4000);
    hand.write(i % 8 == 0 ? Vec{} : Vec{f / 2, f / 2, f / 2});
    std::this_thread::sleep_for(200us);
  }
  over = true;
  moves.join();
  stops.join();
  CHECK(read >= 300);
  CHECK(torn == 0);
  for (const Told& told : service.told()) {
    if (told.force[0] != told.force[1] || told.force[0] != told.force[2]) ++torn;
  }
  CHECK(torn == 0);
}

TEST_CASE("measurement: prints the latencies of Haply forces and zeros by the machine's clock",
          "[.measure]") {
  real_clock = true;
  MockService service(Speaks::k35);
  const Plugin plugin(service.url());
  Hand hand(plugin, "049D");
  REQUIRE(hand.device != nullptr);
  REQUIRE(hand.readNew());
  // Returns the time from `since` to the first message with a zero (`zero` true) or non-zero force
  // [ms].
  const auto took = [&](std::int64_t since, bool zero) {
    double ms = -1.0;
    eventually([&] {
      for (const Told& t : service.told()) {
        if (t.when < since || (t.force == Vec{}) != zero) continue;
        ms = static_cast<double>(t.when - since) / 1e6;
        return true;
      }
      return false;
    });
    service.forget();
    return ms;
  };
  const auto show = [](const char* what, std::vector<double> ms) {
    std::sort(ms.begin(), ms.end());
    std::printf("%-28s median %7.3f  p99 %7.3f  most %7.3f ms  of %zu\n", what, ms[ms.size() / 2],
                ms[ms.size() * 99 / 100], ms.back(), ms.size());
  };
  const auto on = [&] {
    hand.write({});
    service.forget();
    for (int i = 0; i < 5; ++i) {
      while (hand.read() == PALPATE_PLUGIN_OK) {
      }
      hand.write({1.0, 0.0, 0.0});
      std::this_thread::sleep_for(1ms);
    }
    service.forget();
  };
  std::vector<double> written;
  std::vector<double> stopped;
  std::vector<double> unwritten;
  std::vector<double> silent;
  for (int i = 0; i < 300; ++i) {
    hand.write({});
    std::this_thread::sleep_for(2ms);
    service.forget();
    const std::int64_t since = monotonic();
    hand.write({1.0, 0.0, 0.0});
    written.push_back(took(since, false));
  }
  for (int i = 0; i < 300; ++i) {
    on();
    const std::int64_t since = monotonic();
    hand.device->stop(hand.device);
    stopped.push_back(took(since, true));
  }
  for (int i = 0; i < 50; ++i) {
    on();
    hand.write({1.0, 0.0, 0.0});
    unwritten.push_back(took(monotonic(), true));
  }
  for (int i = 0; i < 50; ++i) {
    on();
    service.lie(Lie::kDrops);
    const std::int64_t since = monotonic();
    std::atomic<bool> over{false};
    std::thread writes([&] {
      while (!over) {
        hand.write({1.0, 0.0, 0.0});
        std::this_thread::sleep_for(1ms);
      }
    });
    silent.push_back(took(since, true));
    over = true;
    writes.join();
    service.lie(Lie::kNone);
    hand.readNew();
    hand.read();
  }
  const long before = service.heard().messages;
  std::this_thread::sleep_for(2s);
  std::printf("%ld messages a second\n", (service.heard().messages - before) / 2);
  show("write to force", written);
  show("stop() to zero", stopped);
  show("last write to zero", unwritten);
  show("service silent to zero", silent);
  real_clock = false;
}
