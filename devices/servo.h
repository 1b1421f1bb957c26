/// palpate inside somebody else's servo loop: CHAI3D's, OpenHaptics' or a robot's. That loop reads
/// the arm and moves it; a Servo makes a force of a position.
#pragma once

#include <memory>

#include "palpate/engine/device.h"
#include "palpate/engine/haptic_loop.h"
#include "palpate/engine/types.h"

namespace palpate {

/// All that a HapticLoop does, a call a tick: the hand is watched, the force engages, is bounded
/// and slew-limited, and cut where something is wrong. Its clock is the caller's.
///
/// Two threads use it: `tick` is the servo's, the rest is the application's.
class Servo {  // NOLINT(clang-analyzer-optin.performance.Padding): the loop's mailboxes
 public:
  /// @param arm   What the arm can do, in particular its limits. `hand` is to be false only where
  ///              no hand can be on it: then forces do not engage and positions are not watched.
  /// @param rate  Of the servo, as it should be [Hz], 10 to 100000.
  /// Throws DeviceError where a number is none that can be used.
  Servo(DeviceInfo arm, double rate);

  /// One tick. The servo sends the force as it is, and sends zero where it has not called this.
  ///
  /// @param hand  In W, in metres, as HandState: usually the position alone. A fault that the arm
  ///              reports goes into HandState::fault, how old the position is into HandState::age.
  ///              Where the same position comes again, bit by bit, HandState::still counts from the
  ///              first: a driver that stopped to read its arm loses its force (StillFade).
  /// @param dt    Time since the last call [s]. Longer than 5 ms, or three periods where these are
  ///              longer (WatchLimits::late), is a fault: the force is cut until clear(). So are so
  ///              many ticks in a row without a hundredth of their period, or no number.
  /// @return      Force for the arm in W [N].
  /// RT: no allocation, no lock, no system call.
  [[nodiscard]] Vec3 tick(const HandState& hand, double dt) noexcept PALPATE_NONBLOCKING;

  /// The scene that the next tick feels; the force is zero until there is one.
  void publish(std::shared_ptr<const Scene> scene) noexcept { loop_.publish(std::move(scene)); }
  /// The newest tick, and why its force is cut if it is.
  [[nodiscard]] const Telemetry& latest() noexcept { return loop_.latest(); }
  /// Cuts the force with the next tick, until clear(). From any thread.
  void cut() noexcept { loop_.cut(); }
  /// Lets force out again after a fault, by an engagement. From any thread.
  void clear() noexcept { loop_.clear(); }

 private:
  /// What the loop takes for the arm.
  class Arm final : public Device {
   public:
    explicit Arm(DeviceInfo info) : info_(std::move(info)) {}
    [[nodiscard]] const DeviceInfo& info() const noexcept override { return info_; }
    [[nodiscard]] HandState read() noexcept PALPATE_NONBLOCKING override { return hand; }
    void write(const Vec3& sent) noexcept PALPATE_NONBLOCKING override { force = sent; }

    HandState hand;
    Vec3 force = Vec3::Zero();  ///< [N]

   private:
    DeviceInfo info_;
  };

  Arm arm_;
  HapticLoop loop_;
  double period_;       ///< [s]
  double now_ = 0.0;    ///< [s]
  double still_ = 0.0;  ///< How long the position has been the same [s].
  double stood_ = 0.0;  ///< Periods in which the caller's time has not gone on [s].
};

}  // namespace palpate
