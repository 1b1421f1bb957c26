#include "palpate/devices/hid_profile.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <sstream>
#include <string_view>
#include <system_error>
#include <utility>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "palpate/devices/hid_data.h"
#include "palpate/devices/json_node.h"
#include "palpate/devices/profile_facts.h"
#include "palpate/engine/device.h"
#include "palpate/engine/error.h"

namespace palpate {
namespace {

using Node = JsonNode<DeviceError>;
constexpr std::size_t kMostBytes = 1024;  // of a report
constexpr std::size_t kMostReports = 16;
constexpr std::size_t kMostSteps = 64;
constexpr double kMostStale = 2.0;  // [s]: a switch that is believed for longer is none
// No desktop arm is larger, stronger or faster: who writes more has another unit in mind.
constexpr double kMostLength = 2.0;     // [m]
constexpr double kMostAngle = 6.2832;   // [rad]
constexpr double kMostForce = 100.0;    // [N]
constexpr double kMostSlew = 1e5;       // [N/s]
constexpr double kMostStiffness = 1e5;  // [N/m]
constexpr double kMostDamping = 500.0;  // [N s/m]
constexpr double kMostStep = 5e-3;      // [m], of the tip by one count
constexpr double kMostAsked = 20.0;     // of what its field lets a motor have
constexpr double kLeastAsked = 1e-3;
constexpr double kMostHeating = 1e4;   // [s]
constexpr double kLeastHeating = 0.1;  // [s]
constexpr double kSame = 1e-4;         // [m]: so far apart two places are one
constexpr double kMostMass = 5.0;      // [kg]
constexpr double kMostCarried = 0.5;  // of what its field lets a motor have: the rest is to be felt
constexpr std::size_t kMostMasses = 16;

double positiveUpTo(const Node& node, double most, const char* unit) {
  (void)node.positive();
  return node.sized(most, unit);
}

/// True where a motor is told by an output field.
bool isMotor(const HidProfile& profile, std::size_t field) {
  return std::any_of(profile.joints.begin(), profile.joints.end(),
                     [&](const HidJoint& joint) { return joint.to == field; });
}

/// Numbers that a device is named by are written as people write them: "16C0".
std::uint16_t readHex(const Node& node) {
  std::string text = node.text();
  if (text.rfind("0x", 0) == 0 || text.rfind("0X", 0) == 0) text.erase(0, 2);
  std::uint16_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value, 16);
  if (error != std::errc() || end != text.data() + text.size() || text.empty()) {
    node.fail(fmt::format("\"{}\" is not a hexadecimal number of 16 bits", node.text()),
              "write it as lsusb does, as \"16C0\"");
  }
  return value;
}

std::vector<HidMatch> readMatches(const Node& node) {
  if (!node.json().is_array() || node.json().empty()) {
    node.fail("it is not a list of devices",
              "write [{\"vendor\": \"16C0\", \"product\": \"0486\"}]");
  }
  std::vector<HidMatch> matches;
  for (std::size_t i = 0; i < node.json().size(); ++i) {
    const Node at = node.element(i).object({"vendor", "product", "usage_page", "usage"});
    HidMatch match;
    match.vendor = readHex(at.need("vendor"));
    match.product = readHex(at.need("product"));
    if (at.has("usage_page")) match.usage_page = readHex(at.child("usage_page"));
    if (at.has("usage")) match.usage = readHex(at.child("usage"));
    matches.push_back(match);
  }
  return matches;
}

ReportField readField(const std::string& name, const Node& node, std::size_t size, bool output) {
  node.object(
      {"bit", "bits", "type", "big_endian", "scale", "offset", "least", "most", "wraps", "rest"});
  ReportField field;
  field.name = name;
  using Type = ReportField::Type;
  if (node.has("type")) {
    field.type = node.child("type").word<Type>(
        {{"unsigned", Type::kUnsigned}, {"signed", Type::kSigned}, {"float", Type::kFloat}});
  } else if (node.has("bits") && node.child("bits").json() == 1) {
    field.type = Type::kUnsigned;  // a flag
  }
  const int most_bit = static_cast<int>(8 * size) - 1;
  field.bit = static_cast<std::uint32_t>(node.need("bit").whole(0, most_bit));
  field.bits = static_cast<std::uint32_t>(node.need("bits").whole(1, 32));
  if (field.type == Type::kFloat && field.bits != 32) {
    node.child("bits").fail("a float has 32 bits", "write 32");
  }
  if (node.has("big_endian")) field.big_endian = node.child("big_endian").flag();
  if (field.big_endian && (field.bit % 8 != 0 || field.bits % 8 != 0)) {
    node.fail("big-endian numbers are whole bytes", "remove \"big_endian\", or mend bit and bits");
  }
  if (field.end() > size) {
    node.fail(fmt::format("it ends beyond the report's {} bytes", size), "mend bit, bits or size");
  }
  if (node.has("scale")) field.scale = node.child("scale").number();
  if (field.scale == 0.0) node.child("scale").fail("it is 0", "write what one count is");
  if (node.has("offset")) field.offset = node.child("offset").number();
  if (node.has("wraps")) field.wraps = node.child("wraps").flag();
  if (field.wraps && field.type == Type::kFloat) {
    node.child("wraps").fail("a float is no counter", "remove it");
  }
  const int bits = static_cast<int>(field.bits);
  const bool with_sign = field.type == Type::kSigned;
  field.least = with_sign ? -std::ldexp(1.0, bits - 1) : 0.0;
  field.most = with_sign ? -field.least - 1.0 : std::ldexp(1.0, bits) - 1.0;
  if (field.type == Type::kFloat) {
    field.least = -3e38;
    field.most = 3e38;
  }
  const auto fits = [&, lowest = field.least, highest = field.most](const Node& number) {
    const double value = number.number();
    if (value < lowest || value > highest) {
      number.fail(fmt::format("{} does not fit: its bits hold {} to {}", value, lowest, highest),
                  "mend it, or the field's type and bits");
    }
    return value;
  };
  if (node.has("least")) field.least = fits(node.child("least"));
  if (node.has("most")) field.most = fits(node.child("most"));
  if (!(field.least <= field.most)) node.fail("least is above most", "exchange them");
  field.bounded = node.has("least") && node.has("most");
  if (node.has("rest")) {
    if (!output) node.child("rest").fail("nothing is sent in it", "remove it");
    field.rest = fits(node.child("rest"));
  }
  return field;
}

HidReportSpec readReport(const Node& node, bool output) {
  if (output) {
    node.object({"id", "size", "fields"});
  } else {
    node.object({"id", "size", "fields", "sequence", "stale"});
  }
  HidReportSpec report;
  if (node.has("id")) report.id = static_cast<std::uint8_t>(node.child("id").whole(1, 255));
  report.size = static_cast<std::size_t>(node.need("size").whole(1, kMostBytes));
  const Node fields = node.need("fields");
  if (!fields.json().is_object()) fields.fail("it is not an object", "write { \"name\": {...} }");
  for (const auto& [name, value] : fields.json().items()) {
    report.fields.push_back(readField(name, fields.child(name), report.size, output));
  }
  if (node.has("sequence")) {
    const Node sequence = node.child("sequence");
    const std::string name = sequence.text();
    const auto at = std::find_if(report.fields.begin(), report.fields.end(),
                                 [&](const ReportField& field) { return field.name == name; });
    if (at == report.fields.end()) {
      sequence.fail("this report has no field \"" + name + "\"", "name one of its fields");
    }
    report.sequence = static_cast<std::size_t>(at - report.fields.begin());
  }
  if (node.has("stale")) report.stale = positiveUpTo(node.child("stale"), kMostStale, "seconds");
  return report;
}

/// A report that drives motors: no two fields share a bit, and what a guardian writes fits.
HidReportSpec readOutput(const Node& node) {
  HidReportSpec report = readReport(node, true);
  constexpr std::size_t kMostOut = ZeroForce::kMostBytes - 1;
  if (report.size > kMostOut) {
    node.child("size").fail(fmt::format("more than {} bytes", kMostOut), "use a shorter report");
  }
  std::vector<bool> used(8 * report.size);
  for (const ReportField& field : report.fields) {
    for (std::uint32_t bit = field.bit; bit < field.bit + field.bits; ++bit) {
      if (used[bit]) {
        node.child("fields")
            .child(field.name)
            .fail("its bits are another field's as well", "mend bit or bits");
      }
      used[bit] = true;
    }
  }
  return report;
}

/// Finds fields by their names.
class Fields {
 public:
  explicit Fields(const HidProfile& profile) : profile_(profile) {}
  [[nodiscard]] FieldRef input(const Node& node) const {
    const std::string name = node.name();
    std::vector<std::string> names;
    for (std::size_t r = 0; r < profile_.input.size(); ++r) {
      for (std::size_t f = 0; f < profile_.input[r].fields.size(); ++f) {
        names.push_back(profile_.input[r].fields[f].name);
        if (names.back() == name) return {r, f};
      }
    }
    unknown(node, name, names, "input");
  }
  /// @param motors  Whether a motor's may be meant.
  [[nodiscard]] std::size_t output(const Node& node, const std::string& name, bool motors) const {
    std::vector<std::string> names;
    if (!profile_.output) node.fail("this arm has no output", "remove it, or add \"output\"");
    for (std::size_t f = 0; f < profile_.output->fields.size(); ++f) {
      const std::string& here = profile_.output->fields[f].name;
      if (here == name) return f;
      if (motors || !isMotor(profile_, f)) names.push_back(here);
    }
    unknown(node, name, names, "output");
  }

