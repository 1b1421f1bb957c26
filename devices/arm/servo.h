/// Runs palpate inside another program's servo loop, such as that of CHAI3D, OpenHaptics or a
/// robot. That loop reads the arm and moves it; a Servo computes a force from a position.
#pragma once

#include <memory>

#include "palpate/engine/loop/haptic_loop.h"
#include "palpate/engine/safety/device.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Does all that a HapticLoop does, one call per tick: it watches the hand, engages, limits and
/// slew-limits the force, and cuts the force if something is wrong. Its clock is the caller's.
///
/// Two threads use it: the servo's thread calls `tick`, the application's thread the other
/// functions.
class Servo {  // NOLINT(clang-analyzer-optin.performance.Padding): the loop's mailboxes
 public:
  /// @param arm   Description of the arm, in particular its limits. `hand` may be false only if no
  ///              hand can be on it: then forces do not engage and positions are not watched.
  /// @param rate  Nominal rate of the servo [Hz], 10 to 100000.
  /// Throws DeviceError if a number is not usable.
  Servo(DeviceInfo arm, double rate);

  /// Runs one tick. The servo sends the returned force unchanged. In a cycle without this call the
  /// servo sends zero.
  ///
  /// @param hand  Reading in W [m], as HandState; usually only the position. A fault that the arm
  ///              reports goes into HandState::fault, the age of the position into HandState::age.
  ///              If the same position comes again, bit by bit, HandState::still counts from the
  ///              first: a driver that has stopped reading its arm loses its force (StillFade).
  /// @param dt    Time since the last call [s]. The force is cut until clear() if dt exceeds a
  ///              period by 5 ms, or by three periods if these are longer (WatchLimits::late). It
  ///              is also cut if ticks for that long have a dt below a hundredth of the period or
  ///              not finite.
  /// @return      Force for the arm in W [N].
  /// RT: no allocation, no lock, no system call.
  [[nodiscard]] Vec3 tick(const HandState& hand, double dt) noexcept PALPATE_NONBLOCKING;

  /// Sets the scene for the next tick; the force is zero until a scene is set.
  void publish(std::shared_ptr<const Scene> scene) noexcept { loop_.publish(std::move(scene)); }
  /// Returns the newest tick, with the reason if its force is cut.
  [[nodiscard]] const Telemetry& latest() noexcept { return loop_.latest(); }
  /// Cuts the force with the next tick, until clear(). From any thread.
  void cut() noexcept { loop_.cut(); }
  /// Gives force again after a fault, with an engagement. From any thread.
  void clear() noexcept { loop_.clear(); }

 private:
  /// The loop's view of the arm.
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
  double stood_ = 0.0;  ///< Sum of periods in which the caller's time stood still [s].
};

}  // namespace palpate
