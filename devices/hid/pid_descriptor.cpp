#include "palpate/devices/hid/pid_descriptor.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "palpate/engine/error.h"

namespace palpate {

namespace {

using Way = DescribedReport::Way;

constexpr std::uint32_t kMostSideBySide = 64;
constexpr std::uint32_t kButtons = 0x090000;

/// Returns field i; no value if the field cannot be read or written as one number.
std::optional<ReportField> fieldAt(const DescribedFields& of, std::uint32_t i) {
  if (of.bits > 32) return std::nullopt;
  ReportField field;
  field.bit = of.bit + i * of.bits;
  field.bits = of.bits;
  field.type = of.least < 0 ? ReportField::Type::kSigned : ReportField::Type::kUnsigned;
  // Limits the range to the field's bits, because a descriptor may give a larger range.
  const double half = std::ldexp(1.0, static_cast<int>(of.bits) - 1);
  const bool with_sign = of.least < 0;
  const double low = with_sign ? -half : 0.0;
  const double high = with_sign ? half - 1.0 : 2.0 * half - 1.0;
  field.least = std::clamp(static_cast<double>(of.least), low, high);
  field.most = std::clamp(static_cast<double>(of.most), field.least, high);
  return field;
}

bool isInside(const DescribedFields& of, std::uint32_t usage) {
  return std::find(of.inside.begin(), of.inside.end(), usage) != of.inside.end();
}

std::uint32_t innermost(const DescribedFields& of) {
  return of.inside.empty() ? 0 : of.inside.back();
}

void addArray(const DescribedFields& of, const ReportField& field, PidReport& to) {
  std::uint32_t place = 0;
  for (const DescribedUsages& some : of.usages) {
    for (std::uint32_t u = some.first; place < kMostSideBySide; ++u, ++place) {
      const double raw = static_cast<double>(of.least) + place;
      if (raw >= field.least && raw <= field.most) to.choices.push_back({u, {field, raw}});
      if (u == some.last) {
        ++place;
        break;
      }
    }
  }
}

void addTo(PidReport& to, const DescribedFields& of) {
  if (of.constant || (of.usages.empty() && !of.array)) return;
  if (of.array) {
    // If an array holds several numbers, only the first is used.
    const std::optional<ReportField> field = fieldAt(of, 0);
    if (field) addArray(of, *field, to);
    return;
  }
  for (std::uint32_t i = 0; i < std::min(of.count, kMostSideBySide); ++i) {
    const std::optional<ReportField> field = fieldAt(of, i);
    if (!field) return;
    // Surplus fields repeat the last usage. PidReport::find() returns the first field of a usage.
    PidField found{of.usage(i), innermost(of), *field, 1.0, of.unit != 0};
    const double range = static_cast<double>(of.most) - static_cast<double>(of.least);
    if (range > 0.0 && of.physical_most > of.physical_least) {
      found.step = (of.physical_most - of.physical_least) / range;
    }
    found.step *= std::pow(10.0, of.exponent);
    if (of.bits == 1) {
      found.at.type = ReportField::Type::kUnsigned;
      found.at.least = 0.0;
      found.at.most = 1.0;
    }
    if (of.bits == 1) to.choices.push_back({found.usage, {found.at, 1.0}});
    to.fields.push_back(found);
  }
}

std::size_t sizeOf(const HidDescriptor& device, Way way, std::uint8_t id) {
  const auto at = std::find_if(device.reports.begin(), device.reports.end(),
                               [&](const auto& r) { return r.way == way && r.id == id; });
  return at == device.reports.end() ? 0 : at->size;
}

/// Finds the first output or feature report with fields for which `is` returns true. Returns the
/// report with these fields.
template <class Is>
std::optional<PidReport> reportOf(const HidDescriptor& device, Is is) {
  std::optional<PidReport> found;
  for (const DescribedFields& of : device.fields) {
    if (of.way == Way::kInput || !is(of)) continue;
    if (!found) {
      found.emplace();
      found->report = {of.way, of.id, sizeOf(device, of.way, of.id)};
    }
    if (of.way == found->report.way && of.id == found->report.id) addTo(*found, of);
  }
  return found;
}

std::optional<PidReport> reportOf(const HidDescriptor& device, std::uint32_t collection) {
  return reportOf(device, [&](const DescribedFields& of) { return isInside(of, collection); });
}

void takeInputs(const HidDescriptor& device, PidMap& map) {
  for (const DescribedFields& of : device.fields) {
    if (of.way != Way::kInput || of.constant || of.array || of.usages.empty()) continue;
    for (std::uint32_t i = 0; i < std::min(of.count, kMostSideBySide); ++i) {
      const std::uint32_t usage = of.usage(i);
      const std::optional<ReportField> field = fieldAt(of, i);
      if (!field) break;
      const PidInput input{of.id, *field};
      if (usage >= pid::kX && usage < pid::kX + 3) {
        auto& axis = map.axes[usage - pid::kX];
        if (!axis && !of.relative && field->most > field->least) axis = input;
      } else if ((usage & 0xFFFF0000U) == kButtons) {
        if (of.bits == 1 && map.buttons.size() < HandleInfo::kMostButtons) {
          map.buttons.push_back(input);
        }
      } else if (of.bits == 1) {
        for (auto [which, to] :
             {std::pair{pid::kActuators, &map.actuators}, std::pair{pid::kSafety, &map.safety},
              std::pair{pid::kPower, &map.power}}) {
          if (usage == which && !*to) *to = input;
        }
      }
    }
  }
}

[[noreturn]] void refuse(const std::string& name, const char* why) {
  throw DeviceError(name, why,
                    "check that its firmware has constant forces of USB's PID class; for a device "
                    "with reports of its own, write a profile with \"output\"");
}

}  // namespace

const PidField* PidReport::find(std::uint32_t usage) const noexcept {
  const auto at = std::find_if(fields.begin(), fields.end(),
                               [&](const PidField& field) { return field.usage == usage; });
  return at == fields.end() ? nullptr : &*at;
}

const PidChoice* PidReport::choice(std::uint32_t usage) const noexcept {
  const auto at = std::find_if(choices.begin(), choices.end(),
                               [&](const auto& choice) { return choice.first == usage; });
  return at == choices.end() ? nullptr : &at->second;
}

PidMap readPidMap(const HidDescriptor& device, const std::string& name) {
  PidMap map;
  map.numbered = device.numbered;
  map.reports = device.reports;
  takeInputs(device, map);
  const auto constant = reportOf(device, pid::kSetConstant);
  const auto operation = reportOf(device, pid::kOperationReport);
  if (!constant || constant->find(pid::kIndex) == nullptr ||
      constant->find(pid::kMagnitude) == nullptr) {
    refuse(name,
           "its descriptor has no report for the magnitude of a constant force with its index");
  }
  const ReportField& magnitude = constant->find(pid::kMagnitude)->at;
  if (!(magnitude.least < 0.0 && magnitude.most > 0.0)) {
    refuse(name, "its constant force cannot be both positive and negative");
  }
  if (!operation || operation->find(pid::kIndex) == nullptr ||
      operation->choice(pid::kStart) == nullptr || operation->choice(pid::kStop) == nullptr) {
    refuse(name, "its descriptor has no report that starts and stops an effect by its index");
  }
  map.constant = *constant;
  map.operation = *operation;
  map.effect = reportOf(device, pid::kSetEffect);
  map.create = reportOf(device, pid::kCreate);
  map.load = reportOf(device, pid::kBlockLoad);
  map.free = reportOf(device, pid::kBlockFree);
  map.gain = reportOf(device, pid::kGainReport);
  map.pool = reportOf(device, pid::kPool);
  // Finds the report by its usages, because descriptors name its collection in two different ways.
  map.control = reportOf(device, [](const DescribedFields& of) {
    return of.placeOf(pid::kStopAll) || of.placeOf(pid::kEnable) || of.placeOf(pid::kDisable);
  });
  const bool typed = (map.effect && map.effect->choice(pid::kConstant) != nullptr) ||
                     (map.create && map.create->choice(pid::kConstant) != nullptr);
  if (!typed) refuse(name, "its descriptor cannot set the type of an effect to constant force");
  return map;
}

HidProfile describedBy(const PidMap& map, HidProfile profile) {
  profile.input.clear();
  profile.joints.clear();
  profile.output.emplace();
  const ReportField& magnitude = map.constant.find(pid::kMagnitude)->at;
  const double full = std::min(-magnitude.least, magnitude.most);
  for (std::size_t i = 0; i < profile.pid.size(); ++i) {
    const PidAxisSpec& axis = profile.pid[i];
    const auto& input = map.axes[static_cast<std::size_t>(axis.axis)];
    const std::string name = kAxisNames[static_cast<std::size_t>(axis.axis)];
    if (!input) {
      throw DeviceError(profile.source + ": /pid/axes/" + std::to_string(i),
                        "the device does not report a position along " + name, "remove this axis");
    }
    const std::optional<std::uint8_t> id =
        map.numbered ? std::optional(input->report) : std::nullopt;
    auto report = std::find_if(profile.input.begin(), profile.input.end(),
                               [&](const HidReportSpec& spec) { return spec.id == id; });
    if (report == profile.input.end()) {
      report = profile.input.emplace(profile.input.end());
      report->id = id;
      for (const DescribedReport& r : map.reports) {
        if (r.way == Way::kInput && r.id == input->report) report->size = r.size;
      }
    }
    ReportField in = input->at;
    in.name = name;
    in.scale = axis.way / (in.most - in.least);
    in.offset = -in.scale * 0.5 * (in.most + in.least);
    ReportField out;
    out.name = name;
    out.bit = static_cast<std::uint32_t>(32 * i);
    out.bits = 32;
    out.scale = full / axis.force;
    out.least = -full;
    out.most = full;
    out.bounded = true;
    HidJoint joint;
    joint.from = {static_cast<std::size_t>(report - profile.input.begin()), report->fields.size()};
    joint.to = i;
    report->fields.push_back(in);
    profile.output->fields.push_back(out);
    profile.joints.push_back(joint);
  }
  profile.output->size = 4 * profile.pid.size();
  return profile;
}

}  // namespace palpate
