/// Tests the parser and writer of Haply's messages without a network: published, wrong and mutated
/// messages.
#include <array>
#include <numbers>
#include <string>
#include <vector>

#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>

#include "palpate/devices/plugins/haply_messages.h"
#include "tests/devices/haply/fuzz_messages.h"
#include "tests/support/random.h"

using namespace palpate::haply;
using palpate::test::cases;
using palpate::test::Random;

namespace {

/// A message of version 3.5, in the format of docs.haply.co, with this test's values.
const std::string k35Text = R"({"session_id":7,"inverse3":[{"device_id":"049D","config":{
  "type":"inverse3","handedness":"left","preset":"arm_front_centered",
  "basis":{"permutation":"XYZ"}},"state":{"cursor_position":{"x":0.01,"y":-0.02,"z":0.03},
  "cursor_velocity":{"x":0.1,"y":0.2,"z":-0.3},"angular_position":{"a0":30,"a1":45,"a2":-90},
  "transform":{"position":{"x":0,"y":0,"z":0},"rotation":{"w":1,"x":0,"y":0,"z":0}}},
  "status":{"calibrated":true,"power_supply":true,"ready":false}}],
  "wireless_verse_grip":[{"device_id":"61548","state":{"orientation":{"w":0.5,"x":0.5,"y":-0.5,
  "z":0.5},"buttons":{"a":true,"b":false,"c":true}}}]})";
const std::string k31Text = R"({"inverse3":[{"device_id":"04BA","state":{
  "cursor_position":{"x":0.078,"y":-0.148,"z":0.143},"cursor_velocity":{"x":0,"y":0,"z":0},
  "mode":"idle"},"status":{"calibrated":false,"power_supply":true,"ready":true}}],
  "verse_grip":[{"device_id":"61576","state":{"button":true,"hall":0,
  "orientation":{"w":0.71655273,"x":0.19647217,"y":0.6290283,"z":-0.22833252}}}]})";
const std::string k30Text = R"({"inverse3":{"049D":{"config":{"device_info":{"model":4}},
  "state":{"cursor_position":{"x":0,"y":-0.1,"z":0.1}}}},"verse_grip":{}})";

Message readState(const std::string& text) {
  Message message;
  REQUIRE(readMessage(text, message) == Verdict::kState);
  return message;
}

/// Returns the 3.1 message with this text as the x coordinate of the position.
std::string withX(const std::string& x) {
  std::string text = k31Text;
  return text.replace(text.find("0.078"), 5, x);
}

}  // namespace

TEST_CASE("state messages of each version of Haply's service are decoded correctly", "[haply]") {
  const Message newer = readState(k35Text);
  CHECK(newer.generation == Generation::k35);
  REQUIRE(newer.arm_count == 1);
  const ArmState& arm = newer.arms[0];
  CHECK(arm.id.view() == "049D");
  CHECK(arm.placed);
  CHECK(arm.position_D == Triple{0.01, -0.02, 0.03});
  CHECK(arm.velocity_D == Triple{0.1, 0.2, -0.3});
  CHECK(arm.joints[0] == Approx(std::numbers::pi / 6));
  CHECK(arm.joints[1] == Approx(std::numbers::pi / 4));
  CHECK(arm.joints[2] == Approx(-std::numbers::pi / 2));
  CHECK_FALSE(arm.transformed);
  CHECK(arm.powered == 1);
  CHECK(arm.calibrated == 1);
  CHECK(arm.ready == 0);
  REQUIRE(arm.configured);
  CHECK(arm.config.origin == Origin::kCentre);
  CHECK(arm.config.left);
  CHECK(arm.config.plain_axes);
  REQUIRE(newer.grip_count == 1);
  CHECK(newer.grips[0].turned);
  CHECK(newer.grips[0].orientation_D == std::array<double, 4>{0.5, 0.5, -0.5, 0.5});
  CHECK(newer.grips[0].buttons == 0b101);
  CHECK(newer.grips[0].button_count == 3);

  const Message older = readState(k31Text);
  CHECK(older.generation == Generation::k31);
  CHECK(older.arms[0].position_D == Triple{0.078, -0.148, 0.143});
  CHECK(older.arms[0].calibrated == 0);
  CHECK_FALSE(older.arms[0].configured);
  REQUIRE(older.grip_count == 1);
  CHECK(older.grips[0].turned);
  CHECK(older.grips[0].buttons == 1);
  CHECK(older.grips[0].button_count == 1);

  const Message oldest = readState(k30Text);
  CHECK(oldest.generation == Generation::k30);
  CHECK(oldest.arms[0].id.view() == "049D");
  CHECK(oldest.arms[0].position_D == Triple{0.0, -0.1, 0.1});
}

