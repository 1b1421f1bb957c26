/// Simulates an arm and a hand in virtual time, to try a scene without hardware.
#pragma once

#include <functional>
#include <vector>

#include "palpate/devices/simulated/path_device.h"
#include "palpate/engine/safety/device.h"

namespace palpate {

/// The arm, per axis.
struct ArmParams {
  double mass = 0.1;                 ///< [kg], > 0.
  double viscous = 0.5;              ///< b [N s/m], >= 0.
  double coulomb = 0.02;             ///< c [N], >= 0.
  double encoder = 1e-5;             ///< Step of the position sensor D [m]; 0: none.
  double delay = 1e-3;               ///< Delay from a reading to its force [s], >= 0.
  double lag = 0.0;                  ///< Time constant of the amplifiers, first order [s], >= 0.
  TankUse tank = TankUse::kObserve;  ///< Use of the energy tank, which relies on these numbers.
  double refill = 0.0;               ///< TankParams::refill [W].
  bool hand = false;  ///< True: treated as an arm whose force could hurt (DeviceInfo::hand).
  double late = WatchLimits{}.late;  ///< WatchLimits::late, the longest delay of a tick [s].
};

/// The hand that holds the arm: a spring and damper to its target. The default is relaxed; firm is
/// about 1,000 N/m and 15 N s/m; zeros are a released arm.
struct GripParams {
  double stiffness = 300.0;  ///< [N/m], >= 0.
  double damping = 5.0;      ///< [N s/m], >= 0.
};

/// Target of the hand.
struct HandTarget {
  /// Returns the target [m] at a time [s], 0 to `seconds`. A device calls it once a tick, with
  /// times that do not decrease. The function may have a memory, like the hand behind a mouse.
  std::function<Vec3(double)> at;
  double seconds = 0.0;  ///< Duration [s], >= 0; the device ends with it.
};

/// m x'' = -b x' - c x'/|x'| + k_h (target - x) + b_h (target' - x') + f, per tick of 1/rate.
///
/// f is the written force, held over a tick, delayed by `delay` (whole and fractional ticks) and
/// lagging by `lag`. The hand's target and its speed are held over a tick as well. The linear part
/// is solved exactly over each piece of a tick with constant f. Coulomb friction is a constant
/// force over each piece, limited to the force that stops the arm, so it never drives it. The probe
/// is the arm's position rounded to the encoder's step. Deterministic. Ends with the target.
class SimulatedDevice final : public Device {
 public:
  /// Throws DeviceError for parameters out of range.
  SimulatedDevice(const ArmParams& arm, const GripParams& grip, HandTarget target, double rate);

  /// Limits of a Phantom Desktop, 7.9 N and 1000 N/m; mass, hand and tank are those of ArmParams.
  [[nodiscard]] const DeviceInfo& info() const noexcept override { return info_; }
  [[nodiscard]] HandState read() noexcept override;
  void write(const Vec3& force) noexcept override;
  [[nodiscard]] bool ended() const noexcept override;

  [[nodiscard]] const Vec3& position() const noexcept { return position_; }  ///< Not rounded [m].
  [[nodiscard]] const Vec3& velocity() const noexcept { return velocity_; }  ///< [m/s]

 private:
  /// Exact step of one axis with a constant force: x and v after a time, from x, v and f.
  struct Propagator {
    double xx, xv, vx, vv, xf, vf;
    double time;
    // With lag: coefficients for the amplifier's force a and its commanded force u.
    double xa = 0.0, va = 0.0, aa = 0.0, xu = 0.0, vu = 0.0, au = 0.0;
  };
  [[nodiscard]] Propagator propagator(double time) const;
  /// `order` is the force commanded to the amplifiers; `pull` is the hand's.
  void advance(const Propagator& step, const Vec3& order, const Vec3& pull) noexcept;

  DeviceInfo info_;
  ArmParams arm_;
  GripParams grip_;
  HandTarget target_;
  double rate_;
  std::int64_t tick_ = 0;
  Vec3 aim_;  ///< The hand's target in the last tick [m].
  Vec3 position_;
  Vec3 velocity_ = Vec3::Zero();
  Vec3 amplifier_ = Vec3::Zero();  ///< The amplifiers' force [N].
  std::vector<Vec3> queue_;        ///< Delayed forces, oldest at next_.
  std::size_t next_ = 0;
  Propagator early_;  ///< While the older force still acts.
  Propagator late_;   ///< After the newer force has begun.
};

/// Returns a scripted exploration of a box, from several sides in turn, five seconds each. The hand
/// comes round the outside, touches, slides in a circle, presses deep and leaves.
[[nodiscard]] HandTarget explore(const Box& bounds, double seconds);

/// Returns a recorded path as the hand's target. The path has at least one point.
[[nodiscard]] HandTarget alongPath(std::vector<PathPoint> path);

}  // namespace palpate
