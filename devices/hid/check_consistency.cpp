#include "palpate/devices/hid/check_consistency.h"

#include <algorithm>
#include <cmath>
#include <string>

#include <fmt/format.h>

#include "palpate/devices/hid/profile_facts.h"
#include "palpate/engine/error.h"

namespace palpate {
namespace {

constexpr double kMostStep = 5e-3;  // [m]: largest travel of the tip for one count of each joint
// Largest ratio of the needed motor value to the limit of the motor's field.
constexpr double kMostAsked = 20.0;
// Largest share of a motor's continuous limit for the arm's weight; contact forces need the rest.
constexpr double kMostCarried = 0.5;
constexpr double kSame = 1e-4;  // [m]: positions closer than this count as equal

/// Checks that fields of motors have no "rest", and that other fields have no "scale" or "offset".
void checkOutput(const JsonNode& fields, const HidProfile& profile) {
  for (std::size_t f = 0; f < profile.output->fields.size(); ++f) {
    const bool motor = isMotor(profile, f);
    const JsonNode at = fields.child(profile.output->fields[f].name);
    if (motor && at.has("rest")) {
      at.child("rest").fail("the field drives a motor", "remove \"rest\"");
    }
    for (const char* key : {"scale", "offset"}) {
      if (motor || !at.has(key)) continue;
      at.child(key).fail("the field does not drive a motor",
                         std::string("remove \"") + key +
                             "\"; give the raw value that the field holds as \"rest\"");
    }
  }
}

/// Without "home" steps and home_at_open, palpate assumes that each counter is in the range that
/// brings the tip nearest to the origin of W. This is right only if the next range moves the tip
/// out of the workspace.
void checkRanges(const JsonNode& root, const HidProfile& profile, const ProfileFacts& facts) {
  if (profile.home_at_open || !profile.home.empty()) return;  // homing determines the turn
  const ArmPose middle = profile.kinematics->at(facts.middle);
  for (std::size_t i = 0; i < profile.joints.size(); ++i) {
    const HidJoint& joint = profile.joints[i];
    const ReportField& field = profile.input[joint.from.report].fields[joint.from.field];
    if (!field.wraps) continue;
    const double range =
        std::ldexp(std::abs(field.scale / joint.ratio), static_cast<int>(field.bits));
    const double way = range * middle.jacobian[i].norm();
    // If the counter's range is a whole turn of the joint, one more range leads to the same
    // position.
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
                  "{} wraps every {:.3g} m of the tip, and the workspace is {:.3g} m wide, so the "
                  "number of wraps is unknown even if a flag means homed",
                  field.name, way, 2.0 * profile.limits.workspace_radius),
              "add \"home\" steps or home_at_open, or correct bits or workspace_radius");
  }
}

void checkFacts(const JsonNode& root, const HidProfile& profile) {
  const ProfileFacts facts = factsOf(profile);
  constexpr double kReached = 1e-3;  // [m]: at this distance the tip counts as at the origin of W
  if (!(facts.off <= kReached)) {
    const std::string why =
        std::isfinite(facts.off)
            ? fmt::format("the origin of the hand's world is {:.3g} m outside of the tip's reach",
                          facts.off)
            : "the tip cannot reach any place from the joints' home";
    const JsonNode at = root.has("mount") && root.child("mount").has("origin")
                            ? root.child("mount").child("origin")
                            : root;
    at.fail(why, "correct mount/origin, home, or the lengths, all in metres and radians");
  }
  if (facts.step > kMostStep) {
    root.child("kinematics")
        .child("joints")
        .fail(fmt::format("one count of each joint moves the tip by {:.3g} m, more than {} m",
                          facts.step, kMostStep),
              "correct the inputs' scale (radians or metres per count) or the ratio");
  }
  checkRanges(root, profile, facts);
  const char* const remedy =
      "correct torque_constant, ratio, limits/force, or the motor's field: scale, least and most";
  const MotorFact* strongest = nullptr;
  for (const MotorFact& motor : facts.motors) {
    if (motor.asked > kMostAsked * motor.room) {
      root.child("kinematics")
          .child("joints")
          .element(motor.joint)
          .fail(fmt::format("a force of {} N at the tip needs an output of {:.3g} from {}, more "
                            "than {} times its limit of {:.3g}",
                            profile.limits.force, motor.asked, motor.field, kMostAsked, motor.room),
                remedy);
    }
    if (motor.carries > kMostCarried * motor.continuous) {
      root.child("gravity").fail(
          fmt::format("{} needs an output of {:.3g} to carry the arm's masses, more than half of "
                      "its {}limit of {:.3g}",
                      motor.field, motor.carries,
                      motor.continuous < motor.room ? "continuous " : "", motor.continuous),
          "correct masses and centres, or counterweight the arm");
    }
    if (strongest == nullptr || motor.asked / motor.room > strongest->asked / strongest->room) {
      strongest = &motor;
    }
  }
  // A motor that moves the tip perpendicularly to the force needs little torque, so only the motor
  // with the largest share is checked.
  if (strongest != nullptr && strongest->asked < kLeastAsked * strongest->room) {
    root.child("kinematics")
        .child("joints")
        .element(strongest->joint)
        .fail(fmt::format("a force of {} N at the tip needs less than {} % of every motor's limit, "
                          "at most {:.2g} % ({})",
                          profile.limits.force, 100.0 * kLeastAsked,
                          100.0 * strongest->asked / strongest->room, strongest->field),
              remedy);
  }
}

}  // namespace

