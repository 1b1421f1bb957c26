/// The virtual coupling (Lundin et al., eq. 3) and the last gate before the hand.
#pragma once

#include "engine/types.h"

namespace palpate {

struct CouplingParams {
  double stiffness = 500.0;  ///< k of eq. (3) [N/m], > 0.
  double damping = 0.0;      ///< D of eq. (3) [N s/m], >= 0.
};

/// Eq. (3): k (x_proxy - x_probe) + D (v_proxy - v_probe), the force on the hand [N].
///
/// The damping is left out of the balance, as in the paper (D = 0 in section 4.2), and enters the
/// output only. Departure: the damper acts along the spring, on the rate of its length, and may at
/// most cancel or double the spring's force. As eq. (3) is written it pulls the hand into a surface
/// that it leaves, kicks it by D times every jump of the proxy (contact, yield), and drives it
/// round a curve; along the spring it only makes a loop of force over length that dissipates. In
/// free space, where the proxy is at the probe, the force is exactly zero.
///
/// @param offset       x_proxy - x_probe [m].
/// @param offset_rate  v_proxy - v_probe, the rate of change of `offset` [m/s].
/// RT: no allocation.
[[nodiscard]] Vec3 couplingForce(const CouplingParams& params, const Vec3& offset,
                                 const Vec3& offset_rate) noexcept PALPATE_NONBLOCKING;

/// How fast a varying stiffness may change [N/m per s]: over 5 mm of spring 25 N/s, felt as smooth.
inline constexpr double kStiffnessRate = 5000.0;
/// The most that pays for stiffening at a time [J]: 300 to 800 N/m at 6 mm.
inline constexpr double kStiffnessTank = 0.01;

/// A coupling stiffness that follows a transfer function.
struct VaryingStiffness {
  double value = 0.0;  ///< k [N/m]; 0: not yet set.
  double tank = 0.0;  ///< Energy that the proxy has dissipated and that may stiffen the spring [J].
};

/// Brings the stiffness nearer to `wanted`, at a limited rate and passively: a stiffer spring holds
/// (k_new - k)/2 |offset|^2 more, which must come out of the tank. What the proxy's own motion
/// dissipates (friction, viscosity, yielding) and what a softening spring gives up fills it. So in
/// free space the stiffness follows at once at the rate; pressed against a hard surface it waits
/// for something to be dissipated, or for the hand to let go.
///
/// @param wanted      [N/m]; not finite or <= 0: the stiffness stays.
/// @param offset      x_proxy - x_probe [m].
/// @param dissipated  In this tick [J]; negative counts as none.
/// @param dt          [s]
/// RT: no allocation.
[[nodiscard]] VaryingStiffness nextStiffness(const VaryingStiffness& last, double wanted,
                                             const Vec3& offset, double dissipated,
                                             double dt) noexcept PALPATE_NONBLOCKING;

/// What a device and its user allow.
struct ForceLimits {
  double peak = 3.3;     ///< [N], > 0. Default: the weakest common arm (Touch), safe for any.
  double slew = 2000.0;  ///< Growth of the force [N/s], > 0. A real contact needs k v: 1,000 N/s at
                         ///< 500 N/m and 2 m/s.
};

/// A force that may be sent, and what had to be done to it.
struct LimitedForce {
  Vec3 force = Vec3::Zero();  ///< [N], finite, |force| <= min(peak, |wanted|).
  bool finite = true;         ///< False: a NaN or infinity came in; the force is zero. Latch it.
  bool peaked = false;        ///< Scaled down to the peak.
  bool slewed = false;        ///< Held back by the slew limit.

  [[nodiscard]] bool limited() const noexcept { return !finite || peaked || slewed; }
};

/// The last statement before a device is written to; trusts nothing that came before it.
///
/// In order: finite, else zero; peak, direction kept; slew on growth only. The part of the last
/// force that is still wanted (the projection of the wanted force on it, between zero and all of
/// it) stays at once, and what is wanted beyond it grows by at most slew * dt. So a release is
/// never delayed, the result never exceeds the wanted force, and |force| <= |previous| + slew * dt.
///
/// @param wanted    Any bits [N].
/// @param previous  The force sent last tick [N]; not finite counts as zero.
/// @param dt        Time since then [s]; not finite or <= 0 allows no growth.
/// RT: no allocation.
[[nodiscard]] LimitedForce limitForce(const Vec3& wanted, const Vec3& previous, double dt,
                                      const ForceLimits& limits) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