TEST_CASE("numbered buttons of a Haply handle are decoded like buttons with letters", "[haply]") {
  std::string text = k35Text;
  text.replace(text.find(R"({"a":true,"b":false,"c":true})"), 29,
               R"({"button_0":false,"button_3":true})");
  const Message message = readState(text);
  CHECK(message.grips[0].buttons == 8);
  CHECK(message.grips[0].button_count == 4);
}

TEST_CASE("a Haply message with an invalid or out-of-reach coordinate gives no position",
          "[haply]") {
  for (const char* x : {"1e300", "-2.1", "\"0.078\"", "null", "true", "[0.078]", "{}"}) {
    CAPTURE(x);
    const Message message = readState(withX(x));
    REQUIRE(message.arm_count == 1);
    CHECK_FALSE(message.arms[0].placed);
    CHECK(message.arms[0].position_D == Triple{});
  }
  for (const char* x : {"NaN", "1e999", "-1e999", "Infinity", "0x10", "+1", ".5"}) {
    CAPTURE(x);
    Message message;
    CHECK(readMessage(withX(x), message) == Verdict::kNotJson);
    CHECK(message.arm_count == 0);
  }
  CHECK(readState(withX("2")).arms[0].placed);
}

TEST_CASE("a Haply message that is too long or too deeply nested or not a state is refused",
          "[haply]") {
  Message message;
  std::string longest = k31Text;
  longest.resize(kMessageLimit, ' ');
  CHECK(readMessage(longest, message) == Verdict::kState);
  CHECK(readMessage(longest + " ", message) == Verdict::kTooLong);
  CHECK(message.arm_count == 0);
  const auto nested = [](int depth) {
    std::string text = R"({"inverse3":[],"x":)";
    for (int i = 1; i < depth; ++i) text += '[';
    for (int i = 1; i < depth; ++i) text += ']';
    return text + "}";
  };
  CHECK(readMessage(nested(kDepthLimit), message) == Verdict::kState);
  CHECK(readMessage(nested(kDepthLimit + 1), message) == Verdict::kTooDeep);
  // Brackets within strings do not count as nesting, and a string may contain an escaped quote.
  CHECK(readMessage(R"({"inverse3":[],"x":"\"[[[[[[[[[[[[[[[[[["})", message) == Verdict::kState);
  CHECK(readMessage("", message) == Verdict::kNotJson);
  CHECK(readMessage("[]", message) == Verdict::kOther);
  CHECK(readMessage(R"({"session_id":7})", message) == Verdict::kOther);
  CHECK(readMessage(R"({"inverse3":7})", message) == Verdict::kOther);
}

TEST_CASE("arms with malformed ids in a Haply message are ignored", "[haply]") {
  for (const char* id : {"04\\\"9D", "", "0 4", "04\\u00009D", "\\u00e9",
                         "0123456789012345678901234567890123456789012345678"}) {
    CAPTURE(id);
    std::string text = k31Text;
    CHECK(readState(text.replace(text.find("04BA"), 4, id)).arm_count == 0);
  }
}

