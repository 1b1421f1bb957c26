#include "palpate/devices/hid/profile_table.h"

#include <charconv>
#include <utility>

#include "palpate/devices/hid/kinematics.h"

namespace palpate {
namespace {

// Assumed limits of desktop arms. A number beyond them probably has a wrong unit.
constexpr double kMostLength = 2.0;     // [m]
constexpr double kMostAngle = 6.2832;   // [rad]
constexpr double kMostForce = 100.0;    // [N]
constexpr double kMostSlew = 1e5;       // [N/s]
constexpr double kMostStiffness = 1e5;  // [N/m]
constexpr double kMostDamping = 500.0;  // [N s/m]
constexpr double kMostMass = 5.0;       // [kg]
constexpr double kMostHeating = 1e4;    // [s]
constexpr double kLeastHeating = 0.1;   // [s]
// [s]: a switch state that is older than this is not reliable.
constexpr double kMostStale = 2.0;
constexpr double kMostSeconds = 600.0;  // [s]
constexpr int kMostBytes = 1024;        // largest report [bytes]
constexpr std::size_t kMostFlags = 1024;
constexpr std::size_t kMostReports = 16;
constexpr std::size_t kMostSteps = 64;
constexpr std::size_t kMostMasses = 16;

/// Returns true if a vector with this norm has a direction and a finite square.
bool isLength(double norm) {
  return norm > 1e-6 && norm < 1e6;
}

JsonType<double> lengthType() {
  return jsonPositiveUpTo(kMostLength, "metres");
}

JsonType<Vec3> placeType() {
  return jsonNumbers<3>(jsonUpTo(kMostLength, "metres")).as<Vec3>([](const auto& v) {
    return Vec3(v[0], v[1], v[2]);
  });
}

JsonType<std::uint16_t> hexType() {
  return jsonMatching("^(0[xX])?[0-9A-Fa-f]{1,4}$", "it is not a hexadecimal number of 16 bits",
                      "write it as lsusb prints it, such as \"16C0\"")
      .as<std::uint16_t>([](const std::string& text) {
        const std::size_t begin = text.size() > 2 && (text[1] == 'x' || text[1] == 'X') ? 2 : 0;
        std::uint16_t value = 0;
        std::from_chars(text.data() + begin, text.data() + text.size(), value, 16);
        return value;
      });
}

JsonType<HidMatch> matchType() {
  return JsonObject<HidMatch>()
      .need("vendor", hexType(), &HidMatch::vendor)
      .need("product", hexType(), &HidMatch::product)
      .may("usage_page", hexType(), &HidMatch::usage_page)
      .may("usage", hexType(), &HidMatch::usage)
      .type();
}

JsonType<FileField> fieldType() {
  using Type = ReportField::Type;
  return JsonObject<FileField>()
      .need("bit",
            jsonWhole(0, 8 * kMostBytes - 1)
                .says("Lowest bit of the field, counted from the first byte after the report's "
                      "number."),
            &FileField::bit)
      .need("bits", jsonWhole(1, 32), &FileField::bits)
      .may("type",
           jsonWord<Type>(
               {{"unsigned", Type::kUnsigned}, {"signed", Type::kSigned}, {"float", Type::kFloat}})
               .says("Type of the number. The default is \"signed\"; for a field of one bit it is "
                     "\"unsigned\"."),
           &FileField::type)
      .may("big_endian", jsonFlag(), &FileField::big_endian)
      .may("scale",
           jsonNumber()
               .where([](double scale) { return scale != 0.0; }, "it is 0",
                      "write the value of one count, or for an output the counts per unit")
               .also({{"not", {{"const", 0}}}})
               .says("Scale of the field. For an input, value = scale * raw + offset; for an "
                     "output, raw = scale * value + offset."),
           &FileField::scale)
      .may("offset", jsonNumber(), &FileField::offset)
      .may("least", jsonNumber().says("Least raw value of an output."), &FileField::least)
      .may("most", jsonNumber(), &FileField::most)
      .may("wraps", jsonFlag().says("If true, the counter wraps around."), &FileField::wraps)
      .may("rest",
           jsonNumber().says("Raw value of an output that drives no motor, in reports for which no "
                             "step gives another value. The default is 0."),
           &FileField::rest)
      .type();
}

JsonObject<FileReport> reportRows(const JsonType<FileField>& field) {
  return JsonObject<FileReport>()
      .may("id", jsonWhole(1, 255), &FileReport::id)
      .need("size", jsonWhole(1, kMostBytes), &FileReport::size)
      .need("fields", jsonMap(field, 0, "it is not an object", "write { \"name\": {...} }"),
            &FileReport::fields);
}

JsonType<FileReport> inputType(const JsonType<FileField>& field) {
  return reportRows(field)
      .may("sequence",
           jsonText().says("Name of the field that counts readings of the encoders. A report with "
                           "an unchanged count repeats the last report."),
           &FileReport::sequence)
      .may("stale",
           jsonPositiveUpTo(kMostStale, "seconds")
               .says("Longest time for which a flag in the report is valid [s]. The default is "
                     "limits/stale."),
           &FileReport::stale)
      .type();
}

JsonType<FileFlag> flagType() {
  using Means = HidFlag::Means;
  return JsonObject<FileFlag>()
      .need("field", jsonName(), &FileFlag::field)
      .may("equals", jsonNumber(), [](FileFlag& to, double equals) { to.flag.equals = equals; })
      .need("means",
            jsonWord<Means>({{"homed", Means::kHomed},
                             {"enabled", Means::kEnabled},
                             {"hot", Means::kHot},
                             {"unpowered", Means::kUnpowered},
                             {"open", Means::kOpen}}),
            [](FileFlag& to, Means means) { to.flag.means = means; })
      .type();
}

auto to(double HidJoint::*member) {
  return [member](FileJoint& joint, double value) { joint.joint.*member = value; };
}

JsonType<FileJoint> jointType() {
  constexpr const char* kMotor = "\"motor\" and \"torque_constant\" are valid only together";
  constexpr const char* kHeat = "a motor's \"continuous\" and \"heating\" are valid only together";
  constexpr const char* kBoth = "give both or none";
  const JsonType<double> heating =
      jsonPositiveUpTo(kMostHeating, "seconds")
          .where([](double value) { return value >= kLeastHeating; },
                 "it is less than 0.1 s, and no winding heats so fast", "write it in seconds")
          .also({{"minimum", kLeastHeating}});
  return JsonObject<FileJoint>()
      .need("from", jsonName(), &FileJoint::from)
      .may("ratio",
           jsonNumber()
               .where([](double ratio) { return ratio != 0.0; }, "it is 0",
                      "write field units per joint unit, such as encoder radians per joint "
                      "radian: 1 without a gear")
               .also({{"not", {{"const", 0}}}})
               .says("Encoder radians per joint radian, negative for opposite directions."),
           to(&HidJoint::ratio))
      .may("home",
           jsonUpTo(kMostAngle, "radians")
               .says("Position of the joint where the value of the field is 0; with home_at_open, "
                     "its position in the home pose [rad; for a sliding joint m]."),
           to(&HidJoint::home))
      .may("motor", jsonName(), &FileJoint::motor)
      .may("torque_constant", jsonPositive().says("Torque per unit of the output [N m]."),
           to(&HidJoint::torque_constant))
      .may("continuous",
           jsonPositive().says("Output that the motor can hold indefinitely, in units of the "
                               "output, usually amperes."),
           to(&HidJoint::continuous))
      .may("heating", heating.says("Thermal time constant of the motor's winding [s]."),
           to(&HidJoint::heating))
      .needs("motor", "torque_constant", kMotor, kBoth)
      .needs("torque_constant", "motor", kMotor, kBoth)
      .needs("continuous", "heating", kHeat, kBoth)
      .needs("heating", "continuous", kHeat, kBoth)
      .needs("continuous", "motor", "the joint has no motor",
             "name its motor, or remove \"continuous\" and \"heating\"")
      .type();
}

JsonType<ChainLink> linkType() {
  const JsonType<double> angle = jsonUpTo(kMostAngle, "radians");
  const JsonType<double> length = jsonUpTo(kMostLength, "metres");
  return JsonObject<ChainLink>()
      .may("turn", angle.says("Rotation about z, which is added to the joint's angle [rad]."),
           &ChainLink::turn)
      .may("along", length.says("Displacement along z [m]."), &ChainLink::along)
      .may("across", length.says("Displacement along the x axis after \"turn\" [m]."),
           &ChainLink::across)
      .may("twist", angle.says("Rotation about the x axis after \"turn\" [rad]."),
           &ChainLink::twist)
      .type();
}

using Rows = JsonObject<ProfileFile>;

template <class T>
auto to(T FileGeometry::*member) {
  return [member](ProfileFile& file, T value) { file.geometry.*member = std::move(value); };
}

Rows kinematicsRows(const JsonType<FileJoint>& joint) {
  const auto model = [&](std::size_t least, std::size_t most, const char* why, const char* says,
                         auto make) {
    return Rows()
        .always([make](ProfileFile& file) { file.model = make; })
        .need("joints",
              jsonList(joint, least, most, why, "give one for each joint of the model").says(says),
              [](ProfileFile& file, std::vector<FileJoint> joints) {
                file.joints = std::move(joints);
              });
  };
  constexpr const char* kThree = "it is not a list of 3 joints";
  const JsonType<double> length = lengthType();
  using G = FileGeometry;
  return Rows()
      .choose(
          "model",
          {{"cartesian", model(3, 3, kThree, "Three sliding joints: x, y, z [m].",
                               [](const G&) { return makeCartesian(); })},
           {"chain",
            model(3, kMostJoints, "it is not a list of 3 to 6 joints",
                  "Joints, in the order of the links.",
                  [](const G& g) { return makeChain(g.links, g.tip); })
                .need("links",
                      jsonList(linkType(), 3, kMostJoints, "it is not a list of 3 to 6 links",
                               "write [{...}, ...]")
                          .says("Links between rotary joints, with Denavit-Hartenberg parameters."),
                      to(&G::links))
                .may("tip", placeType().says("Position of the tip in the last link's frame [m]."),
                     to(&G::tip))},
           {"capstan-arm",
            model(3, 3, kThree,
                  "Angles A, B, C. The tip is at x = cos A (b sin B + c sin C), y = sin A (b sin B "
                  "+ c sin C), z = a + b cos B - c cos C.",
                  [](const G& g) { return makeCapstanArm(g.a, g.b, g.c); })
                .need("a",
                      jsonUpTo(kMostLength, "metres")
                          .says("Length a in the formula for the tip's position [m]."),
                      to(&G::a))
                .need("b", length.says("Length b of the upper link [m]."), to(&G::b))
                .need("c", length.says("Length c of the lower link [m]."), to(&G::c))},
           {"pantograph", model(2, 2, "it is not a list of 2 joints",
                                "Angles of the two bars at the motors, in a plane. The motors are "
                                "at (0, 0) and (-base, 0).",
                                [](const G& g) { return makePantograph(g.lengths, g.base); })
                              .need("lengths",
                                    jsonNumbers<4>(lengthType())
                                        .says("Lengths of the four bars, in order from the motor "
                                              "at (0, 0) to the motor at (-base, 0) [m]."),
                                    to(&G::lengths))
                              .need("base",
                                    jsonNotNegativeUpTo(kMostLength, "metres")
                                        .says("Distance between the motors [m]."),
                                    to(&G::base))},
           {"delta",
            model(3, 3, kThree,
                  "Angles of the three upper arms of Clavel's delta robot. The motors are on a "
                  "circle, and the tip is below them.",
                  [](const G& g) { return makeDelta(g.base, g.plate, g.upper, g.fore); })
                .need("base", length.says("Radius of the circle of the motors [m]."), to(&G::base))
                .need("plate", length.says("Radius of the circle of the plate's joints [m]."),
                      to(&G::plate))
                .need("upper", length.says("Length of the upper arms [m]."), to(&G::upper))
                .need("fore", length.says("Length of the forearms [m]."), to(&G::fore))}})
      .may("home_at_open", jsonFlag(),
           [](ProfileFile& file, bool flag) { file.profile.home_at_open = flag; })
      .may("home_words", jsonText(),
           [](ProfileFile& file, std::string words) { file.profile.home_words = std::move(words); })
      .may("rate_control", jsonPositive().says("Speed per unit of position [m/s]."),
           [](ProfileFile& file, double speed) { file.profile.rate_control = speed; });
}

JsonType<HidMass> massType() {
  return JsonObject<HidMass>()
      .need("mass", jsonPositiveUpTo(kMostMass, "kilograms").says("Mass [kg]."), &HidMass::mass)
      .may("link",
           jsonWhole(0, static_cast<int>(kMostJoints) - 1)
               .says("Index of the link that holds the mass, counted from the base, from 0. "
                     "Without a link the mass is at the tip."),
           &HidMass::link)
      .may("centre", placeType().says("Centre in the link's frame [m]."), &HidMass::centre)
      .needs("centre", "link", "a centre needs a link",
             "add \"link\", or remove \"centre\": the mass is then at the tip")
      .type();
}

Rows gravityRows() {
  return Rows()
      .may("down",
           jsonNumbers<3>()
               .as<Vec3>([](const auto& v) { return Vec3(v[0], v[1], v[2]); })
               .where([](const Vec3& down) { return isLength(down.norm()); },
                      "it is not a direction", "write a vector, such as [0, 0, -1]")
               .says("Direction of gravity in the arm's frame. The default is [0, 0, -1]."),
           [](ProfileFile& file, const Vec3& down) { file.profile.down_D = down.normalized(); })
      .need("masses",
            jsonList(massType(), 0, kMostMasses, "it is not a list of at most 16 masses",
                     "write [{\"mass\": 0.1}]"),
            [](ProfileFile& file, std::vector<HidMass> masses) {
              file.profile.masses = std::move(masses);
            });
}

auto to(double HidTurn::*member) {
  return [member](FileTurn& turn, double value) { turn.turn.*member = value; };
}

JsonObject<FileTurn> encoderRows(const char* unit) {
  return JsonObject<FileTurn>()
      .need("from", jsonName(), &FileTurn::from)
      .may("ratio",
           jsonNumber()
               .where([](double ratio) { return ratio != 0.0; }, "it is 0",
                      "write encoder radians per radian: 1 without a gear")
               .also({{"not", {{"const", 0}}}})
               .says("Encoder radians per radian, negative for opposite directions."),
           to(&HidTurn::ratio))
      .may("home", jsonUpTo(kMostAngle, "radians").says(unit), to(&HidTurn::home));
}

JsonObject<FileTurn> jointRows() {
  return JsonObject<FileTurn>().need(
      "joint",
      jsonWhole(0, static_cast<int>(kMostJoints) - 1)
          .says("Index of the joint in \"kinematics\" that turns the handle, from 0."),
      [](FileTurn& turn, int joint) { turn.turn.joint = static_cast<std::size_t>(joint); });
}

JsonObject<FileTurn> axisRows(JsonObject<FileTurn> rows) {
  return rows.need("axis",
                   jsonNumbers<3>()
                       .as<Vec3>([](const auto& v) { return Vec3(v[0], v[1], v[2]); })
                       .where([](const Vec3& axis) { return isLength(axis.norm()); },
                              "it is not a direction", "write a vector, such as [0, 0, 1]")
                       .says("Axis of the rotation, in the frame after the rotations before it. "
                             "The first axis is in the arm's frame."),
                   [](FileTurn& turn, const Vec3& axis) { turn.turn.axis = axis.normalized(); });
}

Rows handleRows() {
  const JsonType<FileButton> button =
      JsonObject<FileButton>()
          .need("name", jsonName(),
                [](FileButton& to, std::string name) { to.button.name = std::move(name); })
          .need("field", jsonName(), &FileButton::field)
          .may("equals", jsonNumber().says("Raw value of a pressed button. The default is 1."),
               [](FileButton& to, double equals) { to.button.equals = equals; })
          .type();
  const JsonType<FileTurn> turn =
      JsonObject<FileTurn>()
          .chooseByKey({axisRows(jointRows()),
                        axisRows(encoderRows("Angle at which the field is 0 [rad]."))})
          .type();
  return Rows()
      .may("buttons",
           jsonList(button, 0, HandleInfo::kMostButtons, "it is not a list of at most 32 buttons",
                    "write [{\"name\": \"dark\", \"field\": ...}]"),
           &ProfileFile::buttons)
      .may("orientation",
           jsonList(turn, 1, 2 * kMostJoints, "it is not a list of 1 to 12 turns",
                    "write [{\"joint\": 0, \"axis\": [0, 0, 1]}, ...]")
               .says("Orientation of the handle: rotations from the arm's frame to the handle's "
                     "frame, in order."),
           &ProfileFile::orientation)
      .may("gripper", encoderRows("Opening angle at which the field is 0 [rad].").type(),
           &ProfileFile::gripper);
}

Rows mountRows() {
  return Rows()
      .may("origin", placeType().says("The origin of the hand's world, in the arm's frame [m]."),
           [](ProfileFile& file, const Vec3& origin) { file.profile.origin_D = origin; })
      .may("rotation_wxyz",
           jsonNumbers<4>()
               .where([](const auto& q) { return isLength(Eigen::Vector4d(q.data()).norm()); },
                      "it is not a rotation", "give w, x, y, z, such as [1, 0, 0, 0]")
               .says("Rotation from arm coordinates to world coordinates: p_world = R (p_arm - "
                     "origin)."),
           &ProfileFile::rotation_wxyz);
}

JsonType<FileStep> stepType() {
  using Kind = HidStep::Kind;
  const auto kind = [](Kind value) { return [value](FileStep& step) { step.step.kind = value; }; };
  const JsonType<double> seconds =
      jsonPositiveUpTo(kMostSeconds, "it is longer than 600 s", "use at most 600 s");
  const auto put_seconds = [](FileStep& step, double value) { step.step.seconds = value; };
  const JsonObject<FileStep> wait =
      JsonObject<FileStep>()
          .need("field", jsonName(), &FileStep::field)
          .need("equals", jsonNumber(),
                [](FileStep& step, double value) { step.step.equals = value; })
          .need("seconds", seconds, put_seconds)
          .may("words", jsonText(),
               [](FileStep& step, std::string words) { step.step.words = std::move(words); });
  const JsonType<std::vector<int>> bytes =
      jsonList(jsonWhole(0, 255), 1, kMostBytes, "it is not a list of 1 to 1024 bytes",
               "write the report's number first, such as [3, 0, 1]");
  return JsonObject<FileStep>()
      .chooseByKey(
          {JsonObject<FileStep>()
               .always(kind(Kind::kSend))
               .need("send",
                     jsonMap(jsonNumber(), 0, "it is not an object", "write {\"field\": number}")
                         .says("Raw values of output fields in one report. Other fields have their "
                               "value \"rest\"."),
                     &FileStep::send),
           JsonObject<FileStep>()
               .always(kind(Kind::kWait))
               .mustHold("wait", wait,
                         "Waits until the input field has the value \"equals\", for at most "
                         "\"seconds\" [s]."),
           JsonObject<FileStep>().always(kind(Kind::kPause)).need("pause", seconds, put_seconds),
           JsonObject<FileStep>()
               .always(kind(Kind::kFeature))
               .need("feature", bytes,
                     [](FileStep& step, const std::vector<int>& values) {
                       for (const int byte : values) {
                         step.step.bytes.push_back(static_cast<std::byte>(byte));
                       }
                     })})
      .type();
}

JsonObject<HidLimits> limitsRows() {
  constexpr const char* kHeat = "limits/continuous and limits/heating are valid only together";
  constexpr const char* kBoth = "give both or none";
  return JsonObject<HidLimits>()
      .need("force", jsonPositiveUpTo(kMostForce, "newtons").says("Largest force at the tip [N]."),
            &HidLimits::force)
      .need("stiffness",
            jsonPositiveUpTo(kMostStiffness, "N/m")
                .says("Largest stiffness that the arm renders stably [N/m]."),
            &HidLimits::stiffness)
      .need("damping",
            jsonNotNegativeUpTo(kMostDamping, "N s/m")
                .says("Largest damping that the arm renders stably [N s/m]."),
            &HidLimits::damping)
      .need("workspace_radius",
            lengthType().says("Radius of the workspace about the origin of the hand's world [m]. "
                              "Scenes are fitted into it."),
            &HidLimits::workspace_radius)
      .may("slew",
           jsonPositiveUpTo(kMostSlew, "N/s")
               .says("Largest growth of the force [N/s]. The default is 2000."),
           &HidLimits::slew)
      .may("stale",
           jsonPositiveUpTo(0.1, "seconds")
               .says("Largest age of a position [s]. If the newest position is older, the loop "
                     "cuts the force. The default is 0.05."),
           &HidLimits::stale)
      .may("speed",
           jsonPositiveUpTo(5.0, "m/s")
               .says("Largest speed [m/s]. Above it the loop brakes the arm; if the speed stays "
                     "above it, the loop cuts the force. The default is 3."),
           &HidLimits::speed)
      .may("continuous", jsonPositive().says("Force that the motors can hold indefinitely [N]."),
           &HidLimits::continuous)
      .may("heating", jsonPositive().says("Thermal time constant of the motors [s]."),
           &HidLimits::heating)
      .needs("continuous", "heating", kHeat, kBoth)
      .needs("heating", "continuous", kHeat, kBoth);
}

JsonType<PidAxisSpec> pidAxisType() {
  const auto not_zero = [](double value) { return value != 0.0; };
  const JsonSchema no_zero = {{"not", {{"const", 0}}}};
  return JsonObject<PidAxisSpec>()
      .need(
          "axis",
          jsonWord<int>({{"x", 0}, {"y", 1}, {"z", 2}})
              .says("Axis of the arm, which is also the axis's usage in the device's descriptor."),
          &PidAxisSpec::axis)
      .need("way",
            jsonUpTo(kMostLength, "metres")
                .where(not_zero, "it is 0", "measure the travel of the grip in metres")
                .also(no_zero)
                .says("Travel of the grip from the least position to the most [m]. A negative "
                      "travel means the opposite direction."),
            &PidAxisSpec::way)
      .need("force",
            jsonUpTo(kMostForce, "newtons")
                .where(not_zero, "it is 0", "measure the force at the grip in newtons")
                .also(no_zero)
                .says("Force at the grip at full magnitude and gain [N]. A negative force means "
                      "the opposite direction."),
            &PidAxisSpec::force)
      .type();
}

JsonType<std::vector<FileFlag>> flagList() {
  return jsonList(flagType(), 0, kMostFlags, "it is not a list of at most 1024 flags",
                  "write [{\"field\": ...}]");
}

struct Table {
  JsonSchema definitions;
  Rows profile;
};

const Table& table() {
  static const Table made = [] {
    Table t;
    const auto field = fieldType().defined("field", t.definitions);
    const auto step = stepType().defined("step", t.definitions);
    const auto steps = [&] {
      return jsonList(step, 0, kMostSteps, "it is not a list of at most 64 steps",
                      "write [{\"pause\": 0.1}]");
    };
    const auto limits = [](ProfileFile& file, const HidLimits& of) { file.profile.limits = of; };
    const Rows raw =
        Rows()
            .need("input",
                  jsonList(inputType(field).defined("input", t.definitions), 1, kMostReports,
                           "it is not a list of 1 to 16 reports",
                           "write [{\"size\": ..., \"fields\": ...}]"),
                  &ProfileFile::input)
            .may("output", reportRows(field).type().defined("output", t.definitions),
                 &ProfileFile::output)
            .may("flags", flagList(), &ProfileFile::flags)
            .mustHold("kinematics", kinematicsRows(jointType().defined("joint", t.definitions)),
                      "Model that computes the tip's position from the joints' positions.")
            .mayHold("gravity", gravityRows(), "Masses that the motors carry.")
            .mayHold(
                "handle", handleRows(),
                "Handle inputs that the application receives in addition to the tip's position.")
            .may("open", steps(), &ProfileFile::open)
            .may("home", steps(), &ProfileFile::home)
            .may("close", steps(), &ProfileFile::close)
            .may("limits", limitsRows().type(), limits)
            .needs("output", "limits", "an arm with \"output\" needs limits", "add \"limits\"");
    const Rows pid_rows =
        Rows().need("axes",
                    jsonList(pidAxisType(), 1, 3, "it is not a list of 1 to 3 axes",
                             "write [{\"axis\": \"x\", \"way\": 0.1, \"force\": 5}]"),
                    [](ProfileFile& file, std::vector<PidAxisSpec> axes) {
                      file.profile.pid = std::move(axes);
                    });
    const Rows pid =
        Rows()
            .mustHold("pid", pid_rows,
                      "A device of USB's PID class. Its descriptor describes its reports.")
            .need("limits", limitsRows().type(), limits);
    t.profile.remark("$schema")
        .version("palpate_arm", 1, "Version of this format.")
        .need("name",
              jsonMatching("^[A-Za-z0-9_.-]{1,64}$",
                           "it is not 1 to 64 letters, digits, \".\", \"-\" or \"_\"",
                           "use only these characters, at most 64"),
              [](ProfileFile& file, std::string name) { file.profile.name = std::move(name); })
        .may(
            "description", jsonText(),
            [](ProfileFile& file, std::string text) { file.profile.description = std::move(text); })
        .may("firmware",
             jsonText().says("When the firmware takes the force off. Optional without motors."),
             [](ProfileFile& file, std::string text) { file.profile.firmware = std::move(text); })
        .need("match",
              jsonList(matchType(), "it is not a list of devices",
                       "write [{\"vendor\": \"16C0\", \"product\": \"0486\"}]"),
              [](ProfileFile& file, std::vector<HidMatch> match) {
                file.profile.match = std::move(match);
              })
        .mustHold("rate",
                  Rows()
                      .always([](ProfileFile& file) { file.profile.output_rate = 0.0; })
                      .need("input", jsonPositive(),
                            [](ProfileFile& file, double rate) { file.profile.input_rate = rate; })
                      .may("output", jsonPositive(),
                           [](ProfileFile& file, double rate) { file.profile.output_rate = rate; }),
                  "Reports per second, from the maker's data sheet.")
        .mayHold("mount", mountRows(), "Pose of the arm's frame in the hand's world.")
        .may("sources", jsonMap(jsonText(), 0, "it is not an object", "write {\"/limits\": ...}"),
             [](ProfileFile& file, std::map<std::string, std::string> sources) {
               file.profile.sources = std::move(sources);
             })
        .chooseByKey({raw, pid});
    return t;
  }();
  return made;
}

}  // namespace

const JsonObject<ProfileFile>& profileTable() {
  return table().profile;
}

JsonSchema profileTableSchema() {
  return jsonFileSchema("palpate arm, version 1",
                        "A force-feedback arm that speaks HID: its identity, reports, geometry and "
                        "limits. See docs/profiles.md.",
                        table().profile.schema(), table().definitions);
}

}  // namespace palpate
