/// A device with a trouble: what a loop makes of it is tried without breaking an arm.
#pragma once

#include <limits>
#include <memory>
#include <optional>
#include <string_view>

#include "palpate/engine/device.h"

namespace palpate {

/// What is wrong with it.
enum class Trouble : std::uint8_t {
  kLate,       ///< Nothing new comes: the last position, ever older.
  kEarly,      ///< Its stamps are ahead: positions of the future.
  kRepeated,   ///< Each position four times, as of a slower arm.
  kFrozen,     ///< The last position again and again, as if it were new; no counter moves.
  kJumping,    ///< A count lost: all is kJump beside where it was.
  kNotFinite,  ///< Positions that are no numbers.
  kRunaway,    ///< It drives off at kRun, whatever the hand does.
  kUnwritten,  ///< Writes fail: the motors keep the force that they have.
  kBlocked,    ///< Writes take kHang.
  kHung,       ///< Reads take kHang.
  kGone,       ///< Unplugged; likewise.
  kHot,        ///< Too hot, as it says itself,
  kUnpowered,  ///< without power,
  kSwitch,     ///< with its safety switch open,
  kReleased,   ///< or with its dead man's switch let go.
};
inline constexpr std::size_t kTroubles = 15;  ///< Number of values of Trouble.

/// A trouble's word, as in `simulated:nan`.
[[nodiscard]] const char* wordFor(Trouble trouble) noexcept;
/// The trouble of a word; none where there is no such.
[[nodiscard]] std::optional<Trouble> troubleOf(std::string_view word) noexcept;
/// True where only a real clock shows it.
[[nodiscard]] bool needsClock(Trouble trouble) noexcept;

/// Another device, which has a trouble from a time on. All it does otherwise is the other's.
class FaultyDevice final : public Device {
 public:
  static constexpr double kJump = 0.02;  ///< [m]
  static constexpr double kRun = 4.5;  ///< [m/s]: faster than WatchLimits::max_speed, and no jump.
  static constexpr double kHang = 0.03;  ///< [s]: more than any limit of the loop.

  /// Times by its ticks [s], of `rate` [Hz]: from `begin` until `end`. Throws DeviceError where a
  /// force could reach a real hand, as of a device with a ZeroForce.
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
  /// `hand` as the last whole reading was, `old` ticks ago.
  void hold(HandState& hand, std::int64_t old) const noexcept;

  std::unique_ptr<Device> device_;
  Trouble trouble_;
  double rate_;
  double begin_;
  double end_;
  std::int64_t tick_ = 0;
  std::int64_t since_ = 0;     ///< Readings since the trouble began.
  Vec3 force_ = Vec3::Zero();  ///< The last that went out.
  HandState whole_;            ///< The last reading before it, or the last that was passed on.
};

}  // namespace palpate