TEST_CASE("a change of origin, basis, model or transform is read from a Haply state message",
          "[haply]") {
  const auto with = [](const std::string& from, const std::string& to) {
    std::string text = k35Text;
    return readState(text.replace(text.find(from), from.size(), to)).arms[0];
  };
  CHECK(with("arm_front_centered", "defaults").config.origin == Origin::kBase);
  CHECK(with("arm_front_centered", "arm_front").config.origin == Origin::kBase);
  CHECK(with("arm_front_centered", "led_front").config.origin == Origin::kOther);
  CHECK(with("arm_front_centered", "custom").config.origin == Origin::kOther);
  CHECK_FALSE(with("XYZ", "XZY").config.plain_axes);
  CHECK(with(R"("type":"inverse3")", R"("type":"minverse")").config.miniature);
  CHECK(with(R"("w":1)", R"("w":0.5)").transformed);
  CHECK(with(R"("transform":{)", R"("transform":{"scale":{"x":1,"y":2,"z":1},)").transformed);
  CHECK(
      with(R"("transform":{"position":{"x":0)", R"("transform":{"position":{"x":0.1)").transformed);
  CHECK(
      with(R"("transform":{"position":{"x":0)", R"("transform":{"position":{"x":"0")").transformed);
}

TEST_CASE("force messages to Haply's service have the format of its version and exact force values",
          "[haply]") {
  Random random(1);
  std::array<char, kRoom> room{};
  for (int i = 0; i < 1000; ++i) {
    std::array<ForceTo, 2> forces{{{"049D", {}}, {"04BA", {}}}};
    for (auto& one : forces) {
      for (double& along : one.force_D) {
        along = random.uniform(-1.0, 1.0) * random.logUniform(1e-300, 10.0);
      }
    }
    for (const Generation generation : {Generation::k31, Generation::k35}) {
      const bool introduce = i % 2 == 0;
      const std::size_t size = writeForces(generation, forces, introduce, room);
      REQUIRE(size > 0);
      const auto json = nlohmann::json::parse(room.begin(), room.begin() + static_cast<long>(size));
      REQUIRE(json.contains("session") == (introduce && generation == Generation::k35));
      REQUIRE(json["inverse3"].size() == 2);
      for (std::size_t k = 0; k < 2; ++k) {
        REQUIRE(json["inverse3"][k]["device_id"] == forces[k].id);
        const auto& command = json["inverse3"][k]["commands"]["set_cursor_force"];
        REQUIRE(command.size() == 1);
        const auto& force = command[generation == Generation::k35 ? "vector" : "values"];
        REQUIRE(force["x"] == forces[k].force_D[0]);
        REQUIRE(force["y"] == forces[k].force_D[1]);
        REQUIRE(force["z"] == forces[k].force_D[2]);
      }
    }
  }
  // The longest message fits into the buffer. A message that does not fit, or that the service's
  // version does not support, is not written.
  const std::string longest(47, 'x');
  const Triple digits{-2.2250738585072014e-308, -1.7976931348623157e-308, -3.3333333333333335e-307};
  const std::array<ForceTo, kMaxArms> four{
      {{longest, digits}, {longest, digits}, {longest, digits}, {longest, digits}}};
  const std::size_t size = writeForces(Generation::k35, four, true, room);
  CHECK(size > 700);
  CHECK(writeForces(Generation::k35, four, true, std::span(room).first(size)) == size);
  CHECK(writeForces(Generation::k35, four, true, std::span(room).first(size - 1)) == 0);
  CHECK(writeForces(Generation::k30, four, true, room) == 0);
  CHECK(writeForces(Generation::kUnknown, four, true, room) == 0);
}

