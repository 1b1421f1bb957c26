#include "palpate/devices/recording/replay_device.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <system_error>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

/// Returns the index of the first tick at `seconds` or later.
std::int64_t tickAt(const Recording& recording, double seconds) noexcept {
  // A binary search by hand, because clang 14 does not support the library's views.
  std::int64_t low = 0;
  std::int64_t high = recording.size();
  while (low < high) {
    const std::int64_t middle = low + (high - low) / 2;
    if (recording.tick(middle).time < seconds) {
      low = middle + 1;
    } else {
      high = middle;
    }
  }
  return low;
}

}  // namespace

ReplayDevice::ReplayDevice(std::shared_ptr<const Recording> recording, std::int64_t begin)
    : recording_(std::move(recording)),
      info_(recording_->setting().device),
      begin_(begin),
      at_(begin) {}

HandState ReplayDevice::read() noexcept {
  const std::int64_t last = recording_->size() - 1;
  return telemetryOf(recording_->tick(std::min(at_, last))).input.hand;
}

void ReplayDevice::write(const Vec3& /*force*/) noexcept {
  if (ended()) return;
  given_ = recording_->tick(at_).given;
  ++at_;
}

NameAt nameAt(const std::string& words) {
  const std::size_t at = words.rfind('@');
  if (at == std::string::npos) return {words, std::nullopt};
  double seconds = 0.0;
  const char* end = words.data() + words.size();
  const auto read = std::from_chars(words.data() + at + 1, end, seconds);
  if (read.ec != std::errc() || read.ptr != end) return {words, std::nullopt};
  if (!(seconds >= 0.0) || !std::isfinite(seconds)) return {words, std::nullopt};
  return {words.substr(0, at), seconds};
}

std::string fileOfReplay(const std::string& name) {
  std::error_code error;
  return std::filesystem::exists(name, error) ? name : nameAt(name).name;
}

std::unique_ptr<ReplayDevice> openReplay(const std::string& name) {
  const std::string file = fileOfReplay(name);
  const double seconds = file == name ? 0.0 : nameAt(name).seconds.value_or(0.0);
  auto recording = std::make_shared<const Recording>(file);
  const std::int64_t first = tickAt(*recording, seconds);
  if (first >= recording->size()) {
    const std::int64_t ticks = recording->size();
    throw Error(file,
                ticks == 0 ? "it has no ticks"
                           : fmt::format("it ends at {} s, before the given start, {} s",
                                         recording->tick(ticks - 1).time, seconds),
                ticks == 0 ? "record again" : "give an earlier start");
  }
  return std::make_unique<ReplayDevice>(std::move(recording), first);
}

}  // namespace palpate
