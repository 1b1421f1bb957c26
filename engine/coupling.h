/// The virtual coupling (Lundin et al., eq. 3).
#pragma once

#include <array>
#include <cstddef>

#include "palpate/engine/types.h"

namespace palpate {

/// The spring and the damper of eq. (3), between the proxy and the probe.
struct CouplingParams {
  double stiffness = 500.0;  ///< k of eq. (3) [N/m], > 0.
  double damping = 0.0;      ///< D of eq. (3) [N s/m], >= 0.
};

/// The rate of a spring's length is taken over about this time [s]. Over one tick an encoder's step
/// would count for the more the faster the loop is; over longer, damping comes late:
/// docs/stability.md, "How long damping looks back".
inline constexpr double kRateTime = 2e-3;

/// The rate at which a spring's length changes, by the difference to the reading whose age is
/// nearest to `time` [s].
class LengthRate {
 public:
  /// `time`: how far to look back [s]; 0: to the reading before.
  explicit LengthRate(double time = kRateTime) noexcept : time_(time) {}
  /// Takes a length [m], `dt` [s] after the last one; returns the rate [m/s]: 0 for the first one,
  /// and where dt is not above 0. Looks back over at most kMost readings. RT: no allocation.
  [[nodiscard]] double next(double length, double dt) noexcept PALPATE_NONBLOCKING;
  void forget() noexcept { count_ = 0; }  ///< The next length is the first one: its rate is 0.

  static constexpr std::size_t kMost = 128;  ///< Enough for 2 ms at 64 kHz.

 private:
  struct Reading {
    double length, time;
  };
  [[nodiscard]] static std::size_t after(std::size_t i) noexcept { return (i + 1) % kMost; }

  double time_;
  double now_ = 0.0;
  std::size_t count_ = 0;
  std::size_t last_ = 0;
  std::size_t then_ = 0;  ///< The reading whose age is nearest to `time`.
  std::array<Reading, kMost> readings_{};
};

/// Eq. (3): k (x_proxy - x_probe) + D (v_proxy - v_probe), the force on the hand [N].
///
/// The damping is left out of the balance, as in the paper (D = 0 in section 4.2), and enters the
/// output only. Departure: the damper acts along the spring, on the rate of its length, and may at
/// most cancel or double the spring's force. As eq. (3) is written the damper pulls a leaving hand
/// back into the surface, kicks the hand by D times every jump of the proxy (contact, yield), and
/// drives it round a curve; along the spring it only makes a loop of force over length that
/// dissipates. In free space, where the proxy is at the probe, the force is exactly zero.
///
/// @param offset       x_proxy - x_probe [m].
/// @param length_rate  Rate of change of the offset's length [m/s]: LengthRate.
/// RT: no allocation.
[[nodiscard]] Vec3 couplingForce(const CouplingParams& params, const Vec3& offset,
                                 double length_rate) noexcept PALPATE_NONBLOCKING;

/// How fast a varying stiffness may change [N/m per s]: 25 N/s at 5 mm of spring, felt as smooth.
inline constexpr double kStiffnessRate = 5000.0;
/// The most energy that the tank of a varying stiffness holds [J]: for 300 to 800 N/m at 6 mm.
inline constexpr double kStiffnessTank = 0.01;

/// A coupling stiffness that a transfer function sets, and the energy that pays for its rise.
struct VaryingStiffness {
  double value = 0.0;  ///< k [N/m]; 0: not yet set.
  double tank = 0.0;  ///< Energy that the proxy has dissipated and that may stiffen the spring [J].
};

/// Brings the stiffness nearer to `wanted`, at a limited rate and passively: a stiffer spring holds
/// (k_new - k)/2 |offset|^2 more, which must come out of the tank. What the proxy's own motion
/// dissipates (friction, viscosity, yielding) and what a softening spring gives up fills the tank.
/// In free space the stiffness therefore changes at the full rate; pressed against a hard surface
/// it waits until something is dissipated or the hand retreats.
///
/// @param wanted      Stiffness to reach [N/m]; not finite or <= 0: the stiffness stays.
/// @param offset      x_proxy - x_probe [m].
/// @param dissipated  Energy dissipated in this tick [J]; negative counts as none.
/// @param dt          Time since the last call [s]; not above 0: the stiffness stays.
/// RT: no allocation.
[[nodiscard]] VaryingStiffness nextStiffness(const VaryingStiffness& last, double wanted,
                                             const Vec3& offset, double dissipated,
                                             double dt) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
