/// Newton's step on a balance whose primitives turn with the place at which they are read.
#pragma once

#include <cstddef>
#include <span>

#include "palpate/engine/primitive.h"
#include "palpate/engine/types.h"

namespace palpate {

/// The step [m] from x, where the primitives were read, to the place where they would balance if
/// they were read there, to second order.
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
/// converges: the change of the loads drops out across all n, and the step is free across all c.
/// Directed forces and primitives that yield give all they have: there ds/dx counts. D is how the
/// pull of lines and points that slide turns about G; how a friction's strength depends on its load
/// is left out. M' is M without the planes of surfaces. r is where the primitives were read: before
/// a tick's first reading, the place of the last tick's. A primitive that holds and does not turn
/// holds as in the balance. n and c, and the turn of n along n, are told apart: in a groove n and c
/// differ most, and with n in place of c the step is short by a factor that does not fall from one
/// reading to the next. Where the balance is a ridge (beyond the centre of curvature of a convex
/// edge) the step goes down from it, by the eigenvalues' magnitudes, none taken as below 0.05.
///
/// @param balance     G(x), the balance of the primitives [m].
/// @param from        x, where the step begins [m].
/// @param read        r, where the primitives were read [m].
/// @param stiffness   k [N/m].
/// @param primitives  The primitives in balance.
/// @param forces      What each primitive does to the proxy [N].
/// @param varying     Those of the primitives that vary, in the same order.
/// RT: no allocation. Cost: O(primitives) where something varies, else none.
[[nodiscard]] Vec3 newtonStep(const Vec3& balance, const Vec3& from, const Vec3& read,
                              double stiffness, std::span<const Primitive> primitives,
                              std::span<const Vec3> forces,
                              std::span<const Varying> varying) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
