/// Tests the parsing of arm profiles.
#include "palpate/devices/hid/hid_profile.h"

#include <array>
#include <csignal>
#include <cstdlib>
#include <fcntl.h>
#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>
#include <string>
#include <sys/file.h>
#include <sys/wait.h>
#include <unistd.h>
#include <vector>

#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>

#include "palpate/devices/arm/tested_arms.h"
#include "palpate/devices/hid/hid_port.h"
#include "palpate/devices/hid/open_arm.h"
#include "palpate/devices/hid/profile_facts.h"
#include "palpate/engine/error.h"
#include "tests/support/json_schema.h"
#include "tests/support/pid_model.h"
#include "tests/support/source_dir.h"
#include "tests/support/vdb_files.h"

namespace palpate::hid_profile_test {
using Catch::Contains;
using Json = nlohmann::json;

namespace {

Json full() {
  return Json::parse(R"({
    "$schema": "x", "palpate_arm": 1, "name": "mine", "description": "d", "firmware": "f",
    "match": [{"vendor": "0x1209", "product": "0001", "usage_page": "FF00", "usage": "1"}],
    "rate": {"input": 1000, "output": 500},
    "input": [{"id": 1, "size": 40, "fields": {
      "a": {"bit": 96, "bits": 32, "scale": 1e-6, "wraps": true},
      "b": {"bit": 128, "bits": 32, "scale": 1e-6},
      "c": {"bit": 160, "bits": 32, "scale": 1e-6, "offset": 0.5},
      "d": {"bit": 192, "bits": 32, "scale": 1e-6},
      "wrist": {"bit": 256, "bits": 16, "scale": 1e-4},
      "state": {"bit": 240, "bits": 3, "type": "unsigned"}}}],
    "output": {"id": 2, "size": 16, "fields": {
      "fa": {"bit": 48, "bits": 16, "scale": 1000, "least": -5000, "most": 5000},
      "fb": {"bit": 64, "bits": 16, "scale": 1000, "least": -5000, "most": 5000},
      "fc": {"bit": 80, "bits": 16, "scale": 1000, "least": -5000, "most": 5000},
      "command": {"bit": 0, "bits": 8, "type": "unsigned", "rest": 3}}},
    "flags": [{"field": "state", "equals": 1, "means": "homed"}],
    "kinematics": {"model": "cartesian", "joints": [
      {"from": "a", "motor": "fa", "torque_constant": 1},
      {"from": "b", "ratio": -1, "motor": "fb", "torque_constant": 1},
      {"from": "c", "home": 0.1, "motor": "fc", "torque_constant": 2}]},
    "handle": {"buttons": [{"name": "dark", "field": "state", "equals": 2},
                           {"name": "light", "field": "state", "equals": 4}],
               "orientation": [{"joint": 1, "axis": [0, 0, 2]},
                               {"from": "wrist", "ratio": 2, "home": 0.5, "axis": [0, 1, 0]}],
               "gripper": {"from": "wrist", "ratio": -10}},
    "mount": {"origin": [0, 0, 0.1], "rotation_wxyz": [0.7071, 0, 0, 0.7071]},
    "open": [{"feature": [3, 0, 255]}, {"pause": 0.01}],
    "home": [{"send": {"command": 1}},
             {"wait": {"field": "state", "equals": 1, "seconds": 5, "words": "let go"}}],
    "close": [{"send": {"command": 0}}],
    "limits": {"force": 5, "slew": 1000, "stiffness": 800, "damping": 4, "workspace_radius": 0.1,
               "stale": 0.02, "speed": 2, "continuous": 2, "heating": 10},
    "sources": {"/limits": "measured"}})");
}

bool schemaAccepts(const Json& json) {
  return !schemaComplaint(json, hidProfileSchema());
}

std::string trouble(const Json& json) {
  try {
    (void)parseHidProfile(json.dump(), "arm.json");
  } catch (const DeviceError& e) {
    return e.what();
  }
  return "none";
}

}  // namespace

TEST_CASE("the values of a complete HID profile are read", "[profile]") {
  const HidProfile arm = parseHidProfile(full().dump(), "arm.json");
  CHECK(arm.match[0].vendor == 0x1209);
  CHECK(arm.match[0].usage_page == 0xFF00);
  CHECK(arm.output_rate == 500);
  CHECK(arm.joints[1].ratio == -1);
  CHECK(arm.limits.continuous == 2);
  CHECK(arm.home[1].words == "let go");
  CHECK(arm.world_from_device(1, 0) == Approx(1.0));
  CHECK(arm.sources.at("/limits") == "measured");
  CHECK(arm.output->fields.size() == 4);
  CHECK(arm.handle.buttons[1].name == "light");
  CHECK(arm.handle.buttons[1].equals == 4);
  CHECK(arm.handle.orientation[0].joint == 1);
  CHECK(arm.handle.orientation[0].axis.z() == 1.0);
  CHECK(arm.handle.orientation[1].from.field == 5);
  CHECK(arm.handle.gripper->ratio == -10);
}

