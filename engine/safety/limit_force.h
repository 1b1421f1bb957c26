/// The last stage before the hand: the force is finite, bounded, slew-limited and begins gently.
#pragma once

#include <algorithm>

#include "palpate/engine/safety/passivity.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Limits set by a device and its user.
struct ForceLimits {
  /// Largest force [N], > 0. The default is that of the weakest common arm (Touch).
  double peak = 3.3;
  double slew =
      2000.0;  ///< Largest growth of the force [N/s], > 0. A real contact may need 1,000 N/s.
  double continuous = 0.0;  ///< Force that the device can always hold [N], <= peak; 0 if unknown.
  double heating = 10.0;    ///< Time constant of the heat in the motors [s].
  double friction =
      0.0;  ///< Friction of the arm [N]: a smaller force may fail to move the arm (StillFade).
  /// Length of the ramp of an engagement [s]. At a hand, HapticLoop uses at least kEngage. 0 means
  /// no ramp, and is only for forces that do not reach a hand.
  double engage = 0.0;
  TankParams tank = {};  ///< Limits of the energy that the hand may get from the device.
};

inline constexpr double kEngage = 0.5;  ///< Shortest ramp if a hand is present [s].
/// Length of the ramp after an edit that changes only numbers of a scene [s]. In this time the
/// force grows by at most the peak.
inline constexpr double kEngageEdit = 0.05;
/// An engagement waits until the wanted force is below this [N].
inline constexpr double kEngageBelow = 0.1;
inline constexpr double kEngageWait = 1.0;  ///< An engagement waits at most this long [s].

/// State of limitForce.
struct LimiterState {
  Vec3 sent = Vec3::Zero();  ///< Force that was sent last [N].
  double heat = 0.0;      ///< Mean of |force|^2 with the time constant ForceLimits::heating [N^2].
  bool waiting = false;   ///< True if an engagement has begun, but its ramp has not.
  double waited = 0.0;    ///< Time that the engagement has waited [s].
  double share = 1.0;     ///< Factor that the ramp applies to the force, 0 to 1.
  double ramp = kEngage;  ///< Length of the ramp [s].
  /// Time for which the growth of the force is still reduced after an edit [s].
  double gentle = 0.0;
  Tank tank;  ///< The energy tank of the device.

  /// Forgets the last force, and empties the tank. Call this function if zero or an unknown force
  /// was sent instead of the result of limitForce.
  void forget() noexcept {
    sent.setZero();
    tank.forget();
  }

  /// Returns the force that StillFade compares with friction [N]; zero during an engagement.
  [[nodiscard]] double letsOut(double wanted, double peak) const noexcept {
    return waiting || share < 1.0 ? 0.0 : std::min(wanted, peak);
  }
  /// Begins an engagement: zero force until the wanted force is below kEngageBelow or kEngageWait
  /// has passed, then a ramp of `length` [s].
  void engage(double length) noexcept {
    waiting = true;
    waited = 0.0;
    share = 0.0;
    ramp = length;
  }
};

/// A force that may be sent, and the limits that changed it.
struct LimitedForce {
  /// Force to send [N], finite. |force| <= min(peak, |wanted|).
  Vec3 force = Vec3::Zero();
  bool finite =
      true;  ///< False if the wanted force was not finite. The force is then zero; latch a fault.
  bool peaked = false;  ///< True if the wanted force exceeded the peak.
  bool heated = false;  ///< True if scaled down to the force that the heat of the motors allows.
  bool ramped = false;  ///< True if scaled down by an engagement.
  bool slewed = false;  ///< True if reduced by the slew limit.
  /// Share of the force that the tank can pay for; applied only if the tank acts.
  double share = 1.0;
  bool drained = false;  ///< True if scaled down by the tank.

  /// Returns true if any limit changed the force.
  [[nodiscard]] bool limited() const noexcept {
    return !finite || peaked || heated || ramped || slewed || drained;
  }
};

/// Limits a force. This function is the last call before a write to a device, and checks its input.
///
/// Steps, in this order: (1) A force that is not finite becomes zero. (2) The peak and the
/// continuous limit scale the force. (3) The engagement scales it, before the slew limit, because a
/// ramp of a limited force would grow by more than slew * dt. (4) The slew limit reduces its
/// growth. (5) The energy tank scales it. Scaling keeps the direction. Step 4 keeps the part of the
/// last force that is still wanted. This part is the projection of the wanted force on the last
/// force, from zero to the whole last force. The rest may grow by slew * dt. So a release is never
/// delayed, the result never exceeds the wanted force, and |force| <= |previous| + slew * dt.
///
/// For the continuous limit, `heat` follows |force|^2 with the time constant `heating`.
/// allowedByHeat() gives the largest force. If dt is short enough, below 0.2 heating
/// (continuous/peak)^2, the heat does not rise above continuous^2.
///
/// @param wanted    Wanted force [N]. Any number is allowed, also NaN.
/// @param hand      Position of the hand as read [m]. Any number is allowed, also NaN. Only the
///                  tank uses this position.
/// @param dt        Time since the last force was sent [s]. If not finite or <= 0, the force does
///                  not grow.
/// @param state     State of this device. A `sent` that is not finite counts as zero.
/// @param fresh     False if the hand's position only repeats the previous position.
/// RT: no allocation.
[[nodiscard]] LimitedForce limitForce(const Vec3& wanted, const Vec3& hand, double dt,
                                      const ForceLimits& limits, LimiterState& state,
                                      bool fresh = true) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
