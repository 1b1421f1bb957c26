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

/// What fields mean: each usage from the first to the last, its page in the upper 16 bits.
struct DescribedUsages {
  std::uint32_t first = 0;  ///< The lowest,
  std::uint32_t last = 0;   ///< and the highest.
};

/// Fields side by side that one item of a descriptor tells of.
struct DescribedFields {
  DescribedReport::Way way = DescribedReport::Way::kInput;  ///< The report's,
  std::uint8_t id = 0;                                      ///< and its number; 0: none.
  std::uint32_t bit = 0;                ///< The first one's lowest, of the bytes after the number.
  std::uint32_t bits = 0;               ///< Of each, > 0.
  std::uint32_t count = 0;              ///< > 0.
  bool constant = false;                ///< They mean nothing.
  bool array = false;                   ///< Each says which one of `usages`, the first by `least`.
  bool relative = false;                ///< They say what has changed.
  std::int64_t least = 0;               ///< Raw ("logical"),
  std::int64_t most = 0;                ///< likewise.
  double physical_least = 0.0;          ///< What `least` stands for, in 10^exponent units;
  double physical_most = 0.0;           ///< where nothing is said, itself.
  std::uint32_t unit = 0;               ///< As it is written; 0: none.
  int exponent = 0;                     ///< Of ten, -8 to 7.
  std::vector<DescribedUsages> usages;  ///< In their order.
  std::vector<std::uint32_t> inside;    ///< Usages of collections about them, the outermost first.

  /// Of field i: where there are too few, the last; where there are none, 0.
  [[nodiscard]] std::uint32_t usage(std::uint32_t i) const noexcept;
  /// How far it is from the first usage to that one; nothing: it is not among them.
  [[nodiscard]] std::optional<std::uint32_t> placeOf(std::uint32_t usage) const noexcept;
};

/// Each of its reports once, by way and number.
struct HidDescriptor {
  bool numbered = false;                 ///< All reports have a number, or none.
  std::vector<DescribedReport> reports;  ///< As parsed at least one, by their first fields.
  std::vector<DescribedFields> fields;   ///< All within their reports, in the descriptor's order.
};

/// Reads a report descriptor (Device Class Definition for HID 1.11, 6.2.2). Nothing for bytes that
/// are none, or that tell of no report: an item that is cut off, a pop of what was never pushed, an
/// end of what has not begun, a number 0, a report of more than 16 kB (Linux knows none), more than
/// 1,024 items with fields, 32 collections in each other, or 1,024 usages of one item. Any bytes
/// are safe; O(bytes) but for collections.
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
