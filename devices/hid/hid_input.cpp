#include "palpate/devices/hid/hid_input.h"

#include <algorithm>
#include <span>

namespace palpate {

namespace {

// Waiting reports at which the kernel's ring counts as full; it keeps 63 and drops later ones.
constexpr std::size_t kFullRing = 60;
constexpr std::size_t kMostReads = 128;  // largest number of reports read per call

}  // namespace

HidInput::HidInput(const HidProfile& profile) : profile_(profile) {
  std::size_t fields = 0;
  for (const HidReportSpec& report : profile.input) {
    first_.push_back(fields);
    fields += report.fields.size();
    if (report.id) head_ = 1;
  }
  values_.assign(fields, 0.0);
  forget();
  joints_in_.assign(profile.input.size(), false);
  for (const HidJoint& joint : profile.joints) joints_in_[joint.from.report] = true;
  fresh_.assign(profile.input.size(), false);
  came_ = known_ = fresh_;
}

HidInput::Taken HidInput::take(std::span<const std::byte> report) noexcept {
  for (std::size_t r = 0; r < profile_.input.size(); ++r) {
    const HidReportSpec& spec = profile_.input[r];
    if (spec.id && (report.empty() || static_cast<std::byte>(*spec.id) != report[0])) continue;
    const std::span<const std::byte> body = report.subspan(std::min(head_, report.size()));
    std::size_t needed = 0;
    for (const ReportField& field : spec.fields) needed = std::max(needed, field.end());
    if (body.size() < needed) return Taken::kStrange;
    if (spec.sequence && known_[r] &&
        values_[first_[r] + *spec.sequence] == rawOf(body, spec.fields[*spec.sequence])) {
      return Taken::kRepeated;
    }
    for (std::size_t f = 0; f < spec.fields.size(); ++f) {
      values_[first_[r] + f] = rawOf(body, spec.fields[f]);
    }
    fresh_[r] = came_[r] = known_[r] = true;
    return Taken::kUsed;
  }
  return Taken::kStrange;
}

void HidInput::forget() noexcept {
  // Before its first report a 3D mouse is assumed to be at rest.
  for (std::size_t r = 0; r < profile_.input.size(); ++r) {
    for (std::size_t f = 0; f < profile_.input[r].fields.size(); ++f) {
      const ReportField& field = profile_.input[r].fields[f];
      values_[first_[r] + f] = profile_.rate_control > 0.0 ? -field.offset / field.scale : 0.0;
    }
  }
  std::fill(fresh_.begin(), fresh_.end(), false);
  came_ = known_ = fresh_;
}

void HidInput::adopt(const HidInput& other) noexcept {
  std::copy(other.values_.begin(), other.values_.end(), values_.begin());
  std::copy(other.known_.begin(), other.known_.end(), known_.begin());
  std::fill(fresh_.begin(), fresh_.end(), false);
}

ReadStatus HidInput::takeNewest(ReportPort& port) noexcept {
  std::size_t count = 0;
  std::int64_t good = 0;
  std::fill(came_.begin(), came_.end(), false);
  for (; count < kMostReads; ++count) {
    std::size_t size = 0;
    const ReadStatus got = port.read(buffer_, size);
    if (got == ReadStatus::kGone) return ReadStatus::kGone;
    if (got == ReadStatus::kNothing) break;
    const auto report = std::span<const std::byte>(buffer_).first(std::min(size, buffer_.size()));
    const Taken taken = take(report);
    good += static_cast<std::int64_t>(taken == Taken::kUsed);
    counts_.strange += static_cast<std::int64_t>(taken == Taken::kStrange);
    counts_.repeated += static_cast<std::int64_t>(taken == Taken::kRepeated);
  }
  if (count >= kFullRing) {
    std::fill(known_.begin(), known_.end(), false);
    counts_.dropped += static_cast<std::int64_t>(count);
    std::fill(fresh_.begin(), fresh_.end(), false);
    std::fill(came_.begin(), came_.end(), false);
    return ReadStatus::kNothing;
  }
  counts_.taken += good;
  // A position needs a new report for every joint's field.
  for (std::size_t r = 0; r < fresh_.size(); ++r) {
    if (joints_in_[r] && !fresh_[r]) return ReadStatus::kNothing;
  }
  std::fill(fresh_.begin(), fresh_.end(), false);
  counts_.passed_by += good - 1;
  ++counts_.reports;
  return ReadStatus::kReport;
}

}  // namespace palpate
