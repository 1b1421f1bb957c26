/// Simulates an arm and a hand, to try a scene without hardware.
#pragma once

#include <functional>
#include <vector>

#include "palpate/devices/simulated/path_device.h"
#include "palpate/engine/safety/device.h"

namespace palpate {

/// Parameters of the arm, the same for each axis.
struct ArmParams {
  double mass = 0.1;      ///< m [kg], > 0.
  double viscous = 0.5;   ///< b [N s/m], >= 0.
  double coulomb = 0.02;  ///< c [N], >= 0.
  double encoder = 1e-5;  ///< Step of the position sensor D [m]; 0: exact.
  double delay = 1e-3;    ///< Delay from a reading to its force [s], 0 to 0.1.
  double lag = 0.0;       ///< Time constant of the amplifiers, first order [s], 0 to 0.1.
  /// Use of the energy tank, which relies on the friction and delay given here.
  TankUse tank = TankUse::kObserve;
  double refill = 0.0;  ///< TankParams::refill [W].
  /// DeviceInfo::hand: the loop treats the arm as one that could hurt a hand.
  bool hand = false;
  double late = WatchLimits{}.late;  ///< WatchLimits::late, the longest delay of a tick [s].
};

/// The hand that holds the arm: a spring and a damper to its target. The default is a relaxed grip.
/// A firm grip has about 1,000 N/m and 15 N s/m; zeros mean a released arm.
struct GripParams {
  double stiffness = 300.0;  ///< k_h [N/m], >= 0.
  double damping = 5.0;      ///< b_h [N s/m], >= 0.
};

/// Target of the hand.
struct HandTarget {
  /// Returns the target [m] at a time [s], from 0. A device calls it at its construction and once
  /// per tick, with times that do not decrease. The function may keep state, like a hand that
  /// follows a mouse.
  std::function<Vec3(double)> at;
  double seconds = 0.0;  ///< Duration [s], >= 0; the device ends after it.
};

/// Simulates m x'' = -b x' - c x'/|x'| + k_h (target - x) + b_h (target' - x') + f, by 1/rate for
/// each write. Deterministic. The device ends with its target.
///
/// f is the written force: held for a tick, delayed by `delay` (whole and fractional ticks), and
/// filtered with the time constant `lag`. The target and its velocity are held for a tick as well.
/// The linear part is solved exactly for each piece of a tick in which the delayed force is
/// constant. Coulomb friction is constant over a piece, and at most stops the arm. The probe is the
/// arm's position rounded to the encoder's step.
class SimulatedDevice final : public Device {
 public:
  /// Throws DeviceError for parameters out of range.
  SimulatedDevice(const ArmParams& arm, const GripParams& grip, HandTarget target, double rate);

  /// Returns the limits of a Phantom Desktop (7.9 N, 1000 N/m), with mass, `hand`, `late` and tank
  /// of ArmParams.
  [[nodiscard]] const DeviceInfo& info() const noexcept override { return info_; }
  [[nodiscard]] HandState read() noexcept override;
  void write(const Vec3& force) noexcept override;
  [[nodiscard]] bool ended() const noexcept override;

  /// Returns the exact position, not rounded to encoder steps [m].
  [[nodiscard]] const Vec3& position() const noexcept { return position_; }
  [[nodiscard]] const Vec3& velocity() const noexcept { return velocity_; }  ///< [m/s]

 private:
  /// Exact step of one axis under a constant force: computes x and v after a time from x, v and f.
  struct Propagator {
    double xx, xv, vx, vv, xf, vf;
    double time;
    // With lag: coefficients of the amplifier's force a and of its commanded force u.
    double xa = 0.0, va = 0.0, aa = 0.0, xu = 0.0, vu = 0.0, au = 0.0;
  };
  [[nodiscard]] Propagator propagator(double time) const;
  /// `order` is the force that was commanded to the amplifiers, `pull` the part of the hand's force
  /// that depends on its target.
  void advance(const Propagator& step, const Vec3& order, const Vec3& pull) noexcept;

  DeviceInfo info_;
  ArmParams arm_;
  GripParams grip_;
  HandTarget target_;
  double rate_;
  std::int64_t tick_ = 0;
  Vec3 aim_;
  Vec3 position_;
  Vec3 velocity_ = Vec3::Zero();
  Vec3 amplifier_ = Vec3::Zero();
  std::vector<Vec3> queue_;  ///< Pending forces; the oldest is at next_.
  std::size_t next_ = 0;
  Propagator early_;  ///< Step of the part of a tick in which the older force still acts.
  Propagator late_;   ///< Step of the rest of the tick, in which the newer force acts.
};

/// Returns a scripted exploration of a box, from one or more sides in turn, about five seconds for
/// each side. The hand moves around the box, touches it, slides in a circle, presses deep and
/// leaves.
[[nodiscard]] HandTarget explore(const Box& bounds, double seconds);

/// Returns a target that follows a recorded path. The path has at least one point.
[[nodiscard]] HandTarget alongPath(std::vector<PathPoint> path);

}  // namespace palpate
