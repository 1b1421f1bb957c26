/// The virtual coupling (Lundin et al., eq. 3).
#pragma once

#include <array>
#include <cstddef>

#include "palpate/engine/types.h"

namespace palpate {

/// The spring and the damper of eq. (3) between proxy and probe.
struct CouplingParams {
  double stiffness = 500.0;  ///< k of eq. (3) [N/m], > 0.
  double damping = 0.0;      ///< D of eq. (3) [N s/m], >= 0.
};

/// Approximate time over which the change of a spring's length is measured [s]. Over a single tick,
/// one step of the encoder would give a rate in proportion to the rate of the loop. A longer time
/// delays the damping: docs/stability.md, "The time span of the damper".
inline constexpr double kRateTime = 2e-3;

/// Measures the rate at which a spring's length changes. The rate is the difference from the stored
/// length with an age nearest to `time` [s], divided by that age.
class LengthRate {
 public:
  /// @param time  Age of the length to compare with [s]; 0 selects the previous length.
  explicit LengthRate(double time = kRateTime) noexcept : time_(time) {}
  /// Adds a length [m], `dt` [s] after the previous, and returns the rate [m/s]. The rate of the
  /// first length is 0. If dt is not above 0, the length is ignored and the rate is 0. RT: no
  /// allocation.
  [[nodiscard]] double next(double length, double dt) noexcept PALPATE_NONBLOCKING;
  /// Forgets all lengths.
  void forget() noexcept { count_ = 0; }

  /// Largest number of stored lengths, enough for 2 ms at 100 kHz, the fastest rate of a servo.
  static constexpr std::size_t kMost = 256;

 private:
  struct Reading {
    double length, time;
  };
  [[nodiscard]] static std::size_t after(std::size_t i) noexcept { return (i + 1) % kMost; }

  double time_;
  double now_ = 0.0;
  std::size_t count_ = 0;
  std::size_t last_ = 0;
  std::size_t then_ = 0;  ///< Index of the stored length with an age nearest to `time`.
  std::array<Reading, kMost> readings_{};
};

/// Returns the force on the hand [N], eq. (3): k (x_proxy - x_probe) + D (v_proxy - v_probe).
///
/// As in the paper, the balance has no damping; damping affects the output only. Departure from the
/// paper: the damper acts along the spring, on the rate of its length, and can at most cancel or
/// double the spring's force. With eq. (3) as written, the damper pulls a leaving hand back into
/// the surface, and pushes a hand forward that slides over a convex surface. Every jump of the
/// proxy would also cause a jump of the force in proportion to D. Along the spring, the damper
/// dissipates if `length_rate` has the sign of the true rate. In free space, where the proxy is at
/// the probe, the force is exactly zero.
///
/// @param offset       x_proxy - x_probe [m].
/// @param length_rate  Rate of the offset's length [m/s], from LengthRate. NaN counts as 0.
/// RT: no allocation.
[[nodiscard]] Vec3 couplingForce(const CouplingParams& params, const Vec3& offset,
                                 double length_rate) noexcept PALPATE_NONBLOCKING;

/// Largest rate of a varying stiffness [N/m per s]. At a length of 5 mm the force then changes by
/// at most 25 N/s.
inline constexpr double kStiffnessRate = 5000.0;
/// Largest energy in the tank of a varying stiffness [J]. At a length of 6 mm, this energy can
/// raise the stiffness by 555 N/m.
inline constexpr double kStiffnessTank = 0.01;

/// A varying stiffness, and the energy that may raise it.
struct VaryingStiffness {
  double value = 0.0;  ///< Stiffness k [N/m]; 0 if not yet set.
  /// Energy that a rise of the stiffness may use [J]; see nextStiffness().
  double tank = 0.0;
};

/// Moves the stiffness towards `wanted` at a limited rate, and limits its rise so that the spring
/// stays passive. A stiffer spring holds (k_new - k)/2 |offset|^2 more energy, which must come from
/// the tank. The energy that the proxy's motion dissipates (friction, viscosity, yielding), and the
/// energy that a softening spring releases, fill the tank. If the tank is empty, the stiffness does
/// not rise until the proxy dissipates energy or the hand is back at the proxy.
///
/// @param wanted      Stiffness to reach [N/m]. If not finite or <= 0, the stiffness stays.
/// @param offset      x_proxy - x_probe [m].
/// @param dissipated  Energy dissipated in this tick [J]; negative counts as 0.
/// @param dt          Time since the last call [s]. If not above 0, the stiffness does not change.
/// RT: no allocation.
[[nodiscard]] VaryingStiffness nextStiffness(const VaryingStiffness& last, double wanted,
                                             const Vec3& offset, double dissipated,
                                             double dt) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
