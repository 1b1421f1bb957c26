/// The methods that are compared, each at its settings, behind one signature.
#pragma once

#include <functional>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include "palpate/devices/methods/method.h"
#include "tests/support/problems.h"

namespace palpate::bench {

/// A method's answer, and what it claims of it.
struct Answer {
  methods::Balance balance;
  double bound = std::numeric_limits<double>::infinity();  ///< Certified error [m].
};

/// A method at one setting.
struct Contender {
  std::string method;  ///< As charts name it.
  std::string
      setting;  ///< Its tolerance (of the fixed step: the step) as 1e-3; empty: it has none.
  /// The primitives are the problem's, in memory that was just written, as in a tick.
  std::function<Answer(const BalanceProblem&, std::span<const Primitive>)> solve;
  /// Called before a balance that does not follow from the last one.
  std::function<void()> forget = [] {};
};

/// What charts call the engine's solver, and our reading of the paper's.
inline constexpr const char* kOurs = "palpate";
inline constexpr const char* kOursWarm = "palpate, warm";
inline constexpr const char* kPaper = "Euler, adaptive step";

/// All of them. The engine's solver remembers nothing, and, for motions, remembers the last
/// balance.
[[nodiscard]] std::vector<Contender> makeContenders(bool motion);

/// Those of figure 7: of our readings of the paper's solver the one that needs as many iterations
/// as the paper says, and the engine's as the tick calls it.
[[nodiscard]] std::vector<Contender> makeFigure7Contenders();

}  // namespace palpate::bench
