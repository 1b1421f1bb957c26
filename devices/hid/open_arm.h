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
  HidDeviceName device;              ///< With the first of its usages that a profile matches.
  std::vector<HidProfile> profiles;  ///< At least one.
  bool may_open = false;             ///< This user may open the device.

  /// Returns the serial number that distinguishes it from others of its kind. Empty if its firmware
  /// gives no number, or gives all devices the same one (mbed's "0123456789").
  [[nodiscard]] std::string serial() const;
  /// Returns the identity for names and stored tests: its serial number, or else its port. Two arms
  /// without a number that swap ports are mistaken for each other. Empty if neither is known.
  [[nodiscard]] std::string identity() const;
  /// Returns the difference between the device's own report descriptor and a profile
  /// (complaintAbout). No value if they agree, or if the system does not show the descriptor.
  [[nodiscard]] std::optional<DeviceError> against(const HidProfile& profile) const;
  /// Returns the name for openArm: `hid:PROFILE@IDENTITY`.
  [[nodiscard]] std::string nameAs(const HidProfile& profile) const;
};

/// Returns the plugged-in devices that a profile matches, each once. Slow.
[[nodiscard]] std::vector<FoundArm> findArms(const std::vector<HidProfile>& profiles);

/// The parts of `hid`, `hid:PROFILE`, `hid:PROFILE@SERIAL` or `hid:FILE.json@SERIAL`. An arm
/// without a serial number has its port in that place.
struct ArmName {
  std::string profile;  ///< A name, or a path that ends in .json; empty: any.
  std::string serial;   ///< Empty: any. May have any character.
  [[nodiscard]] bool isFile()
      const;  ///< True if it ends in .json, even if the file does not exist.
};
/// Splits a name into its parts. Returns no value if it is not the name of an arm.
[[nodiscard]] std::optional<ArmName> parseArmName(const std::string& name);

/// Returns the profile of a name; `hid` alone has none. Throws DeviceError with a similar name if
/// no profile has that name.
///
/// @param say  Receives messages about user's files that cannot be used; may be empty.
[[nodiscard]] HidProfile namedProfile(const ArmName& name,
                                      const std::function<void(const std::string&)>& say);

/// A plugged-in arm, chosen by its name.
struct ChosenArm {
  FoundArm arm;        ///< Was not open in this process when it was found.
  HidProfile profile;  ///< The profile of `arm` that the name means.
};

/// Finds the arm of that name that is not yet open in this program. Throws DeviceError with the
/// matching names and the remedy if no arm or several arms match.
[[nodiscard]] ChosenArm findArm(const std::string& name,
                                const std::function<void(const std::string&)>& say);

/// An open arm, and the identity for its test.
struct OpenedArm {
  std::unique_ptr<Arm> device;  ///< Not null.
  ArmIdentity identity;         ///< Key under which its test is stored.
};

/// Finds an arm by its name, `hid...` (findArm), and opens it. Throws DeviceError, also if its
/// reports differ from the profile's.
[[nodiscard]] OpenedArm openArm(const std::string& name, const ArmHost& host);

/// Returns the key under which the test of an arm of this profile is stored; `own` is
/// FoundArm::identity.
[[nodiscard]] ArmIdentity identityOf(const HidProfile& profile, const std::string& own,
                                     bool numbered = true);

}  // namespace palpate
