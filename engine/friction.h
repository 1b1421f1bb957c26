/// Coulomb friction inside the balance: one tick, one load.
#pragma once

#include <span>
#include <vector>

#include "palpate/engine/primitive.h"
#include "palpate/engine/solver.h"
#include "palpate/engine/types.h"

namespace palpate {

/// The frictions of the last balance, from which the next one starts. Memory is allocated when it
/// is made.
struct FrictionStart {
  FrictionStart()
      : strengths(kMaxPrimitives, 0.0),
        tried(kMaxPrimitives, 0.0),
        missed(kMaxPrimitives, 0.0),
        best(kMaxPrimitives, 0.0) {}
  void forget() noexcept { count = 0; }  ///< The next balance starts with all frictions at zero.

  std::vector<double> strengths;  ///< Strength of each link [N].
  std::size_t count = 0;          ///< Number of links of that balance; 0: nothing remembered.
  std::vector<double> tried;      ///< Scratch: the strengths of the last trial [N].
  std::vector<double> missed;     ///< Scratch: mu n - s_t of each link in the last trial [N].
  std::vector<double> best;       ///< Scratch: the strengths of the trial that missed least [N].
};

/// Most balances for one friction, most for several together (which need not have an answer), and
/// most 3x3 solves after which no other trial begins; several frictions get half as many solves.
inline constexpr int kMostFrictionSolves = 64;
inline constexpr int kMostJointSolves = 22;          ///< Balances for several frictions.
inline constexpr int kMostFrictionIterations = 400;  ///< SolveResult::iterations, added up.

/// Finds the balance in which every line of set.links() is as strong as Coulomb's law allows,
///
///     s_t = mu n(s_t),   n the load of its plane in this very balance,
///
/// and leaves those strengths in the set. A plane and its friction alone are orthogonal: n does not
/// depend on s_t, and two closed forms are exact. With other primitives it is one scalar equation a
/// link on [0, mu s_n], continuous and with a change of sign: a bracketed secant (Illinois),
/// started from `start`, which also decides between several roots; several links together by
/// Anderson's mixing of the last two trials. Where that fails, each holds as it did in the last
/// tick or in the best trial, whichever is more: nothing slips because a search failed. However the
/// load is found, the balance is one of primitives anchored at the old proxy and makes no energy.
///
/// @param forces  At least as many as primitives; filled as solveProxy and shareLoads do.
/// @return        As solveProxy; error_bound gains |s_t - mu n| / k of every link, iterations are
///                those of all balances, and kIterationLimit says that a law was not met: that
///                |s_t - mu n| exceeds what the balance can tell, at most 0.1 % and 0.1 mN.
///
/// RT: no allocation. Cost: one solveProxy without links; two for planes with friction alone, five
/// or so for one among others; several together take up to kMostJointSolves. Measured, surfaces
/// with friction in one place: p99 of the tick 40 us with 2, 160 us with 4, worst 0.6 ms with 8.
[[nodiscard]] SolveResult solveWithFriction(const Vec3& probe, double stiffness, PrimitiveSet& set,
                                            const Vec3& proxy, const SolverParams& params,
                                            WarmStart& warm, FrictionStart& start,
                                            std::span<Vec3> forces) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
