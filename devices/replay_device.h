/// A hand that was recorded: `replay:FILE`.
#pragma once

#include <memory>
#include <optional>
#include <string>

#include "palpate/devices/recording.h"
#include "palpate/engine/device.h"

namespace palpate {

/// Reads the recorded hand, a tick at a write, whatever the force. Says what its arm was; no force
/// reaches a hand. What was ordered (stops, lateness) is not in it: HandTick replays that as well.
class ReplayDevice final : public Device {
 public:
  /// From the tick `begin`, an index below the recording's size, on.
  explicit ReplayDevice(std::shared_ptr<const Recording> recording, std::int64_t begin = 0);

  [[nodiscard]] const DeviceInfo& info() const noexcept override { return info_; }
  [[nodiscard]] HandState read() noexcept override;
  void write(const Vec3& force) noexcept override;
  [[nodiscard]] double given() const noexcept override { return given_; }
  [[nodiscard]] bool ended() const noexcept override { return at_ >= recording_->size(); }

  /// What it is replayed from,
  [[nodiscard]] const Recording& recording() const noexcept { return *recording_; }
  /// and the index of the tick with which it begins.
  [[nodiscard]] std::int64_t begin() const noexcept { return begin_; }

 private:
  std::shared_ptr<const Recording> recording_;
  DeviceInfo info_;
  std::int64_t begin_;
  std::int64_t at_;
  double given_ = 1.0;
};

/// Words of a device, as `FILE@SECONDS`.
struct NameAt {
  std::string name;               ///< What is before the last @ where a time follows it; else all.
  std::optional<double> seconds;  ///< That time, 0 or more [s].
};
/// Takes such words apart.
[[nodiscard]] NameAt nameAt(const std::string& words);

/// FILE of `FILE`, or of `FILE@SECONDS`.
[[nodiscard]] std::string fileOfReplay(const std::string& name);

/// `FILE` or `FILE@SECONDS`, where it begins. Throws Error: it is no recording, or ends before.
[[nodiscard]] std::unique_ptr<ReplayDevice> openReplay(const std::string& name);

}  // namespace palpate
