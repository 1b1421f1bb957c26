#include "palpate/devices/hid_descriptor.h"

#include <algorithm>
#include <iterator>
#include <utility>

namespace palpate {

namespace {

using Way = DescribedReport::Way;

constexpr std::uint64_t kMostBits = 131072;  // of a report: Linux' HID_MAX_BUFFER_SIZE, 16 kB
constexpr std::size_t kMostPushed = 64;

/// A short item's bytes without its length: tag and type (6.2.2.4 and 6.2.2.7).
enum Tag : std::uint8_t {
  kInputTag = 0x80,
  kOutputTag = 0x90,
  kFeatureTag = 0xB0,
  kSizeTag = 0x74,
  kIdTag = 0x84,
  kCountTag = 0x94,
  kPushTag = 0xA4,
  kPopTag = 0xB4,
};
constexpr std::uint8_t kLongItem = 0xFE;

/// What holds for the fields that follow.
struct Globals {
  std::uint64_t size = 0;  ///< Bits of a field.
  std::uint64_t count = 0;
  std::uint8_t id = 0;
};

/// Bits of each report, in the order of their first fields.
class Bits {
 public:
  /// False: larger than a report may be.
  [[nodiscard]] bool add(Way way, std::uint8_t id, std::uint64_t bits) {
    auto at = std::find_if(reports_.begin(), reports_.end(),
                           [&](const Report& r) { return r.way == way && r.id == id; });
    if (at == reports_.end()) at = reports_.insert(at, {way, id, 0});
    if (bits > kMostBits - at->bits) return false;
    at->bits += bits;
    return true;
  }
  [[nodiscard]] HidDescriptor descriptor(bool numbered) const {
    HidDescriptor out;
    out.numbered = numbered;
    for (const Report& report : reports_) {
      // Where some are numbered nothing can be said to one that is not.
      if (numbered && report.id == 0) continue;
      if (report.bits > 0) out.reports.push_back({report.way, report.id, (report.bits + 7) / 8});
    }
    return out;
  }

