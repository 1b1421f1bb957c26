/// Private to devices: finds the positions, and the reports for a constant force, of a device of
/// USB's PID class in its report descriptor (Physical Interface Devices 1.01, usage page 0x0F).
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "palpate/devices/hid/hid_descriptor.h"
#include "palpate/devices/hid/hid_profile.h"
#include "palpate/devices/hid/hid_report.h"

namespace palpate {

/// Usages with their page: of PID 1.01, table 1, and kX of the page Generic Desktop.
namespace pid {
inline constexpr std::uint32_t kPage = 0x0F0000;
inline constexpr std::uint32_t kSetEffect = kPage | 0x21;
inline constexpr std::uint32_t kIndex = kPage | 0x22;
inline constexpr std::uint32_t kConstant = kPage | 0x26;
inline constexpr std::uint32_t kDuration = kPage | 0x50;
inline constexpr std::uint32_t kGain = kPage | 0x52;
inline constexpr std::uint32_t kTriggerButton = kPage | 0x53;
inline constexpr std::uint32_t kDirectionEnable = kPage | 0x56;
inline constexpr std::uint32_t kDirection = kPage | 0x57;
inline constexpr std::uint32_t kMagnitude = kPage | 0x70;
inline constexpr std::uint32_t kSetConstant = kPage | 0x73;
inline constexpr std::uint32_t kOperationReport = kPage | 0x77;
inline constexpr std::uint32_t kStart = kPage | 0x79;
inline constexpr std::uint32_t kStop = kPage | 0x7B;
inline constexpr std::uint32_t kLoopCount = kPage | 0x7C;
inline constexpr std::uint32_t kGainReport = kPage | 0x7D;
inline constexpr std::uint32_t kDeviceGain = kPage | 0x7E;
inline constexpr std::uint32_t kPool = kPage | 0x7F;
inline constexpr std::uint32_t kAtOnce = kPage | 0x83;  ///< Largest number of effects at a time.
inline constexpr std::uint32_t kBlockLoad = kPage | 0x89;
inline constexpr std::uint32_t kLoaded = kPage | 0x8C;
inline constexpr std::uint32_t kLoadFull = kPage | 0x8D;
inline constexpr std::uint32_t kLoadError = kPage | 0x8E;
inline constexpr std::uint32_t kBlockFree = kPage | 0x90;
inline constexpr std::uint32_t kEnable = kPage | 0x97;
inline constexpr std::uint32_t kDisable = kPage | 0x98;
inline constexpr std::uint32_t kStopAll = kPage | 0x99;
inline constexpr std::uint32_t kReset = kPage | 0x9A;
inline constexpr std::uint32_t kActuators = kPage | 0xA0;
inline constexpr std::uint32_t kSafety = kPage | 0xA4;
inline constexpr std::uint32_t kPower = kPage | 0xA6;
inline constexpr std::uint32_t kCreate = kPage | 0xAB;
inline constexpr std::uint32_t kX = 0x010030;  ///< Y and Z have the next two numbers.
}  // namespace pid

struct PidField {
  std::uint32_t usage = 0;
  std::uint32_t inside = 0;
  ReportField at;     ///< `least` and `most`: from the descriptor, within its bits.
  double step = 1.0;  ///< Size of one count in units, with the exponent applied.
  bool unit = false;
};

/// One of several choices, such as "start": a number in an array field, or a separate bit.
struct PidChoice {
  ReportField at;
  double raw = 1.0;
};

struct PidReport {
  DescribedReport report;
  std::vector<PidField> fields;
  std::vector<std::pair<std::uint32_t, PidChoice>> choices;

  [[nodiscard]] const PidField* find(std::uint32_t usage) const noexcept;     ///< Null: not found.
  [[nodiscard]] const PidChoice* choice(std::uint32_t usage) const noexcept;  ///< Null: not found.
};

/// A field of an input report.
struct PidInput {
  std::uint8_t report = 0;  ///< Report number; 0: not numbered.
  ReportField at;
};

/// Reports and fields of a device. The device must have the index, type, magnitude and operation of
/// a constant force. PidPort does not send reports that the device lacks.
struct PidMap {
  bool numbered = false;
  std::vector<DescribedReport> reports;
  std::array<std::optional<PidInput>, 3> axes;
  std::vector<PidInput> buttons;                     ///< At most HandleInfo::kMostButtons.
  std::optional<PidInput> actuators, safety, power;  ///< State bits; 1 means good.
  PidReport constant;
  PidReport operation;
  std::optional<PidReport> effect, create, load, free, control, gain, pool;
};

/// Finds the reports and fields in a descriptor. Throws DeviceError that names what the device
/// lacks for a constant force. Any descriptor is safe. If more than 64 fields of one kind are
/// adjacent, uses only the first 64.
[[nodiscard]] PidMap readPidMap(const HidDescriptor& device, const std::string& name);

/// Returns the profile of a PID device (HidProfile::pid) with the fields of the device. Inputs are
/// the device's positions, in counts. For each axis the output has a magnitude of 32 bits, in
/// counts, from which PidPort makes reports. Throws DeviceError for an axis that the device lacks.
[[nodiscard]] HidProfile describedBy(const PidMap& map, HidProfile profile);

}  // namespace palpate