TEST_CASE("an invalid HID profile is refused with the JSON path of its error", "[profile]") {
  REQUIRE(trouble(full()) == "none");
  REQUIRE(schemaAccepts(full()));
  struct Bad {
    const char* pointer;
    Json value;
    const char* says;
    bool schema;  ///< True: the JSON Schema also rejects the file.
  };
  const std::vector<Bad> cases{
      {"/palpate_arm", 2, "/palpate_arm: 2 is a version that this program does not support", true},
      {"/name", "a b", "/name: it is not 1 to 64 letters, digits", true},
      {"/extra", 1, "/extra: unknown key", true},
      {"/match", Json::array(), "/match: it is not a list", true},
      {"/match/0/vendor", "xyz", "/match/0/vendor: it is not a hexadecimal", true},
      {"/match/0/vendor", "12345", "hexadecimal number of 16 bits", true},
      {"/rate/input", 0, "/rate/input: 0 is not > 0", true},
      {"/input/0/size", 0, "not a whole number from 1 to 1024", true},
      {"/input/0/fields/a/bits", 33, "not a whole number from 1 to 32", true},
      {"/input/0/fields/a/bit", 300, "the field ends beyond the report's 40 bytes", false},
      {"/input/0/fields/a/type", "int", "/input/0/fields/a/type: \"int\" is not known", true},
      {"/input/0/fields/a/scale", 0, "/input/0/fields/a/scale: it is 0", true},
      {"/input/0/sequence", "tick", "/input/0/sequence: this report has no field \"tick\"", false},
      {"/input/0/sequence", 3, "/input/0/sequence: ", true},
      {"/input/0/sequence", "a", "/input/0/sequence: a shares bits with the joint's field a, which",
       false},
      {"/input/0/sequence", "state",
       "/input/0/sequence: state shares bits with the flag's field state, which", false},
      {"/input/0/stale", 0, "/input/0/stale: 0 is not > 0", true},
      {"/input/0/stale", 3, "/input/0/stale: ", true},
      {"/handle/buttons/0/field", "knob", "/handle/buttons/0/field: ", false},
      {"/handle/buttons/0/equals", 8, "/handle/buttons/0: the field state cannot hold 8", false},
      {"/handle/buttons/0/name", 3, "/handle/buttons/0/name: ", true},
      {"/handle/orientation/0/joint", 3, "joint: the model does not have this joint", false},
      {"/handle/orientation/0/axis",
       {0, 0, 0},
       "/handle/orientation/0/axis: it is not a direc",
       false},
      {"/handle/orientation/1/from", "a",
       "from: palpate can follow a counter that wraps only if it belongs to a joint", false},
      {"/handle/orientation/1/ratio", 0, "/handle/orientation/1/ratio: it is 0", true},
      {"/handle/orientation", Json::array(), "/handle/orientation: it is not a list", true},
      {"/handle/gripper/axis", {0, 0, 1}, "/handle/gripper/axis: unknown key", true},
      {"/output/stale", 0.1, "/output/stale: unknown key", true},
      {"/output/fields/fa/most", -6000, "least is above most", false},
      {"/flags/0/field", "stat", "did you mean \"state\"?", false},
      {"/flags/0/means", "happy", "\"happy\" is not known", true},
      {"/kinematics/model", "capstan-am", "did you mean \"capstan-arm\"?", true},
      {"/kinematics/a", 1, "model cartesian does not have this key", true},
      {"/kinematics/joints/0/from", "z", "the input has no field \"z\"", false},
      {"/kinematics/joints/0/motor", "fz", "did you mean \"fa\"?", false},
      {"/kinematics/joints/0/torque_constant", 0, "0 is not > 0", true},
      {"/kinematics/joints/0/ratio", 0, "/kinematics/joints/0/ratio: it is 0", true},
      {"/kinematics/joints/0/continuous", 2, "are valid only together", true},
      {"/kinematics/joints/0/heating", 9, "are valid only together", true},
      {"/kinematics/home_at_open", true, "the user must be told which pose is the home pose",
       false},
      {"/kinematics/rate_control", 0.1, "does not take forces", false},
      {"/mount/rotation_wxyz", {0, 0, 0, 0}, "it is not a rotation", false},
      {"/mount/rotation_wxyz", {0, 1e200, 0, 0}, "it is not a rotation", false},
      {"/name", std::string(200000, 'a') + " ", "/name: it is not 1 to 64 letters, digits", true},
      {"/home/0/send/fa", 100, "a step drives a motor", false},
      {"/home/0/send", {{"fa", 0}}, "a step drives a motor", false},
      {"/output/fields/fb/bit", 56, "the field shares bits with another field", false},
      {"/output/fields/fa/offset", 6000, "cannot hold a force of zero", false},
      {"/output/fields/fa/most", -1, "cannot hold a force of zero", false},
      {"/output/fields/fa/most", 0, "cannot hold both positive and negative forces", false},
      {"/output/fields/fa/most", 40000,
       "/most: 40000 does not fit into the field, which holds -32768", false},
      {"/output/fields/fa/type", "unsigned", "/least: -5000 does not fit", false},
      {"/output/fields/fa/rest", 1, "the field drives a motor", false},
      {"/output/fields/command/offset", 1, "the field does not drive a motor", false},
      {"/output/fields/command/rest", 300, "/rest: 300 does not fit", false},
      {"/input/0/fields/a/rest", 1, "only output fields have a rest", false},
      {"/home/0/send/command", 300, "/home/0/send/command: 300 is outside of 0 to", false},
      {"/home/0/send", {{"comand", 1}}, "did you mean \"command\"?", false},
      {"/home/0/send", {{"f", 1}}, "name one of its fields", false},
      {"/kinematics/joints/1/from", "a", "shares bits with that of another joint", false},
      {"/input/0/fields/b/bit", 100, "shares bits with that of another joint", false},
      {"/kinematics/joints/1/home", 90, "90 is more than 6.2832 radians", true},
      {"/kinematics/joints/1/torque_constant", 0.01,
       "a force of 5 N at the tip needs an output of 500 from fb", false},
      {"/kinematics/joints",
       {{{"from", "a"}}, {{"from", "b"}}, {{"from", "c"}}},
       "no joint has a motor",
       false},
      {"/input/0/fields/b/scale", 0.01, "one count of each joint moves the tip by 0.01 m", false},
      {"/mount/origin", {0, 0, 100}, "/mount/origin/2: 100 is more than 2 metres", true},
      {"/gravity", {{"masses", {{{"mass", 0}}}}}, "/gravity/masses/0/mass: 0 is not > 0", true},
      {"/gravity", {{"masses", {{{"mass", 300}}}}}, "300 is more than 5 kilograms", true},
      {"/gravity", {{"masses", 1}}, "/gravity/masses: it is not a list", true},
      {"/gravity", {{"down", {0, 0, -1}}}, "/gravity: \"masses\" is missing", true},
      {"/gravity",
       {{"masses", {{{"mass", 0.1}}}}, {"down", {0, 0, 0}}},
       "/gravity/down: it is not a direction",
       false},
      {"/gravity",
       {{"masses", {{{"mass", 0.1}, {"link", 3}}}}},
       "/gravity/masses/0/link: 3 is not a whole number from 0 to 2",
       false},
      {"/gravity",
       {{"masses", {{{"mass", 0.1}, {"centre", {0, 0, 0}}}}}},
       "/gravity/masses/0/centre: a centre needs a link",
       true},
      {"/gravity",
       {{"masses", {{{"mass", 0.1}}}}},
       "/gravity: limits/continuous does not account for the weight that the motors carry",
       false},
      {"/mount/turned", 1, "use one of origin, rotation_wxyz", true},
      {"/limits/force", 400, "400 is more than 100 newtons", true},
      {"/limits/slew", 1e9, "is more than 100000 N/s", true},
      {"/limits/workspace_radius", 100, "100 is more than 2 metres", true},
      {"/sources", {{"/nonsense", "x"}}, "\"/nonsense\" is not in this file", false},
      {"/output/size", 256, "more than 255 bytes", false},
      {"/kinematics/joints/1/motor", "fa", "this motor already drives another joint", false},
      {"/flags/0/equals", 9, "the field state cannot hold 9", false},
      {"/limits/stale", 10, "more than 0.1 s", true},
      {"/limits/speed", 50, "more than 5 m/s", true},
      {"/limits/continuous", 6, "is more than the", false},
      {"/close", {{{"pause", 3}}, {{"pause", 3}}}, "/close: the steps may take 6 s", false},
      {"/home/1/wait/seconds", 0, "0 is not > 0", true},
      {"/open/0/feature", {256}, "not a whole number from 0 to 255", true},
      {"/open/1", {{"pause", 1}, {"feature", {1}}}, "none or several of the keys send, wait", true},
      {"/limits/force", 0, "/limits/force: 0 is not > 0", true},
      {"/sources", 1, "/sources: it is not an object", true},
  };
  for (const Bad& bad : cases) {
    Json json = full();
    if (std::string(bad.pointer) == "/home/0/send/fa") json["home"][0]["send"].erase("command");
    json[Json::json_pointer(bad.pointer)] = bad.value;
    CAPTURE(bad.pointer, bad.value.dump());
    const std::string says = trouble(json);
    CHECK_THAT(says, Contains("arm.json") && Contains(bad.says));
    CHECK(says.find('\n') == std::string::npos);
    if (bad.schema) CHECK_FALSE(schemaAccepts(json));
  }
  for (const char* needed :
       {"palpate_arm", "name", "match", "rate", "input", "kinematics", "limits"}) {
    Json json = full();
    json.erase(needed);
    CAPTURE(needed);
    CHECK(trouble(json) != "none");
    CHECK_FALSE(schemaAccepts(json));
  }
  Json homeless = full();
  homeless.erase("flags");
  homeless.erase("home");
  CHECK_THAT(trouble(homeless), Contains("/kinematics/joints/0/from: the counter wraps, and the "
                                         "pose at the counter's zero is unknown"));
  Json numbers = full();
  numbers["output"].erase("id");
  CHECK_THAT(trouble(numbers), Contains("numbers all its reports or none"));
  Json twins = full();
  twins["input"].push_back({{"id", 1}, {"size", 2}, {"fields", Json::object()}});
  CHECK_THAT(trouble(twins), Contains("two reports have the number 1"));
  Json flag = full();
  flag["input"][0]["fields"]["hot"] = {{"bit", 243}, {"bits", 1}};
  flag["flags"].push_back({{"field", "hot"}, {"means", "hot"}});
  CHECK(trouble(flag) == "none");
  Json motorless = full();
  motorless.erase("output");
  CHECK_THAT(trouble(motorless), Contains("\"output\" and rate/output are valid only together"));
}

