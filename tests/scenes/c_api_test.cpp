/// Tests the C interface, including invalid arguments.
#include "palpate/scenes/bindings/c/c_api.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <string>

#include <catch2/catch.hpp>

#include "palpate/engine/safety/safety.h"
#include "tests/support/counters.h"
#include "tests/support/vdb_files.h"

namespace palpate::c_api_test {

namespace {

/// A scene with a ball of radius 43 mm from a .vdb file, and a hand that presses on it.
class Host {
 public:
  Host() {
    test::writeTestVolumes(folder_.path());
    palpate_arm arm = palpate_weakest_arm();
    arm.hand = 0;  // no human hand: positions may jump, and forces start without a ramp
    char error[200];
    hand = palpate_load(file().c_str(), &arm, 1000.0, error, sizeof error);
    INFO(error);
    REQUIRE(hand != nullptr);
  }
  Host(const Host&) = delete;
  Host& operator=(const Host&) = delete;
  ~Host() { palpate_unload(hand); }

  [[nodiscard]] std::string file() const { return (folder_ / "ball.vdb").string(); }
  palpate_felt tick(double z) const {
    const double position[3] = {0.0, 0.0, z};
    palpate_felt felt{};
    const int fault = palpate_tick(hand, position, 0.0, 1e-3, &felt);
    CHECK(fault == felt.fault);
    return felt;
  }
  /// Presses from outside to below the surface. Returns the last result.
  palpate_felt press() const {
    palpate_felt felt{};
    for (int i = 0; i < 1000; ++i) felt = tick(0.06 - 2e-5 * i);
    return felt;
  }

  palpate_hand* hand = nullptr;

 private:
  test::TemporaryFolder folder_;
};

/// Changes the working directory during the object's lifetime.
class Folder {
 public:
  explicit Folder(const std::filesystem::path& to) { std::filesystem::current_path(to); }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  ~Folder() { std::filesystem::current_path(before_); }

