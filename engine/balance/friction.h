/// Coulomb friction in the balance: its strength is mu times the plane's load in the same tick.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/balance/solver.h"
#include "palpate/engine/types.h"

namespace palpate {

/// State of a plane: it does not touch the proxy, holds it, or yields to it.
enum class Piece : std::uint8_t { kFree, kHolds, kYields };

/// One plane of a balance and its friction.
struct RoughPlane {
  Vec3 q;              ///< Unit normal.
  double foot;         ///< Height of the plane over the old proxy: q.(x_i - proxy) [m].
  double strength;     ///< Strength s [N].
  double coefficient;  ///< Coefficient mu; 0 if the plane is smooth.
  Vec3 grip;           ///< Point where friction holds the proxy, relative to the old proxy [m].
  std::size_t plane;   ///< Index of the plane.
  std::size_t line;  ///< Index of the friction's line; if the plane is smooth, index of the plane.
  /// Index of the friction among the set's links; meaningless if the plane is smooth.
  std::size_t link;
  double load;       ///< Load n [N].
  double kept_load;  ///< Load at zero penetration [N].
  Vec3 pull;         ///< Dual b: the force of friction is -mu n b, |b| <= 1.
  Vec3 read;         ///< Dual b that Compliant::read() computes from the place.
  Vec3 kept_pull;    ///< Dual b at zero slip.
  Piece piece;       ///< Computed from the place by Compliant::read().
  bool sticks;       ///< True if the friction sticks; computed by Compliant::read().
};

/// One point or line of a balance, in the same form as RoughPlane.
struct Pull {
  Vec3 q;             ///< Direction of a line.
  Vec3 at;            ///< Anchor x_i minus the old proxy [m].
  double strength;    ///< Strength s [N].
  bool line;          ///< True for a line, false for a point.
  std::size_t index;  ///< Index of the primitive.
  Vec3 pull;          ///< Dual z: the force is -s z, |z| <= 1.
  Vec3 read;          ///< Dual z that Compliant::read() computes from the place.
  Vec3 kept_pull;     ///< Dual z at zero displacement.
  bool holds;         ///< True if the primitive holds the proxy; computed by Compliant::read().
};

/// Frictions of the last balance, to start the next search. The constructor allocates all memory.
struct FrictionStart {
  FrictionStart() : planes(kMaxPrimitives), pulls(kMaxPrimitives), held(kMaxPrimitives, 0.0) {}
  void forget() noexcept { count = 0; }  ///< Makes the next balance start without memory.

  std::vector<RoughPlane> planes;  ///< Planes of the last balance, in the order of its set.
  std::vector<Pull> pulls;      ///< Points and lines of the last balance, in the order of its set.
  std::vector<double> held;     ///< Strength of each link in the last balance [N].
  Vec3 motion = Vec3::Zero();   ///< proxy - old proxy of the last balance [m].
  std::size_t plane_count = 0;  ///< Number of `planes` in use.
  std::size_t pull_count = 0;   ///< Number of `pulls` in use.
  std::size_t count = 0;        ///< Number of links of the last balance; 0 if there is none.
};

/// Finds the balance in which the line of each entry in set.links() has the strength of Coulomb's
/// law,
///
///     s_t = mu n,   n the load of its plane in the same balance,
///
/// and writes those strengths to the set. Every kink gets a compliance c of at most 1 um. Loads and
/// frictions are then functions of the place,
///
///     n_i = s_i clamp(-h_i/c, 0, 1),   f_i = -mu_i n_i beta(u_i/c),   f_j = -s_j beta(d_j/c),
///     beta(v) = v / max(1, |v|),   h the height, u the slip, d the distance from point or line,
///
/// and R(x) = k (w - x) + sum of forces = 0 is a vector equation for x. It has a solution for any
/// mu, k and angle, because its forces are bounded (Brouwer). In a wedge that friction can jam,
/// there are several solutions. The search follows the last tick's solution. If that solution
/// ceases to exist, the search jumps to another. The method is Newton with the duals b and z in its
/// derivative (Hintermueller and Stadler 2006); friction.cpp lists the steps.
///
/// The method of multipliers removes c, if it converges. Finally solveProxy runs with those
/// strengths, and bounds the error of the proxy. If no balance is found, each friction gets the
/// larger of two strengths: in the last tick, and in the trial with the least |R|. So a failed
/// search seldom weakens a friction that held in the last tick. In all cases, the friction lines
/// are anchored at their grips, or at the feet of the grips (see below). If the grips are at the
/// old proxy, friction adds no energy beyond the effect of error_bound.
///
/// @param forces  At least as many entries as primitives. Receives the forces as in solveProxy. If
///                several kinks share a load, a balance without memory has the least sum |f|^2/s.
///                Later balances change the shares as little as possible.
/// @return        As from solveProxy. error_bound bounds the distance to the balance with the
///                strengths in the set, plus |s_t - mu n|/k of each link. Other balances may
///                satisfy Coulomb's law as well. `iterations` counts all methods; kIterationLimit
///                means that a search failed, so that some friction may not satisfy the law. If
///                frictions press each other's planes, error_bound can exceed the tolerance
///                although all frictions satisfy the law.
///
/// A common case is one plane with friction and drags (points where the friction grips). If the
/// plane bears the spring and all drags, the solution is unique, from a closed form or a scalar
/// equation. If the plane has moved in front of the grip, friction and drags hold the proxy at the
/// foot of the grip on the plane. The function moves them in `set` to the foot.
///
/// RT: no allocation. Cost: for one plane and drags, a closed form or a scalar equation; otherwise
/// one solveProxy and, if there are links or several kinks share a load, at most
/// SolverParams::max_iterations 3x3 solves. A search can fail: docs/decisions/0019 counts the
/// failures (palpate_bench_friction).
[[nodiscard]] SolveResult solveWithFriction(const Vec3& probe, double stiffness, PrimitiveSet& set,
                                            const Vec3& proxy, const SolverParams& params,
                                            WarmStart& warm, FrictionStart& start,
                                            std::span<Vec3> forces) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
