/// Parses the report descriptor of a HID device and compares it with a profile. Needs no device.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "palpate/devices/hid/hid_profile.h"

namespace palpate {

/// A report of a device.
struct DescribedReport {
  /// The sender: the device (input), the host (output), or either one on request (feature).
  enum class Way : std::uint8_t { kInput, kOutput, kFeature };
  Way way = Way::kInput;  ///< Direction. A number may occur once in each direction.
  std::uint8_t id = 0;    ///< Number of the report; 0: the device does not number its reports.
  std::size_t size = 0;   ///< Bytes without the number.
};

/// A range of usages. A usage is the meaning of a field; its upper 16 bits are its page.
struct DescribedUsages {
  std::uint32_t first = 0;  ///< Lowest usage.
  std::uint32_t last = 0;   ///< Highest usage.
};

/// Adjacent fields that one item of a descriptor describes.
struct DescribedFields {
  DescribedReport::Way way = DescribedReport::Way::kInput;  ///< Direction of their report.
  /// Number of their report; 0: the report has no number.
  std::uint8_t id = 0;
  std::uint32_t bit = 0;    ///< Lowest bit of the first field, in the bytes after the number.
  std::uint32_t bits = 0;   ///< Bits of each field, > 0.
  std::uint32_t count = 0;  ///< Number of fields, > 0.
  bool constant = false;    ///< The fields are padding without meaning.
  /// True if each field holds the number of a usage: a field of value v has usage(v - least).
  /// If false, field i has usage(i).
  bool array = false;
  bool relative = false;   ///< The values are changes, not positions.
  std::int64_t least = 0;  ///< Lowest raw ("logical") value.
  std::int64_t most = 0;   ///< Highest raw value.
  /// Physical value of `least`, in 10^exponent units; default `least`.
  double physical_least = 0.0;
  /// Physical value of `most`, in 10^exponent units; default `most`.
  double physical_most = 0.0;
  std::uint32_t unit = 0;               ///< Raw code of the unit; 0: no unit.
  int exponent = 0;                     ///< Power of ten, -8 to 7.
  std::vector<DescribedUsages> usages;  ///< Ranges of usages, in the descriptor's order.
  std::vector<std::uint32_t> inside;    ///< Usages of enclosing collections, outermost first.

  /// Returns the usage of field i. Surplus fields have the last usage. Without usages returns 0.
  [[nodiscard]] std::uint32_t usage(std::uint32_t i) const noexcept;
  /// Returns the index of a usage; no value if `usages` does not contain it.
  [[nodiscard]] std::optional<std::uint32_t> placeOf(std::uint32_t usage) const noexcept;
};

/// A parsed descriptor. Each report appears once, by direction and number.
struct HidDescriptor {
  /// True: all reports have a number. False: no report has a number.
  bool numbered = false;
  std::vector<DescribedReport> reports;  ///< At least one, in the order of their first fields.
  std::vector<DescribedFields> fields;   ///< In the descriptor's order, each within its report.
};

/// Parses a report descriptor (Device Class Definition for HID 1.11, 6.2.2). Any bytes are safe.
/// Cost: O(bytes), and for each item with fields O(its usages, enclosing collections and reports).
///
/// Returns no value if the bytes describe no report or are invalid. The following are invalid: an
/// item that is cut off, a pop without a push, an end without a begin, a report number outside of 1
/// to 255. A report of more than 16 kB (the limit of Linux) is also invalid. So are more than 1,024
/// items with fields, 64 pushes, 32 nested collections, or 1,024 usages and ranges of one item.
[[nodiscard]] std::optional<HidDescriptor> parseHidDescriptor(std::span<const std::byte> bytes);

/// A difference between a profile and the device.
struct DescriptorComplaint {
  std::string path;    ///< Path in the profile, such as /input/0.
  std::string what;    ///< The problem in words, with the device's value.
  std::string remedy;  ///< The change to make in the profile, or the check.
};

/// Returns the first difference between a profile and the device's descriptor: a missing or
/// superfluous report number, a report that does not exist, another size, or a feature report that
/// does not fit. A profile without an output may leave the end of a report unread.
[[nodiscard]] std::optional<DescriptorComplaint> complaintAbout(const HidProfile& profile,
                                                                const HidDescriptor& device);

}  // namespace palpate
