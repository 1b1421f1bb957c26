#include "palpate/devices/hid/arm_watch.h"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include "palpate/devices/hid/profile_facts.h"

namespace palpate {

namespace {

constexpr std::size_t kLongest = 4096;   // longest report [bytes]
constexpr std::size_t kShown = 64;       // bytes of a report that are printed
constexpr std::size_t kMostReads = 512;  // largest number of reports read per call

double seconds(std::int64_t ns) {
  return 1e-9 * static_cast<double>(ns);
}

std::string hex(std::span<const std::byte> bytes) {
  std::string out;
  for (std::size_t i = 0; i < std::min(bytes.size(), kShown); ++i) {
    out += fmt::format("{}{:02x}", i == 0 ? "" : " ", std::to_integer<unsigned>(bytes[i]));
  }
  return bytes.size() > kShown ? out + " ..." : out;
}

const char* wordOf(HidFlag::Means means) {
  using Means = HidFlag::Means;
  switch (means) {
    case Means::kHomed:
      return "homed";
    case Means::kEnabled:
      return "enabled";
    case Means::kHot:
      return "hot";
    case Means::kUnpowered:
      return "unpowered";
    case Means::kOpen:
      return "open";
  }
  return "";
}

}  // namespace

ArmWatch::ArmWatch(HidProfile profile)
    : profile_(std::move(profile)),
      counters_(profile_.joints.size()),
      about_(rawInMiddle(profile_, factsOf(profile_))),
      home_raw_(profile_.joints.size(), 0.0),
      seen_(profile_.joints.size(), false),
      buffer_(kLongest) {
  for (std::size_t r = 0; r < profile_.input.size(); ++r) {
    Kind kind;
    kind.spec = r;
    kind.id = profile_.input[r].id.value_or(0);
    numbered_ = numbered_ || profile_.input[r].id.has_value();
    kinds_.push_back(kind);
  }
}

ArmWatch::Kind* ArmWatch::kindOf(std::span<const std::byte> report) {
  const std::uint8_t id =
      numbered_ && !report.empty() ? std::to_integer<std::uint8_t>(report[0]) : std::uint8_t{0};
  const auto at =
      std::find_if(kinds_.begin(), kinds_.end(), [&](const Kind& kind) { return kind.id == id; });
  if (at != kinds_.end()) return &*at;
  if (kinds_.size() >= profile_.input.size() + kMostStrange) return nullptr;
  kinds_.emplace_back().id = id;
  return &kinds_.back();
}

ReadStatus ArmWatch::take(ReportPort& port, std::int64_t now) {
  if (!begun_) span_ = now;
  begun_ = true;
  bool any = false;
  for (std::size_t i = 0; i < kMostReads; ++i) {
    std::size_t size = 0;
    const ReadStatus got = port.read(buffer_, size);
    if (got == ReadStatus::kGone) return ReadStatus::kGone;
    if (got == ReadStatus::kNothing) break;
    any = true;
    const auto report = std::span<const std::byte>(buffer_).first(std::min(size, buffer_.size()));
    Kind* kind = kindOf(report);
    if (kind == nullptr) {
      ++passed_by_;
      continue;
    }
    kind->bytes.assign(report.begin(), report.end());
    ++kind->count;
    ++kind->total;
    kind->at = now;
    if (kind->spec != kNoSpec) follow();
  }
  return any ? ReadStatus::kReport : ReadStatus::kNothing;
}

std::span<const std::byte> ArmWatch::bodyFor(const FieldRef& field) const {
  const Kind& kind = kinds_[field.report];
  const std::size_t head = numbered_ ? 1 : 0;
  if (kind.total == 0 || kind.bytes.size() < head) return {};
  const auto body = std::span<const std::byte>(kind.bytes).subspan(head);
  return body.size() < profile_.input[field.report].fields[field.field].end()
             ? std::span<const std::byte>()
             : body;
}

void ArmWatch::follow() {
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    const FieldRef from = profile_.joints[i].from;
    const std::span<const std::byte> body = bodyFor(from);
    if (body.empty()) continue;
    const ReportField& field = profile_.input[from.report].fields[from.field];
    double raw = rawOf(body, field);
    if (!seen_[i]) {
      home_raw_[i] = raw;
      if (profile_.home_at_open) about_[i] = raw;
    }
    seen_[i] = true;
    if (field.wraps) raw = counters_[i].follow(raw, field.bits, about_[i]);
    joints_[i] = jointAt(profile_, i, raw, home_raw_[i]);
  }
}

