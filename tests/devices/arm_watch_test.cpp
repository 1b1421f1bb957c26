/// Tests ArmWatch, which shows an arm's reports as text, with simulated reports.
#include "palpate/devices/hid/arm_watch.h"

#include <algorithm>
#include <cstddef>
#include <deque>
#include <string>
#include <utility>
#include <vector>

#include <catch2/catch.hpp>

namespace palpate::arm_watch_test {
using Catch::Contains;

namespace {

/// A port whose reads return the reports that the test queued. Counts the writes.
class Says final : public ReportPort {
 public:
  [[nodiscard]] ReadStatus read(std::span<std::byte> to, std::size_t& size) noexcept override {
    if (!there) return ReadStatus::kGone;
    if (waiting.empty()) return ReadStatus::kNothing;
    size = std::min(to.size(), waiting.front().size());
    std::copy_n(waiting.front().begin(), size, to.begin());
    waiting.pop_front();
    return ReadStatus::kReport;
  }
  [[nodiscard]] bool write(std::span<const std::byte> /*report*/) noexcept override {
    ++sent;
    return true;
  }
  [[nodiscard]] bool sendFeature(std::span<const std::byte> report) noexcept override {
    return write(report);
  }
  void say(const std::vector<int>& bytes) {
    waiting.emplace_back();
    for (const int b : bytes) waiting.back().push_back(static_cast<std::byte>(b));
  }

  std::deque<std::vector<std::byte>> waiting;
  bool there = true;
  int sent = 0;
};

/// Returns a profile with two kinds of reports: one with three fields of 10 um per count, the
/// other with a switch.
HidProfile arm(const char* home) {
  return parseHidProfile(std::string(R"({
    "palpate_arm": 1, "name": "mine", "firmware": "f",
    "match": [{"vendor": "1209", "product": "0001"}], "rate": {"input": 1000, "output": 1000},
    "input": [{"id": 1, "size": 6, "fields": {
                 "a": {"bit": 0, "bits": 16, "scale": 1e-5, "wraps": true},
                 "b": {"bit": 16, "bits": 16, "scale": -1e-5, "offset": 0.01},
                 "c": {"bit": 32, "bits": 16, "scale": 1e-5}}},
              {"id": 2, "size": 1, "fields": {
                 "switch": {"bit": 0, "bits": 1}, "late": {"bit": 1, "bits": 7}}}],
    "output": {"id": 3, "size": 6, "fields": {
                 "fa": {"bit": 0, "bits": 16, "scale": 1000, "least": -5000, "most": 5000},
                 "fb": {"bit": 16, "bits": 16, "scale": 1000, "least": -5000, "most": 5000},
                 "fc": {"bit": 32, "bits": 16, "scale": 1000, "least": -5000, "most": 5000}}},
    "flags": [{"field": "switch", "means": "homed"}],
    "kinematics": {"model": "cartesian", )") +
                             home + R"("joints": [
      {"from": "a", "motor": "fa", "torque_constant": 1},
      {"from": "b", "ratio": 2, "motor": "fb", "torque_constant": 1},
      {"from": "c", "motor": "fc", "torque_constant": 1}]},
    "mount": {"rotation_wxyz": [0.70710678, 0, 0, 0.70710678]},
    "limits": {"force": 5, "stiffness": 1000, "damping": 5, "workspace_radius": 0.1}})",
                         "mine.json");
}

std::int64_t ms(std::int64_t t) {
  return t * 1000000;
}

}  // namespace