TEST_CASE("the shipped schema of profiles equals the one that the program prints", "[profile]") {
  std::ifstream in(test::sourceDir() + "/devices/hid/hid_profile.schema.json");
  std::ostringstream shipped;
  shipped << in.rdbuf();
  // If this check fails, run: build/release/bin/palpate schema arm >
  // devices/hid/hid_profile.schema.json
  CHECK(shipped.str() == hidProfileSchema());
}

TEST_CASE("a profile's sequence field and stale time of a report are read", "[profile]") {
  Json json = full();
  json["input"][0]["sequence"] = "d";
  json["input"][0]["stale"] = 0.25;
  REQUIRE(schemaAccepts(json));
  const HidProfile profile = parseHidProfile(json.dump(), "p.json");
  const HidReportSpec& report = profile.input[0];
  REQUIRE(report.sequence);
  CHECK(report.fields[*report.sequence].name == "d");
  CHECK(report.stale == 0.25);
  const HidProfile plain = parseHidProfile(full().dump(), "p.json");
  CHECK_FALSE(plain.input[0].sequence);
  CHECK(plain.input[0].stale == 0.0);
}

TEST_CASE(
    "a profile without home steps is refused if a count can mean several positions of the tip",
    "[profile]") {
  Json json = full();
  json.erase("home");
  REQUIRE(trouble(json) == "none");  // 32 bits of 1 um per count
  // 16 bits of 1 um per count cover 66 mm of a workspace of 200 mm. So one counter value can mean
  // up to four positions, and palpate must refuse the profile.
  json["input"][0]["fields"]["a"]["bits"] = 16;
  CHECK_THAT(trouble(json), Contains("/kinematics/joints/0/from: a wraps every 0.0655 m of the "
                                     "tip, and the workspace is 0.2 m wide"));
  json["limits"]["workspace_radius"] = 0.03;
  CHECK(trouble(json) == "none");
  json["limits"]["workspace_radius"] = 0.1;
  Json wide = json;
  wide["input"][0]["fields"]["a"]["scale"] = 4e-6;
  CHECK(trouble(wide) == "none");
  Json steps = json;
  steps["home"] = full()["home"];
  CHECK(trouble(steps) == "none");
  Json at_open = json;
  at_open["kinematics"]["home_at_open"] = true;
  at_open["kinematics"]["home_words"] = "in the middle";
  CHECK(trouble(at_open) == "none");

  // Two joints whose wraps are harmless: a wrist that turns without moving the tip, and a joint
  // whose range is one whole turn.
  Json chain = full();
  chain.erase("home");
  chain["kinematics"] = Json::parse(R"({"model": "chain", "tip": [0.01, 0, 0],
    "links": [{"along": 0.1, "twist": 1.5708}, {"across": 0.2}, {"across": 0.15}, {}],
    "joints": [{"from": "a", "motor": "fa", "torque_constant": 0.05},
               {"from": "b", "motor": "fb", "torque_constant": 0.05},
               {"from": "c", "motor": "fc", "torque_constant": 0.05}, {"from": "d"}]})");
  chain["mount"]["origin"] = {0.2, 0.1, 0.2};
  chain["input"][0]["fields"]["d"] = {{"bit", 192},
                                      {"bits", 12},
                                      {"type", "unsigned"},
                                      {"scale", 2.0 * M_PI / 4096},
                                      {"wraps", true}};
  CHECK(trouble(chain) == "none");
  chain["input"][0]["fields"]["d"]["scale"] = 0.5 * M_PI / 4096;
  CHECK_THAT(trouble(chain), Contains("/kinematics/joints/3/from: d wraps every 0.0157 m"));
  chain["kinematics"]["tip"] = {0, 0, 0.01};
  CHECK(trouble(chain) == "none");
}

TEST_CASE("only one program at a time can claim a device", "[profile]") {
  const test::TemporaryFolder folder;
  const std::string file = (folder / "hidraw0").string();
  std::ofstream(file) << "x";
  const int ours = open(file.c_str(), O_RDWR | O_CLOEXEC);
  REQUIRE(ours >= 0);
  CHECK_NOTHROW(claim(ours, file));
  CHECK_NOTHROW(claim(ours, file));
  const int second = open(file.c_str(), O_RDWR | O_CLOEXEC);
  CHECK_THROWS_WITH(claim(second, file),
                    Contains("(" + std::to_string(getpid()) + ") uses this arm"));
  // A guardian's copy of the descriptor keeps the device claimed after the program has ended.
  const int guard = fcntl(ours, F_DUPFD_CLOEXEC, 3);
  close(ours);
  CHECK_THROWS_AS(claim(second, file), DeviceError);
  close(guard);
  CHECK_NOTHROW(claim(second, file));
  close(second);
}

