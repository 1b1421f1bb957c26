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
  std::string method;   ///< Name of the method in charts.
  std::string setting;  ///< The method's tolerance, or the step of the fixed-step method, such as
                        ///< 1e-3. Empty: the method has no setting.
  /// Solves a problem. The primitives are those of the problem, in memory that was just written, as
  /// in a tick.
  std::function<Answer(const BalanceProblem&, std::span<const Primitive>)> solve;
  /// To be called before a balance that does not continue the previous one.
  std::function<void()> forget = [] {};
};

/// Names in charts of the engine's solver and of our version of the paper's solver.
inline constexpr const char* kOurs = "palpate";
inline constexpr const char* kOursWarm = "palpate, warm";
inline constexpr const char* kPaper = "Euler, adaptive step";

/// Returns all methods. The engine's solver starts without memory. For motions, the list also has
/// the engine's solver with the memory of the last balance.
[[nodiscard]] std::vector<Contender> makeContenders(bool motion);

/// Returns the methods of figure 7. Our version of the paper's solver is the one that needs the
/// paper's number of iterations. The engine's solver is called as in a tick.
[[nodiscard]] std::vector<Contender> makeFigure7Contenders();

}  // namespace palpate::bench