std::string ArmWatch::wordsOf(const Kind& kind, std::int64_t now) const {
  std::string out = "report";
  if (numbered_) out += fmt::format(" {}", kind.id);
  if (kind.total == 0) return out + ": none received\n";
  const double span = seconds(now - span_);
  const double age = seconds(now - kind.at);
  const std::size_t head = numbered_ ? 1 : 0;
  const std::size_t size = kind.bytes.size() - std::min(head, kind.bytes.size());
  out += fmt::format(", {} byte{}", size, size == 1 ? "" : "s");
  if (kind.count == 0) {
    out += fmt::format(": NONE in the last {:.2f} s, last received {:.2f} s ago", span, age);
  } else if (span > 0.0) {
    out += fmt::format(": {:.0f} per second, last received {:.2f} s ago",
                       static_cast<double>(kind.count) / span, age);
  }
  if (kind.spec == kNoSpec) out += ", not in the profile";
  out += "\n  " + hex(kind.bytes) + "\n";
  if (kind.spec == kNoSpec) return out;
  const HidReportSpec& spec = profile_.input[kind.spec];
  for (std::size_t f = 0; f < spec.fields.size(); ++f) {
    const ReportField& field = spec.fields[f];
    const std::span<const std::byte> body = bodyFor({kind.spec, f});
    if (body.empty()) {
      out += fmt::format("  {:16} beyond the report's end\n", field.name);
      continue;
    }
    const double raw = rawOf(body, field);
    out += fmt::format("  {:16} {:>12g} {:>14.6g}\n", field.name, raw,
                       field.scale * raw + field.offset);
  }
  return out;
}

std::string ArmWatch::arm(std::int64_t now) const {
  std::string out;
  std::int64_t oldest = now;
  bool all = true;
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    const HidJoint& joint = profile_.joints[i];
    const std::string& from = profile_.input[joint.from.report].fields[joint.from.field].name;
    out += seen_[i] ? fmt::format("joint {} of {:16} {:>14.6g}\n", i + 1, from, joints_[i])
                    : fmt::format("joint {} of {:16} not known\n", i + 1, from);
    all = all && seen_[i];
    oldest = std::min(oldest, kinds_[joint.from.report].at);
  }
  if (all) {
    const ArmPose pose = profile_.kinematics->at(joints_);
    const Vec3 p_W = profile_.world_from_device * (pose.position_D - profile_.origin_D);
    if (!pose.reachable) {
      out += "tip: unknown, because the joint values do not fit the arm's geometry\n";
    } else if (profile_.rate_control > 0.0) {
      out += fmt::format("deflected by ({:.3f}, {:.3f}, {:.3f}), full scale 1", p_W.x(), p_W.y(),
                         p_W.z());
    } else {
      out += fmt::format("tip at ({:.5f}, {:.5f}, {:.5f}) m in the hand's world", p_W.x(), p_W.y(),
                         p_W.z());
    }
    if (pose.reachable) {
      // A 3D mouse sends no reports while it rests, so the age of its position is not shown.
      const double age = seconds(now - oldest);
      const bool old = age > profile_.limits.stale && profile_.rate_control <= 0.0;
      out += old ? fmt::format(", {:.2f} s ago\n", age) : "\n";
    }
  }
  for (const HidFlag& flag : profile_.flags) {
    const ReportField& field = profile_.input[flag.field.report].fields[flag.field.field];
    const std::span<const std::byte> body = bodyFor(flag.field);
    out += fmt::format("flag {} ({} is {:g}): {}\n", wordOf(flag.means), field.name, flag.equals,
                       body.empty()                        ? "not known"
                       : rawOf(body, field) == flag.equals ? "yes"
                                                           : "no");
  }
  return out;
}

std::string ArmWatch::picture(std::int64_t now) {
  std::string out;
  bool any = false;
  for (const Kind& kind : kinds_) {
    out += wordsOf(kind, now);
    any = any || kind.total > 0;
  }
  if (passed_by_ > 0) out += fmt::format("{} more reports of unknown kinds\n", passed_by_);
  out += arm(now);
  if (!any && profile_.output) {
    out +=
        "no report received: the firmware may only reply to reports, and this command sends none\n";
  }
  for (Kind& kind : kinds_) kind.count = 0;
  span_ = now;
  return out;
}

}  // namespace palpate
