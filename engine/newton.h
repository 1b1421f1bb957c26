/// Newton's step on the balance: where the primitives turn with the place at which they are read.
#pragma once

#include <cstddef>
#include <span>

#include "palpate/engine/primitive.h"
#include "palpate/engine/types.h"

namespace palpate {

/// From x, where the primitives were read, to where they would balance if they were read there, to
/// second order.
///
/// Primitives that are read at x balance at G(x); what a tick looks for is x = G(x). Going to G and
/// reading again is Picard's iteration: under a load L on a surface of radius r its error grows by
/// L / (k r) a reading, and it does not converge in a fillet of a radius below L / k. Newton's
/// method on the forces (eq. 14) and the surfaces together,
///
///     (I + D - M) step - sum_i n_i dL_i / k = (I + D) (G(x) - x) + M' (x - r),
///     M = sum_i (L_i dn_i/dx + [it gives all it has] n_i (ds_i/dx)^T) / k,
///     c_i . step = -height_i   for every plane that holds, 0 < L_i < s_i,
///
/// does: the change of the loads falls out across all n, and the step is free across all c.
/// Directed forces, and what yields, give all they have: there the strength counts. D is how the
/// pull of lines and points that slide turns about G; that a friction's strength follows its load
/// is left out. M' is M without the planes of surfaces, r where it was read: before a tick's first
/// reading that is the last tick's. What holds and does not turn holds as the balance has it. n and
/// c, and the turn of n along n, are told apart: in a groove they differ most, and where n stands
/// for both the step is short by a factor that does not fall from reading to reading. Where the
/// balance is a ridge (beyond the centre of curvature of a convex edge) the step goes down from it,
/// by the magnitudes of the eigenvalues; none counts as smaller than 0.05.
///
/// @param balance     G(x) [m], that of the primitives,
/// @param from        x,
/// @param read        and r.
/// @param stiffness   k [N/m].
/// @param primitives  In balance,
/// @param forces      what each does to the proxy [N],
/// @param varying     and those that vary, in the order of the primitives.
/// RT: no allocation. Cost: O(primitives) where something varies, else none.
[[nodiscard]] Vec3 newtonStep(const Vec3& balance, const Vec3& from, const Vec3& read,
                              double stiffness, std::span<const Primitive> primitives,
                              std::span<const Vec3> forces,
                              std::span<const Varying> varying) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
