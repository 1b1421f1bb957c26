#include "palpate/devices/hid/check_profile.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "palpate/devices/hid/check_consistency.h"
#include "palpate/engine/error.h"
#include "palpate/engine/safety/device.h"

namespace palpate {
namespace {

using Node = JsonNode;

ReportField fieldOf(const std::string& name, const FileField& file, const Node& node,
                    std::size_t size, bool output) {
  using Type = ReportField::Type;
  ReportField field;
  field.name = name;
  field.type = file.type.value_or(file.bits == 1 ? Type::kUnsigned : Type::kSigned);
  field.bit = static_cast<std::uint32_t>(file.bit);
  field.bits = static_cast<std::uint32_t>(file.bits);
  field.big_endian = file.big_endian;
  field.scale = file.scale;
  field.offset = file.offset;
  field.wraps = file.wraps;
  if (field.type == Type::kFloat && field.bits != 32) {
    node.child("bits").fail("a float has 32 bits", "write 32");
  }
  if (field.big_endian && (field.bit % 8 != 0 || field.bits % 8 != 0)) {
    node.fail("big-endian numbers are whole bytes",
              "remove \"big_endian\", or correct bit and bits");
  }
  if (field.end() > size) {
    node.fail(fmt::format("the field ends beyond the report's {} bytes", size),
              "correct bit, bits or size");
  }
  if (field.wraps && field.type == Type::kFloat) {
    node.child("wraps").fail("a field of type float cannot be a counter that wraps",
                             "remove \"wraps\", or correct \"type\"");
  }
  const bool with_sign = field.type == Type::kSigned;
  field.least = with_sign ? -std::ldexp(1.0, file.bits - 1) : 0.0;
  field.most = with_sign ? -field.least - 1.0 : std::ldexp(1.0, file.bits) - 1.0;
  if (field.type == Type::kFloat) {
    field.least = -3e38;
    field.most = 3e38;
  }
  const double lowest = field.least;
  const double highest = field.most;
  const auto fits = [&](const char* key, const std::optional<double>& value, double& to) {
    if (!value) return;
    if (*value < lowest || *value > highest) {
      node.child(key).fail(fmt::format("{} does not fit into the field, which holds {} to {}",
                                       *value, lowest, highest),
                           "correct the value, or the field's type and bits");
    }
    to = *value;
  };
  fits("least", file.least, field.least);
  fits("most", file.most, field.most);
  if (!(field.least <= field.most)) node.fail("least is above most", "exchange them");
  field.bounded = file.least && file.most;
  if (file.rest && !output)
    node.child("rest").fail("only output fields have a rest", "remove \"rest\"");
  fits("rest", file.rest, field.rest);
  return field;
}

HidReportSpec reportOf(const FileReport& file, const Node& node, bool output) {
  HidReportSpec report;
  if (file.id) report.id = static_cast<std::uint8_t>(*file.id);
  report.size = static_cast<std::size_t>(file.size);
  report.stale = file.stale;
  for (const auto& [name, field] : file.fields) {
    report.fields.push_back(
        fieldOf(name, field, node.child("fields").child(name), report.size, output));
  }
  if (!node.has("sequence")) return report;
  const auto at =
      std::find_if(report.fields.begin(), report.fields.end(),
                   [&](const ReportField& field) { return field.name == file.sequence; });
  if (at == report.fields.end()) {
    node.child("sequence")
        .fail("this report has no field \"" + file.sequence + "\"", "name one of its fields");
  }
  report.sequence = static_cast<std::size_t>(at - report.fields.begin());
  return report;
}

/// Returns the output report. Checks that its fields share no bit, and that the report fits into a
/// guardian's buffer.
HidReportSpec outputOf(const FileReport& file, const Node& node) {
  HidReportSpec report = reportOf(file, node, true);
  constexpr std::size_t kMostOut = ZeroForce::kMostBytes - 1;
  if (report.size > kMostOut) {
    node.child("size").fail(fmt::format("the report has more than {} bytes", kMostOut),
                            "use a shorter report");
  }
  std::vector<const ReportField*> used(8 * report.size, nullptr);
  for (const ReportField& field : report.fields) {
    for (std::uint32_t bit = field.bit; bit < field.bit + field.bits; ++bit) {
      if (used[bit] != nullptr) {
        node.child("fields")
            .child(field.name)
            .fail("the field shares bits with another field, " + used[bit]->name,
                  "correct bit or bits");
      }
      used[bit] = &field;
    }
  }
  return report;
}

class Fields {
 public:
  explicit Fields(const HidProfile& profile) : profile_(profile) {}
  [[nodiscard]] FieldRef input(const Node& node, const std::string& name) const {
    std::vector<std::string> names;
    for (std::size_t r = 0; r < profile_.input.size(); ++r) {
      for (std::size_t f = 0; f < profile_.input[r].fields.size(); ++f) {
        names.push_back(profile_.input[r].fields[f].name);
        if (names.back() == name) return {r, f};
      }
    }
    unknown(node, name, names, "input");
  }
  /// @param motors  True: for an unknown name, the error may suggest a field that drives a motor.
  [[nodiscard]] std::size_t output(const Node& node, const std::string& name, bool motors) const {
    std::vector<std::string> names;
    if (!profile_.output)
      node.fail("the profile has no \"output\"", "remove this key, or add \"output\"");
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

FieldRef fieldThatMayBe(double equals, const std::string& name, const Node& node,
                        const Fields& fields, const HidProfile& profile) {
  const FieldRef field = fields.input(node.child("field"), name);
  const ReportField& of = profile.input[field.report].fields[field.field];
  if (equals < of.least || equals > of.most) {
    node.fail(fmt::format("the field {} cannot hold {}", of.name, equals),
              "correct equals, or the field's type, bits, least and most");
  }
  return field;
}

HidFlag flagOf(const FileFlag& file, const Node& node, const Fields& fields,
               const HidProfile& profile) {
  HidFlag flag = file.flag;
  flag.field = fieldThatMayBe(flag.equals, file.field, node, fields, profile);
  return flag;
}

HidTurn turnOf(const FileTurn& file, const Node& node, const Fields& fields,
               const HidProfile& profile) {
  HidTurn turn = file.turn;
  if (turn.joint) {
    if (*turn.joint >= profile.joints.size()) {
      node.child("joint").fail("the model does not have this joint",
                               fmt::format("give 0 to {}", profile.joints.size() - 1));
    }
    return turn;
  }
  turn.from = fields.input(node.child("from"), file.from);
  if (profile.input[turn.from.report].fields[turn.from.field].wraps) {
    node.child("from").fail(
        "palpate can follow a counter that wraps only if it belongs to a joint",
        "name the joint; if the counter never wraps, remove \"wraps\" of its field");
  }
  return turn;
}

void takeHandle(const ProfileFile& file, const Node& root, const Fields& fields,
                HidProfile& profile) {
  if (!root.has("handle")) return;
  const Node at = root.child("handle");
  for (std::size_t i = 0; i < file.buttons.size(); ++i) {
    const FileButton& from = file.buttons[i];
    HidButton button = from.button;
    button.field =
        fieldThatMayBe(button.equals, from.field, at.child("buttons").element(i), fields, profile);
    profile.handle.buttons.push_back(std::move(button));
  }
  for (std::size_t i = 0; i < file.orientation.size(); ++i) {
    profile.handle.orientation.push_back(
        turnOf(file.orientation[i], at.child("orientation").element(i), fields, profile));
  }
  if (file.gripper) {
    profile.handle.gripper = turnOf(*file.gripper, at.child("gripper"), fields, profile);
  }
}

void checkHeat(const Node& at, const HidProfile& profile, const HidJoint& joint) {
  if (joint.continuous == 0.0) return;
  const ReportField& field = profile.output->fields[*joint.to];
  const double room =
      std::min(field.most - field.offset, field.offset - field.least) / std::abs(field.scale);
  if (joint.continuous > room) {
    at.child("continuous")
        .fail(fmt::format("{} is more than the limit of the motor's field, {:.4g}",
                          joint.continuous, room),
              "reduce the value, correct the field, or remove \"continuous\" and \"heating\"");
  }
}

std::size_t motorOf(const FileJoint& file, const Node& node, const Fields& fields,
                    const HidProfile& profile) {
  const std::size_t to = fields.output(node, file.motor, true);
  const ReportField& motor = profile.output->fields[to];
  if (!motor.bounded) {
    node.fail("the motor's field does not have both limits",
              "give the field \"least\" and \"most\", small at first");
  }
  const double none = std::round(motor.offset);
  if (none < motor.least || none > motor.most) {
    node.fail("the motor's field cannot hold a force of zero", "correct offset, least and most");
  }
  if (none == motor.least || none == motor.most) {
    node.fail("the motor's field cannot hold both positive and negative forces",
              "correct offset, type, least and most");
  }
  const auto other = std::find_if(profile.joints.begin(), profile.joints.end(),
                                  [&](const HidJoint& joint) { return joint.to == to; });
  if (other != profile.joints.end()) {
    node.fail(fmt::format("this motor already drives another joint, /kinematics/joints/{}",
                          other - profile.joints.begin()),
              "name this joint's own motor");
  }
  return to;
}

HidJoint jointOf(const FileJoint& file, const Node& at, const Fields& fields,
                 const HidProfile& profile) {
  HidJoint joint = file.joint;
  joint.from = fields.input(at.child("from"), file.from);
  for (const HidJoint& other : profile.joints) {
    const ReportField& one = profile.input[joint.from.report].fields[joint.from.field];
    const ReportField& two = profile.input[other.from.report].fields[other.from.field];
    const bool apart = joint.from.report != other.from.report || one.bit >= two.bit + two.bits ||
                       two.bit >= one.bit + one.bits;
    if (!apart) {
      at.child("from").fail(
          fmt::format("the field shares bits with that of another joint, /kinematics/joints/{}",
                      &other - profile.joints.data()),
          "correct from, or bit and bits");
    }
  }
  if (file.motor.empty()) return joint;
  const Node motor = at.child("motor");
  if (profile.joints.size() >= kMotors) {
    motor.fail("only the first three joints have motors", "remove \"motor\"");
  }
  joint.to = motorOf(file, motor, fields, profile);
  checkHeat(at, profile, joint);
  return joint;
}

HidStep stepOf(const FileStep& file, const Node& at, const Fields& fields,
               const HidProfile& profile) {
  HidStep step = file.step;
  if (step.kind == HidStep::Kind::kWait) {
    step.field = fields.input(at.child("wait").child("field"), file.field);
  }
  for (const auto& [name, raw] : file.send) {
    const Node field = at.child("send").child(name);
    const std::size_t to = fields.output(field, name, false);
    const ReportField& of = profile.output->fields[to];
    if (raw < of.least || raw > of.most) {
      field.fail(fmt::format("{} is outside of {} to {}", raw, of.least, of.most),
                 "correct the value, or the field's type, bits, least and most");
    }
    step.values.emplace_back(to, raw);
  }
  // Only forces that have passed the engine's force limit may drive a motor.
  for (const auto& sent : step.values) {
    if (isMotor(profile, sent.first)) {
      at.child("send").fail("a step drives a motor, " + profile.output->fields[sent.first].name,
                            "remove the fields of motors: palpate keeps their forces at zero");
    }
  }
  return step;
}

std::vector<HidStep> stepsOf(const std::vector<FileStep>& file, const Node& root, const char* key,
                             const Fields& fields, const HidProfile& profile) {
  std::vector<HidStep> steps;
  for (std::size_t i = 0; i < file.size(); ++i) {
    steps.push_back(stepOf(file[i], root.child(key).element(i), fields, profile));
  }
  return steps;
}

/// Adds the reports to the profile. Checks that their numbers and the names of all input fields are
/// unique.
void takeReports(const ProfileFile& file, const Node& root, HidProfile& profile) {
  const Node input = root.child("input");
  std::set<std::string> names;
  std::set<std::uint8_t> numbers;
  for (std::size_t i = 0; i < file.input.size(); ++i) {
    const Node here = input.element(i);
    profile.input.push_back(reportOf(file.input[i], here, false));
    const HidReportSpec& report = profile.input.back();
    for (const ReportField& field : report.fields) {
      if (names.insert(field.name).second) continue;
      here.child("fields")
          .child(field.name)
          .fail("the name occurs twice", "give each field its own name");
    }
    if (file.input.size() > 1 && !report.id) {
      here.fail("the profile has several reports, and this one has no number", "add \"id\"");
    }
    if (report.id && !numbers.insert(*report.id).second) {
      input.fail(fmt::format("two reports have the number {}", *report.id),
                 "give each report its own number");
    }
  }
  if (file.output) profile.output = outputOf(*file.output, root.child("output"));
  if (profile.output && profile.output->id.has_value() == numbers.empty()) {
    root.child("output").fail("a device numbers all its reports or none",
                              "give every report an \"id\", or none");
  }
}

void takeKinematics(const ProfileFile& file, const Node& root, const Fields& fields,
                    HidProfile& profile) {
  const Node node = root.child("kinematics");
  profile.kinematics = file.model(file.geometry);
  const std::size_t count = profile.kinematics->joints();
  if (file.joints.size() != count) {
    node.child("joints").fail(fmt::format("it is not a list of {} joints", count),
                              "give one for each link, or correct links");
  }
  for (std::size_t i = 0; i < count; ++i) {
    profile.joints.push_back(
        jointOf(file.joints[i], node.child("joints").element(i), fields, profile));
  }
  if (profile.home_at_open && profile.home_words.empty()) {
    node.child("home_at_open")
        .fail("the user must be told which pose is the home pose", "add \"home_words\"");
  }
  const int last = static_cast<int>(profile.kinematics->links()) - 1;
  for (std::size_t i = 0; i < profile.masses.size(); ++i) {
    if (!profile.masses[i].link) continue;
    (void)root.child("gravity").child("masses").element(i).child("link").whole(0, last);
  }
}

/// Adds the axes of a PID device to the profile. Until the device's descriptor is known, positions
/// are fractions of the travel and forces are fractions of the full force.
void takePid(const Node& root, HidProfile& profile) {
  const Node axes = root.child("pid").child("axes");
  std::vector<PidAxisSpec>& all = profile.pid;
  for (std::size_t i = 0; i < all.size(); ++i) {
    const Node at = axes.element(i);
    const bool twice =
        std::any_of(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(i),
                    [&](const PidAxisSpec& other) { return other.axis == all[i].axis; });
    if (twice) at.child("axis").fail("the axis occurs twice", "name each axis once");
    if (2.0 * profile.limits.workspace_radius > std::abs(all[i].way) * (1.0 + 1e-9)) {
      at.child("way").fail(
          fmt::format("the workspace is {:.4g} m wide, but the grip travels only {:.4g} m",
                      2.0 * profile.limits.workspace_radius, std::abs(all[i].way)),
          "correct \"way\", or reduce limits/workspace_radius");
    }
    const double share = profile.limits.force / std::abs(all[i].force);
    if (share > 1.0 || share < kLeastAsked) {
      at.child("force").fail(
          fmt::format("limits/force is {:.4g} N, and this axis gives {:.4g} N",
                      profile.limits.force, std::abs(all[i].force)),
          "correct the axis's force, or set limits/force to 0.1 to 100 % of the axis's force");
    }
  }
  std::sort(all.begin(), all.end(),
            [](const PidAxisSpec& a, const PidAxisSpec& b) { return a.axis < b.axis; });
  std::vector<int> directions;
  profile.input.emplace_back();
  profile.output.emplace();
  for (std::size_t i = 0; i < all.size(); ++i) {
    ReportField share;
    share.name = kAxisNames[static_cast<std::size_t>(all[i].axis)];
    share.bit = static_cast<std::uint32_t>(32 * i);
    share.bits = 32;
    share.type = ReportField::Type::kFloat;
    ReportField force = share;
    share.scale = all[i].way;
    force.scale = 1.0 / all[i].force;
    force.least = -1.0;
    force.most = 1.0;
    force.bounded = true;
    profile.input[0].fields.push_back(share);
    profile.output->fields.push_back(force);
    HidJoint joint;
    joint.from = {0, i};
    joint.to = i;
    profile.joints.push_back(joint);
    directions.push_back(all[i].axis);
  }
  profile.input[0].size = profile.output->size = 4 * all.size();
  profile.kinematics = makeSlides(directions);
  // Each force needs one report per axis, so the axes share the reports per second.
  profile.output_rate /= static_cast<double>(all.size());
}

}  // namespace

HidProfile checkedProfile(ProfileFile file, const JsonNode& root) {
  HidProfile profile = std::move(file.profile);
  checkRates(root, profile, file.output || !profile.pid.empty());
  if (profile.pid.empty()) {
    takeReports(file, root, profile);
  } else {
    takePid(root, profile);
  }
  const Fields fields(profile);
  for (std::size_t i = 0; i < file.flags.size(); ++i) {
    const Node at = root.child("flags").element(i);
    profile.flags.push_back(flagOf(file.flags[i], at, fields, profile));
  }
  if (profile.pid.empty()) {
    takeKinematics(file, root, fields, profile);
    takeHandle(file, root, fields, profile);
    checkSequences(root.child("input"), profile);
  }
  const auto& q = file.rotation_wxyz;
  profile.world_from_device =
      Eigen::Quaterniond(q[0], q[1], q[2], q[3]).normalized().toRotationMatrix();
  profile.open = stepsOf(file.open, root, "open", fields, profile);
  profile.home = stepsOf(file.home, root, "home", fields, profile);
  profile.close = stepsOf(file.close, root, "close", fields, profile);
  checkTogether(root, profile);
  checkSources(root, profile);
  return profile;
}

}  // namespace palpate
