/// What a HID device says of its own reports, and whether a profile has them so. Pure: no device is
/// needed.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "palpate/devices/hid_profile.h"

namespace palpate {

/// A report of a device.
struct DescribedReport {
  /// Who sends it: the device (input), the host (output), or either on request (feature).
  enum class Way : std::uint8_t { kInput, kOutput, kFeature };
  Way way = Way::kInput;  ///< One number may be used for each way.
  std::uint8_t id = 0;    ///< 0: the device numbers none.
  std::size_t size = 0;   ///< Bytes, the number not among them.
};

/// Each of its reports once, by way and number.
struct HidDescriptor {
  bool numbered = false;                 ///< All reports have a number, or none.
  std::vector<DescribedReport> reports;  ///< As parsed at least one, by their first fields.
};

/// Reads a report descriptor as far as numbers and sizes go (Device Class Definition for HID 1.11,
/// 6.2.2). Nothing for bytes that are none, or that tell of no report: an item that is cut off, a
/// pop of what was never pushed, a number 0, a report of more than 16 kB (Linux knows none). Any
/// bytes are safe; O(bytes).
[[nodiscard]] std::optional<HidDescriptor> parseHidDescriptor(std::span<const std::byte> bytes);

/// What of a profile the device has otherwise.
struct DescriptorComplaint {
  std::string path;    ///< In the profile, as /input/0.
  std::string what;    ///< In words, with what the device has.
  std::string remedy;  ///< What to change in the profile, or to look at.
};

/// The first report of a profile that the device does not have so: a number forgotten or one too
/// many, a report that does not exist, another size, a feature report that does not fit. What
/// drives nothing may leave the end of a report unread. Nothing: they agree.
[[nodiscard]] std::optional<DescriptorComplaint> complaintAbout(const HidProfile& profile,
                                                                const HidDescriptor& device);

}  // namespace palpate
