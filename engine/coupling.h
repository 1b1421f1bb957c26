/// The virtual coupling (Lundin et al., eq. 3).
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

}  // namespace palpate
