/// What palpate knows of an arm that speaks HID: how it is found, where the numbers are in its
/// reports, its geometry and its limits. A JSON file (devices/hid_profile.schema.json);
/// docs/profiles.md says how to write one.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "palpate/devices/arm.h"
#include "palpate/devices/hid_report.h"
#include "palpate/devices/kinematics.h"

namespace palpate {

/// A device of this profile, as USB names it. What is not given may be anything.
struct HidMatch {
  std::uint16_t vendor = 0;                 ///< USB's idVendor; always needed.
  std::uint16_t product = 0;                ///< USB's idProduct; always needed.
  std::optional<std::uint16_t> usage_page;  ///< Of its top-level collection,
  std::optional<std::uint16_t> usage;       ///< and the usage there.
};

/// One kind of report, either way.
struct HidReportSpec {
  std::optional<std::uint8_t> id;   ///< Where the device numbers its reports.
  std::size_t size = 0;             ///< Bytes, the number not among them.
  std::vector<ReportField> fields;  ///< In the order of their names.
  /// Of what is read: the field that counts reports. One that has the same number again is the
  /// last report, sent again.
  std::optional<std::size_t> sequence;
  double stale = 0.0;  ///< Of what is read: no flag in it is believed for longer [s]; 0: as
                       ///< HidLimits::stale.
};

/// A field of what is read, by its name found once.
struct FieldRef {
  std::size_t report = 0;  ///< Of HidProfile::input.
  std::size_t field = 0;   ///< Of HidReportSpec::fields there.
};

/// A field that says something of the arm while it has a value.
struct HidFlag {
  /// What holds while the flag is up, and what follows for the force.
  enum class Means : std::uint8_t {
    kHomed,      ///< Its encoders know where it is; else no force.
    kEnabled,    ///< The dead-man switch is held; else no force.
    kHot,        ///< Fault::kTemperature.
    kUnpowered,  ///< Fault::kPower.
    kOpen,       ///< Fault::kSwitch.
  };
  FieldRef field;               ///< The field that is looked at.
  double equals = 1.0;          ///< Its raw number while the flag is up.
  Means means = Means::kHomed;  ///< The first two are conditions, the others faults.
};

/// A joint of the kinematics: joint = value / ratio + home; the motor's torque is the joint's over
/// ratio, what is sent is that over the torque constant.
struct HidJoint {
  FieldRef from;                  ///< The field of its encoder; no two joints share bits.
  double ratio = 1.0;             ///< Field units a joint unit; the sign is the direction.
  double home = 0.0;              ///< The joint where the field is zero, or at home [rad or m].
  std::optional<std::size_t> to;  ///< Of the output's fields: its motor; none: only sensed.
  double torque_constant = 1.0;   ///< [N m per unit of the output field]
  double continuous = 0.0;  ///< What its motor can hold for ever [unit of the output field]; 0: all
                            ///< that the field gives.
  double heating = 0.0;     ///< Time constant of its winding's heat [s].
};

/// A mass that the arm's motors carry.
struct HidMass {
  double mass = 0.0;                ///< [kg]
  std::optional<std::size_t> link;  ///< Of the kinematics; none: it is at the tip.
  Vec3 centre = Vec3::Zero();       ///< In the link's frame (Kinematics::on) [m].
};

/// A button that its user presses: pressed while its field has the value.
struct HidButton {
  std::string name;     ///< In HandleInfo::buttons.
  FieldRef field;       ///< The field that is looked at.
  double equals = 1.0;  ///< Its raw number while it is pressed.
};

/// An encoder of the handle, or one of the arm's joints that turns it.
struct HidTurn {
  std::optional<std::size_t> joint;  ///< Of HidProfile::joints; then `from` means nothing.
  FieldRef from;                     ///< The field of its encoder: angle = value / ratio + home.
  double ratio = 1.0;                ///< As HidJoint::ratio.
  double home = 0.0;                 ///< The angle where the field is zero [rad].
  Vec3 axis = Vec3::UnitZ();         ///< In the frame that the turns before it leave; unit.
};

/// What an arm has beside where its tip is (Handle).
struct HidHandle {
  std::vector<HidButton> buttons;  ///< At most HandleInfo::kMostButtons.
  /// From the arm's frame to the handle's, in turn: R_D = R(axis 1, angle 1) R(axis 2, angle 2) ...
  /// Empty: how it is held is not measured.
  std::vector<HidTurn> orientation;
  std::optional<HidTurn> gripper;  ///< How far it is open; its axis means nothing.
};

/// A step of a sequence: what a device needs before or after it is felt.
struct HidStep {
  /// What is done: a report is sent, a field waited for, time let pass, a feature report sent.
  enum class Kind : std::uint8_t { kSend, kWait, kPause, kFeature };
  Kind kind = Kind::kPause;  ///< Decides which of the members below count.
  std::vector<std::pair<std::size_t, double>> values;  ///< kSend: output fields, raw; others rest.
  FieldRef field;                                      ///< kWait: until it
  double equals = 0.0;                                 ///< has this value,
  double seconds = 0.0;                                ///< at most so long; of a pause: how long.
  std::string words;                                   ///< kWait: what the user is to do.
  std::vector<std::byte> bytes;                        ///< kFeature: the whole report.
};

inline constexpr std::array<const char*, 3> kAxisNames{"x", "y", "z"};  ///< As profiles say.

/// An axis of a device of USB's PID class, which says of itself neither metres nor newtons.
struct PidAxisSpec {
  int axis = 0;        ///< 0 is x: its usage in the device's descriptor, and the arm's axis.
  double way = 0.0;    ///< From its least position to its most [m]; < 0: it goes the other way.
  double force = 0.0;  ///< At full magnitude and gain [N]; < 0: it pushes the other way.
};

/// What may be asked of the arm. All [SI]; needed wherever there are motors.
struct HidLimits {
  double force = 0.0;             ///< [N]
  double slew = 2000.0;           ///< [N/s]
  double stiffness = 0.0;         ///< [N/m]
  double damping = 0.0;           ///< [N s/m]
  double workspace_radius = 0.0;  ///< [m]
  double stale = 0.05;            ///< [s]; so long does a puck move on that says nothing more.
  double speed = 3.0;             ///< [m/s]
  double continuous = 0.0;        ///< [N] at the tip; 0: the peak, or HidJoint::continuous.
  double heating = 0.0;           ///< [s]
};

/// The waits and pauses of a profile's "close", all together [s]: the program's end waits for them.
inline constexpr double kLongestClose = 5.0;

/// One arm, as parseHidProfile has read and checked it.
struct HidProfile {
  std::string name;         ///< As `hid:NAME`.
  std::string description;  ///< A line for people.
  std::string firmware;     ///< What must run in the arm, and whether it has a watchdog of its own.
  std::string source;       ///< The file, for errors.
  std::uint64_t fingerprint = 0;  ///< Of all that is in it: what was tested is what is used.
  std::vector<HidMatch> match;    ///< One that fits is enough.
  double input_rate = 1000.0;     ///< [Hz], as the maker says.
  double output_rate = 1000.0;    ///< [Hz], the most reports a second that it is sent; 0: there is
                                  ///< no output.
  std::vector<HidReportSpec> input;     ///< At least one; of several each has its id.
  std::optional<HidReportSpec> output;  ///< None: input only.
  /// Axes of a device of USB's PID class, x before y; empty: it is none. What it has else is in its
  /// own descriptor (describedBy); until that is known `input` and `output` are shares of ways and
  /// forces.
  std::vector<PidAxisSpec> pid;
  std::vector<HidFlag> flags;  ///< What it must say, and may not, for any force to be given.
  std::shared_ptr<const Kinematics> kinematics;  ///< From joints to the tip; not null.
  std::vector<HidJoint> joints;                  ///< As many as the kinematics has.
  bool home_at_open = false;  ///< The arm is in its home pose, `home` of every joint, when opened.
  std::string home_words;     ///< What that pose is.
  double rate_control = 0.0;  ///< [m/s] at 1: the kinematics' position is a velocity; 0: it is not.
  Mat3 world_from_device = Mat3::Identity();  ///< Of the arm in the hand's world:
  Vec3 origin_D = Vec3::Zero();               ///< p_W = world_from_device (p_D - origin_D).
  std::vector<HidMass> masses;                ///< That its motors carry; empty: none.
  Vec3 down_D = -Vec3::UnitZ();               ///< Where the masses fall to.
  HidHandle handle;                           ///< Buttons, orientation, gripper.
  std::vector<HidStep> open,                  ///< Before its first report is waited for.
      home,                                   ///< After it: until the arm knows where it is.
      close;         ///< At the end, and where opening or homing has failed.
  HidLimits limits;  ///< In the file wherever there is an output.
  std::map<std::string, std::string> sources;  ///< By JSON pointer: where numbers come from.
};

/// Reads and checks a profile. Throws DeviceError (file and JSON path).
[[nodiscard]] HidProfile parseHidProfile(const std::string& text, const std::string& source);
/// The same from a file; DeviceError also where it cannot be read.
[[nodiscard]] HidProfile readHidProfile(const std::filesystem::path& file);

/// Those that come with palpate, and the user's own in `folder`, which win over them. What is wrong
/// with a file of the user's, or its name, is put in `notes`, one line each; the one that it would
/// have replaced, by its name or its file's, is then not there either.
[[nodiscard]] std::vector<HidProfile> hidProfiles(const std::filesystem::path& folder,
                                                  std::vector<std::string>& notes);
/// Where a user's profiles are: $XDG_CONFIG_HOME/palpate/arms or ~/.config/palpate/arms.
[[nodiscard]] std::filesystem::path hidProfileFolder();

/// The JSON Schema of profiles.
[[nodiscard]] const std::string& hidProfileSchema();

/// Limits of an arm that people know, from a source.
struct KnownArm {
  std::string name;       ///< As people call it; twice where two sources disagree.
  double force,           ///< At most [N].
      stiffness,          ///< Likewise, of a coupling [N/m].
      damping,            ///< Likewise, of a coupling [N s/m].
      workspace_radius;   ///< [m]
  std::string transport;  ///< How it could be driven.
  std::string source;     ///< Whose numbers these are, and in which file.
};
/// devices/known_arms.json.
[[nodiscard]] std::vector<KnownArm> knownArms();

}  // namespace palpate