TEST_CASE("a claim of a device waits for the guardian of a killed program and reports the wait",
          "[profile]") {
  const test::TemporaryFolder folder;
  const std::string file = (folder / "hidraw0").string();
  std::ofstream(file) << "x";
  // Starts and kills a program whose guardian keeps the device claimed for `keeps_ms` [ms]. The
  // program stays a zombie until waitpid().
  const auto killed = [&](unsigned keeps_ms) {
    std::array<int, 2> ready{};
    REQUIRE(pipe(ready.data()) == 0);
    const pid_t program = fork();
    if (program == 0) {
      const int own = open(file.c_str(), O_RDWR | O_CLOEXEC);
      claim(own, file);
      const pid_t parent = getpid();
      if (fork() == 0) {
        while (getppid() == parent) usleep(1000);
        usleep(1000 * keeps_ms);
        _exit(0);
      }
      (void)!write(ready[1], "x", 1);
      for (;;) pause();
    }
    close(ready[1]);
    char byte = 0;
    REQUIRE(read(ready[0], &byte, 1) == 1);
    close(ready[0]);
    REQUIRE(kill(program, SIGKILL) == 0);
    // kill() may return before the program has ended.
    siginfo_t end{};
    REQUIRE(waitid(P_PID, static_cast<id_t>(program), &end, WEXITED | WNOWAIT) == 0);
    return program;
  };
  const int ours = open(file.c_str(), O_RDWR | O_CLOEXEC);
  REQUIRE(ours >= 0);
  std::vector<std::string> said;
  const Say say = [&](const std::string& words) { said.push_back(words); };
  const pid_t short_one = killed(300);
  CHECK_NOTHROW(claim(ours, file, say));
  REQUIRE(said.size() == 1);
  CHECK(said[0] == file + ": the program that used it (process " + std::to_string(short_one) +
                       ") has ended: waiting for its guardian");
  CHECK(waitpid(short_one, nullptr, 0) == short_one);
  REQUIRE(flock(ours, LOCK_UN) == 0);

  // claim() waits for a limited time. Its message names the process id of the program that has
  // ended.
  const pid_t long_one = killed(static_cast<unsigned>(1000.0 * kLongestClaim) + 2000);
  CHECK(waitpid(long_one, nullptr, 0) == long_one);
  CHECK_THROWS_WITH(claim(ours, file, say), Contains("the guardian of a program that has ended (" +
                                                     std::to_string(long_one) + ") uses this arm"));
  close(ours);
}

TEST_CASE("a profile's continuous limit of a motor is read and checked", "[profile]") {
  Json json = full();
  json["limits"].erase("continuous");
  json["limits"].erase("heating");
  Json& joint = json["kinematics"]["joints"][1];
  joint["continuous"] = 1.5;
  joint["heating"] = 16.3;
  REQUIRE(schemaAccepts(json));
  const HidProfile profile = parseHidProfile(json.dump(), "arm.json");
  CHECK(profile.joints[1].continuous == 1.5);
  CHECK(profile.joints[1].heating == 16.3);
  CHECK(profile.joints[0].continuous == 0.0);
  const ProfileFacts facts = factsOf(profile);
  CHECK(facts.motors[1].continuous == 1.5);
  CHECK(facts.motors[0].continuous == Approx(5.0));
  const auto with = [&](const char* key, const Json& value) {
    Json other = json;
    other["kinematics"]["joints"][1][key] = value;
    return trouble(other);
  };
  CHECK_THAT(with("continuous", 6),
             Contains("/joints/1/continuous: 6 is more than the limit of the motor's field, 5: "));
  CHECK_THAT(with("continuous", 0), Contains("0 is not > 0"));
  CHECK_THAT(with("heating", 0.01), Contains("/joints/1/heating: it is less than 0.1 s"));
  CHECK_THAT(with("heating", 1e6), Contains("more than 10000 seconds"));
  Json twice = json;
  twice["limits"]["continuous"] = 2;
  twice["limits"]["heating"] = 10;
  CHECK_THAT(trouble(twice),
             Contains("/limits/continuous: joints have continuous limits of their own"));
  Json sensed = json;
  sensed["kinematics"] = Json::parse(R"({"model": "chain",
    "links": [{"along": 0.1, "twist": 1.5708}, {"across": 0.2}, {"across": 0.15}, {}],
    "joints": [{"from": "a", "motor": "fa", "torque_constant": 0.05},
               {"from": "b", "motor": "fb", "torque_constant": 0.05},
               {"from": "c", "motor": "fc", "torque_constant": 0.05},
               {"from": "d", "continuous": 1, "heating": 10}]})");
  CHECK_THAT(trouble(sensed), Contains("/joints/3/continuous: the joint has no motor"));
  CHECK_FALSE(schemaAccepts(sensed));
}

TEST_CASE("capstan, delta, pantograph and chain geometries are read from a profile", "[profile]") {
  const auto with = [](const char* kinematics, std::size_t joints, const Vec3& middle) {
    Json json = full();
    Json& model = json["kinematics"];
    model = Json::parse(kinematics);
    const std::array from{"a", "b", "c", "d"};
    for (std::size_t i = 0; i < joints; ++i) {
      Json joint{{"from", from[i]}};
      if (i < 3) {
        joint["motor"] = std::array{"fa", "fb", "fc"}[i];
        joint["torque_constant"] = 0.05;
      }
      model["joints"].push_back(joint);
    }
    if (joints < 3) json["output"]["fields"].erase("fc");
    CAPTURE(json["kinematics"].dump());
    CHECK(schemaAccepts(json));
    // The tip must be able to reach the origin of the hand's world.
    json["mount"]["origin"] = {0.0, 0.0, 1.9};
    CHECK_THAT(trouble(json), Contains("/mount/origin: the origin of the hand's world is"));
    json["mount"]["origin"] = {middle.x(), middle.y(), middle.z()};
    const HidProfile profile = parseHidProfile(json.dump(), "arm.json");
    CHECK(factsOf(profile).off < 1e-3);
    CHECK(profile.joints.size() == joints);
    return profile.kinematics->at({0.3, 0.3, 0.3, 0.1, 0.2, 0.3}).position_D;
  };
  CHECK(
      (with(R"({"model": "capstan-arm", "a": 0.08, "b": 0.2, "c": 0.25})", 3, Vec3(0.2, 0.0, 0.1)) -
       makeCapstanArm(0.08, 0.2, 0.25)->at({0.3, 0.3, 0.3}).position_D)
          .norm() == 0.0);
  CHECK((with(R"({"model": "delta", "base": 0.08, "plate": 0.03, "upper": 0.06, "fore": 0.12})", 3,
              Vec3(0.0, 0.01, -0.1)) -
         makeDelta(0.08, 0.03, 0.06, 0.12)->at({0.3, 0.3, 0.3}).position_D)
            .norm() == 0.0);
  CHECK((with(R"({"model": "pantograph", "lengths": [0.08, 0.1, 0.1, 0.08], "base": 0.05})", 2,
              Vec3(-0.02, 0.12, 0.0)) -
         makePantograph({0.08, 0.1, 0.1, 0.08}, 0.05)->at({0.3, 0.3}).position_D)
            .norm() == 0.0);
  const std::vector<ChainLink> links{
      {0, 0.1, 0, 1.5}, {0.2, 0, 0.2, 0}, {0, 0, 0.15, 0}, {0, 0.02, 0, 0}};
  CHECK((with(R"({"model": "chain", "tip": [0.01, 0, 0], "links": [{"along": 0.1, "twist": 1.5},
               {"turn": 0.2, "across": 0.2}, {"across": 0.15}, {"along": 0.02}]})",
              4, Vec3(0.2, 0.1, 0.2)) -
         makeChain(links, {0.01, 0, 0})->at({0.3, 0.3, 0.3, 0.1}).position_D)
            .norm() == 0.0);
}

