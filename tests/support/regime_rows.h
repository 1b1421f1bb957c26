/// Compares the engine with methods of the literature where these fail: one row for each regime, in
/// numbers, each with two halves. Deterministic.
#pragma once

#include <string>
#include <vector>

namespace palpate::bench {

/// A measured number and its bound.
struct Finding {
  std::string who;   ///< The method, or the part that was left out.
  std::string what;  ///< The quantity, with its unit.
  double value = 0.0;
  double bound = 0.0;

  [[nodiscard]] bool fails() const { return value >= bound; }
  [[nodiscard]] bool holds() const { return value <= bound; }
};

/// One regime. In `fails` every finding fails. In `holds`, the engine's half, every finding holds.
struct Regime {
  std::string where;
  std::vector<Finding> fails;
  std::vector<Finding> holds;
};

/// Constraints of a millinewton, 60 degrees to 1 apart, and parallel ones: section 3.1, figure 2.
[[nodiscard]] Regime weakConstraints();
/// Two planes 1 to 30 degrees apart, a slot, a corner of three.
[[nodiscard]] Regime acuteWalls();
/// Springs of 1 to 1e5 N/m with strengths that pull them a millionth of a metre or a metre long.
[[nodiscard]] Regime extremeSprings();
/// Strikes of 2 m/s on a thin shell, and hands without positions for 10 to 100 ms.
[[nodiscard]] Regime strikesAndJumps();
/// A hand that slides along a noisy ball with steep values and a jump.
[[nodiscard]] Regime steepAndNoisy();
/// Couplings past the stability boundary; arms with delays to 5 ms, encoders of 1 to 100 um.
[[nodiscard]] Regime stiffAndLate();
/// Volumes that appear, move and are swapped under the hand.
[[nodiscard]] Regime scenesThatChange();
/// Devices that report false data: unplugged, stale, not a number, late.
[[nodiscard]] Regime brokenDevices();

/// Returns all regimes.
[[nodiscard]] std::vector<Regime> allRegimes();

}  // namespace palpate::bench
