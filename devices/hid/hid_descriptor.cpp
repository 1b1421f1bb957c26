#include "palpate/devices/hid/hid_descriptor.h"

#include <algorithm>
#include <iterator>
#include <tuple>
#include <utility>

namespace palpate {

namespace {

using Way = DescribedReport::Way;

constexpr std::uint64_t kMostBits = 131072;  // bits of a report: Linux' HID_MAX_BUFFER_SIZE, 16 kB
constexpr std::size_t kMostPushed = 64;

constexpr std::size_t kMostFields = 1024;  // items that describe fields
constexpr std::size_t kMostUsages = 1024;  // usages and ranges of one item
constexpr std::size_t kDeepest = 32;       // levels of nested collections

/// Tag and type of a short item, without its length (HID 1.11: 6.2.2.4, 6.2.2.7, 6.2.2.8).
enum Tag : std::uint8_t {
  kInputTag = 0x80,
  kOutputTag = 0x90,
  kFeatureTag = 0xB0,
  kBeginTag = 0xA0,
  kEndTag = 0xC0,
  kPageTag = 0x04,
  kLeastTag = 0x14,
  kMostTag = 0x24,
  kPhysicalLeastTag = 0x34,
  kPhysicalMostTag = 0x44,
  kExponentTag = 0x54,
  kUnitTag = 0x64,
  kSizeTag = 0x74,
  kIdTag = 0x84,
  kCountTag = 0x94,
  kPushTag = 0xA4,
  kPopTag = 0xB4,
  kUsageTag = 0x08,
  kFirstUsageTag = 0x18,
  kLastUsageTag = 0x28,
};
constexpr std::uint8_t kLongItem = 0xFE;

struct Item {
  std::uint8_t tag = 0;
  std::uint32_t value = 0;
  std::size_t length = 0;  ///< Bytes of the value: 0, 1, 2 or 4.
  [[nodiscard]] std::int64_t withSign() const noexcept {
    if (length == 1) return static_cast<std::int8_t>(value);
    if (length == 2) return static_cast<std::int16_t>(value);
    return static_cast<std::int32_t>(value);
  }
};

/// State that holds for all later fields, until an item changes it.
struct Globals {
  std::uint64_t size = 0;  ///< Bits of a field.
  std::uint64_t count = 0;
  std::uint8_t id = 0;
  std::uint32_t page = 0;
  Item least, most, physical_least, physical_most;
  Item exponent;
  std::uint32_t unit = 0;
};

/// Returns the ends of a range. If the lower end is below 0, both ends are signed.
std::pair<std::int64_t, std::int64_t> range(const Item& least, const Item& most) {
  const std::int64_t low = least.withSign();
  return {low, low < 0 ? most.withSign() : static_cast<std::int64_t>(most.value)};
}

/// Returns the exponent in an item. HID 1.11 defines four bits with a sign, but a device may write
/// a signed byte.
int exponentOf(const Item& item) {
  const auto whole = static_cast<int>(std::clamp<std::int64_t>(item.withSign(), -8, 15));
  return whole > 7 ? whole - 16 : whole;
}

/// State that holds for the next main item only.
class Locals {
 public:
  [[nodiscard]] bool take(const Item& item) {
    if (item.tag == kFirstUsageTag) {
      first_ = item;
      return true;
    }
    if (usages_.size() == kMostUsages) return false;
    if (item.tag == kUsageTag) usages_.emplace_back(item, item);
    if (item.tag == kLastUsageTag && first_) usages_.emplace_back(*first_, item);
    if (item.tag == kLastUsageTag) first_.reset();
    return true;
  }
  /// A usage of fewer than 4 bytes gets the page that is set at the main item (HID 1.11, 6.2.2.8).
  [[nodiscard]] std::vector<DescribedUsages> usages(std::uint32_t page) const {
    const auto whole = [&](const Item& item) {
      return item.length == 4 ? item.value : page << 16U | item.value;
    };
    std::vector<DescribedUsages> all;
    for (const auto& [first, last] : usages_) {
      if (whole(first) <= whole(last)) all.push_back({whole(first), whole(last)});
    }
    return all;
  }
  void forget() {
    usages_.clear();
    first_.reset();
  }

