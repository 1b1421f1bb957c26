#include "palpate/devices/replay_device.h"

#include <algorithm>
#include <charconv>
#include <filesystem>
#include <ranges>
#include <system_error>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

/// The index of the first tick at `seconds` or later.
std::int64_t tickAt(const Recording& recording, double seconds) noexcept {
  const auto before = [&](std::int64_t i) { return recording.tick(i).time < seconds; };
  return *std::ranges::partition_point(std::views::iota(std::int64_t{0}, recording.size()), before);
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

std::string fileOfReplay(const std::string& name) {
  std::error_code error;
  const std::size_t at = name.rfind('@');
  return at == std::string::npos || std::filesystem::exists(name, error) ? name
                                                                         : name.substr(0, at);
}

std::unique_ptr<ReplayDevice> openReplay(const std::string& name) {
  const std::string file = fileOfReplay(name);
  double seconds = 0.0;
  if (file.size() < name.size()) {
    const std::size_t at = file.size();
    const char* begin = name.data() + at + 1;
    const char* end = name.data() + name.size();
    const auto read = std::from_chars(begin, end, seconds);
    if (read.ec != std::errc() || read.ptr != end || !(seconds >= 0.0)) {
      throw Error("--device", fmt::format("\"{}\" is no time", name.substr(at + 1)),
                  "give seconds from the recording's start, as replay:hand.rec@12.5");
    }
  }
  auto recording = std::make_shared<const Recording>(file);
  const std::int64_t first = tickAt(*recording, seconds);
  if (first >= recording->size()) {
    const std::int64_t ticks = recording->size();
    throw Error(file,
                ticks == 0 ? "there is no tick in it"
                           : fmt::format("it ends at {} s", recording->tick(ticks - 1).time),
                ticks == 0 ? "record again" : "begin earlier");
  }
  return std::make_unique<ReplayDevice>(std::move(recording), first);
}

}  // namespace palpate