 private:
  [[noreturn]] static void unknown(const Node& node, const std::string& name,
                                   const std::vector<std::string>& names, const char* where) {
    const std::string near = nearestName(name, names);
    node.fail(fmt::format("the {} has no field \"{}\"", where, name),
              near.empty() ? "name one of its fields" : "did you mean \"" + near + "\"?");
  }
  const HidProfile& profile_;
};

void readFlags(const Node& node, const Fields& fields, HidProfile& profile) {
  if (!node.json().is_array()) node.fail("it is not a list", "write [{\"field\": ...}]");
  for (std::size_t i = 0; i < node.json().size(); ++i) {
    const Node at = node.element(i).object({"field", "equals", "means"});
    using Means = HidFlag::Means;
    HidFlag flag;
    flag.field = fields.input(at.need("field"));
    if (at.has("equals")) flag.equals = at.child("equals").number();
    const ReportField& of = profile.input[flag.field.report].fields[flag.field.field];
    if (flag.equals < of.least || flag.equals > of.most) {
      at.fail(fmt::format("{} is never {}", of.name, flag.equals),
              "mend equals, or the field's type and bits");
    }
    flag.means = at.need("means").word<Means>({{"homed", Means::kHomed},
                                               {"enabled", Means::kEnabled},
                                               {"hot", Means::kHot},
                                               {"unpowered", Means::kUnpowered},
                                               {"open", Means::kOpen}});
    profile.flags.push_back(flag);
  }
}

/// In metres.
Vec3 readPlace(const Node& node) {
  const auto v = node.numbers<3>();
  for (std::size_t i = 0; i < 3; ++i) (void)node.element(i).sized(kMostLength, "metres");
  return {v[0], v[1], v[2]};
}

std::shared_ptr<const Kinematics> readModel(const Node& node) {
  const auto length = [&](const char* key) {
    return positiveUpTo(node.need(key), kMostLength, "metres");
  };
  const std::string model = node.need("model").text();
  const auto common = [&](std::initializer_list<const char*> own) {
    std::vector<const char*> keys(own);
    keys.insert(keys.end(), {"model", "joints", "home_at_open", "home_words", "rate_control"});
    for (const auto& item : node.json().items()) {
      const std::string& key = item.key();
      const bool known =
          std::any_of(keys.begin(), keys.end(), [&](const char* k) { return key == k; });
      if (!known) node.child(key).fail("model " + model + " has no such key", "remove it");
    }
  };
  if (model == "cartesian") {
    common({});
    return makeCartesian();
  }
  if (model == "chain") {
    common({"links", "tip"});
    const Node list = node.need("links");
    if (!list.json().is_array()) list.fail("it is not a list of links", "write [{...}, ...]");
    std::vector<ChainLink> links;
    if (list.json().size() < 3 || list.json().size() > kMostJoints) {
      list.fail(fmt::format("{} links", list.json().size()), "give 3 to 6");
    }
    for (std::size_t i = 0; i < list.json().size(); ++i) {
      const Node at = list.element(i).object({"turn", "along", "across", "twist"});
      const auto number = [&](const char* key, double most, const char* unit) {
        return at.has(key) ? at.child(key).sized(most, unit) : 0.0;
      };
      links.push_back(
          {number("turn", kMostAngle, "radians"), number("along", kMostLength, "metres"),
           number("across", kMostLength, "metres"), number("twist", kMostAngle, "radians")});
    }
    return makeChain(links, node.has("tip") ? readPlace(node.child("tip")) : Vec3(Vec3::Zero()));
  }
  if (model == "capstan-arm") {
    common({"a", "b", "c"});
    return makeCapstanArm(node.need("a").sized(kMostLength, "metres"), length("b"), length("c"));
  }
  if (model == "pantograph") {
    common({"lengths", "base"});
    const Node lengths = node.need("lengths");
    const auto bars = lengths.numbers<4>();
    for (std::size_t i = 0; i < bars.size(); ++i) {
      (void)positiveUpTo(lengths.element(i), kMostLength, "metres");
    }
    (void)node.need("base").notNegative();
    return makePantograph(bars, node.child("base").sized(kMostLength, "metres"));
  }
  if (model == "delta") {
    common({"base", "plate", "upper", "fore"});
    return makeDelta(length("base"), length("plate"), length("upper"), length("fore"));
  }
  const std::string near =
      nearestName(model, {"cartesian", "chain", "capstan-arm", "pantograph", "delta"});
  node.child("model").fail("\"" + model + "\" is not known",
                           near.empty() ? "use cartesian, chain, capstan-arm, pantograph or delta"
                                        : "did you mean \"" + near + "\"?");
}

/// What a motor can hold for ever.
void readHeat(const Node& at, const HidProfile& profile, HidJoint& joint) {
  if (at.has("continuous") != at.has("heating")) {
    at.fail("what a motor holds for ever and its heating time belong together",
            "give both or none");
  }
  if (!at.has("continuous")) return;
  if (!joint.to) at.child("continuous").fail("the joint has no motor", "name it, or remove this");
  joint.continuous = at.child("continuous").positive();
  joint.heating = positiveUpTo(at.child("heating"), kMostHeating, "seconds");
  if (joint.heating < kLeastHeating) {
    at.child("heating").fail(fmt::format("less than {} s: no winding heats as fast", kLeastHeating),
                             "write it in seconds");
  }
  const ReportField& field = profile.output->fields[*joint.to];
  const double room =
      std::min(field.most - field.offset, field.offset - field.least) / std::abs(field.scale);
  if (joint.continuous > room) {
    at.child("continuous")
        .fail(fmt::format("{} is more than its field ever gives, {:.4g}", joint.continuous, room),
              "remove it and \"heating\", or mend it or the field");
  }
}

void readKinematics(const Node& node, const Fields& fields, HidProfile& profile) {
  if (!node.json().is_object()) node.fail("it is not an object", "write { ... }");
  profile.kinematics = readModel(node);
  const Node joints = node.need("joints");
  const std::size_t count = profile.kinematics->joints();
  if (!joints.json().is_array() || joints.json().size() != count) {
    joints.fail(fmt::format("it is not a list of {} joints", count), "give each of the model's");
  }
  for (std::size_t i = 0; i < count; ++i) {
    const Node at = joints.element(i).object(
        {"from", "ratio", "home", "motor", "torque_constant", "continuous", "heating"});
    HidJoint joint;
    joint.from = fields.input(at.need("from"));
    if (at.has("ratio")) joint.ratio = at.child("ratio").number();
    if (joint.ratio == 0.0) {
      at.child("ratio").fail("it is 0",
                             "write the encoder's radians a joint radian, 1 without gear");
    }
    if (at.has("home")) joint.home = at.child("home").sized(kMostAngle, "radians");
    for (const HidJoint& other : profile.joints) {
      const ReportField& one = profile.input[joint.from.report].fields[joint.from.field];
      const ReportField& two = profile.input[other.from.report].fields[other.from.field];
      const bool apart = joint.from.report != other.from.report || one.bit >= two.bit + two.bits ||
                         two.bit >= one.bit + one.bits;
      if (!apart) {
        at.child("from").fail("its bits are another joint's as well", "mend from, or bit and bits");
      }
    }
    if (at.has("motor") != at.has("torque_constant")) {
      at.fail("a motor and its torque constant belong together", "give both or none");
    }
    if (at.has("motor")) {
      if (i >= kMotors)
        at.child("motor").fail("only the first three joints have motors", "remove it");
      joint.to = fields.output(at.child("motor"), at.child("motor").name(), true);
      joint.torque_constant = at.need("torque_constant").positive();
      const ReportField& motor = profile.output->fields[*joint.to];
      if (!motor.bounded) {
        at.child("motor").fail("nothing says what it may be given at most",
                               "give its field \"least\" and \"most\", small at first");
      }
      const double none = std::round(motor.offset);
      if (none < motor.least || none > motor.most) {
        at.child("motor").fail("its field cannot say that there is no force",
                               "mend offset, least and most");
      }
      if (none == motor.least || none == motor.most) {
        at.child("motor").fail("its field cannot pull and push",
                               "mend offset, type, least and most");
      }
      for (const HidJoint& other : profile.joints) {
        if (other.to == joint.to) at.child("motor").fail("it drives another joint", "name its own");
      }
    }
    readHeat(at, profile, joint);
    profile.joints.push_back(joint);
  }
  if (node.has("home_at_open")) profile.home_at_open = node.child("home_at_open").flag();
  if (node.has("home_words")) profile.home_words = node.child("home_words").text();
  if (profile.home_at_open && profile.home_words.empty()) {
    node.child("home_at_open").fail("its user must know the pose", "add \"home_words\"");
  }
  if (node.has("rate_control")) profile.rate_control = node.child("rate_control").positive();
}

void readGravity(const Node& node, HidProfile& profile) {
  node.object({"down", "masses"});
  if (node.has("down")) {
    const auto v = node.child("down").numbers<3>();
    const Vec3 down(v[0], v[1], v[2]);
    if (!(down.norm() > 1e-6)) node.child("down").fail("it is no direction", "write [0, 0, -1]");
    profile.down_D = down.normalized();
  }
  const Node masses = node.need("masses");
  if (!masses.json().is_array() || masses.json().size() > kMostMasses) {
    masses.fail("it is not a list of at most 16 masses", "write [{\"mass\": 0.1}]");
  }
  for (std::size_t i = 0; i < masses.json().size(); ++i) {
    const Node at = masses.element(i).object({"mass", "link", "centre"});
    HidMass mass;
    mass.mass = positiveUpTo(at.need("mass"), kMostMass, "kilograms");
    if (at.has("link")) {
      const int last = static_cast<int>(profile.kinematics->links()) - 1;
      mass.link = static_cast<std::size_t>(at.child("link").whole(0, last));
      if (at.has("centre")) mass.centre = readPlace(at.child("centre"));
    } else if (at.has("centre")) {
      at.child("centre").fail("of no link", "add \"link\"; without both it is at the tip");
    }
    profile.masses.push_back(mass);
  }
}

std::vector<HidStep> readSequence(const Node& node, const Fields& fields,
                                  const HidProfile& profile) {
  if (!node.json().is_array() || node.json().size() > kMostSteps) {
    node.fail("it is not a list of at most 64 steps", "write [{\"pause\": 0.1}]");
  }
  std::vector<HidStep> steps;
  for (std::size_t i = 0; i < node.json().size(); ++i) {
    const Node at = node.element(i).object({"send", "wait", "pause", "feature"});
    if (at.json().size() != 1)
      at.fail("it is not one step", "give one of send, wait, pause, feature");
    HidStep step;
    if (at.has("send")) {
      step.kind = HidStep::Kind::kSend;
      const Node send = at.child("send");
      if (!send.json().is_object()) send.fail("it is not an object", "write {\"field\": number}");
      for (const auto& [name, value] : send.json().items()) {
        const Node field = send.child(name);
        const std::size_t to = fields.output(field, name, false);
        const ReportField& of = profile.output->fields[to];
        const double raw = field.number();
        if (raw < of.least || raw > of.most) {
          field.fail(fmt::format("{} does not fit: {} to {} do", raw, of.least, of.most),
                     "mend it, or the field's type and bits");
        }
        step.values.emplace_back(to, raw);
      }
      // A motor is driven by the gate of the engine and by nothing else.
      for (const auto& sent : step.values) {
        if (isMotor(profile, sent.first))
          send.fail("a step drives a motor", "leave motors out: they get no force");
      }
    } else if (at.has("wait")) {
      step.kind = HidStep::Kind::kWait;
      const Node wait = at.child("wait").object({"field", "equals", "seconds", "words"});
      step.field = fields.input(wait.need("field"));
      step.equals = wait.need("equals").number();
      step.seconds = wait.need("seconds").positive();
      if (wait.has("words")) step.words = wait.child("words").text();
    } else if (at.has("pause")) {
      step.seconds = at.child("pause").positive();
    } else {
      step.kind = HidStep::Kind::kFeature;
      const Node bytes = at.child("feature");
      if (!bytes.json().is_array() || bytes.json().empty() || bytes.json().size() > kMostBytes) {
        bytes.fail("it is not a list of bytes", "write its number first, as [3, 0, 1]");
      }
      for (std::size_t b = 0; b < bytes.json().size(); ++b) {
        step.bytes.push_back(static_cast<std::byte>(bytes.element(b).whole(0, 255)));
      }
    }
    if (step.seconds > 600.0) at.fail("it is longer than 600 s", "use less");
    steps.push_back(step);
  }
  return steps;
}

void readLimits(const Node& node, HidLimits& limits) {
  node.object({"force", "slew", "stiffness", "damping", "workspace_radius", "stale", "speed",
               "continuous", "heating"});
  limits.force = positiveUpTo(node.need("force"), kMostForce, "newtons");
  limits.stiffness = positiveUpTo(node.need("stiffness"), kMostStiffness, "N/m");
  (void)node.need("damping").notNegative();
  limits.damping = node.child("damping").sized(kMostDamping, "N s/m");
  limits.workspace_radius = positiveUpTo(node.need("workspace_radius"), kMostLength, "metres");
  if (node.has("slew")) limits.slew = positiveUpTo(node.child("slew"), kMostSlew, "N/s");
  if (node.has("stale")) limits.stale = node.child("stale").positive();
  if (node.has("speed")) limits.speed = node.child("speed").positive();
  if (node.has("continuous") != node.has("heating")) {
    node.fail("a continuous force and its heating time belong together", "give both or none");
  }
  if (node.has("continuous")) {
    limits.continuous = node.child("continuous").positive();
    limits.heating = node.child("heating").positive();
  }
}

/// What is sent and is no motor's rests; a motor's does not.
void checkOutput(const Node& fields, const HidProfile& profile) {
  for (std::size_t f = 0; f < profile.output->fields.size(); ++f) {
    const bool motor = isMotor(profile, f);
    const Node at = fields.child(profile.output->fields[f].name);
    if (motor && at.has("rest")) at.child("rest").fail("a motor drives it", "remove it");
    for (const char* key : {"scale", "offset"}) {
      if (motor || !at.has(key)) continue;
      at.child(key).fail("no motor drives it",
                         "remove it; \"rest\" is what is sent in it, raw, where no step sends it");
    }
  }
}

/// What counts reports is one that the firmware raises with each; what stands still while the arm
/// does would make old reports of new ones.
void checkSequences(const Node& input, const HidProfile& profile) {
  for (std::size_t r = 0; r < profile.input.size(); ++r) {
    if (!profile.input[r].sequence) continue;
    const ReportField& counter = profile.input[r].fields[*profile.input[r].sequence];
    const auto shares = [&](const FieldRef& other) {
      const ReportField& field = profile.input[r].fields[other.field];
      return other.report == r && counter.bit < field.bit + field.bits &&
             field.bit < counter.bit + counter.bits;
    };
    const bool joint = std::any_of(profile.joints.begin(), profile.joints.end(),
                                   [&](const HidJoint& j) { return shares(j.from); });
    const bool flag = std::any_of(profile.flags.begin(), profile.flags.end(),
                                  [&](const HidFlag& f) { return shares(f.field); });
    if (!joint && !flag) continue;
    input.element(r)
        .child("sequence")
        .fail(fmt::format("{}'s bits are a {}'s, which does not change with every report",
                          counter.name, joint ? "joint" : "flag"),
              "name a field that counts reports, or remove it");
  }
}

/// A counter of an arm that says by itself that it is homed is taken for the one nearest to the
/// middle of the hand's world: no other of its ranges may bring the tip into that world.
void checkRanges(const Node& root, const HidProfile& profile, const ProfileFacts& facts) {
  if (profile.home_at_open || !profile.home.empty()) return;  // there it is known
  const ArmPose middle = profile.kinematics->at(facts.middle);
  for (std::size_t i = 0; i < profile.joints.size(); ++i) {
    const HidJoint& joint = profile.joints[i];
    const ReportField& field = profile.input[joint.from.report].fields[joint.from.field];
    if (!field.wraps) continue;
    const double range =
        std::ldexp(std::abs(field.scale / joint.ratio), static_cast<int>(field.bits));
    const double way = range * middle.jacobian[i].norm();
    // Whole turns bring it to the same place.
    Joints turned = facts.middle;
    turned[i] += range;
    const bool same =
        (profile.kinematics->at(turned).position_D - middle.position_D).norm() < kSame;
    if (same || way >= 2.0 * profile.limits.workspace_radius) continue;
    root.child("kinematics")
        .child("joints")
        .element(i)
        .child("from")
        .fail(fmt::format(
                  "{} begins anew every {:.3g} m of the tip, and the workspace is {:.3g} m wide: a "
                  "flag that means homed does not say in which of them the arm is",
                  field.name, way, 2.0 * profile.limits.workspace_radius),
              "add \"home\" steps, home_at_open or bits, or mend workspace_radius");
  }
}

/// Numbers that fit together: in other units than they are meant they do not.
void checkFacts(const Node& root, const HidProfile& profile) {
  const ProfileFacts facts = factsOf(profile);
  constexpr double kReached = 1e-3;  // [m]
  if (!(facts.off <= kReached)) {
    const std::string why =
        std::isfinite(facts.off)
            ? fmt::format("the middle of the hand's world is {:.3g} m out of the tip's reach",
                          facts.off)
            : "the tip reaches no place from the joints' home";
    const Node at = root.has("mount") && root.child("mount").has("origin")
                        ? root.child("mount").child("origin")
                        : root;
    at.fail(why, "mend mount/origin, home, or the lengths, all in metres and radians");
  }
  if (facts.step > kMostStep) {
    root.child("kinematics")
        .child("joints")
        .fail(fmt::format("a count of every joint moves the tip {:.3g} m", facts.step),
              "mend the inputs' scale (radians a count) or the ratio");
  }
  checkRanges(root, profile, facts);
  const char* const remedy = "mend torque_constant, ratio, or its field's scale, least and most";
  const MotorFact* strongest = nullptr;
  for (const MotorFact& motor : facts.motors) {
    if (motor.asked > kMostAsked * motor.room) {
      root.child("kinematics")
          .child("joints")
          .element(motor.joint)
          .fail(fmt::format("{} N would ask {:.3g} of {}, which may be given {:.3g}",
                            profile.limits.force, motor.asked, motor.field, motor.room),
                remedy);
    }
    if (motor.carries > kMostCarried * motor.continuous) {
      root.child("gravity").fail(
          fmt::format("to carry its masses {} is asked for {:.3g}, of {:.3g} that it may hold",
                      motor.field, motor.carries, motor.continuous),
          "mend masses and centres, or counterweight it: more than half is not for this");
    }
    if (strongest == nullptr || motor.asked / motor.room > strongest->asked / strongest->room) {
      strongest = &motor;
    }
  }
  // One that stands across the force has little to do; not all of them have.
  if (strongest != nullptr && strongest->asked < kLeastAsked * strongest->room) {
    root.child("kinematics")
        .child("joints")
        .element(strongest->joint)
        .fail(
            fmt::format(
                "{} N would ask but {:.2g} % of what {} may be given, and less of the others",
                profile.limits.force, 100.0 * strongest->asked / strongest->room, strongest->field),
            remedy);
  }
}

HidProfile readProfile(const Node& root) {
  root.object({"$schema", "palpate_arm", "name", "description", "firmware", "match", "rate",
               "input", "output", "flags", "kinematics", "gravity", "mount", "open", "home",
               "close", "limits", "sources"});
  if (root.need("palpate_arm").number() != 1.0) {
    root.child("palpate_arm").fail("this program does not know that version", "write 1");
  }
  HidProfile profile;
  profile.name = root.need("name").name();
  const bool plain = std::all_of(profile.name.begin(), profile.name.end(), [](unsigned char c) {
    return std::isalnum(c) != 0 || c == '-' || c == '_' || c == '.';
  });
  if (!plain) root.child("name").fail("it has other characters", "use letters, digits, - and _");
  if (root.has("description")) profile.description = root.child("description").text();
  if (root.has("firmware")) profile.firmware = root.child("firmware").text();
  profile.match = readMatches(root.need("match"));
  const Node rate = root.need("rate").object({"input", "output"});
  profile.input_rate = rate.need("input").positive();
  profile.output_rate = rate.has("output") ? rate.child("output").positive() : 0.0;
  if (rate.has("output") && (profile.output_rate < 1.0 || profile.output_rate > 1e5)) {
    rate.child("output").fail(fmt::format("{:g} reports a second", profile.output_rate),
                              "give 1 to 100,000");
  }

  const Node input = root.need("input");
  if (!input.json().is_array() || input.json().empty() || input.json().size() > kMostReports) {
    input.fail("it is not a list of 1 to 16 reports", "write [{\"size\": ..., \"fields\": ...}]");
  }
  std::set<std::string> names;
  for (std::size_t i = 0; i < input.json().size(); ++i) {
    profile.input.push_back(readReport(input.element(i), false));
    for (const ReportField& field : profile.input.back().fields) {
      if (!names.insert(field.name).second) {
        input.element(i)
            .child("fields")
            .child(field.name)
            .fail("the name stands twice", "give each field its own");
      }
    }
    if (input.json().size() > 1 && !profile.input.back().id) {
      input.element(i).fail("several reports are told apart by their numbers", "add \"id\"");
    }
  }
  if (root.has("output")) profile.output = readOutput(root.child("output"));
  std::set<std::uint8_t> numbers;
  for (const HidReportSpec& report : profile.input) {
    if (report.id && !numbers.insert(*report.id).second) {
      input.fail(fmt::format("two reports have the number {}", *report.id), "give each its own");
    }
  }
  if (profile.output && profile.output->id.has_value() == numbers.empty()) {
    root.child("output").fail("a device numbers all its reports or none",
                              "give every report an \"id\", or none");
  }
  if (profile.output.has_value() != rate.has("output")) {
    root.fail("an output and its rate belong together", "give both \"output\" and rate/output");
  }

  const Fields fields(profile);
  if (root.has("flags")) readFlags(root.child("flags"), fields, profile);
  readKinematics(root.need("kinematics"), fields, profile);
  checkSequences(input, profile);
  if (root.has("gravity")) readGravity(root.child("gravity"), profile);
  if (root.has("mount")) {
    const Node mount = root.child("mount").object({"origin", "rotation_wxyz"});
    if (mount.has("origin")) profile.origin_D = readPlace(mount.child("origin"));
    if (mount.has("rotation_wxyz")) {
      const auto q = mount.child("rotation_wxyz").numbers<4>();
      const Eigen::Quaterniond turn(q[0], q[1], q[2], q[3]);
      if (!(turn.norm() > 1e-6)) {
        mount.child("rotation_wxyz").fail("it is no rotation", "give w, x, y, z, as [1, 0, 0, 0]");
      }
      profile.world_from_device = turn.normalized().toRotationMatrix();
    }
  }
  if (root.has("open")) profile.open = readSequence(root.child("open"), fields, profile);
  if (root.has("home")) profile.home = readSequence(root.child("home"), fields, profile);
  if (root.has("close")) profile.close = readSequence(root.child("close"), fields, profile);

  double closing = 0.0;
  for (const HidStep& step : profile.close) closing += step.seconds;
  if (closing > kLongestClose) {
    root.child("close").fail(fmt::format("it may take {} s", closing),
                             fmt::format("use at most {} s in all", kLongestClose));
  }

  const auto motors = std::count_if(profile.joints.begin(), profile.joints.end(),
                                    [](const HidJoint& j) { return j.to.has_value(); });
  if (root.has("limits")) {
    readLimits(root.child("limits"), profile.limits);
  } else if (profile.output) {
    root.fail("an arm with an output has limits", "add \"limits\"");
  }
  if (profile.output) {
    const Node limits = root.child("limits");
    if (profile.limits.stale > 0.1) limits.child("stale").fail("more than 0.1 s", "use less");
    if (profile.limits.speed > 5.0) limits.child("speed").fail("more than 5 m/s", "use less");
    if (profile.limits.continuous > profile.limits.force) {
      limits.child("continuous").fail("more than the force", "use less");
    }
    const bool own = std::any_of(profile.joints.begin(), profile.joints.end(),
                                 [](const HidJoint& j) { return j.continuous > 0.0; });
    if (own && profile.limits.continuous > 0.0) {
      limits.child("continuous")
          .fail("its motors have limits of their own", "remove it and \"heating\", or theirs");
    }
  }
  // A counter counts from wherever it was switched on.
  const bool homed = profile.home_at_open || !profile.home.empty() ||
                     std::any_of(profile.flags.begin(), profile.flags.end(), [](const HidFlag& f) {
                       return f.means == HidFlag::Means::kHomed;
                     });
  for (std::size_t i = 0; profile.output && !homed && i < profile.joints.size(); ++i) {
    const FieldRef from = profile.joints[i].from;
    if (!profile.input[from.report].fields[from.field].wraps) continue;
    root.child("kinematics")
        .child("joints")
        .element(i)
        .child("from")
        .fail("nothing says where its counter is zero",
              "add \"home\" steps, home_at_open, a flag that means homed, or remove \"wraps\"");
  }
  if (profile.output && motors == 0) {
    root.child("kinematics").fail("no joint has a motor", "name them, or remove \"output\"");
  }
  if (!profile.masses.empty() && motors == 0) {
    root.child("gravity").fail("no joint has a motor to carry it", "remove it");
  }
  if (!profile.masses.empty() && profile.limits.continuous > 0.0) {
    root.child("gravity").fail("limits/continuous knows nothing of what its motors carry",
                               "give the motors' own, \"continuous\" and \"heating\" of joints");
  }
  if (profile.output && profile.firmware.empty()) {
    root.fail("nothing says how its firmware takes the force off when no message comes",
              "add \"firmware\"");
  }
  if (profile.rate_control > 0.0 && profile.output) {
    root.child("kinematics")
        .fail("an arm that gives velocities takes no forces",
              "remove \"output\" or \"rate_control\"");
  }
  if (profile.output) {
    checkOutput(root.child("output").child("fields"), profile);
    checkFacts(root, profile);
  }
  if (root.has("sources")) {
    const Node sources = root.child("sources");
    if (!sources.json().is_object())
      sources.fail("it is not an object", "write {\"/limits\": ...}");
    for (const auto& [pointer, text] : sources.json().items()) {
      bool there = pointer.empty() || pointer[0] == '/';
      try {
        there = there && root.json().contains(Json::json_pointer(pointer));
      } catch (const Json::exception&) {
        there = false;
      }
      if (!there) {
        sources.fail("\"" + pointer + "\" is nothing in this file",
                     "write the path of a number, as \"/limits/force\"");
      }
      profile.sources[pointer] = sources.child(pointer).text();
    }
  }
  return profile;
}

}  // namespace