TEST_CASE("a profile's masses are refused if a motor needs over half of its force to carry them",
          "[profile]") {
  Json json = full();
  json["limits"].erase("continuous");
  json["limits"].erase("heating");
  json["gravity"] = Json::parse(R"({"down": [0, 0, -2], "masses": [
    {"mass": 0.1}, {"mass": 0.2, "link": 1, "centre": [0.1, 0, 0]}]})");
  CHECK(schemaAccepts(json));
  const HidProfile arm = parseHidProfile(json.dump(), "p.json");
  CHECK(arm.down_D == Vec3(0, 0, -1));
  REQUIRE(arm.masses.size() == 2);
  CHECK_FALSE(arm.masses[0].link);
  CHECK(arm.masses[1].link == 1U);
  CHECK(arm.masses[1].centre.x() == 0.1);
  // The second mass moves only horizontally, so no motor carries it.
  const ProfileFacts facts = factsOf(arm);
  CHECK((facts.carried_W - Vec3(0, 0, 0.1 * 9.80665)).norm() < 1e-4);
  CHECK(facts.motors[2].carries == Approx(0.1 * 9.80665 / 2.0));
  CHECK(facts.motors[0].carries == 0.0);
  // The weight may need at most half of a motor's peak force and half of its continuous force.
  json["gravity"]["masses"][0]["mass"] = 1.0;
  CHECK_THAT(trouble(json),
             Contains("/gravity: fc needs an output of 4.9 to carry the arm's masses, more than "
                      "half of its limit of 5"));
  json["gravity"]["masses"][0]["mass"] = 0.1;
  Json& motor = json["kinematics"]["joints"][2];
  motor["heating"] = 10.0;
  motor["continuous"] = 0.9;
  CHECK_THAT(trouble(json),
             Contains("fc needs an output of 0.49 to carry the arm's masses, more than half of "
                      "its continuous limit of 0.9"));
  motor["continuous"] = 1.0;
  CHECK(trouble(json) == "none");
}

TEST_CASE("the world axes along which an arm moves and is driven follow from its profile",
          "[profile]") {
  const auto axes = [](const Json& json) {
    const ProfileFacts facts = factsOf(parseHidProfile(json.dump(), "arm.json"));
    std::string words;
    for (const Mat3& onto : {facts.moves, facts.drives}) {
      const ArmAxes there = axesWithin(onto);
      for (int a = 0; a < 3; ++a) {
        if (there.has[static_cast<std::size_t>(a)]) words += there.name(a);
      }
      words += "|";
    }
    return words;
  };
  CHECK(axes(full()) == "xyz|xyz|");
  // Tests a slide without a motor. The mount turns the arm's x axis to the world's y axis.
  Json sensed = full();
  sensed["kinematics"]["joints"][0].erase("motor");
  sensed["kinematics"]["joints"][0].erase("torque_constant");
  sensed["output"]["fields"].erase("fa");
  CHECK(schemaAccepts(sensed));
  CHECK(axes(sensed) == "xyz|xz|");
  const auto with = [](const char* kinematics, const Json& mount) {
    Json json = full();
    json["kinematics"] = Json::parse(kinematics);
    json["mount"] = mount;
    json["output"]["fields"].erase("fc");
    return json;
  };
  const char* const panto =
      R"({"model": "pantograph", "lengths": [0.08, 0.1, 0.1, 0.08], "base": 0.05, "joints": [
          {"from": "a", "motor": "fa", "torque_constant": 0.1},
          {"from": "b", "motor": "fb", "torque_constant": 0.1}]})";
  CHECK(axes(with(panto, {{"origin", {-0.02, 0.12, 0}}})) == "xy|xy|");
  // Tests the same arm upright, then tilted by 30 degrees.
  CHECK(axes(with(panto, {{"origin", {-0.02, 0.12, 0}}, {"rotation_wxyz", {1, 1, 0, 0}}})) ==
        "xz|xz|");
  CHECK(axes(with(panto, {{"origin", {-0.02, 0.12, 0}},
                          {"rotation_wxyz", {0.9659258, 0.258819, 0, 0}}})) ==
        "xy (0, 0.866, 0.5)|xy (0, 0.866, 0.5)|");
  // A chain of three rotary joints with parallel axes moves in a plane.
  CHECK(
      axes(with(R"({"model": "chain", "links": [{"across": 0.2}, {"across": 0.2}, {"across": 0.1}],
          "joints": [{"from": "a", "motor": "fa", "torque_constant": 0.1},
                     {"from": "b", "motor": "fb", "torque_constant": 0.1}, {"from": "c"}]})",
                {{"origin", {0.3, 0.2, 0}}})) == "xy|xy|");
}

TEST_CASE("a profile's resolution, home position and largest motor demand are computed correctly",
          "[profile]") {
  const ProfileFacts facts = factsOf(parseHidProfile(full().dump(), "arm.json"));
  CHECK(facts.off < 1e-6);
  CHECK(facts.step == Approx(3e-6));
  // In the home pose the tip is at (0, 0, 0.1) m in the arm's frame, which is the origin of W.
  CHECK(facts.home_W.norm() < 1e-12);
  REQUIRE(facts.motors.size() == 3);
  CHECK(facts.motors[0].asked == Approx(5.0));
  CHECK(facts.motors[2].asked == Approx(2.5));
  CHECK(facts.motors[0].room == Approx(5.0));
  // Expected for the Polhem arm: 5 N perpendicular to the arm, 0.14 m from its axis, converted by
  // gear ratio and torque constant.
  std::vector<std::string> notes;
  for (const HidProfile& arm : hidProfiles("/nowhere", notes)) {
    if (arm.name != "polhem") continue;
    const ProfileFacts polhem = factsOf(arm);
    const HidJoint& base = arm.joints[0];
    const double away = std::hypot(arm.origin_D.x(), arm.origin_D.y());
    CHECK(polhem.motors[0].asked ==
          Approx(5.0 * away / std::abs(base.ratio * base.torque_constant)).epsilon(1e-4));
  }
}

