/// Runs palpate inside another program's servo loop, such as that of CHAI3D, OpenHaptics or a
/// robot. The other program reads the arm and sends the force that a Servo computes.
#pragma once

#include <memory>

#include "palpate/engine/loop/haptic_loop.h"
#include "palpate/engine/safety/device.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Does the work of a HapticLoop, one call per tick: watches the hand, engages, limits the force
/// and its slew, and cuts the force after a fault. The caller supplies the time.
///
/// The servo's thread calls `tick`. One other thread calls `publish` and `latest`.
class Servo {  // NOLINT(clang-analyzer-optin.performance.Padding): the loop's mailboxes
 public:
  /// @param arm   Description of the arm. `hand` may be false only if no hand can be on it: then
  ///              the force begins without an engagement, and positions are not watched.
  /// @param rate  Nominal rate of the servo [Hz], 10 to 100000.
  /// @param real  False: the caller ticks in virtual time, so the time that a tick takes on this
  ///              machine does not count. Only for a simulated arm: on a real arm, a force that
  ///              comes too late must be cut.
  /// Throws DeviceError if the rate or a number of `arm` is out of range.
  Servo(DeviceInfo arm, double rate, bool real = true);

  /// Runs one tick. The servo must send the returned force unchanged, and zero without this call.
  ///
  /// @param hand  Reading in W [m], as HandState; usually only the position. Put a fault of the arm
  ///              into HandState::fault, the position's age into HandState::age. If a hand may be
  ///              on the arm, the Servo counts up HandState::still while the position repeats
  ///              exactly. So the force fades (StillFade) if a driver no longer reads its arm.
  /// @param dt Time since the last call [s]. A call that is too late cuts the force until clear():
  /// its dt exceeds a period by 5 ms, or by three periods if these are longer (WatchLimits::late).
  /// The force is also cut if, for this time, every dt is not finite or below a hundredth of the
  /// period. In real time, a call that takes too long also cuts the force.
  /// @return      Force for the arm in W [N].
  /// RT: no allocation, no lock, no system call.
  [[nodiscard]] Vec3 tick(const HandState& hand, double dt) noexcept PALPATE_NONBLOCKING;

  /// Sets the scene for the next tick; the force is zero until a scene is set. Throws DeviceError
  /// as checkCoupling() does; the previous scene then stays active.
  void publish(std::shared_ptr<const Scene> scene) {
    checkCoupling(arm_.info(), scene.get());
    loop_.publish(std::move(scene));
  }
  /// Returns the telemetry of the newest tick, with the reason if its force is cut.
  [[nodiscard]] const Telemetry& latest() noexcept { return loop_.latest(); }
  /// Cuts the force from the next tick until clear(). Callable from any thread.
  void cut() noexcept { loop_.cut(); }
  /// Gives force again after a fault, with an engagement. Callable from any thread.
  void clear() noexcept { loop_.clear(); }

 private:
  class Arm final : public Device {
   public:
    explicit Arm(DeviceInfo info) : info_(std::move(info)) {}
    [[nodiscard]] const DeviceInfo& info() const noexcept override { return info_; }
    [[nodiscard]] HandState read() noexcept PALPATE_NONBLOCKING override { return hand; }
    void write(const Vec3& sent) noexcept PALPATE_NONBLOCKING override { force = sent; }

    HandState hand;
    Vec3 force = Vec3::Zero();

   private:
    DeviceInfo info_;
  };

  Arm arm_;
  HapticLoop loop_;
  double period_;
  bool real_;
  double now_ = 0.0;
  double still_ = 0.0;  ///< Time since the position last changed [s].
  /// Time for which `dt` has been too small or not finite, as a sum of periods [s].
  double stood_ = 0.0;
};

}  // namespace palpate
