/// Compares the engine with methods of the literature where those methods fail. Each function gives
/// the numbers of one regime. The results are deterministic.
#pragma once

#include <string>
#include <vector>

namespace palpate::bench {

/// A measured number and its limit.
struct Finding {
  std::string who;   ///< The method, or the engine without one of its parts.
  std::string what;  ///< The quantity, with its unit.
  double value = 0.0;
  double bound = 0.0;

  [[nodiscard]] bool fails() const { return value >= bound; }
  [[nodiscard]] bool holds() const { return value <= bound; }
};

/// One regime. Every finding of `fails` (other methods) breaks its limit; every finding of `holds`
/// (the engine) meets it.
struct Regime {
  std::string where;
  std::vector<Finding> fails;
  std::vector<Finding> holds;
};

/// Constraints of 1 mN at angles of 60 degrees down to 1 degree, and parallel ones: section 3.1 and
/// figure 2 of Lundin et al.
[[nodiscard]] Regime weakConstraints();
/// Two planes at angles of 1 to 30 degrees, a slot, and a corner of three planes.
[[nodiscard]] Regime acuteWalls();
/// Springs of 1 to 1e5 N/m. Each strength stretches its spring by at most 1 um, 0.1 mm, 1 cm or 1
/// m.
[[nodiscard]] Regime extremeSprings();
/// Strikes on a thin shell at 2 m/s, and hands without positions for 10 to 100 ms.
[[nodiscard]] Regime strikesAndJumps();
/// A hand on a noisy ball with a steep ramp, a hand that presses on a wall, and the energy that a
/// tick creates.
[[nodiscard]] Regime steepAndNoisy();
/// Couplings beyond the stability limit, delays up to 5 ms, encoder steps of 1 to 100 um.
[[nodiscard]] Regime stiffAndLate();
/// Balls that appear around the hand, move over it, or are replaced in every tick.
[[nodiscard]] Regime scenesThatChange();
/// Devices that are unplugged or late, and positions that jump, are old or are NaN.
[[nodiscard]] Regime brokenDevices();

[[nodiscard]] std::vector<Regime> allRegimes();

}  // namespace palpate::bench
