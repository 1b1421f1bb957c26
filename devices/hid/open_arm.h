/// Opens an arm by its name, such as `hid:polhem@SERIAL`.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "palpate/devices/hid/hid_device.h"
#include "palpate/engine/error.h"

namespace palpate {

/// A plugged-in device and the profiles that match it.
struct FoundArm {
  /// The device, with the first of its usages that matches a profile.
  HidDeviceName device;
  std::vector<HidProfile> profiles;  ///< Profiles that match the device; at least one.
  bool may_open = false;             ///< This user has permission to open the device.

  /// Returns the serial number that distinguishes this arm from others of its kind. Empty if the
  /// firmware gives no number, or gives all devices the same number (mbed's "0123456789").
  [[nodiscard]] std::string serial() const;
  /// Returns the identity for names and stored tests: the serial number, else the port, else an
  /// empty text. If two arms without serial numbers swap ports, palpate takes each for the other.
  [[nodiscard]] std::string identity() const;
  /// Compares the device's own report descriptor with a profile (complaintAbout; for a PID device,
  /// readPidMap and describedBy). Returns the first difference; no value if they agree, or if the
  /// descriptor is not shown or not valid.
  [[nodiscard]] std::optional<DeviceError> against(const HidProfile& profile) const;
  /// Returns a name that openArm accepts: `hid:PROFILE@IDENTITY`, or `hid:PROFILE` without
  /// identity.
  [[nodiscard]] std::string nameAs(const HidProfile& profile) const;
};

/// Returns the plugged-in devices that match a profile, each once. Slow.
[[nodiscard]] std::vector<FoundArm> findArms(const std::vector<HidProfile>& profiles);

/// The parts of `hid`, `hid:PROFILE`, `hid:PROFILE@SERIAL` or `hid:FILE.json@SERIAL`. For an arm
/// without a serial number, SERIAL is its port.
struct ArmName {
  std::string profile;  ///< A profile's name, or a path that ends in .json; empty: any profile.
  std::string serial;   ///< Empty: any arm. May contain any character.
  [[nodiscard]] bool isFile() const;  ///< Returns true if `profile` ends in .json.
};
/// Splits a name into its parts. Returns no value if the name is not that of an arm.
[[nodiscard]] std::optional<ArmName> parseArmName(const std::string& name);

/// Returns the profile that a name selects; `hid` alone does not select one. Throws DeviceError if
/// the name is unknown (with a similar name, if there is one) or if its file is invalid. `say` (may
/// be empty) receives messages about the user's files that cannot be used, and about a torque
/// constant that seems to be in mN m/A.
[[nodiscard]] HidProfile namedProfile(const ArmName& name,
                                      const std::function<void(const std::string&)>& say);

/// A plugged-in arm, chosen by its name.
struct ChosenArm {
  FoundArm arm;        ///< The arm, which this process has not opened yet.
  HidProfile profile;  ///< The profile of `arm` that the name selects.
};

/// Finds the arm of this name that this program has not opened yet. If no arm or several arms
/// match, throws DeviceError with the matching names and the remedy. `say` is that of namedProfile.
[[nodiscard]] ChosenArm findArm(const std::string& name,
                                const std::function<void(const std::string&)>& say);

/// An open arm and its identity.
struct OpenedArm {
  std::unique_ptr<Arm> device;  ///< Not null.
  ArmIdentity identity;         ///< Key under which its test is stored.
};

/// Finds an arm by its name, `hid...` (findArm), and opens it. Throws DeviceError, including when
/// the device's reports differ from the profile's.
[[nodiscard]] OpenedArm openArm(const std::string& name, const ArmHost& host);

/// Returns the key of the test of an arm of this profile. `own` is FoundArm::identity; `numbered`
/// is true if `own` is a serial number.
[[nodiscard]] ArmIdentity identityOf(const HidProfile& profile, const std::string& own,
                                     bool numbered = true);

}  // namespace palpate
