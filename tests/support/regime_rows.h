/// Compares the engine with methods of the literature in regimes in which these methods fail. Each
/// row gives the numbers of both for one regime. Deterministic.
#pragma once

#include <string>
#include <vector>

namespace palpate::bench {

/// A measured number and its bound.
struct Finding {
  std::string who;   ///< The method, or the part of the engine that was switched off.
  std::string what;  ///< The quantity, with its unit.
  double value = 0.0;
  double bound = 0.0;

  [[nodiscard]] bool fails() const { return value >= bound; }
  [[nodiscard]] bool holds() const { return value <= bound; }
};

/// One regime. In `fails`, the findings of the other methods, every finding fails. In `holds`, the
/// findings of the engine, every finding holds.
struct Regime {
  std::string where;
  std::vector<Finding> fails;
  std::vector<Finding> holds;
};

/// Constraints of a millinewton, at angles of 60 degrees to 1, and parallel ones: section 3.1 and
/// figure 2 of Lundin et al.
[[nodiscard]] Regime weakConstraints();
/// Two planes at angles of 1 to 30 degrees, a slot, and a corner of three planes.
[[nodiscard]] Regime acuteWalls();
/// Springs of 1 to 1e5 N/m, with strengths that stretch them by 1 um or by 1 m.
[[nodiscard]] Regime extremeSprings();
/// Strikes at 2 m/s on a thin shell, and hands without positions for 10 to 100 ms.
[[nodiscard]] Regime strikesAndJumps();
/// A hand that slides along a noisy ball with steep values and a jump.
[[nodiscard]] Regime steepAndNoisy();
/// Couplings beyond the stability limit, arms with delays up to 5 ms, encoders with steps of 1 to
/// 100 um.
[[nodiscard]] Regime stiffAndLate();
/// Volumes that appear, move and are swapped under the hand.
[[nodiscard]] Regime scenesThatChange();
/// Devices that report false data: unplugged, stale, not a number, late.
[[nodiscard]] Regime brokenDevices();

[[nodiscard]] std::vector<Regime> allRegimes();

}  // namespace palpate::bench
