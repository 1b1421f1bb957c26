/// The solver: balances primitives and the coupling spring (Lundin et al., section 4.2).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/types.h"

namespace palpate {

/// How a solve ended. With every value, `proxy` is finite if `start` is.
enum class SolveStatus : std::uint8_t {
  kConverged,       ///< error_bound is within the tolerance, or as small as rounding allows.
  kIterationLimit,  ///< proxy is the best point found, within error_bound of the balance.
  /// The input is invalid: a NaN, an infinity, stiffness <= 0, a primitive that isValid() rejects,
  /// too many primitives, too few entries in `forces`, or an overflow. proxy is `start`; offset is
  /// meaningless, so send no force; error_bound is infinite.
  kBadInput,
};

/// The method that found the result.
enum class SolverKind : std::uint8_t {
  kClosedForm,  ///< A primitive alone, two or three orthogonal primitives, directed forces, or a
                ///< plane with friction and drags.
  kPair,        ///< A plane with another primitive, or with friction and drags: a scalar equation.
  kGeneral,     ///< Pivots between planes, Newton with memory, or the method of multipliers.
};

/// Stopping criteria of solveProxy.
struct SolverParams {
  /// Wanted error_bound as a share of T/k. T is the sum of the strengths of points and lines, and
  /// of half the strengths of planes. Rounding allows 1e-8 in most sets. If the tolerance is NaN,
  /// or less than the rounding of the input, that rounding replaces it.
  double tolerance = 1e-6;
  /// Largest number of 3x3 linear solves of solveProxy, >= 1, in addition to at most 40 pivots
  /// between planes. solveWithFriction may use this number twice.
  int max_iterations = 120;
};

/// The balance that solveProxy found, and a bound of its error.
struct SolveResult {
  Vec3 proxy = Vec3::Zero();   ///< Position of the proxy in the balance [m].
  Vec3 offset = Vec3::Zero();  ///< proxy - probe [m], without the rounding to the probe's
                               ///< magnitude; k times `offset` is the spring's force.
  double error_bound = 0.0;    ///< Upper bound of the distance between probe + offset and the exact
                               ///< balance of the given primitives [m]. It includes the last digits
  ///< of their directions and of their positions relative to the probe.
  int iterations = 0;  ///< Number of pivots and 3x3 linear solves of all methods tried; for kPair,
                       ///< the number of evaluations of the scalar equation. 0 for the closed form.
                       ///< solveWithFriction adds the solves of its own search.
  SolverKind solver =
      SolverKind::kClosedForm;  ///< Method that gave `proxy`; meaningless after kBadInput.
  SolveStatus status = SolveStatus::kConverged;  ///< Determines which other members are valid.
};

/// Result of the last balance, from which the next one starts, because the same primitives usually
/// hold the proxy. solveProxy uses the memory only if `count` is the number of primitives. This
/// requires that the last balance was kGeneral and kConverged, or that solveWithFriction wrote the
/// memory. The primitives must be in the same order. Wrong memory costs more solves but never makes
/// the result wrong. The constructor allocates all memory.
struct WarmStart {
  WarmStart() : multipliers(kMaxPrimitives, Vec3::Zero()) {}
  /// Makes the next balance start without memory.
  void forget() noexcept { count = 0; }

  /// Multiplier of each primitive: -f/s for a point or line, -(f - s q/2)/(s/2) for a plane. If two
  /// opposed planes count as one slab, the first has -f/s with the force f of both.
  std::vector<Vec3> multipliers;
  Vec3 motion = Vec3::Zero();  ///< proxy - start of the last balance [m].
  std::size_t count = 0;       ///< Number of primitives of the stored balance; 0 if there is none.
};

/// Finds the position of the proxy at which the primitives balance the coupling spring: the
/// minimiser of the potential whose negative gradient is the residual force of eq. (14),
///
///     E(x) = k/2 |x - probe|^2 - sum_force s q.x + sum_point s |x - x_i|
///            + sum_line s |(I - q q^T)(x - x_i)| + sum_plane s max(0, q.(x_i - x)),
///
/// which solves eq. (15). With k > 0 and strengths >= 0 the potential is strongly convex, so the
/// solution is unique. Within error_bound it does not depend on `start` and `warm`. Departures from
/// the paper: (1) At a kink (proxy exactly on a plane, line or point) eq. (14) takes the
/// primitive's force as zero. This solver allows any force of the subgradient there, because the
/// balance usually lies on a kink. (2) Section 4.2 searches for the smallest |f_res|, which is not
/// always the balance (tests/engine/paper_test.cpp has a case). This solver stops by the duality
/// gap: |x - x*| <= sqrt(2 gap / k).
///
/// @param probe       Hand position [m].
/// @param stiffness   Coupling stiffness k of eq. (3) [N/m], > 0.
/// @param primitives  The primitives to balance; at most kMaxPrimitives.
/// @param start       Last position of the proxy [m]; returned as the proxy if the input is bad.
/// @param warm        Memory of the last balance, which this balance replaces; may be null. With
///                    memory a balance usually takes fewer solves. The solver proves every result
///                    that it finds from memory.
/// @param forces      Empty, or at least as many entries as primitives: the force of each primitive
///                    on the proxy [N]. Their sum with k (probe - proxy) is zero, up to k
///                    error_bound, unless the status is kIterationLimit. If primitives share a load
///                    (parallel planes), the forces are one possible distribution. Meaningless
///                    after kBadInput.
///
/// RT: no allocation, no lock, no system call; about 150 KB of stack for more than 16 primitives,
/// touched only as far as needed. Cost: O(primitives) per iteration. Deterministic: in the same
/// program, the same input and `warm` give the same bits.
[[nodiscard]] SolveResult solveProxy(const Vec3& probe, double stiffness,
                                     std::span<const Primitive> primitives, const Vec3& start,
                                     const SolverParams& params = {}, WarmStart* warm = nullptr,
                                     std::span<Vec3> forces = {}) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