HidProfile parseHidProfile(const std::string& text, const std::string& source) {
  const Json json = parseJson<DeviceError>(text, source);
  HidProfile profile = readProfile(Node(json, source, ""));
  validateJson<DeviceError>(json, hidProfileSchema(), "hid_profile.schema.json", source);
  profile.source = source;
  profile.fingerprint = 14695981039346656037ULL;  // FNV-1a
  for (const char c : json.dump()) {
    profile.fingerprint = (profile.fingerprint ^ static_cast<unsigned char>(c)) * 1099511628211ULL;
  }
  return profile;
}

HidProfile readHidProfile(const std::filesystem::path& file) {
  std::ifstream in(file);
  std::ostringstream text;
  text << in.rdbuf();
  if (!in) throw DeviceError(file.string(), "it cannot be read", "check the path and its rights");
  return parseHidProfile(text.str(), file.string());
}

namespace {

/// The name that a file seems to give that is no profile, perhaps not even JSON; empty: none.
std::string nameIn(const std::filesystem::path& file) {
  std::ifstream in(file);
  std::ostringstream text;
  text << in.rdbuf();
  const std::string all = text.str();
  const std::size_t colon = all.find(':', all.find("\"name\""));
  const std::size_t begin = all.find('"', colon);
  const std::size_t end = begin == std::string::npos ? begin : all.find('"', begin + 1);
  return end == std::string::npos ? "" : all.substr(begin + 1, end - begin - 1);
}

}  // namespace