TEST_CASE("self-test results are stored by serial number and by profile", "[profile]") {
  const test::TemporaryFolder folder;
  setenv("XDG_STATE_HOME", folder.path().c_str(), 1);
  const HidProfile arm = parseHidProfile(full().dump(), "arm.json");
  CHECK_FALSE(isTested(identityOf(arm, "S1")));
  SelfTestResult measured;
  measured.scale = {0.99, 1.0, 1.01};
  for (AxisResult& axis : measured.axes) {
    axis.driven = true;
    axis.viscous = 0.5;
    axis.viscous_error = 0.01;
    axis.coulomb = 0.04;
    axis.coulomb_error = 0.02;
    axis.delay = 1e-3;
    axis.delay_error = 0.1e-3;
  }
  measured.axes[1].viscous = 0.4;
  rememberTest(identityOf(arm, "S1"), measured);
  CHECK(isTested(identityOf(arm, "S1")));
  CHECK_FALSE(isTested(identityOf(arm, "S2")));
  CHECK(testedArms(identityOf(arm, "")) == std::vector<std::string>{"S1"});
  CHECK(measuredArm(identityOf(arm, "S1")).viscous == Approx(0.37));
  CHECK(measuredArm(identityOf(arm, "S1")).coulomb == 0.0);
  // The delay's uncertainty is half a millisecond plus three standard errors to each side. The
  // lower limit is never negative.
  CHECK(measuredArm(identityOf(arm, "S1")).delay == Approx(1e-3));
  CHECK(measuredArm(identityOf(arm, "S1")).doubt == Approx(0.8e-3));
  measured.axes[2].delay = 0.3e-3;
  rememberTest(identityOf(arm, "S1"), measured);
  CHECK(measuredArm(identityOf(arm, "S1")).delay == Approx(0.9e-3));
  CHECK(measuredArm(identityOf(arm, "S1")).doubt == Approx(0.9e-3));
  CHECK(measuredArm(identityOf(arm, "S2")).viscous == 0.0);
  CHECK_FALSE(isTested(identityOf(arm, "")));
  // A profile with a changed sign of a joint counts as untested.
  Json other = full();
  other["kinematics"]["joints"][0]["ratio"] = -1;
  CHECK_FALSE(isTested(identityOf(parseHidProfile(other.dump(), "arm.json"), "S1")));
  rememberTest(identityOf(parseHidProfile(other.dump(), "arm.json"), "S2"), measured);
  CHECK(isTested(identityOf(arm, "S1")));
  // If the file of tested arms is invalid, every arm counts as untested, without an error.
  for (const char* text : {"{", "[]", R"({"mine@S1": 3})", R"({"mine@S1": {"profile": 7}})", ""}) {
    std::ofstream(testedArmsFile()) << text;
    CHECK_FALSE(isTested(identityOf(arm, "S1")));
  }
  std::ofstream(testedArmsFile()) << std::string(300000, '[');
  CHECK_FALSE(isTested(identityOf(arm, "S1")));
  std::ofstream(testedArmsFile()) << R"({"mine@S1": )" + std::string(300000, '[') +
                                         std::string(300000, ']') + "}";
  CHECK_FALSE(isTested(identityOf(arm, "S1")));
  rememberTest(identityOf(arm, "S1"), measured);
  CHECK(isTested(identityOf(arm, "S1")));
  // Records without a measured scale, or with the scale of one axis only, do not count.
  for (const Json& scale : {Json(), Json(1.0)}) {
    std::ifstream in(testedArmsFile());
    Json json = Json::parse(in);
    json["mine@S1"]["scale"] = scale;
    std::ofstream(testedArmsFile()) << json;
    CHECK_FALSE(isTested(identityOf(arm, "S1")));
  }
  // A planar arm has no measurement along the axis without a motor. This axis is ignored.
  rememberTest(identityOf(arm, "S1"), measured);
  CHECK(measuredArm(identityOf(arm, "S1")).viscous == Approx(0.37));
  measured.axes[1] = {};
  rememberTest(identityOf(arm, "S1"), measured);
  CHECK(measuredArm(identityOf(arm, "S1")).viscous == Approx(0.47));
  CHECK(measuredArm(identityOf(arm, "S1")).delay > 0.0);
  rememberTest(identityOf(arm, "S1"), measured);
  CHECK(isTested(identityOf(arm, "S1")));
  forgetTest(identityOf(arm, "S1"));
  CHECK_FALSE(isTested(identityOf(arm, "S1")));
  setenv("XDG_STATE_HOME", "state", 1);
  CHECK(testedArmsFile().is_absolute());
  unsetenv("XDG_STATE_HOME");
}

TEST_CASE("an arm without a usable serial number is identified by its port", "[profile]") {
  const HidProfile profile = parseHidProfile(full().dump(), "arm.json");
  FoundArm arm;
  arm.device.port = "usb-0000:00:14.0-2/input0";
  for (const char* none : {"", "0123456789"}) {
    arm.device.serial = none;
    CHECK(arm.identity() == arm.device.port);
    const auto name = parseArmName(arm.nameAs(profile));
    REQUIRE(name);
    CHECK(name->serial == arm.device.port);
  }
  arm.device.serial = "A1";
  CHECK(arm.identity() == "A1");
  CHECK(arm.nameAs(profile) == "hid:mine@A1");
  CHECK(FoundArm{}.identity().empty());
}

TEST_CASE("an arm's name is split into profile, serial number and file", "[profile]") {
  const auto parts = [](const char* name) {
    const auto parsed = parseArmName(name);
    return parsed ? parsed->profile + "|" + parsed->serial + (parsed->isFile() ? "|file" : "")
                  : std::string("none");
  };
  CHECK(parts("hid") == "|");
  CHECK(parts("hid:") == "|");
  CHECK(parts("hid:polhem") == "polhem|");
  CHECK(parts("hid:polhem@A1") == "polhem|A1");
  CHECK(parts("hid:@A1") == "|A1");
  CHECK(parts("hid:polhem@A@1") == "polhem|A@1");
  CHECK(parts("hid:a@b/mine.json") == "a@b/mine.json||file");
  CHECK(parts("hid:a@b/mine.json@S@1") == "a@b/mine.json|S@1|file");
  CHECK(parts("hid:my.json.d/mine.json@S") == "my.json.d/mine.json|S|file");
  CHECK(parts("hidden") == "none");
  CHECK(parts("hid@S1") == "none");
  CHECK(parts("simulated") == "none");
  CHECK_THROWS_WITH(openArm("hid@S1", {}), Contains("hid:PROFILE@SERIAL"));
}

TEST_CASE("a profile name that fits two profiles is refused with both their names", "[profile]") {
  // The motor constants of the two editions differ by a factor of twelve. With the profile of 2015,
  // an arm of 2019 would get twelve times the wanted force.
  const std::string editions =
      "hid:woodenhaptics: this name is incomplete, and fits woodenhaptics-v2015 or "
      "woodenhaptics-v2019";
  CHECK_THROWS_WITH(namedProfile({"woodenhaptics", ""}, nullptr), Contains(editions));
  CHECK_THROWS_WITH(openArm("hid:woodenhaptics", {}), Contains(editions));
  CHECK_THROWS_WITH(namedProfile({"woodenhaptic", ""}, nullptr),
                    Contains("no profile has the name"));
  const HidProfile old = namedProfile({"woodenhaptics-v2015", ""}, nullptr);
  const HidProfile young = namedProfile({"woodenhaptics-v2019", ""}, nullptr);
  CHECK(young.joints[0].torque_constant / old.joints[0].torque_constant ==
        Approx(12.394).epsilon(1e-4));
  for (std::size_t i = 0; i < 3; ++i) CHECK(young.joints[i].ratio == old.joints[i].ratio);
  CHECK(young.joints[1].torque_constant == 0.0603);
}

