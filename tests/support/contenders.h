/// The compared methods, each at its settings, behind one signature.
#pragma once

#include <functional>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include "palpate/bench/methods/method.h"
#include "tests/support/problems.h"

namespace palpate::bench {

/// A method's answer and the error bound that it claims.
struct Answer {
  methods::Balance balance;
  double bound = std::numeric_limits<double>::infinity();  ///< Certified error [m].
};

/// A method at one setting.
struct Contender {
  std::string method;  ///< Its name in charts.
  std::string
      setting;  ///< Its tolerance (for the fixed step: the step) as 1e-3; empty: it has no setting.
  /// Solves a problem. The primitives are the problem's, in memory that was just written, as in a
  /// tick.
  std::function<Answer(const BalanceProblem&, std::span<const Primitive>)> solve;
  /// Called before a balance that does not follow from the previous balance.
  std::function<void()> forget = [] {};
};

/// Names in charts of the engine's solver and of our reading of the paper's solver.
inline constexpr const char* kOurs = "palpate";
inline constexpr const char* kOursWarm = "palpate, warm";
inline constexpr const char* kPaper = "Euler, adaptive step";

/// Returns all methods. The engine's solver starts without memory. For motions the list also has
/// the solver that remembers the last balance.
[[nodiscard]] std::vector<Contender> makeContenders(bool motion);

/// Returns the methods of figure 7. Of our readings of the paper's solver the list has the one that
/// needs as many iterations as the paper says. The engine's solver is called as in the tick.
[[nodiscard]] std::vector<Contender> makeFigure7Contenders();

}  // namespace palpate::bench