std::vector<HidProfile> hidProfiles(const std::filesystem::path& folder,
                                    std::vector<std::string>& notes) {
  std::vector<HidProfile> profiles;
  std::error_code error;
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder, error)) {
    if (entry.path().extension() == ".json") files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  std::set<std::string> broken;
  for (const auto& file : files) {
    try {
      HidProfile profile = readHidProfile(file);
      const bool taken = std::any_of(profiles.begin(), profiles.end(),
                                     [&](const HidProfile& p) { return p.name == profile.name; });
      if (taken) {
        notes.push_back(file.string() + ": /name: another file here calls itself " + profile.name +
                        ": give it its own");
        continue;
      }
      const bool hides = std::any_of(
          std::begin(kHidProfiles), std::end(kHidProfiles),
          [&](const auto& own) { return std::string_view(own.first) == profile.name + ".json"; });
      if (hides && file.stem() != profile.name) {
        notes.push_back(file.string() + ": /name: it calls itself " + profile.name +
                        ", as one of palpate's own, and is used instead: give it its own name if "
                        "that is not meant");
      }
      profiles.push_back(std::move(profile));
    } catch (const DeviceError& e) {
      notes.emplace_back(e.what());
      broken.insert(file.stem());
      broken.insert(nameIn(file));
    }
  }
  for (const auto& [name, text] : kHidProfiles) {
    HidProfile profile = parseHidProfile(text, std::string("palpate's own ") + name);
    const bool replaced = std::any_of(profiles.begin(), profiles.end(),
                                      [&](const HidProfile& p) { return p.name == profile.name; });
    // Whose own numbers cannot be read does not want others instead.
    if (!replaced && broken.count(profile.name) == 0) profiles.push_back(std::move(profile));
  }
  return profiles;
}

std::filesystem::path hidProfileFolder() {
  const char* config = std::getenv("XDG_CONFIG_HOME");
  const char* home = std::getenv("HOME");
  // A relative one is to be ignored (XDG Base Directory Specification).
  if (config != nullptr && *config == '/') return std::filesystem::path(config) / "palpate/arms";
  return std::filesystem::path(home != nullptr ? home : "/") / ".config/palpate/arms";
}

const std::string& hidProfileSchema() {
  static const std::string schema(kHidProfileSchema);
  return schema;
}

std::vector<KnownArm> knownArms() {
  const Json json = Json::parse(kKnownArms);
  std::vector<KnownArm> arms;
  for (const Json& arm : json.at("arms")) {
    arms.push_back({arm.at("name"), arm.at("force"), arm.at("stiffness"), arm.at("damping"),
                    arm.at("workspace_radius"), arm.at("transport"), arm.at("source")});
  }
  return arms;
}

}  // namespace palpate
