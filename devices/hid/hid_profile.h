/// The profile of an arm that uses HID: its identification, reports, geometry and limits, from a
/// JSON file (devices/hid/hid_profile.schema.json). See docs/profiles.md.
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

#include "palpate/devices/arm/arm.h"
#include "palpate/devices/hid/hid_report.h"
#include "palpate/devices/hid/kinematics.h"

namespace palpate {

/// USB identification of a device of this profile. Members without a value match any device.
struct HidMatch {
  std::uint16_t vendor = 0;                 ///< USB's idVendor; always required.
  std::uint16_t product = 0;                ///< USB's idProduct; always required.
  std::optional<std::uint16_t> usage_page;  ///< Usage page of its top-level collection.
  std::optional<std::uint16_t> usage;       ///< Usage of its top-level collection.
};

/// One kind of report, input or output.
struct HidReportSpec {
  std::optional<std::uint8_t> id;   ///< Number, if the device numbers its reports.
  std::size_t size = 0;             ///< Bytes without the number.
  std::vector<ReportField> fields;  ///< Sorted by name.
  /// Input: the field that counts reports. A report with the previous count is a repetition.
  std::optional<std::size_t> sequence;
  double stale = 0.0;  ///< Input: largest age of the report's flags [s]; 0: HidLimits::stale.
};

/// An input field, resolved from its name.
struct FieldRef {
  std::size_t report = 0;  ///< Index in HidProfile::input.
  std::size_t field = 0;   ///< Index in HidReportSpec::fields.
};

/// A state of the arm, which is active while an input field has a given value.
struct HidFlag {
  /// The state, and its effect on the force.
  enum class Means : std::uint8_t {
    /// The arm is homed: its encoders report its true position. Otherwise the force is zero.
    kHomed,
    kEnabled,    ///< The user holds the dead-man switch. Otherwise the force is zero.
    kHot,        ///< Fault::kTemperature.
    kUnpowered,  ///< Fault::kPower.
    kOpen,       ///< Fault::kSwitch.
  };
  FieldRef field;       ///< The field to compare.
  double equals = 1.0;  ///< Raw number of the field while the state is active.
  /// kHomed and kEnabled are conditions for a force; the others are faults.
  Means means = Means::kHomed;
};

/// A joint of the kinematics: joint = value / ratio + home. The motor's torque is the joint's
/// torque divided by ratio. The output field's value is the motor's torque divided by the torque
/// constant.
struct HidJoint {
  FieldRef from;  ///< Field of its encoder. Fields of two joints share no bits.
  /// Field units per joint unit; negative if they count in opposite directions.
  double ratio = 1.0;
  /// Joint position at field value 0; with home_at_open, in the home pose [rad or m].
  double home = 0.0;
  std::optional<std::size_t> to;  ///< Output field of its motor; empty: the joint has no motor.
  double torque_constant = 1.0;   ///< [N m, or N if it slides, per unit of the field]
  /// Value that its motor can hold forever [unit of the output field]; 0: every value of the field.
  double continuous = 0.0;
  double heating = 0.0;  ///< Time constant of its winding's heat [s].
};

/// A mass that the arm's motors carry.
struct HidMass {
  double mass = 0.0;                ///< Mass [kg].
  std::optional<std::size_t> link;  ///< Link of the kinematics; empty: at the tip.
  Vec3 centre = Vec3::Zero();       ///< Centre of mass in the link's frame (Kinematics::on) [m].
};

/// A button, which is pressed while its field has a given value.
struct HidButton {
  std::string name;     ///< Name in HandleInfo::buttons.
  FieldRef field;       ///< The field to compare.
  double equals = 1.0;  ///< Raw number of the field while the button is pressed.
};

/// A rotation of the handle: that of an encoder of the handle, or that of a joint of the arm.
struct HidTurn {
  std::optional<std::size_t> joint;  ///< Index in HidProfile::joints; if set, `from` is unused.
  FieldRef from;                     ///< Field of its encoder: angle = value / ratio + home.
  double ratio = 1.0;                ///< Field units per angle unit, like HidJoint::ratio.
  double home = 0.0;                 ///< Angle at field zero [rad].
  Vec3 axis = Vec3::UnitZ();         ///< Unit axis, in the frame after the turns before it.
};

/// The handle's sensors (Handle).
struct HidHandle {
  std::vector<HidButton> buttons;  ///< At most HandleInfo::kMostButtons.
  /// Turns from the arm's frame to the handle's, in order: R_D = R(axis 1, angle 1) R(axis 2, angle
  /// 2) ... Empty: the orientation is not measured.
  std::vector<HidTurn> orientation;
  std::optional<HidTurn> gripper;  ///< Opening of the gripper; the turn's axis is unused.
};

/// A step of a sequence that a device needs before or after its use.
struct HidStep {
  /// Action: send a report, wait for a field's value, pause, or send a feature report.
  enum class Kind : std::uint8_t { kSend, kWait, kPause, kFeature };
  Kind kind = Kind::kPause;  ///< Action of this step; decides which of the members below are used.
  /// kSend: raw values of output fields; all other fields are at rest.
  std::vector<std::pair<std::size_t, double>> values;
  FieldRef field;       ///< kWait: the field to wait for.
  double equals = 0.0;  ///< kWait: the expected raw value.
  /// kWait: longest wait [s]; kPause: length of the pause [s].
  double seconds = 0.0;
  std::string words;             ///< kWait: instruction for the user.
  std::vector<std::byte> bytes;  ///< kFeature: the whole report.
};

inline constexpr std::array<const char*, 3> kAxisNames{"x", "y", "z"};  ///< Names in profiles.

/// An axis of a device of USB's PID class, which reports neither metres nor newtons.
struct PidAxisSpec {
  /// The axis; 0 is x. Selects both the usage in the device's descriptor and the axis of the arm.
  int axis = 0;
  /// Travel from the smallest to the largest position [m]; < 0: in the opposite direction.
  double way = 0.0;
  double force = 0.0;  ///< Force at full magnitude and gain [N]; < 0: in the opposite direction.
};

/// Limits of the arm, in SI units; required if the arm has motors.
struct HidLimits {
  double force = 0.0;             ///< Largest force [N].
  double slew = 2000.0;           ///< Largest growth of the force [N/s].
  double stiffness = 0.0;         ///< Largest stiffness of a coupling [N/m].
  double damping = 0.0;           ///< Largest damping of a coupling [N s/m].
  double workspace_radius = 0.0;  ///< Radius of a ball about the origin of W [m].
  /// Largest age of a position [s]. A silent 3D mouse keeps its velocity for this time.
  double stale = 0.05;
  double speed = 3.0;  ///< Largest speed of a hand on the arm [m/s].
  /// Force at the tip that the arm can hold forever [N]; 0: `force`, unless joints have limits
  /// (HidJoint::continuous).
  double continuous = 0.0;
  double heating = 0.0;  ///< Time constant of the motors' heat [s].
};

/// Longest total time of waits and pauses in "close" [s]; a program waits for them before it ends.
inline constexpr double kLongestClose = 5.0;

/// One arm, as read and checked by parseHidProfile.
struct HidProfile {
  std::string name;         ///< Name in `hid:NAME`.
  std::string description;  ///< One line for the user.
  std::string firmware;     ///< Firmware that the arm needs, and whether it has its own watchdog.
  std::string source;       ///< The file, for error messages.
  /// Hash of the whole profile. Identifies the profile for which a test result is stored.
  std::uint64_t fingerprint = 0;
  /// Devices of this profile; a device needs to match only one entry.
  std::vector<HidMatch> match;
  double input_rate = 1000.0;           ///< Positions per second, from the maker's data [Hz].
  double output_rate = 1000.0;          ///< Most forces sent per second [Hz]; 0: no output.
  std::vector<HidReportSpec> input;     ///< At least one; if there are several, each has its `id`.
  std::optional<HidReportSpec> output;  ///< Empty: the arm has no motors.
  /// Axes of a device of USB's PID class, x before y; empty for other devices. The device's own
  /// descriptor supplies the fields (describedBy). Until the descriptor is known, `input` and
  /// `output` are shares of travel and force.
  std::vector<PidAxisSpec> pid;
  std::vector<HidFlag> flags;                    ///< States of the arm.
  std::shared_ptr<const Kinematics> kinematics;  ///< Maps joints to the tip; not null.
  std::vector<HidJoint> joints;                  ///< One for each joint of the kinematics.
  /// The arm is in its home pose, with every joint at its `home`, when it is opened.
  bool home_at_open = false;
  std::string home_words;  ///< Describes the home pose to the user.
  /// For rate control, in which a position means a velocity: the velocity at position 1 of the
  /// kinematics [m/s]. 0: no rate control.
  double rate_control = 0.0;
  /// Rotation from the arm's frame D to W.
  Mat3 world_from_device = Mat3::Identity();
  Vec3 origin_D = Vec3::Zero();  ///< [m], for p_W = world_from_device (p_D - origin_D).
  std::vector<HidMass> masses;   ///< Masses that the arm's motors carry; may be empty.
  Vec3 down_D = -Vec3::UnitZ();  ///< Direction of gravity in the arm's axes, a unit vector.
  HidHandle handle;              ///< Buttons, orientation, gripper.
  std::vector<HidStep> open,     ///< Steps before the first report.
      home,                      ///< Steps after the first report, which home the arm.
      close;                     ///< Steps at the end, or after "open" or "home" has failed.
  HidLimits limits;              ///< Required in a file with an output.
  std::map<std::string, std::string> sources;  ///< Source of each number, keyed by JSON pointer.
};

/// Reads and checks a profile. Throws DeviceError with the file and the JSON path of the error.
[[nodiscard]] HidProfile parseHidProfile(const std::string& text, const std::string& source);
/// Reads and checks a profile's file. Also throws DeviceError if the file cannot be read.
[[nodiscard]] HidProfile readHidProfile(const std::filesystem::path& file);

/// Returns palpate's own profiles and the user's in `folder`. A user's profile replaces palpate's
/// profile of the same name. An invalid file of the user also removes palpate's profiles with the
/// file's name or with a name in the file. Adds problems of the user's files to `notes`, one line
/// each.
[[nodiscard]] std::vector<HidProfile> hidProfiles(const std::filesystem::path& folder,
                                                  std::vector<std::string>& notes);
/// Returns the user's folder: $XDG_CONFIG_HOME/palpate/arms or ~/.config/palpate/arms.
[[nodiscard]] std::filesystem::path hidProfileFolder();

/// Returns the JSON Schema of profiles.
[[nodiscard]] const std::string& hidProfileSchema();

/// Published limits of a well-known arm.
struct KnownArm {
  std::string name;       ///< Common name. An arm occurs twice if two sources disagree.
  double force,           ///< Peak force [N].
      stiffness,          ///< Largest stiffness of a coupling [N/m].
      damping,            ///< Largest damping of a coupling [N s/m].
      workspace_radius;   ///< Radius of the workspace [m].
  std::string transport;  ///< Interface by which the arm could be driven.
  std::string source;     ///< Source of the numbers, with the name of its file.
};
/// Returns the arms of devices/hid/known_arms.json, which is compiled in.
[[nodiscard]] std::vector<KnownArm> knownArms();

}  // namespace palpate
