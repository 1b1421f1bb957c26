/// From a name, as `hid:polhem@SERIAL`, to an arm that is open; and which arms have been tested.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "devices/hid_device.h"
#include "devices/self_test.h"

namespace palpate {

/// A device that is plugged in, and the profiles that it may be of.
struct FoundArm {
  HidDeviceName device;
  std::vector<HidProfile> profiles;  ///< At least one.
  bool may_open = false;             ///< The system lets this user.

  /// What tells it from others of its kind; empty where its firmware gives none, or the same to all
  /// (mbed's "0123456789").
  [[nodiscard]] std::string serial() const;
  /// As openArm takes it: hid:PROFILE@SERIAL.
  [[nodiscard]] std::string nameAs(const HidProfile& profile) const;
};

/// Those that are plugged in and that a profile matches. Slow.
[[nodiscard]] std::vector<FoundArm> findArms(const std::vector<HidProfile>& profiles);

/// Opens `hid`, `hid:PROFILE`, `hid:PROFILE@SERIAL`; PROFILE is a name or a .json file. Throws
/// DeviceError: none or several are there, which ones, and what to write.
[[nodiscard]] std::unique_ptr<HidDevice> openArm(
    const std::string& name, const std::function<void(const std::string&)>& say);

/// Where `palpate devices --test` keeps what it found: $XDG_STATE_HOME/palpate/arms.json or
/// ~/.local/state/palpate/arms.json.
[[nodiscard]] std::filesystem::path testedArmsFile();
/// True where the arm of this serial number has passed with this very profile. An arm without a
/// serial number never has.
[[nodiscard]] bool isTested(const HidProfile& profile, const std::string& serial);
/// Remembers that it has, and what was measured. Throws DeviceError where it cannot be written.
void rememberTest(const HidProfile& profile, const std::string& serial,
                  const SelfTestResult& result);

}  // namespace palpate
