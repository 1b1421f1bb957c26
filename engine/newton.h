/// Newton's step on the balance: where the primitives turn with the place at which they are read.
#pragma once

#include <cstddef>
#include <span>

#include "engine/primitive.h"
#include "engine/types.h"

namespace palpate {

/// A plane whose normal n turns with the place x where it was read.
struct TurningPlane {
  std::size_t index = 0;     ///< Among the primitives.
  Mat3 turn = Mat3::Zero();  ///< dn/dx [1/m].
  Vec3 across =
      Vec3::Zero();     ///< The slope c that the interpolated value has at x, unit, outwards:
                        ///< the surface is across this. Where values are trilinear not n.
  double height = 0.0;  ///< So far along c is x above the surface [m].
};

/// From x, where the primitives were read, to where they would balance if they were read there, to
/// second order.
///
/// Primitives that are read at x balance at G(x); what a tick looks for is x = G(x). Going to G and
/// reading again is Picard's iteration: under a load L on a surface of radius r its error grows by
/// L / (k r) a reading, and it does not converge in a fillet of a radius below L / k. Newton's
/// method on the forces (eq. 14) and the surfaces together,
///
///     (I + D - M) step - sum_i n_i dL_i / k = (I + D) (G(x) - x),   M = sum_i (L_i / k) dn_i/dx,
///     c_i . step = -height_i   for every plane that holds, 0 < L_i < s_i,
///
/// does: the change of the loads falls out across all n, and the step is free across all c. D is
/// how the pull of lines and points that slide turns about G; that a friction's strength follows
/// its load is left out. What holds and does not turn holds as the balance has it. n and c, and the
/// turn of n along n, are told apart: in a groove they differ most, and where n stands for both the
/// step is short by a factor that does not fall from reading to reading. Where the balance is a
/// ridge (beyond the centre of curvature of a convex edge) the step goes down from it, by the
/// magnitudes of the eigenvalues; none counts as smaller than 0.05.
///
/// @param balance     G(x) [m], that of the primitives,
/// @param from        and x.
/// @param stiffness   k [N/m].
/// @param primitives  In balance,
/// @param forces      what each does to the proxy [N],
/// @param turning     and those that turn, in the order of the primitives.
/// RT: no allocation. Cost: O(primitives) where something turns, else none.
[[nodiscard]] Vec3 newtonStep(const Vec3& balance, const Vec3& from, double stiffness,
                              std::span<const Primitive> primitives, std::span<const Vec3> forces,
                              std::span<const TurningPlane> turning) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