bool isMotor(const HidProfile& profile, std::size_t field) {
  return std::any_of(profile.joints.begin(), profile.joints.end(),
                     [&](const HidJoint& joint) { return joint.to == field; });
}

void checkSequences(const JsonNode& input, const HidProfile& profile) {
  for (std::size_t r = 0; r < profile.input.size(); ++r) {
    if (!profile.input[r].sequence) continue;
    const ReportField& counter = profile.input[r].fields[*profile.input[r].sequence];
    std::string shared;
    const auto shares = [&](const FieldRef& other) {
      if (other.report != r) return false;
      const ReportField& field = profile.input[r].fields[other.field];
      const bool overlaps =
          counter.bit < field.bit + field.bits && field.bit < counter.bit + counter.bits;
      if (overlaps) shared = field.name;
      return overlaps;
    };
    const bool joint = std::any_of(profile.joints.begin(), profile.joints.end(),
                                   [&](const HidJoint& j) { return shares(j.from); });
    const bool flag = !joint && std::any_of(profile.flags.begin(), profile.flags.end(),
                                            [&](const HidFlag& f) { return shares(f.field); });
    if (!joint && !flag) continue;
    input.element(r)
        .child("sequence")
        .fail(fmt::format("{} shares bits with the {}'s field {}, which does not change with every "
                          "report",
                          counter.name, joint ? "joint" : "flag", shared),
              "name a field that counts reports, or remove \"sequence\"");
  }
}

void checkRates(const JsonNode& root, const HidProfile& profile, bool drives) {
  if (drives != (profile.output_rate > 0.0)) {
    if (!profile.pid.empty()) root.fail("\"pid\" needs rate/output", "add rate/output");
    root.fail("\"output\" and rate/output are valid only together",
              drives ? "add rate/output" : "add \"output\", or remove rate/output");
  }
  if (drives && (profile.output_rate < 1.0 || profile.output_rate > 1e5)) {
    root.child("rate").child("output").fail(
        fmt::format("{:g} reports per second is out of range", profile.output_rate),
        "give 1 to 100,000");
  }
}

void checkTogether(const JsonNode& root, const HidProfile& profile) {
  double closing = 0.0;
  for (const HidStep& step : profile.close) closing += step.seconds;
  if (closing > kLongestClose) {
    root.child("close").fail(fmt::format("the steps may take {} s", closing),
                             fmt::format("use at most {} s in total", kLongestClose));
  }

  const auto motors = std::count_if(profile.joints.begin(), profile.joints.end(),
                                    [](const HidJoint& j) { return j.to.has_value(); });
  if (profile.output) {
    const JsonNode limits = root.child("limits");
    if (profile.limits.continuous > profile.limits.force) {
      limits.child("continuous")
          .fail(fmt::format("{:g} N is more than the {:g} N of limits/force",
                            profile.limits.continuous, profile.limits.force),
                "use less, or increase limits/force");
    }
    const bool own = std::any_of(profile.joints.begin(), profile.joints.end(),
                                 [](const HidJoint& j) { return j.continuous > 0.0; });
    if (own && profile.limits.continuous > 0.0) {
      limits.child("continuous")
          .fail("joints have continuous limits of their own",
                "remove \"continuous\" and \"heating\" here or in all joints");
    }
  }
  // A counter that wraps starts at zero in any pose of the arm, so it needs homing.
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
        .fail("the counter wraps, and the pose at the counter's zero is unknown",
              "add \"home\" steps, home_at_open or a flag that means homed; if the counter never "
              "wraps, remove \"wraps\"");
  }
  if (profile.output && motors == 0) {
    root.child("kinematics")
        .fail("no joint has a motor", "add \"motor\" to joints, or remove \"output\"");
  }
  if (!profile.masses.empty() && motors == 0) {
    root.child("gravity").fail("no joint has a motor to carry the arm's weight",
                               "remove \"gravity\"");
  }
  if (!profile.masses.empty() && profile.limits.continuous > 0.0) {
    root.child("gravity").fail(
        "limits/continuous does not account for the weight that the motors carry",
        "remove limits/continuous and limits/heating, and give \"continuous\" and \"heating\" of "
        "joints");
  }
  if (profile.output && profile.firmware.empty()) {
    root.fail(
        "the profile does not describe how its firmware removes the force if no message arrives",
        "add \"firmware\"");
  }
  if (profile.rate_control > 0.0 && profile.output) {
    root.child("kinematics")
        .fail("an arm that reports velocities does not take forces",
              "remove \"output\" or \"rate_control\"");
  }
  if (profile.output) {
    if (profile.pid.empty()) checkOutput(root.child("output").child("fields"), profile);
    checkFacts(root, profile);
  }
}

void checkSources(const JsonNode& root, const HidProfile& profile) {
  for (const auto& [pointer, text] : profile.sources) {
    bool there = pointer.empty() || pointer[0] == '/';
    try {
      there = there && root.json().contains(Json::json_pointer(pointer));
    } catch (const Json::exception&) {
      there = false;
    }
    if (!there) {
      root.child("sources").fail("\"" + pointer + "\" is not in this file",
                                 "write the path of a number, such as \"/limits/force\"");
    }
  }
}

}  // namespace palpate
