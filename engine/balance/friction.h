/// Coulomb friction inside the balance: friction and load are those of the same tick.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/balance/solver.h"
#include "palpate/engine/types.h"

namespace palpate {

/// State of a plane: free of the proxy, holding it, or yielding to it with all its strength.
enum class Piece : std::uint8_t { kFree, kHolds, kYields };

/// One plane of a balance, its friction, and the pieces of their force laws that apply.
struct RoughPlane {
  Vec3 q;              ///< Normal, unit.
  double foot;         ///< q.(x_i - proxy) [m].
  double strength;     ///< s [N].
  double coefficient;  ///< mu; 0 if smooth.
  Vec3 grip;           ///< Place where friction holds the proxy, from the old proxy [m].
  std::size_t plane;   ///< Index of the plane.
  std::size_t line;    ///< Index of the friction's line; if smooth, of the plane.
  std::size_t link;    ///< Index of the friction among the set's links; meaningless if smooth.
  double load;         ///< n [N].
  double kept_load;    ///< n that the plane bears at zero penetration [N].
  Vec3 pull;           ///< b: the friction is -mu n b, |b| <= 1.
  Vec3 read;           ///< b computed from the place alone.
  Vec3 kept_pull;      ///< b at zero slip.
  Piece piece;         ///< Computed from the place.
  bool sticks;         ///< True if |b| < 1 by the place.
};

/// One point or line of a balance, in the same form.
struct Pull {
  Vec3 q;             ///< A line's direction.
  Vec3 at;            ///< x_i - proxy [m].
  double strength;    ///< s [N].
  bool line;          ///< True for a line, false for a point.
  std::size_t index;  ///< Index of the primitive.
  Vec3 pull;          ///< z: the force is -s z, |z| <= 1.
  Vec3 read;          ///< z computed from the place alone.
  Vec3 kept_pull;     ///< z at zero displacement.
  bool holds;         ///< True if |z| < 1 by the place.
};

/// Frictions of the last balance, from which the next one starts. The constructor allocates all
/// memory.
struct FrictionStart {
  FrictionStart() : planes(kMaxPrimitives), pulls(kMaxPrimitives), held(kMaxPrimitives, 0.0) {}
  void forget() noexcept { count = 0; }  ///< The next balance starts cold.

  std::vector<RoughPlane> planes;  ///< Planes of the last balance, in their order.
  std::vector<Pull> pulls;         ///< Points and lines of the last balance, in their order.
  std::vector<double> held;        ///< Strength of each link in the last balance [N].
  Vec3 motion = Vec3::Zero();      ///< proxy - old proxy of the last balance [m].
  std::size_t plane_count = 0;     ///< Entries in use of `planes`.
  std::size_t pull_count = 0;      ///< Entries in use of `pulls`.
  std::size_t count = 0;           ///< Number of links of the last balance; 0: no memory.
};

/// Finds the balance in which every line of set.links() is as strong as Coulomb's law allows,
///
///     s_t = mu n,   n the load of its plane in the same balance,
///
/// and leaves those strengths in the set. Every kink gets the compliance c = 1 um. Then loads and
/// frictions are functions of the place alone,
///
///     n_i = s_i clamp(-h_i/c, 0, 1),   f_i = -mu_i n_i beta(u_i/c),   f_j = -s_j beta(d_j/c),
///     beta(v) = v / max(1, |v|),   h the height, u the slip, d the distance from point or line,
///
/// and R(x) = k (w - x) + sum of forces = 0 is one equation in three unknowns. It has a solution
/// for any mu, k and angle, because its forces are bounded (Brouwer). If walls form a wedge that
/// friction can jam, it has several solutions; the search finds the one that continues the last
/// tick's. The method is Newton with the duals b and z in its derivative (Hintermueller and Stadler
/// 2006), and a line search on R.d. If a balance ends, Newton leaps to the next one. The search
/// starts from the pieces of the last tick; else it goes from soft kinks to hard ones; else it
/// starts with all sticking. Then the method of multipliers removes c; the multipliers stay from
/// tick to tick. Finally solveProxy runs with those strengths and certifies the place that the
/// loads balance. If no balance is found, each friction holds as it did in the last tick or in the
/// trial with the least |R|, whichever is more: no friction slips because a search failed. However
/// the load is found, all primitives of the balance are anchored at the old proxy, or at its foot
/// as below. So the balance makes no energy, except what error_bound can hide.
///
/// @param forces  At least as many entries as primitives; filled as by solveProxy. If several kinks
///                share a load, a balance that starts cold has the least sum |f|^2/s. Later
///                balances change the shares only as far as they have to.
/// @return        As solveProxy. error_bound is the distance to the balance with the strengths left
///                in the set, plus |s_t - mu n|/k of each link. That balance need not be the only
///                one that meets Coulomb's law. `iterations` counts all methods; kIterationLimit
///                means that a law was not met. If frictions press each other's planes, error_bound
///                can exceed the tolerance although the law is met.
///
/// One plane, its friction, and points where that friction grips (drags) have one answer, in closed
/// form or by a scalar equation, if the plane bears the spring and all drags. If that plane has
/// moved in front of the grip, friction and drags hold the proxy at the grip's foot on the plane.
/// `set` then has the foot as their position.
///
/// RT: no allocation. Cost: without links, one solveProxy; for one plane and drags, a closed form;
/// else some 10 to 20 3x3 solves, at most SolverParams::max_iterations and those of solveProxy. Of
/// 180,000 balances along motions over one to four rough planes, 19 were not found.
[[nodiscard]] SolveResult solveWithFriction(const Vec3& probe, double stiffness, PrimitiveSet& set,
                                            const Vec3& proxy, const SolverParams& params,
                                            WarmStart& warm, FrictionStart& start,
                                            std::span<Vec3> forces) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