namespace {

template <class List>
const auto& any(Random& random, const List& list) {
  return list[static_cast<std::size_t>(random.integer(static_cast<int>(list.size())))];
}

/// Replaces, removes, duplicates or inserts bytes.
std::string mutateBytes(Random& random, std::string text, const std::vector<std::string>& seeds) {
  static const std::vector<std::string> kPieces{"\"",
                                                "{",
                                                "}",
                                                "[",
                                                "]",
                                                ",",
                                                ":",
                                                "\\",
                                                "\\u0000",
                                                "NaN",
                                                "1e300",
                                                "1e999",
                                                "-0",
                                                "null",
                                                "true",
                                                "\"x\":1e9",
                                                "[[[[[[[[[",
                                                "{\"a\":",
                                                "\xff",
                                                "\"inverse3\":{",
                                                "\"device_id\":\"",
                                                "\"state\":",
                                                "99999999999999999999999"};
  for (int n = 1 + random.integer(6); n > 0 && !text.empty(); --n) {
    const auto at = static_cast<std::size_t>(random.integer(static_cast<int>(text.size())));
    const auto length = static_cast<std::size_t>(random.integer(300));
    const std::string& other = any(random, seeds);
    switch (random.integer(6)) {
      case 0:
        text[at] = static_cast<char>(random.integer(256));
        break;
      case 1:
        text.erase(at, 1 + length / 8);
        break;
      case 2:
        text.resize(at);
        break;
      case 3:
        text.insert(at, any(random, kPieces));
        break;
      case 4:
        text.insert(at, text.substr(at / 2, length));
        break;
      default:
        text.insert(at, other.substr(at % other.size(), length));
    }
  }
  return text;
}

/// Replaces values and removes or duplicates members; the text remains valid JSON.
std::string mutateValues(Random& random, const std::string& text) {
  static const std::vector<nlohmann::json> kValues{nullptr,
                                                   true,
                                                   false,
                                                   0,
                                                   -0.0,
                                                   2.0,
                                                   -2.0,
                                                   2.0000001,
                                                   1e300,
                                                   -1e-300,
                                                   4294967296,
                                                   1e18,
                                                   "",
                                                   "x",
                                                   "049D",
                                                   "04\"9D",
                                                   "led_front",
                                                   "XZY",
                                                   "minverse",
                                                   nlohmann::json::array(),
                                                   nlohmann::json::object(),
                                                   nlohmann::json::array({1, 2, 3}),
                                                   nlohmann::json{{"x", 1}, {"y", 2}, {"z", 3}},
                                                   nlohmann::json{{"state", nullptr}}};
  nlohmann::json json = nlohmann::json::parse(text);
  for (int n = 1 + random.integer(4); n > 0; --n) {
    nlohmann::json* at = &json;
    // Descends from member to member to a random depth.
    while (at->is_structured() && !at->empty() && random.integer(12) != 0) {
      auto it = at->begin();
      std::advance(it, random.integer(static_cast<int>(at->size())));
      at = &*it;
    }
    if (at == &json) continue;
    if (at->is_array() && !at->empty() && random.integer(2) == 0) {
      for (int k = random.integer(9); k > 0; --k) at->push_back(at->front());
    } else if (at->is_object() && !at->empty() && random.integer(2) == 0) {
      at->erase(at->begin());
    } else {
      *at = any(random, kValues);
    }
  }
  return json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

}  // namespace

TEST_CASE("mutated messages never crash the reader of Haply's states or give invalid values",
          "[haply]") {
  const std::vector<std::string> seeds{k35Text, k31Text, k30Text};
  Random random(2);
  const long count = cases(20'000);
  long states = 0;
  Message message;
  for (long i = 0; i < count; ++i) {
    const std::string& seed = any(random, seeds);
    const std::string text =
        i % 2 == 0 ? mutateBytes(random, seed, seeds) : mutateValues(random, seed);
    const std::string wrong = palpate::test::fuzzHaplyMessage(text);
    if (!wrong.empty()) {
      CAPTURE(text);
      FAIL(wrong);
    }
    if (readMessage(text, message) == Verdict::kState) ++states;
  }
  CAPTURE(states);
  // At least a quarter of the mutated texts must still be read as states.
  CHECK(states * 4 > count);
}