TEST_CASE("torque constants above 1 N m per unit are reported once unless their joints slide",
          "[profile]") {
  const test::TemporaryFolder folder;
  const std::string file = (folder / "mine.json").string();
  const auto notes = [&](const Json& json) {
    std::ofstream(file) << json.dump();
    std::vector<std::string> all;
    (void)namedProfile({file, ""}, [&](const std::string& note) { all.push_back(note); });
    return all;
  };
  CHECK(notes(full()).empty());  // three sliding joints, one of them with 2 N per unit
  std::ifstream in(test::sourceDir() + "/devices/hid/profiles/teensy-arm.json");
  Json turning = Json::parse(in);
  CHECK(notes(turning).empty());
  for (Json& joint : turning["kinematics"]["joints"]) joint["torque_constant"] = 1.0;
  CHECK(notes(turning).empty());
  turning["kinematics"]["joints"][1]["torque_constant"] = 2.59;
  turning["kinematics"]["joints"][2]["torque_constant"] = 2.59;
  const std::vector<std::string> noted = notes(turning);
  REQUIRE(noted.size() == 1);
  CHECK_THAT(noted[0], Contains("mine.json: /kinematics/joints/1/torque_constant: 2.59 N m per "
                                "unit of current_b is above 1") &&
                           Contains("divide it by 1000"));
  CHECK_NOTHROW(namedProfile({file, ""}, nullptr));
}

TEST_CASE("a profile with an output but without limits is refused", "[profile]") {
  Json json = full();
  json.erase("limits");
  CHECK_THAT(trouble(json), Contains("an arm with \"output\" needs limits"));
}

TEST_CASE("the shipped profiles are valid and name the source of every number", "[profile]") {
  std::vector<std::string> notes;
  const std::vector<HidProfile> arms = hidProfiles("/nowhere", notes);
  CHECK(notes.empty());
  std::set<std::string> names;
  for (const HidProfile& arm : arms) names.insert(arm.name);
  CHECK(names == std::set<std::string>{"polhem", "spacemouse", "teensy-arm", "woodenhaptics-v2015",
                                       "woodenhaptics-v2019"});
  for (const HidProfile& arm : arms) {
    if (arm.name != "teensy-arm") continue;  // the template, which users copy
    for (const MotorFact& motor : factsOf(arm).motors) CHECK(motor.asked <= motor.room);
  }
  for (const std::string& name : names) {
    std::ifstream in(test::sourceDir() + "/devices/hid/profiles/" + name + ".json");
    const Json json = Json::parse(in);
    CAPTURE(name);
    CHECK(schemaAccepts(json));
    const Json flat = json.flatten();
    for (const auto& [pointer, value] : flat.items()) {
      if (!value.is_number() || pointer == "/palpate_arm") continue;
      CAPTURE(pointer);
      bool said = false;
      for (const auto& [prefix, source] : json.at("sources").items()) {
        said = said || (pointer.rfind(prefix, 0) == 0 && !source.get<std::string>().empty());
      }
      CHECK(said);
    }
    // palpate's udev rules must give users access to the arm.
    std::ifstream rules(test::sourceDir() + "/devices/70-palpate-arms.rules");
    const std::string text((std::istreambuf_iterator<char>(rules)), {});
    for (const Json& match : json.at("match")) {
      const auto lower = [](std::string s) {
        for (char& c : s) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
        return s;
      };
      CHECK_THAT(text, Contains("ATTRS{idVendor}==\"" + lower(match.at("vendor")) +
                                "\", ATTRS{idProduct}==\"" + lower(match.at("product")) + "\""));
    }
  }
}

TEST_CASE("a user's profile replaces the shipped profile of its name even if it is invalid",
          "[profile]") {
  const test::TemporaryFolder folder;
  Json mine = full();
  mine["name"] = "polhem";
  std::ofstream(folder / "a.json") << mine.dump();
  std::ofstream(folder / "b.json") << "{";
  // If a user's profile of an arm is invalid, palpate must not use its own profile of that name
  // instead.
  std::ofstream(folder / "teensy-arm.json") << "{";
  Json broken = full();
  broken["name"] = "woodenhaptics-v2015";
  broken["limits"]["force"] = 0;
  std::string text = broken.dump();
  text.insert(1, ",");
  std::ofstream(folder / "mine.json") << text;
  std::ofstream(folder / "c.txt") << "no profile";
  std::vector<std::string> notes;
  const auto arms = hidProfiles(folder.path(), notes);
  CHECK(arms.size() == 3);
  CHECK(arms[0].name == "polhem");
  CHECK(arms[1].name == "spacemouse");
  CHECK(arms[2].name == "woodenhaptics-v2019");
  CHECK(arms[0].match[0].vendor == 0x1209);
  CHECK(notes.size() == 4);
  CHECK_THAT(notes[0], Contains("a.json: /name: this file replaces palpate's own profile polhem"));
  CHECK_THAT(notes[1], Contains("b.json") && Contains("not valid JSON"));
  // Tests two of the user's files whose profiles have the same name.
  std::ofstream(folder / "b.json") << mine.dump();
  notes.clear();
  CHECK(hidProfiles(folder.path(), notes).size() == 3);
  CHECK_THAT(notes[1], Contains("b.json: /name: another file in this folder has the name polhem"));
}

TEST_CASE("every known arm has limits with their source", "[profile]") {
  const auto arms = knownArms();
  CHECK(arms.size() >= 8);
  for (const KnownArm& arm : arms) {
    CAPTURE(arm.name);
    CHECK(arm.force > 0.0);
    CHECK(arm.stiffness > 0.0);
    CHECK(arm.workspace_radius > 0.0);
    CHECK(arm.source.size() > 3);
  }
}

TEST_CASE("damaged profiles never crash the profile reader", "[profile]") {
  const std::string good = full().dump();
  // Replaces each byte by each of five characters, and removes each byte.
  for (std::size_t i = 0; i < good.size(); ++i) {
    for (const char c : {'0', '"', '}', '-', '9'}) {
      std::string bad = good;
      bad[i] = c;
      try {
        (void)parseHidProfile(bad, "arm.json");
      } catch (const DeviceError&) {
      }
    }
    std::string cut = good;
    cut.erase(i, 1);
    try {
      (void)parseHidProfile(cut, "arm.json");
    } catch (const DeviceError&) {
    }
  }
  SUCCEED();
}

