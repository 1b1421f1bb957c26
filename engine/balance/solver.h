/// The balance: the place where the primitives hold the coupling spring. Lundin et al.,
/// section 4.2.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/types.h"

namespace palpate {

/// How a solve ended. Every value is safe to act on: `proxy` is finite whenever `start` is.
enum class SolveStatus : std::uint8_t {
  kConverged,       ///< error_bound is within the tolerance, or at the rounding of the input.
  kIterationLimit,  ///< Best point found so far; error_bound bounds its distance from the balance.
  kBadInput,        ///< The input has a NaN, an infinity, stiffness <= 0, strength < 0, a direction
                    ///< that is not unit length, an unknown kind, too many primitives, or numbers
                    ///< that (or whose quotients) overflow. proxy is `start`, unchanged; offset is
                    ///< meaningless, so send no force; error_bound is infinite.
};

/// Method that gave the answer.
enum class SolverKind : std::uint8_t {
  kClosedForm,  ///< Orthogonal primitives, including any one alone, and directed forces.
  kPair,        ///< A plane and one other primitive, or a plane with its friction and drags: a
                ///< scalar equation.
  kGeneral,     ///< Several primitives: pivots between planes; else Newton on 3x3 systems,
                ///< warm or by the method of multipliers.
};

/// Stopping rules of solveProxy: the wanted accuracy, and a cap on the work.
struct SolverParams {
  /// Wanted error_bound as a share of T/k, T the strengths of points and lines and half of those of
  /// planes. T/k is the farthest that these can pull the proxy from where directed forces and the
  /// other half of each plane put it. It is at most S/k, S the sum of strengths. Rounding nearly
  /// always allows 1e-8, seldom less. If <= 0 or NaN: as small as rounding allows.
  double tolerance = 1e-6;
  /// Largest number of 3x3 linear solves, >= 1, after up to 40 pivots between planes. Ten million
  /// random balances took at most 50 each. 286 balances from a search for hard ones took at most
  /// 80.
  int max_iterations = 120;
};

/// The balance that solveProxy found, and a bound of its error.
struct SolveResult {
  Vec3 proxy = Vec3::Zero();   ///< [m]
  Vec3 offset = Vec3::Zero();  ///< proxy - probe [m], not rounded to the probe's magnitude: the
                               ///< spring's force is k times this.
  double error_bound = 0.0;    ///< Upper bound of the distance of probe + offset from the exact
                               ///< balance of the primitives as given [m], to the last digit of
                               ///< their directions and of their positions relative to the probe.
  int iterations = 0;  ///< Pivots and 3x3 linear solves of all methods tried; for a plane and one
                       ///< other primitive, evaluations of their scalar equation; 0 for the closed
                       ///< form.
  SolverKind solver = SolverKind::kClosedForm;   ///< Method that gave `proxy`; meaningless after
                                                 ///< kBadInput.
  SolveStatus status = SolveStatus::kConverged;  ///< Decides which other members are valid.
};

/// Result of the last balance, as a start of the next one: from tick to tick the same primitives
/// hold the proxy. Primitives must come in the same order. The next balance starts cold unless
/// their number is the same and the last one was kGeneral and kConverged. Wrong memory costs a few
/// more solves than a cold start, but never makes the answer wrong. The constructor allocates all
/// memory.
struct WarmStart {
  WarmStart() : multipliers(kMaxPrimitives, Vec3::Zero()) {}
  /// The next balance starts cold.
  void forget() noexcept { count = 0; }

  std::vector<Vec3> multipliers;  ///< One for each primitive: -f/s for points and lines, for planes
                                  ///< -(f - s q/2)/(s/2), their force without its constant half.
  Vec3 motion = Vec3::Zero();     ///< proxy - start of the last balance [m].
  std::size_t count = 0;          ///< Number of primitives of the last balance; 0: no memory.
};

/// Finds the proxy position at which the primitives balance the coupling spring.
///
/// Minimises the potential whose gradient is minus the residual force of eq. (14),
///
///     E(x) = k/2 |x - probe|^2 - sum_force s q.x + sum_point s |x - x_i|
///            + sum_line s |(I - q q^T)(x - x_i)| + sum_plane s max(0, q.(x_i - x)),
///
/// whose minimiser is the solution of eq. (15). With k > 0 and strengths >= 0 it is strongly
/// convex, so the answer is unique, and within error_bound it does not depend on `start` and
/// `warm`. Departures from the paper: at a kink (proxy exactly on a plane, line or point) eq. (14)
/// takes the primitive's force as zero. This solver takes any force of its set, because the balance
/// usually lies on a kink. The smallest |f_res|, which section 4.2 searches, is not always the
/// balance (tests/engine/paper_test.cpp has a case). So this solver stops by the duality gap: |x -
/// x*| <= sqrt(2 gap / k).
///
/// @param probe       Hand position [m].
/// @param stiffness   Coupling stiffness k of eq. (3) [N/m], > 0.
/// @param primitives  The primitives to balance; at most kMaxPrimitives.
/// @param start       Last position of the proxy [m]; returned as the proxy if the input is bad.
/// @param warm        Memory of the last balance, replaced by that of this one. With memory a
///                    balance takes one to three solves, from a cold start two to nine. Null: a
///                    cold start. The solver proves every answer that it takes from this memory.
/// @param forces      Empty, or at least as many entries as primitives: the force of each primitive
///                    on the proxy [N]. Their sum with k (probe - proxy) is zero, up to k
///                    error_bound, unless the status is kIterationLimit. If primitives share a load
///                    (parallel planes), the forces are one way to share it. Meaningless after
///                    kBadInput.
///
/// RT: no allocation, no lock, no system call; about 150 KB of stack, touched only as far as the
/// primitives need it. Cost: O(primitives) per iteration. Deterministic: the same input and `warm`
/// give the same bits.
[[nodiscard]] SolveResult solveProxy(const Vec3& probe, double stiffness,
                                     std::span<const Primitive> primitives, const Vec3& start,
                                     const SolverParams& params = {}, WarmStart* warm = nullptr,
                                     std::span<Vec3> forces = {}) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
