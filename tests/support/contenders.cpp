#include "tests/support/contenders.h"

#include <cmath>
#include <cstdio>
#include <memory>
#include <utility>

#include "palpate/bench/methods/constraint_approach.h"
#include "palpate/bench/methods/euler_adaptive.h"
#include "palpate/bench/methods/euler_fixed.h"
#include "palpate/bench/methods/force_function.h"
#include "palpate/bench/methods/nelder_mead.h"
#include "palpate/bench/methods/smallest_residual.h"
#include "palpate/engine/balance/solver.h"

namespace palpate::bench {
namespace {

using methods::Balance;

/// Returns a number as a digit and a power of ten, such as "2e-3". Rounds to one significant digit.
std::string word(double number) {
  const int exponent = static_cast<int>(std::floor(std::log10(number) + 1e-9));
  char text[32];
  std::snprintf(text, sizeof text, "%ge%d", std::round(number / std::pow(10.0, exponent)),
                exponent);
  return text;
}

Contender makePlain(std::string name,
                    Balance (*method)(const Vec3&, double, std::span<const Primitive>,
                                      const Vec3&) noexcept) {
  const auto solve = [method](const BalanceProblem& p, std::span<const Primitive> primitives) {
    return Answer{method(p.probe, p.stiffness, primitives, p.start)};
  };
  return {std::move(name), "", solve};
}

template <class Params>
Contender makeSet(std::string name, std::string setting,
                  Balance (*method)(const Vec3&, double, std::span<const Primitive>, const Vec3&,
                                    const Params&) noexcept,
                  const Params& params) {
  const auto solve = [method, params](const BalanceProblem& p,
                                      std::span<const Primitive> primitives) {
    return Answer{method(p.probe, p.stiffness, primitives, p.start, params)};
  };
  return {std::move(name), std::move(setting), solve};
}

/// How the step shrinks in our version of the solver of Lundin et al.
enum class Pace {
  kSteady,   ///< As EulerAdaptiveParams' defaults.
  kHalving,  ///< Halves, as in the paper: needs fewer iterations.
  /// Shrinks by 3 %, for up to 10,000 iterations.
  kSlow,
};
Contender makePaper(double tolerance, Pace pace) {
  methods::EulerAdaptiveParams params;
  if (tolerance < params.tolerance) params.max_iterations *= 10;
  params.tolerance = tolerance;
  std::string setting = word(tolerance);
  switch (pace) {
    case Pace::kSteady:
      break;
    case Pace::kHalving:
      params.grow = 1.05;
      params.shrink = 0.5;
      setting += ", halving";
      break;
    case Pace::kSlow:
      params.shrink = 0.97;
      params.max_iterations = 10000;
      setting += ", slow";
      break;
  }
  return makeSet(kPaper, setting, methods::eulerAdaptive, params);
}

/// Returns the engine's solver. With `warm`, each balance starts from the last one.
Contender makeOurs(double tolerance, bool warm) {
  SolverParams params;
  params.tolerance = tolerance;
  const auto memory = warm ? std::make_shared<WarmStart>() : nullptr;
  const auto solve = [params, memory](const BalanceProblem& p,
                                      std::span<const Primitive> primitives) {
    const SolveResult r =
        solveProxy(p.probe, p.stiffness, primitives, p.start, params, memory.get());
    return Answer{{r.offset, r.iterations, r.status == SolveStatus::kConverged}, r.error_bound};
  };
  const auto forget = [memory] {
    if (memory) memory->forget();
  };
  return {warm ? kOursWarm : kOurs, word(tolerance), solve, forget};
}

}  // namespace

std::vector<Contender> makeContenders(bool motion) {
  std::vector<Contender> list;
  list.push_back(makePlain("force function", methods::forceFunction));
  list.push_back(makePlain("constraint approach", methods::constraintApproach));
  for (const double step : {1e-1, 1e-2, 1e-3}) {
    methods::EulerFixedParams params;
    params.step = step;
    params.max_iterations = static_cast<int>(std::lround(20.0 / step));
    list.push_back(makeSet("Euler, fixed step", word(step), methods::eulerFixed, params));
  }
  for (const double tolerance :
       {1e-2, 1e-3, methods::EulerAdaptiveParams{}.tolerance, 1e-6, 1e-8}) {
    list.push_back(makePaper(tolerance, Pace::kSteady));
  }
  for (const double tolerance : {1e-3, 3e-5, 1e-6}) {
    list.push_back(makePaper(tolerance, Pace::kHalving));
  }
  for (const double tolerance : {3e-5, 1e-6}) list.push_back(makePaper(tolerance, Pace::kSlow));
  for (const double tolerance : {1e-2, 1e-3, methods::NelderMeadParams{}.tolerance, 1e-8}) {
    methods::NelderMeadParams params;
    params.tolerance = tolerance;
    list.push_back(makeSet("Nelder-Mead", word(tolerance), methods::nelderMead, params));
  }
  for (const double tolerance : {1e-3, methods::SmallestResidualParams{}.tolerance, 1e-8}) {
    methods::SmallestResidualParams params;
    params.tolerance = tolerance;
    list.push_back(
        makeSet("smallest residual", word(tolerance), methods::smallestResidual, params));
  }
  for (const double tolerance : {1e-2, 1e-3, 1e-4, 1e-6, 1e-8}) {
    list.push_back(makeOurs(tolerance, false));
    if (motion) list.push_back(makeOurs(tolerance, true));
  }
  return list;
}

std::vector<Contender> makeFigure7Contenders() {
  return {makePaper(3e-5, Pace::kHalving), makeOurs(SolverParams{}.tolerance, false),
          makeOurs(SolverParams{}.tolerance, true)};
}

}  // namespace palpate::bench