 private:
  std::vector<std::pair<Item, Item>> usages_;
  std::optional<Item> first_;
};

class Bits {
 public:
  /// Returns the index of the fields' first bit; no value if the report would be too large.
  [[nodiscard]] std::optional<std::uint64_t> add(Way way, std::uint8_t id, std::uint64_t bits) {
    auto at = std::find_if(reports_.begin(), reports_.end(),
                           [&](const Report& r) { return r.way == way && r.id == id; });
    if (at == reports_.end()) at = reports_.insert(at, {way, id, 0});
    if (bits > kMostBits - at->bits) return std::nullopt;
    at->bits += bits;
    return at->bits - bits;
  }
  [[nodiscard]] HidDescriptor descriptor(bool numbered) const {
    HidDescriptor out;
    out.numbered = numbered;
    for (const Report& report : reports_) {
      // If some reports have numbers, a report without a number cannot be addressed.
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

struct Wanted {
  std::string path;
  Way way;
  std::optional<std::uint8_t> id;
  std::size_t size;
  bool at_least = false;  ///< The device's report may be longer.
};

std::optional<DescriptorComplaint> compare(const Wanted& wanted, const HidDescriptor& device) {
  std::vector<DescribedReport> same;
  std::copy_if(device.reports.begin(), device.reports.end(), std::back_inserter(same),
               [&](const DescribedReport& r) { return r.way == wanted.way; });
  const std::string kind = std::string(wordOf(wanted.way)) + " report";
  if (same.empty()) {
    return DescriptorComplaint{wanted.path, "the device has no " + kind,
                               "check that this is the right device with the right firmware"};
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
      same.size() > 1
          ? std::string("write the number of the intended report")
          : (feature ? "write the first byte as " : "write \"id\": ") + std::to_string(same[0].id);
  if (!device.numbered && wanted.id) {
    return DescriptorComplaint{wanted.path, "the device does not number its reports",
                               feature ? "write the first byte as 0" : "remove every \"id\""};
  }
  if (device.numbered && !wanted.id) {
    return DescriptorComplaint{wanted.path, has + ", and this report has no number", number};
  }
  const auto at = std::find_if(same.begin(), same.end(), [&](const DescribedReport& r) {
    return r.id == wanted.id.value_or(0);
  });
  if (at == same.end()) {
    return DescriptorComplaint{wanted.path, has + ", but no report " + std::to_string(*wanted.id),
                               number};
  }
  const bool fits = at->size == wanted.size || (wanted.at_least && at->size > wanted.size);
  if (fits) return std::nullopt;
  return DescriptorComplaint{wanted.path,
                             "the device's " + kind +
                                 (device.numbered ? " " + std::to_string(at->id) : "") + " has " +
                                 bytesOf(at->size) + (device.numbered ? " after its number" : "") +
                                 ", not " + std::to_string(wanted.size),
                             feature ? "send at most " + bytesOf(at->size) + " after the first"
                                     : "write \"size\": " + std::to_string(at->size) +
                                           ", and check the positions of its fields"};
}

}  // namespace

std::uint32_t DescribedFields::usage(std::uint32_t i) const noexcept {
  for (const DescribedUsages& some : usages) {
    const std::uint32_t more = some.last - some.first;
    if (i <= more) return some.first + i;
    i -= more + 1;
  }
  return usages.empty() ? 0 : usages.back().last;
}

std::optional<std::uint32_t> DescribedFields::placeOf(std::uint32_t usage) const noexcept {
  std::uint32_t before = 0;
  for (const DescribedUsages& some : usages) {
    if (some.first <= usage && usage <= some.last) return before + (usage - some.first);
    before += some.last - some.first + 1;
  }
  return std::nullopt;
}

namespace {

/// Removes the first item from `bytes`. Returns no value if the bytes end within the item.
std::optional<Item> takeItem(std::span<const std::byte>& bytes) {
  const auto first = std::to_integer<std::uint8_t>(bytes[0]);
  if (first == kLongItem) {
    if (bytes.size() < 3) return std::nullopt;
    const std::size_t length = 3 + std::to_integer<std::size_t>(bytes[1]);
    if (bytes.size() < length) return std::nullopt;
    bytes = bytes.subspan(length);
    return Item{};
  }
  Item item;
  item.tag = static_cast<std::uint8_t>(first & 0xFCU);
  item.length = (first & 3U) == 3U ? 4 : first & 3U;
  if (bytes.size() < 1 + item.length) return std::nullopt;
  for (std::size_t k = 0; k < item.length; ++k) {
    item.value |= std::to_integer<std::uint32_t>(bytes[1 + k]) << (8 * k);
  }
  bytes = bytes.subspan(1 + item.length);
  return item;
}

class Walk {
 public:
  [[nodiscard]] bool take(const Item& item) {
    if (const std::optional<Way> way = wayOf(item.tag)) return takeFields(*way, item.value);
    switch (item.tag) {
      case kBeginTag: {
        if (inside_.size() == kDeepest) return false;
        const auto usages = local_.usages(now_.page);
        inside_.push_back(usages.empty() ? 0 : usages.front().first);
        local_.forget();
        return true;
      }
      case kEndTag:
        if (inside_.empty()) return false;
        inside_.pop_back();
        local_.forget();
        return true;
      case kUsageTag:
      case kFirstUsageTag:
      case kLastUsageTag:
        return local_.take(item);
      default:
        return takeGlobal(item);
    }
  }
  [[nodiscard]] std::optional<HidDescriptor> result() {
    HidDescriptor out = bits_.descriptor(numbered_);
    if (out.reports.empty()) return std::nullopt;
    for (DescribedFields& fields : fields_) {
      if (!numbered_ || fields.id != 0) out.fields.push_back(std::move(fields));
    }
    return out;
  }

 private:
  [[nodiscard]] bool takeGlobal(const Item& item) {
    switch (item.tag) {
      case kPageTag:
        now_.page = item.value & 0xFFFFU;
        break;
      case kLeastTag:
        now_.least = item;
        break;
      case kMostTag:
        now_.most = item;
        break;
      case kPhysicalLeastTag:
        now_.physical_least = item;
        break;
      case kPhysicalMostTag:
        now_.physical_most = item;
        break;
      case kExponentTag:
        now_.exponent = item;
        break;
      case kUnitTag:
        now_.unit = item.value;
        break;
      case kSizeTag:
        now_.size = item.value;
        break;
      case kCountTag:
        now_.count = item.value;
        break;
      case kIdTag:
        if (item.value == 0 || item.value > 255) return false;
        now_.id = static_cast<std::uint8_t>(item.value);
        numbered_ = true;
        break;
      case kPushTag:
        if (pushed_.size() == kMostPushed) return false;
        pushed_.push_back(now_);
        break;
      case kPopTag:
        if (pushed_.empty()) return false;
        now_ = pushed_.back();
        pushed_.pop_back();
        break;
      default:
        break;
    }
    return true;
  }
  [[nodiscard]] bool takeFields(Way way, std::uint32_t flags) {
    const std::uint64_t bits = now_.size * now_.count;
    const std::optional<std::uint64_t> bit = bits_.add(way, now_.id, bits);
    if (!bit) return false;
    if (bits > 0) {
      if (fields_.size() == kMostFields) return false;
      DescribedFields fields;
      fields.way = way;
      fields.id = now_.id;
      fields.bit = static_cast<std::uint32_t>(*bit);
      fields.bits = static_cast<std::uint32_t>(now_.size);
      fields.count = static_cast<std::uint32_t>(now_.count);
      fields.constant = (flags & 1U) != 0;
      fields.array = (flags & 2U) == 0;
      fields.relative = (flags & 4U) != 0;
      std::tie(fields.least, fields.most) = range(now_.least, now_.most);
      const auto [low, high] = range(now_.physical_least, now_.physical_most);
      const bool said = low != 0 || high != 0;
      fields.physical_least = static_cast<double>(said ? low : fields.least);
      fields.physical_most = static_cast<double>(said ? high : fields.most);
      fields.unit = now_.unit;
      fields.exponent = exponentOf(now_.exponent);
      fields.usages = local_.usages(now_.page);
      fields.inside = inside_;
      fields_.push_back(std::move(fields));
    }
    local_.forget();
    return true;
  }

  Bits bits_;
  Globals now_;
  Locals local_;
  std::vector<Globals> pushed_;
  std::vector<std::uint32_t> inside_;
  std::vector<DescribedFields> fields_;
  bool numbered_ = false;
};

}  // namespace

std::optional<HidDescriptor> parseHidDescriptor(std::span<const std::byte> bytes) {
  Walk walk;
  while (!bytes.empty()) {
    const std::optional<Item> item = takeItem(bytes);
    if (!item || !walk.take(*item)) return std::nullopt;
  }
  return walk.result();
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