TEST_CASE("devices --watch shows an arm's reports and the fields and tip that follow from them",
          "[profile]") {
  ArmWatch watch(arm(""));
  Says port;
  CHECK(watch.take(port, ms(1000)) == ReadStatus::kNothing);
  const std::string silent = watch.picture(ms(1100));
  CHECK_THAT(silent,
             Contains("report 1: none received\n") && Contains("report 2: none received\n"));
  CHECK_THAT(silent, Contains("joint 1 of a") && Contains("not known"));
  CHECK_THAT(silent, Contains("flag homed (switch is 1): not known"));
  CHECK_THAT(silent,
             Contains("the firmware may only reply to reports, and this command sends none"));

  // 500 ms of positions at 1 kHz, the switch at 10 Hz, and one report that the profile does not
  // have.
  for (int i = 1; i <= 500; ++i) {
    port.say({1, 0xE8, 0x03, 0x18, 0xFC, 0x00, 0x00});
    if (i % 100 == 0) port.say({2, 0x01});
    if (i == 7) port.say({9, 0xAB, 0xCD});
    CHECK(watch.take(port, ms(1100 + i)) == ReadStatus::kReport);
  }
  const std::string shown = watch.picture(ms(1600));
  CHECK_THAT(shown, Contains("report 1, 6 bytes: 1000 per second, last received 0.00 s ago\n"
                             "  01 e8 03 18 fc 00 00\n"));
  CHECK_THAT(shown, Contains("report 2, 1 byte: 10 per second") && Contains("\n  02 01\n"));
  CHECK_THAT(shown,
             Contains("report 9, 2 bytes: 2 per second, last received 0.49 s ago, not in the "
                      "profile\n  09 ab cd\n"));
  CHECK_THAT(shown, Contains("  a                        1000           0.01\n"));
  CHECK_THAT(shown, Contains("  b                       -1000           0.02\n"));
  // Joint b has the ratio 2. The arm's x axis is the world's y axis.
  CHECK_THAT(shown, Contains("joint 2 of b                          0.01\n"));
  CHECK_THAT(shown, Contains("tip at (-0.01000, 0.01000, 0.00000) m in the hand's world\n"));
  CHECK_THAT(shown, Contains("flag homed (switch is 1): yes\n"));

  // First only the switch's reports stop. Then the position reports stop too.
  for (int i = 1; i <= 500; ++i) {
    port.say({1, 0xE8, 0x03, 0x18, 0xFC, 0x00, 0x00});
    (void)watch.take(port, ms(1600 + i));
  }
  CHECK_THAT(
      watch.picture(ms(2100)),
      Contains("report 2, 1 byte: NONE in the last 0.50 s, last received 0.50 s ago\n  02 01\n"));
  const std::string stopped = watch.picture(ms(4600));
  CHECK_THAT(stopped,
             Contains("report 1, 6 bytes: NONE in the last 2.50 s, last received 2.50 s ago"));
  CHECK_THAT(stopped, Contains("m in the hand's world, 2.50 s ago\n"));

  // Special cases: a report too short for a field, an empty report, more kinds of reports than the
  // watch shows, and an unplugged arm.
  port.say({1, 0x10, 0x00, 0x00});
  port.say({});
  for (int id = 10; id < 40; ++id) port.say({id});
  (void)watch.take(port, ms(4700));
  const std::string odd = watch.picture(ms(5100));
  CHECK_THAT(odd, Contains("  b                beyond the report's end\n"));
  CHECK_THAT(odd, Contains("more reports of unknown kinds\n"));
  CHECK(odd.size() < 3000);
  port.there = false;
  CHECK(watch.take(port, ms(5200)) == ReadStatus::kGone);
  CHECK(port.sent == 0);
}

TEST_CASE("devices --watch unwraps a counter for profiles with and without home_at_open",
          "[profile]") {
  const auto first = [](const char* home, const std::vector<std::vector<int>>& reports) {
    ArmWatch watch(arm(home));
    Says port;
    for (const auto& report : reports) port.say(report);
    (void)watch.take(port, ms(1));
    const std::string all = watch.picture(ms(2));
    const std::size_t at = all.find("joint 1 of a");
    return all.substr(at, all.find('\n', at) - at);
  };
  const std::vector<std::vector<int>> over{{1, 0xFF, 0x7F, 0, 0, 0, 0},
                                           {1, 0x00, 0x80, 0, 0, 0, 0}};
  CHECK_THAT(first("", over), Contains(" 0.32768"));
  CHECK_THAT(first(R"("home_at_open": true, "home_words": "in the middle", )", over),
             Contains(" 1e-05"));
}

}  // namespace palpate::arm_watch_test
