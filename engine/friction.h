/// Coulomb friction inside the balance: one tick, one load.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "palpate/engine/primitive.h"
#include "palpate/engine/solver.h"
#include "palpate/engine/types.h"

namespace palpate {

/// What a plane does: it is free of the proxy, holds it, or yields to it with all its strength.
enum class Piece : std::uint8_t { kFree, kHolds, kYields };

/// One plane of a balance, the friction on it, and the pieces of their laws that were found.
struct RoughPlane {
  Vec3 q;              ///< Normal, unit.
  double foot;         ///< q.(x_i - proxy) [m].
  double strength;     ///< s [N].
  double coefficient;  ///< mu; 0 where smooth.
  Vec3 grip;           ///< Where friction holds the proxy, from the old proxy [m].
  std::size_t plane;   ///< Index of the plane.
  std::size_t line;    ///< Index of its friction's line; of the plane where smooth.
  std::size_t link;    ///< Index of the friction among the set's links; void where smooth.
  double load;         ///< n [N].
  double kept_load;    ///< n that the plane bears without being pressed in [N].
  Vec3 pull;           ///< b: the friction is -mu n b, |b| <= 1.
  Vec3 read;           ///< b by the place alone.
  Vec3 kept_pull;      ///< b without a slip.
  Piece piece;         ///< By the place.
  bool sticks;         ///< By the place: |b| < 1.
};

/// One point or line of a balance, likewise.
struct Pull {
  Vec3 q;             ///< A line's direction.
  Vec3 at;            ///< x_i - proxy [m].
  double strength;    ///< s [N].
  bool line;          ///< A line, else a point.
  std::size_t index;  ///< Index of the primitive.
  Vec3 pull;          ///< z: the force is -s z, |z| <= 1.
  Vec3 read;          ///< z by the place alone.
  Vec3 kept_pull;     ///< z without a displacement.
  bool holds;         ///< By the place: |z| < 1.
};

/// The frictions of the last balance, from which the next one starts. Memory is allocated when it
/// is made.
struct FrictionStart {
  FrictionStart() : planes(kMaxPrimitives), pulls(kMaxPrimitives), held(kMaxPrimitives, 0.0) {}
  void forget() noexcept { count = 0; }  ///< The next balance starts cold.

  std::vector<RoughPlane> planes;  ///< Planes of the last balance, in their order.
  std::vector<Pull> pulls;         ///< Points and lines of it, likewise.
  std::vector<double> held;        ///< Strength of each link in the last balance [N].
  Vec3 motion = Vec3::Zero();      ///< proxy - old proxy of the last balance [m].
  std::size_t plane_count = 0;     ///< Of `planes`.
  std::size_t pull_count = 0;      ///< Of `pulls`.
  std::size_t count = 0;           ///< Number of links of that balance; 0: nothing remembered.
};

/// Finds the balance in which every line of set.links() is as strong as Coulomb's law allows,
///
///     s_t = mu n,   n the load of its plane in this very balance,
///
/// and leaves those strengths in the set. Every kink is given the compliance c = 1 um: then loads
/// and frictions are functions of the place alone,
///
///     n_i = s_i clamp(-h_i/c, 0, 1),   f_i = -mu_i n_i beta(u_i/c),   f_j = -s_j beta(d_j/c),
///     beta(v) = v / max(1, |v|),   h the height, u the slip, d the distance from point or line,
///
/// and R(x) = k (w - x) + sum of forces = 0 is one equation in three unknowns. It has a solution
/// for any mu, k and angle, since its forces are bounded (Brouwer); where walls form a wedge that
/// friction can jam it has several, and the one that continues the last tick's is found. It is
/// solved by Newton with the duals b and z in its derivative (Hintermueller and Stadler 2006) and a
/// line search on R.d; where a balance ends Newton leaps to the next one. It starts from the pieces
/// of the last tick; else from soft kinks to hard ones; else with all sticking. Then c is taken out
/// by the method of multipliers, which stay from tick to tick. Last comes solveProxy with those
/// strengths: it certifies the place that the loads balance. Where no balance is found each
/// friction holds as it did in the last tick or in the last trial, whichever is more: nothing slips
/// because a search failed. However the load is found, the balance is one of primitives anchored at
/// the old proxy, or at its foot as below, and makes no energy, but for what error_bound can hide.
///
/// @param forces  At least as many as primitives; filled as solveProxy does; where
///                several kinks share a load, sum |f|^2/s is least in a balance that begins
///                cold, and later what it is changes as little as it has to.
/// @return        As solveProxy: error_bound is the distance to the balance with the strengths
///                left in the set, with |s_t - mu n|/k of each link added; it need not be the only
///                one that meets Coulomb's law. Iterations are those of all methods, and
///                kIterationLimit says that a law was not met. Where frictions press each other's
///                planes error_bound can exceed the tolerance of a law that is met.
///
/// One plane, the friction on it, and points where that friction grips (drags) have one answer, in
/// closed form or by a scalar equation, where the plane bears the spring and all drags. Where it
/// has moved in front of the grip they hold the proxy at the grip's foot on it, and `set` has that
/// as their position.
///
/// RT: no allocation. Cost: one solveProxy without links, a closed form for one plane and drags;
/// else some 10 to 20 3x3 solves, at most SolverParams::max_iterations and those of
/// solveProxy. Of 180,000 balances along motions over one to four rough planes 19 were not found.
[[nodiscard]] SolveResult solveWithFriction(const Vec3& probe, double stiffness, PrimitiveSet& set,
                                            const Vec3& proxy, const SolverParams& params,
                                            WarmStart& warm, FrictionStart& start,
                                            std::span<Vec3> forces) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