 private:
  struct Report {
    Way way;
    std::uint8_t id;
    std::uint64_t bits;
  };
  std::vector<Report> reports_;
};

std::optional<Way> wayOf(std::uint8_t tag) {
  switch (tag) {
    case kInputTag:
      return Way::kInput;
    case kOutputTag:
      return Way::kOutput;
    case kFeatureTag:
      return Way::kFeature;
    default:
      return std::nullopt;
  }
}

const char* wordOf(Way way) {
  return way == Way::kInput ? "input" : way == Way::kOutput ? "output" : "feature";
}

std::string bytesOf(std::size_t size) {
  return std::to_string(size) + (size == 1 ? " byte" : " bytes");
}

/// A report that a profile has, or a part of one.
struct Wanted {
  std::string path;
  Way way;
  std::optional<std::uint8_t> id;
  std::size_t size;
  bool at_least = false;  ///< The device's may be longer.
};

std::optional<DescriptorComplaint> compare(const Wanted& wanted, const HidDescriptor& device) {
  std::vector<DescribedReport> same;
  std::copy_if(device.reports.begin(), device.reports.end(), std::back_inserter(same),
               [&](const DescribedReport& r) { return r.way == wanted.way; });
  const std::string kind = std::string(wordOf(wanted.way)) + " report";
  if (same.empty()) {
    return DescriptorComplaint{wanted.path, "the device has no " + kind,
                               "see whether this is the right device, with the right firmware"};
  }
  constexpr std::size_t kMostSaid = 8;
  std::string said;
  for (std::size_t i = 0; i < same.size() && i <= kMostSaid; ++i) {
    said += i == 0 ? "" : ", ";
    said += i == kMostSaid ? "..." : std::to_string(same[i].id) + " of " + bytesOf(same[i].size);
  }
  const std::string has = "the device has " + kind + (same.size() == 1 ? " " : "s ") + said;
  const bool feature = wanted.way == Way::kFeature;
  const std::string number =
      same.size() > 1 ? std::string("write the number of the one that is meant")
                      : (feature ? "begin with " : "write \"id\": ") + std::to_string(same[0].id);
  if (!device.numbered && wanted.id) {
    return DescriptorComplaint{wanted.path, "the device does not number its reports",
                               feature ? "begin with 0" : "remove every \"id\""};
  }
  if (device.numbered && !wanted.id) {
    return DescriptorComplaint{wanted.path, has + ", and this has no number", number};
  }
  const auto at = std::find_if(same.begin(), same.end(), [&](const DescribedReport& r) {
    return r.id == wanted.id.value_or(0);
  });
  if (at == same.end()) {
    return DescriptorComplaint{wanted.path, has + ", and none " + std::to_string(*wanted.id),
                               number};
  }
  const bool fits = at->size == wanted.size || (wanted.at_least && at->size > wanted.size);
  if (fits) return std::nullopt;
  return DescriptorComplaint{wanted.path,
                             "the device's " + kind +
                                 (device.numbered ? " " + std::to_string(at->id) : "") + " has " +
                                 bytesOf(at->size) + (device.numbered ? " after its number" : "") +
                                 ", not " + std::to_string(wanted.size),
                             feature ? "send no more than that"
                                     : "write \"size\": " + std::to_string(at->size) +
                                           ", and see whether its fields are where they are"};
}

}  // namespace

std::optional<HidDescriptor> parseHidDescriptor(std::span<const std::byte> bytes) {
  Bits bits;
  Globals now;
  std::vector<Globals> pushed;
  bool numbered = false;
  while (!bytes.empty()) {
    const auto first = std::to_integer<std::uint8_t>(bytes[0]);
    if (first == kLongItem) {
      if (bytes.size() < 3) return std::nullopt;
      const std::size_t length = 3 + std::to_integer<std::size_t>(bytes[1]);
      if (bytes.size() < length) return std::nullopt;
      bytes = bytes.subspan(length);
      continue;
    }
    const std::size_t length = (first & 3U) == 3U ? 4 : first & 3U;
    if (bytes.size() < 1 + length) return std::nullopt;
    std::uint32_t value = 0;
    for (std::size_t k = 0; k < length; ++k) {
      value |= std::to_integer<std::uint32_t>(bytes[1 + k]) << (8 * k);
    }
    bytes = bytes.subspan(1 + length);
    const auto tag = static_cast<std::uint8_t>(first & 0xFCU);
    if (const std::optional<Way> way = wayOf(tag)) {
      if (!bits.add(*way, now.id, now.size * now.count)) return std::nullopt;
    } else if (tag == kSizeTag) {
      now.size = value;
    } else if (tag == kCountTag) {
      now.count = value;
    } else if (tag == kIdTag) {
      if (value == 0 || value > 255) return std::nullopt;
      now.id = static_cast<std::uint8_t>(value);
      numbered = true;
    } else if (tag == kPushTag) {
      if (pushed.size() == kMostPushed) return std::nullopt;
      pushed.push_back(now);
    } else if (tag == kPopTag) {
      if (pushed.empty()) return std::nullopt;
      now = pushed.back();
      pushed.pop_back();
    }
  }
  HidDescriptor out = bits.descriptor(numbered);
  if (out.reports.empty()) return std::nullopt;
  return out;
}

std::optional<DescriptorComplaint> complaintAbout(const HidProfile& profile,
                                                  const HidDescriptor& device) {
  std::vector<Wanted> all;
  for (std::size_t i = 0; i < profile.input.size(); ++i) {
    const HidReportSpec& report = profile.input[i];
    all.push_back({"/input/" + std::to_string(i), Way::kInput, report.id, report.size,
                   !profile.output.has_value()});
  }
  if (profile.output) {
    all.push_back({"/output", Way::kOutput, profile.output->id, profile.output->size});
  }
  const auto features = [&](const char* name, const std::vector<HidStep>& steps) {
    for (std::size_t i = 0; i < steps.size(); ++i) {
      if (steps[i].kind != HidStep::Kind::kFeature || steps[i].bytes.empty()) continue;
      const auto id = std::to_integer<std::uint8_t>(steps[i].bytes[0]);
      all.push_back({"/" + std::string(name) + "/" + std::to_string(i) + "/feature", Way::kFeature,
                     id == 0 ? std::nullopt : std::optional(id), steps[i].bytes.size() - 1, true});
    }
  };
  features("open", profile.open);
  features("home", profile.home);
  features("close", profile.close);
  for (const Wanted& wanted : all) {
    if (auto complaint = compare(wanted, device)) return complaint;
  }
  return std::nullopt;
}

}  // namespace palpate