TEST_CASE("a profile of a PID device gives axis travel in metres and forces in newtons",
          "[profile][pid]") {
  const Json good = Json::parse(R"({
    "palpate_arm": 1, "name": "stick", "firmware": "f",
    "match": [{"vendor": "1209", "product": "FFB0"}],
    "rate": {"input": 1000, "output": 500},
    "pid": {"axes": [{"axis": "y", "way": -0.2, "force": 8},
                     {"axis": "x", "way": 0.3, "force": -10}]},
    "mount": {"rotation_wxyz": [0.7071067811865476, 0, 0, 0.7071067811865476]},
    "limits": {"force": 5, "stiffness": 800, "damping": 4, "workspace_radius": 0.1},
    "sources": {"/pid": "a ruler and a spring scale"}})");
  REQUIRE(trouble(good) == "none");
  REQUIRE(schemaAccepts(good));
  const HidProfile arm = parseHidProfile(good.dump(), "arm.json");
  REQUIRE(arm.pid.size() == 2);
  CHECK(arm.pid[0].axis == 0);  // the axes are sorted, x first
  CHECK(arm.pid[0].way == 0.3);
  CHECK(arm.pid[1].force == 8.0);
  CHECK(arm.output_rate == 250.0);  // [forces/s]; one force takes one report per axis
  const ProfileFacts facts = factsOf(arm);
  CHECK(facts.off < 1e-6);
  CHECK(facts.moves.isApprox(Mat3(Vec3(1, 1, 0).asDiagonal())));
  REQUIRE(facts.motors.size() == 2);
  CHECK(facts.motors[0].asked == Approx(5.0));  // [N]; the device can give 10 N
  CHECK(facts.motors[0].room == Approx(10.0));

  std::ifstream in(test::sourceDir() + "/docs/profiles.md");
  std::ostringstream page;
  page << in.rdbuf();
  const std::string fence = "```json\n";
  const std::size_t begin = page.str().find(fence) + fence.size();
  const Json shown = Json::parse(page.str().substr(begin, page.str().find("```", begin) - begin));
  CHECK(trouble(shown) == "none");
  CHECK(schemaAccepts(shown));

  struct Bad {
    const char* pointer;
    Json value;
    const char* says;
    bool schema;
  };
  for (const Bad& bad : std::vector<Bad>{
           {"/pid/axes", Json::array(), "/pid/axes: it is not a list of 1 to 3 axes", true},
           {"/pid/axes/0/axis", "rx", "/pid/axes/0/axis: \"rx\" is not known", true},
           {"/pid/axes/0/axis", "x", "/pid/axes/1/axis: the axis occurs twice", false},
           {"/pid/axes/0/way", 0, "/pid/axes/0/way: it is 0", true},
           {"/pid/axes/0/way", 200, "200 is more than 2 metres", true},
           {"/pid/axes/0/way", 0.19, "the workspace is 0.2 m wide, but the grip travels only 0.19",
            false},
           {"/pid/axes/0/force", 0, "/pid/axes/0/force: it is 0", true},
           {"/pid/axes/0/force", 4, "limits/force is 5 N, and this axis gives 4", false},
           {"/pid/axes/0/force", 900, "900 is more than 100 newtons", true},
           {"/limits/force", 0.001, "limits/force is 0.001 N, and this axis gives 8", false},
           {"/input", Json::array(), "none or several of the keys input, pid: give one of them",
            true},
           {"/output", Json::object(), "/output: \"pid\" does not have this key", true},
           {"/kinematics", Json::object(), "/kinematics: \"pid\" does not have this key", true},
           {"/rate/output", 0.5, "0.5 reports per second", false},
           {"/firmware", "", "add \"firmware\"", false},
       }) {
    Json json = good;
    json[Json::json_pointer(bad.pointer)] = bad.value;
    CAPTURE(bad.pointer, bad.value.dump());
    CHECK_THAT(trouble(json), Contains("arm.json") && Contains(bad.says));
    if (bad.schema) CHECK_FALSE(schemaAccepts(json));
  }
  for (const char* needed : {"limits", "pid"}) {
    Json json = good;
    json.erase(needed);
    CAPTURE(needed);
    CHECK(trouble(json) != "none");
    CHECK_FALSE(schemaAccepts(json));
  }
  Json slow = good;
  slow["rate"].erase("output");
  CHECK_THAT(trouble(slow), Contains("\"pid\" needs rate/output"));
}

TEST_CASE("a PID profile is refused if it has an axis that the device lacks", "[profile][pid]") {
  const HidProfile arm = parseHidProfile(R"({
    "palpate_arm": 1, "name": "stick", "firmware": "f",
    "match": [{"vendor": "1209", "product": "FFB0"}], "rate": {"input": 1000, "output": 500},
    "pid": {"axes": [{"axis": "x", "way": 0.2, "force": 8}, {"axis": "z", "way": 0.2, "force": 8}]},
    "limits": {"force": 5, "stiffness": 800, "damping": 4, "workspace_radius": 0.1}})",
                                         "arm.json");
  test::PidShape shape;
  shape.axes = 3;
  FoundArm found;
  found.device.descriptor = test::PidModel(shape).descriptor();
  CHECK_FALSE(found.against(arm));
  shape.axes = 2;
  found.device.descriptor = test::PidModel(shape).descriptor();
  REQUIRE(found.against(arm));
  CHECK(std::string(found.against(arm)->what()) ==
        "arm.json: /pid/axes/1: the device does not report a position along z: remove this axis");
}

TEST_CASE("a PID device is refused while another program uses its force effects",
          "[profile][pid]") {
  namespace fs = std::filesystem;
  const test::TemporaryFolder folder;
  const fs::path input = folder / "hidraw3" / "device" / "input" / "input7";
  fs::create_directories(input / "capabilities");
  fs::create_directories(input / "event5");
  fs::create_directories(input / "js0");
  CHECK(effectNodes("/dev/hidraw3", folder / "").empty());
  std::ofstream(input / "capabilities" / "ff") << "0 0\n";
  CHECK(effectNodes("/dev/hidraw3", folder / "").empty());
  std::ofstream(input / "capabilities" / "ff") << "300040000 0\n";
  CHECK(effectNodes("/dev/hidraw3", folder / "") == std::vector<std::string>{"/dev/input/event5"});
  CHECK(effectNodes("/dev/hidraw4", folder / "").empty());

  const std::string node = (folder / "event5").string();
  std::ofstream(node) << "x";
  CHECK_NOTHROW(refuseEffects("/dev/hidraw3", {node}));
  std::array<int, 2> ready{};
  REQUIRE(pipe2(ready.data(), O_CLOEXEC) == 0);
  const pid_t other = fork();
  if (other == 0) {
    (void)open(node.c_str(), O_RDWR);
    (void)!write(ready[1], "x", 1);
    pause();
    _exit(0);
  }
  char word = 0;
  REQUIRE(read(ready[0], &word, 1) == 1);
  CHECK_THROWS_WITH(
      refuseEffects("/dev/hidraw3", {node}),
      Contains("/dev/hidraw3: ") && Contains("(" + std::to_string(other) +
                                             ") can use this arm's force effects through " + node));
  kill(other, SIGKILL);
  waitpid(other, nullptr, 0);
  close(ready[0]);
  close(ready[1]);
  CHECK_NOTHROW(refuseEffects("/dev/hidraw3", {node}));
}

}  // namespace palpate::hid_profile_test
