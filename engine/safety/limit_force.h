/// The last gate before the hand: the force that leaves the engine is finite, bounded and
/// slew-limited, and begins gently, in every case.
#pragma once

#include <algorithm>

#include "palpate/engine/safety/passivity.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Limits that a device and its user set.
struct ForceLimits {
  double peak = 3.3;     ///< Largest force [N], > 0. Default: the weakest common arm's (Touch).
  double slew = 2000.0;  ///< Growth of the force [N/s], > 0. A real contact needs k v: 1,000 N/s at
                         ///< 500 N/m and 2 m/s.
  double continuous = 0.0;  ///< Force that the device can hold for ever [N], <= peak; 0: not
                            ///< stated.
  double heating = 10.0;    ///< Time constant of the heat in its motors [s].
  double friction = 0.0;    ///< A force below this may leave the arm where it is [N]: StillFade.
  double engage = 0.0;   ///< Ramp of an engagement [s]; 0: no ramp, only for forces that go to no
                         ///< hand. HapticLoop takes at least kEngage at a hand.
  TankParams tank = {};  ///< Limits of the energy that may leave the hand's port.
};

inline constexpr double kEngage = 0.5;       ///< Shortest ramp at a hand [s].
inline constexpr double kEngageEdit = 0.05;  ///< Ramp if only numbers of a scene have changed [s]:
                                             ///< in it the force grows by at most the peak.
inline constexpr double kEngageBelow = 0.1;  ///< An engagement waits for a wanted force below this
                                             ///< [N].
inline constexpr double kEngageWait = 1.0;   ///< An engagement waits at most this long [s].

/// Memory of the gate.
struct LimiterState {
  Vec3 sent = Vec3::Zero();  ///< Force that was sent last [N].
  double heat = 0.0;         ///< Mean of |force|^2 over ForceLimits::heating [N^2].
  bool waiting = false;      ///< An engagement has begun, but not its ramp.
  double waited = 0.0;       ///< Time that the engagement has waited [s].
  double share = 1.0;        ///< Share of the force that the ramp lets through.
  double ramp = kEngage;     ///< Length of the ramp [s].
  double gentle = 0.0;       ///< Time for which the force still grows gently after an edit [s].
  Tank tank;                 ///< Energy at the hand's port that may still leave it.

  /// Call this if zero, or an unknown force, was sent instead of the result of limitForce.
  void forget() noexcept {
    sent.setZero();
    tank.forget();
  }

  /// Returns the force that StillFade compares with friction [N]: `wanted`, at most the peak; zero
  /// during an engagement, although its ramp already lets some force out.
  [[nodiscard]] double letsOut(double wanted, double peak) const noexcept {
    return waiting || share < 1.0 ? 0.0 : std::min(wanted, peak);
  }
  /// Begins an engagement: the force is zero until a small one is wanted, then grows over `length`.
  void engage(double length) noexcept {
    waiting = true;
    waited = 0.0;
    share = 0.0;
    ramp = length;
  }
};

/// A force that may be sent, and the limits that changed it.
struct LimitedForce {
  Vec3 force = Vec3::Zero();  ///< [N], finite, |force| <= min(peak, |wanted|).
  bool finite = true;         ///< False: a NaN or infinity came in; the force is zero. Latch it.
  bool peaked = false;        ///< Scaled down to the peak.
  bool heated = false;        ///< Scaled down to the force that the motors can hold.
  bool ramped = false;        ///< Scaled down by an engagement.
  bool slewed = false;        ///< Held back by the slew limit.
  double share = 1.0;         ///< Share that the tank can pay for; applied only if the tank acts.
  bool drained = false;       ///< Scaled down by the tank.

  /// Returns true if any of these changed the force.
  [[nodiscard]] bool limited() const noexcept {
    return !finite || peaked || heated || ramped || slewed || drained;
  }
};

/// Limits a force. This is the last call before a write to a device; it does not trust its input.
///
/// In order: finite, else zero; peak and continuous limit, direction kept; engagement; slew on
/// growth only; last the energy tank, direction kept. The part of the last force that is still
/// wanted stays at once: the projection of the wanted force on it, between zero and all of it. The
/// wanted force beyond that part grows by at most slew * dt. So a release is never delayed, the
/// result never exceeds the wanted force, and |force| <= |previous| + slew * dt. The ramp comes
/// before the slew, since a ramp of a limited force would grow by more than that.
///
/// The continuous limit: `heat` follows |force|^2 with the time constant `heating`. Up to kWarm of
/// continuous^2 the peak is allowed, from there on less, and at continuous^2 just `continuous`
/// (allowedByHeat), so that the heat never exceeds continuous^2.
///
/// @param wanted    Force to be sent [N], any bits.
/// @param hand      Position of the hand as read [m], any bits; only the tank uses it.
/// @param dt        Time since the last force was sent [s]; not finite or <= 0 allows no growth.
/// @param state     State of the same device, one call a tick. A `sent` not finite counts as zero.
/// @param fresh     False: the hand's position is that of the last call, read again.
/// RT: no allocation.
[[nodiscard]] LimitedForce limitForce(const Vec3& wanted, const Vec3& hand, double dt,
                                      const ForceLimits& limits, LimiterState& state,
                                      bool fresh = true) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