 private:
  std::filesystem::path before_ = std::filesystem::current_path();
};

}  // namespace

TEST_CASE("a host program in C gets the force of a scene and keeps the scene if a reload fails",
          "[c]") {
  const Host host;
  (void)host.press();
  for (int i = 0; i < 100; ++i) (void)host.tick(0.04);  // at rest
  const double force = host.tick(0.04).force[2];
  CHECK(force > 0.1);
  char error[200];
  CHECK(palpate_reload(host.hand, "no_such.vdb", error, sizeof error) == -1);
  CHECK(std::string(error).rfind("no_such.vdb: no such file", 0) == 0);
  CHECK(host.tick(0.04).force[2] == Approx(force).epsilon(1e-6));
  CHECK(palpate_reload(host.hand, host.file().c_str(), error, sizeof error) == 0);
  CHECK(std::string(error).empty());
  const test::CountScope scope;
  (void)host.tick(0.04);
  CHECK(test::CountScope::counts().allocations == 0);
}

TEST_CASE("the force of a host program in C stays on if a reload changes only a strength", "[c]") {
  const Host host;
  const std::filesystem::path file = std::filesystem::path(host.file()).parent_path() / "ball.json";
  char error[200];
  const auto load = [&](double strength) {
    std::ofstream(file)
        << R"({"palpate": 1, "volumes": {"ball": {"file": "ball.vdb", "place": {"fit": 0.1}}},
      "modes": [{"mode": "isosurface", "of": "ball", "value": 0, "solid": "below", "strength": )"
        << strength << "}]}";
    return palpate_reload(host.hand, file.c_str(), error, sizeof error);
  };
  REQUIRE(load(3.0) == 0);
  (void)host.press();
  double force = 0.0;
  for (int i = 0; i < 100; ++i) force = host.tick(0.04).force[2];
  CHECK(force > 0.1);
  REQUIRE(load(2.9) == 0);
  CHECK(host.tick(0.04).force[2] == Approx(force).epsilon(1e-6));
}

TEST_CASE("a host program in C that ticks in virtual time gets a late fault only from its own time",
          "[c]") {
  const Host other;
  const palpate_arm arm = palpate_weakest_arm();
  char error[200];
  palpate_hand* hand =
      palpate_load_virtual(other.file().c_str(), &arm, 1000.0, error, sizeof error);
  REQUIRE(hand != nullptr);
  palpate_felt felt{};
  int faults = 0;
  double strongest = 0.0;
  for (int i = 0; i < 1500; ++i) {
    const double position[3] = {0.0, 0.0, 0.06 - 2e-5 * i};
    if (palpate_tick(hand, position, 0.0, 1e-3, &felt) != 0) ++faults;
    strongest = std::max(strongest, felt.force[2]);
  }
  CHECK(faults == 0);
  CHECK(strongest > 0.1);
  const double position[3] = {0.0, 0.0, 0.03};
  CHECK(palpate_tick(hand, position, 0.0, 0.1, &felt) == static_cast<int>(Fault::kLate));
  CHECK(felt.force[2] == 0.0);
  palpate_unload(hand);
  CHECK(palpate_load_virtual("no_such.vdb", &arm, 1000.0, error, sizeof error) == nullptr);
  CHECK(std::string(error).rfind("no_such.vdb: no such file", 0) == 0);
}

TEST_CASE("each failed load gives a host program in C an error of one line", "[c]") {
  const Host host;
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto refusal = [&](const char* path, palpate_arm arm, double rate) {
    char error[200];
    CHECK(palpate_load(path, &arm, rate, error, sizeof error) == nullptr);
    CHECK(std::strchr(error, '\n') == nullptr);
    return std::string(error);
  };
  const palpate_arm good = palpate_weakest_arm();
  CHECK(refusal(nullptr, good, 1000.0).rfind("path: it is null", 0) == 0);
  for (const double rate : {nan, 0.0, -1000.0, 1e-320, 9.0, 1e6, 1e300}) {
    CAPTURE(rate);
    CHECK(refusal(host.file().c_str(), good, rate).rfind("rate: ", 0) == 0);
  }
  CHECK(refusal("", good, 1000.0).find(": no such file") != std::string::npos);
  CHECK(refusal("no\nsuch\xff.vdb", good, 1000.0).rfind("no\\nsuch\\xff.vdb: no such file", 0) ==
        0);
  for (double palpate_arm::*number : {&palpate_arm::peak, &palpate_arm::slew,
                                      &palpate_arm::max_stiffness, &palpate_arm::max_damping}) {
    for (const double value : {nan, -1.0}) {
      palpate_arm bad = good;
      bad.*number = value;
      CHECK(refusal(host.file().c_str(), bad, 1000.0).rfind("arm: ", 0) == 0);
    }
  }
  char tiny[8];
  CHECK(palpate_load("no_such.vdb", &good, 1000.0, tiny, sizeof tiny) == nullptr);
  CHECK(std::string(tiny) == "no_such");
  CHECK(palpate_load("no_such.vdb", &good, 1000.0, nullptr, 0) == nullptr);
  palpate_unload(nullptr);
}

TEST_CASE("a fault cuts the force of a host program in C until it clears the fault", "[c]") {
  const Host host;
  (void)host.press();
  const palpate_felt bad = host.tick(std::numeric_limits<double>::quiet_NaN());
  CHECK(bad.fault != 0);
  CHECK(bad.force[2] == 0.0);
  CHECK(std::string(palpate_fault_words(bad.fault)).find(": ") != std::string::npos);
  CHECK(host.tick(0.04).force[2] == 0.0);
  palpate_clear(host.hand);
  CHECK(host.press().force[2] > 0.1);
  palpate_cut(host.hand);
  CHECK(host.tick(0.04).force[2] == 0.0);
  for (const int none : {0, -1, static_cast<int>(kFaults), 1000})
    CHECK(std::string(palpate_fault_words(none)).empty());
}

TEST_CASE("the text of an explanation for a host program in C is whole or cut to the buffer's size",
          "[c]") {
  const Host host;
  const double at[3] = {0.0, 0.0, 0.03};
  const double push[3] = {0.0, 0.0, -1e-3};
  const long length = palpate_explain(host.hand, at, push, nullptr, 0);
  REQUIRE(length > 100);
  std::string all(static_cast<std::size_t>(length) + 1, '\0');
  CHECK(palpate_explain(host.hand, at, push, all.data(), all.size()) == length);
  CHECK(std::strlen(all.c_str()) == static_cast<std::size_t>(length));
  char some[10];
  CHECK(palpate_explain(host.hand, at, push, some, sizeof some) == length);
  CHECK(all.rfind(some, 0) == 0);
  const double far[3] = {std::numeric_limits<double>::quiet_NaN(), 0.0, 0.0};
  char why[200];
  const long refused = palpate_explain(host.hand, far, push, why, sizeof why);
  CHECK(refused == -static_cast<long>(std::strlen(why)));
  CHECK(std::string(why).rfind("at: ", 0) == 0);
  CHECK(palpate_explain(host.hand, at, far, why, sizeof why) < 0);
  CHECK(std::string(why).rfind("push: ", 0) == 0);  // the message begins with the name of the wrong
                                                    // argument
}

TEST_CASE("a host program in C may change its working directory after loading a scene", "[c]") {
  const Host host;
  const Folder before(std::filesystem::path(host.file()).parent_path());
  char error[200];
  REQUIRE(palpate_reload(host.hand, "ball.vdb", error, sizeof error) == 0);
  std::filesystem::current_path("/");
  const double at[3] = {0.0, 0.0, 0.03};
  const double push[3] = {0.0, 0.0, -1e-3};
  std::string text(100, '\0');
  CHECK(palpate_explain(host.hand, at, push, text.data(), text.size()) > 100);
  CAPTURE(text);
  CHECK(palpate_reload(host.hand, "no_such.vdb", error, sizeof error) == -1);
  CHECK(palpate_explain(host.hand, at, push, nullptr, 0) > 100);
}

}  // namespace palpate::c_api_test
