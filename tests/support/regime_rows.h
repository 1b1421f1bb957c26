/// Where methods of the literature fail, and what the engine does there: a row a regime, in
/// numbers, each with two halves. Deterministic.
#pragma once

#include <string>
#include <vector>

namespace palpate::bench {

/// A number that was found, and the bound that it is held against.
struct Finding {
  std::string who;   ///< The method, or what was left out.
  std::string what;  ///< With its unit.
  double value = 0.0;
  double bound = 0.0;

  [[nodiscard]] bool fails() const { return value >= bound; }
  [[nodiscard]] bool holds() const { return value <= bound; }
};

/// Both halves: in `fails` every finding fails, in `holds`, which are the engine's, every one
/// holds.
struct Regime {
  std::string where;
  std::vector<Finding> fails;
  std::vector<Finding> holds;
};

/// Constraints of a millinewton, 60 degrees to 1 apart, and parallel ones: section 3.1, figure 2.
[[nodiscard]] Regime weakConstraints();
/// Two planes 1 to 30 degrees apart, a slot, a corner of three.
[[nodiscard]] Regime acuteWalls();
/// Springs of 1 to 1e5 N/m that strengths pull a millionth of a metre or a metre long.
[[nodiscard]] Regime extremeSprings();
/// Strikes of 2 m/s on a thin shell, and hands that were lost for 10 to 100 ms.
[[nodiscard]] Regime strikesAndJumps();
/// A hand that rubs along a noisy ball, its values steep and with a jump.
[[nodiscard]] Regime steepAndNoisy();
/// Couplings past the boundary; arms with delays to 5 ms, encoders of 1 to 100 um.
[[nodiscard]] Regime stiffAndLate();
/// Volumes that appear, move and are swapped under the hand.
[[nodiscard]] Regime scenesThatChange();
/// Devices that say what is not so: unplugged, stale, no number, late.
[[nodiscard]] Regime brokenDevices();

/// All of them.
[[nodiscard]] std::vector<Regime> allRegimes();

}  // namespace palpate::bench
