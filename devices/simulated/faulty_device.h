/// A device with a simulated defect (a trouble), to test a loop without risk to a real arm.
#pragma once

#include <limits>
#include <memory>
#include <optional>
#include <string_view>

#include "palpate/engine/safety/device.h"

namespace palpate {

/// The kinds of trouble.
enum class Trouble : std::uint8_t {
  kLate,       ///< No new positions: the last position repeats, with rising age.
  kEarly,      ///< Positions with time stamps in the future.
  kRepeated,   ///< Each position comes four times, as from an arm with a quarter of the rate.
  kFrozen,     ///< The last position repeats as if it were new; no encoder count changes.
  kJumping,    ///< A count was lost: all positions are shifted by kJump along x.
  kNotFinite,  ///< Positions that are not finite.
  kRunaway,    ///< Adds a drift with speed kRun along z to the position of the hand.
  kUnwritten,  ///< Writes fail: the motors keep their force.
  kBlocked,    ///< Writes take kHang.
  kHung,       ///< Reads take kHang.
  kGone,       ///< The device is unplugged: the motors keep their force.
  kHot,        ///< The device reports that it is too hot.
  kUnpowered,  ///< The device reports that it has no power.
  kSwitch,     ///< The device reports that its safety switch is open.
  kReleased,   ///< The device reports that its dead-man switch is released.
};
inline constexpr std::size_t kTroubles = 15;  ///< Number of values of Trouble.

/// Returns a trouble's word, as in `simulated:nan`.
[[nodiscard]] const char* wordFor(Trouble trouble) noexcept;
/// Returns the trouble of a word; empty if the word is unknown.
[[nodiscard]] std::optional<Trouble> troubleOf(std::string_view word) noexcept;
/// Returns true if the trouble has an effect only in real time.
[[nodiscard]] bool needsClock(Trouble trouble) noexcept;

/// Adds a trouble to a device for a given time. Otherwise forwards all calls to that device.
class FaultyDevice final : public Device {
 public:
  static constexpr double kJump = 0.02;  ///< Shift of the positions along x [m].
  /// Speed of a runaway position [m/s]: above the default of WatchLimits::max_speed, but not a
  /// jump.
  static constexpr double kRun = 4.5;
  /// Duration of a read or write that hangs [s]; above 100 Hz, longer than a tick may take.
  static constexpr double kHang = 0.03;

  /// Has the trouble from `begin` until `end` [s], counted in ticks of `rate` [Hz]. Throws
  /// DeviceError if the device has a descriptor for ZeroForce, because it may be a real arm.
  FaultyDevice(std::unique_ptr<Device> device, Trouble trouble, double rate, double begin,
               double end = std::numeric_limits<double>::infinity());

  [[nodiscard]] const DeviceInfo& info() const noexcept override { return device_->info(); }
  [[nodiscard]] HandState read() noexcept override;
  void write(const Vec3& force) noexcept override;
  void carry(bool may) noexcept override { device_->carry(may); }
  [[nodiscard]] double given() const noexcept override { return device_->given(); }
  [[nodiscard]] bool ended() const noexcept override { return device_->ended(); }
  [[nodiscard]] ZeroForce zeroForce() const noexcept override { return device_->zeroForce(); }

 private:
  [[nodiscard]] bool troubled() const noexcept;
  void hold(HandState& hand, std::int64_t old) const noexcept;

  std::unique_ptr<Device> device_;
  Trouble trouble_;
  double rate_;
  double begin_;
  double end_;
  std::int64_t tick_ = 0;
  std::int64_t since_ = 0;  ///< Number of readings since the trouble began.
  Vec3 force_ = Vec3::Zero();
  /// The last reading before the trouble; for Trouble::kRepeated, the reading that is repeated.
  HandState whole_;
};

}  // namespace palpate
