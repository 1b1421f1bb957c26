/// From a name, as `hid:polhem@SERIAL`, to an arm that is open.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "palpate/devices/hid_device.h"
#include "palpate/engine/error.h"

namespace palpate {

/// A device that is plugged in, and the profiles that it may be of.
struct FoundArm {
  HidDeviceName device;              ///< Of its usages the first that a profile matches.
  std::vector<HidProfile> profiles;  ///< At least one.
  bool may_open = false;             ///< The system lets this user.

  /// What tells it from others of its kind; empty where its firmware gives none, or the same to all
  /// (mbed's "0123456789").
  [[nodiscard]] std::string serial() const;
  /// By which it is named and remembered: its serial number, or where it is plugged in. Two arms of
  /// no number that are exchanged there are taken for each other. Empty where neither is known.
  [[nodiscard]] std::string identity() const;
  /// What the device's own report descriptor has against a profile (complaintAbout); nothing also
  /// where the system does not show it.
  [[nodiscard]] std::optional<DeviceError> against(const HidProfile& profile) const;
  /// As openArm takes it: `hid:PROFILE@IDENTITY`.
  [[nodiscard]] std::string nameAs(const HidProfile& profile) const;
};

/// Those that are plugged in and that a profile matches, each once. Slow.
[[nodiscard]] std::vector<FoundArm> findArms(const std::vector<HidProfile>& profiles);

/// `hid`, `hid:PROFILE`, `hid:PROFILE@SERIAL` or `hid:FILE.json@SERIAL`, taken apart; an arm of no
/// serial number has its port there.
struct ArmName {
  std::string profile;                ///< A name, or a path that ends in .json; empty: any.
  std::string serial;                 ///< Empty: any. May have any character.
  [[nodiscard]] bool isFile() const;  ///< By its ending, .json, whether it is there or not.
};
/// Nothing where it is no arm's name.
[[nodiscard]] std::optional<ArmName> parseArmName(const std::string& name);

/// The profile that is meant; of `hid` alone none is. Throws DeviceError: there is none of that
/// name, and which is near.
///
/// @param say  Told of files of the user's that cannot be used; may be empty.
[[nodiscard]] HidProfile namedProfile(const ArmName& name,
                                      const std::function<void(const std::string&)>& say);

/// An arm that is plugged in, as it was named.
struct ChosenArm {
  FoundArm arm;        ///< Not open in this process when it was looked for.
  HidProfile profile;  ///< That of its profiles which the name means.
};

/// The arm of that name that this program does not have yet. Throws DeviceError: none or several
/// are there, which ones, and what to write.
[[nodiscard]] ChosenArm findArm(const std::string& name,
                                const std::function<void(const std::string&)>& say);

/// An arm that is ready, and by what its test is remembered.
struct OpenedArm {
  std::unique_ptr<Arm> device;  ///< Not null.
  ArmIdentity identity;         ///< Its test is remembered by it.
};

/// Finds an arm by its name, `hid...` (findArm), and opens it. Throws DeviceError, also where its
/// reports are not the profile's.
[[nodiscard]] OpenedArm openArm(const std::string& name, const ArmHost& host);

/// By what the test of an arm of this profile is remembered; `own` as FoundArm::identity.
[[nodiscard]] ArmIdentity identityOf(const HidProfile& profile, const std::string& own,
                                     bool numbered = true);

}  // namespace palpate
