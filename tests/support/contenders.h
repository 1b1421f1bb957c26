/// The methods that benchmarks compare, each with its settings, behind one signature.
#pragma once

#include <functional>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include "palpate/bench/methods/method.h"
#include "tests/support/problems.h"

namespace palpate::bench {

/// A method's result and its error bound.
struct Answer {
  methods::Balance balance;
  double bound = std::numeric_limits<double>::infinity();  ///< Error bound [m]; infinity: none.
};

/// A method at one setting.
struct Contender {
  std::string method;  ///< Name of the method in charts.
  /// Tolerance, or the step of the fixed-step method, such as "1e-3". For the paper's solver, a
  /// word on how its step shrinks can follow. Empty: none.
  std::string setting;
  /// Solves a problem. The primitives are a fresh copy of the problem's, as in a tick.
  std::function<Answer(const BalanceProblem&, std::span<const Primitive>)> solve;
  /// Discards the warm start. Call this before a balance that does not continue the previous one.
  std::function<void()> forget = [] {};
};

/// Names, in charts, of the engine's solver and of our version of the paper's solver.
inline constexpr const char* kOurs = "palpate";
inline constexpr const char* kOursWarm = "palpate, warm";
inline constexpr const char* kPaper = "Euler, adaptive step";

/// Returns all methods. The engine's solver starts cold. If `motion` is true, the list also has the
/// engine's solver with a warm start.
[[nodiscard]] std::vector<Contender> makeContenders(bool motion);

/// Returns the methods of figure 7. The paper's solver halves its step, as in the paper.
/// The engine's solver has its default tolerance, once with a cold and once with a warm start.
[[nodiscard]] std::vector<Contender> makeFigure7Contenders();

}  // namespace palpate::bench
