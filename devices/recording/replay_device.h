/// A recorded hand: `replay:FILE`.
#pragma once

#include <memory>
#include <optional>
#include <string>

#include "palpate/devices/recording/recording.h"
#include "palpate/engine/safety/device.h"

namespace palpate {

/// Replays a recorded hand, one tick per write, independent of the force. Has the properties of the
/// recorded arm. Does not replay cleared faults, cuts and late ticks. A HandTick with the recorded
/// TickInput replays them.
class ReplayDevice final : public Device {
 public:
  /// Begins at the tick with index `begin`, which is less than the recording's size.
  explicit ReplayDevice(std::shared_ptr<const Recording> recording, std::int64_t begin = 0);

  [[nodiscard]] const DeviceInfo& info() const noexcept override { return info_; }
  [[nodiscard]] HandState read() noexcept override;
  void write(const Vec3& force) noexcept override;
  [[nodiscard]] double given() const noexcept override { return given_; }
  [[nodiscard]] bool ended() const noexcept override { return at_ >= recording_->size(); }

  /// Returns the recording.
  [[nodiscard]] const Recording& recording() const noexcept { return *recording_; }
  /// Returns the index of the first replayed tick.
  [[nodiscard]] std::int64_t begin() const noexcept { return begin_; }

 private:
  std::shared_ptr<const Recording> recording_;
  DeviceInfo info_;
  std::int64_t begin_;
  std::int64_t at_;
  double given_ = 1.0;
};

/// The two parts of a device's argument: NAME and SECONDS of `NAME@SECONDS`.
struct NameAt {
  /// Text before the last @, if a time follows it; else the whole text.
  std::string name;
  std::optional<double> seconds;  ///< The time, 0 or more [s].
};
/// Splits `NAME` or `NAME@SECONDS` into its parts.
[[nodiscard]] NameAt nameAt(const std::string& words);

/// Returns FILE of `FILE` or `FILE@SECONDS`; the whole name if a file has this name.
[[nodiscard]] std::string fileOfReplay(const std::string& name);

/// Opens `FILE` or `FILE@SECONDS`; the latter begins at SECONDS. Throws Error as Recording, or if
/// the recording has no ticks or ends before SECONDS.
[[nodiscard]] std::unique_ptr<ReplayDevice> openReplay(const std::string& name);

}  // namespace palpate
