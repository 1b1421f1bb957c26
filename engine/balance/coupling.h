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

/// Time over which the rate of a spring's length is measured, about [s]. Over a single tick, an
/// encoder's step would give a larger rate the faster the loop is. A longer time delays the
/// damping: docs/stability.md, "How long damping looks back".
inline constexpr double kRateTime = 2e-3;

/// Measures the rate at which a spring's length changes, by the difference from the reading whose
/// age is nearest to `time` [s].
class LengthRate {
 public:
  /// `time`: age of the reading to compare with [s]; 0: the previous reading.
  explicit LengthRate(double time = kRateTime) noexcept : time_(time) {}
  /// Adds a length [m], `dt` [s] after the last one, and returns the rate [m/s]. The rate of the
  /// first length is 0. If dt is not above 0, the length is ignored and the rate is 0. Looks back
  /// over at most kMost readings. RT: no allocation.
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

/// Returns the force on the hand [N], eq. (3): k (x_proxy - x_probe) + D (v_proxy - v_probe).
///
/// The balance has no damping, as in the paper (D = 0 in section 4.2); damping enters the output
/// only. Departure from the paper: the damper acts along the spring, on the rate of its length. It
/// may at most cancel or double the spring's force. With eq. (3) as written, the damper pulls a
/// leaving hand back into the surface and drives it round a curve. It also kicks the hand by D
/// times every jump of the proxy (contact, yield). Along the spring, the damper only makes a loop
/// of force over length that dissipates. In free space, where the proxy is at the probe, the force
/// is exactly zero.
///
/// @param offset       x_proxy - x_probe [m].
/// @param length_rate  Rate of change of the offset's length [m/s]: LengthRate.
/// RT: no allocation.
[[nodiscard]] Vec3 couplingForce(const CouplingParams& params, const Vec3& offset,
                                 double length_rate) noexcept PALPATE_NONBLOCKING;

/// Largest rate of a varying stiffness [N/m per s]: 25 N/s at 5 mm of spring, which feels smooth.
inline constexpr double kStiffnessRate = 5000.0;
/// Largest energy in the tank of a varying stiffness [J]: enough for 300 to 800 N/m at 6 mm.
inline constexpr double kStiffnessTank = 0.01;

/// A coupling stiffness that a transfer function sets, and the energy that pays for its rise.
struct VaryingStiffness {
  double value = 0.0;  ///< k [N/m]; 0: not yet set.
  double tank = 0.0;  ///< Energy that the proxy has dissipated and that may stiffen the spring [J].
};

/// Brings the stiffness nearer to `wanted`, at a limited rate and passively. A stiffer spring holds
/// (k_new - k)/2 |offset|^2 more energy, which must come from the tank. The tank is filled by the
/// energy that the proxy's own motion dissipates (friction, viscosity, yielding), and by the energy
/// that a softening spring releases. In free space the stiffness therefore changes at the full
/// rate. Pressed against a hard surface, it waits until the proxy dissipates energy or the hand
/// retreats.
///
/// @param wanted      Stiffness to reach [N/m]; not finite or <= 0: the stiffness stays.
/// @param offset      x_proxy - x_probe [m].
/// @param dissipated  Energy dissipated in this tick [J]; negative counts as 0.
/// @param dt          Time since the last call [s]; not above 0: the stiffness stays.
/// RT: no allocation.
[[nodiscard]] VaryingStiffness nextStiffness(const VaryingStiffness& last, double wanted,
                                             const Vec3& offset, double dissipated,
                                             double dt) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
