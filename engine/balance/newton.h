/// Newton's step for a balance whose primitives vary with the place at which the volumes are read.
#pragma once

#include <cstddef>
#include <span>

#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Returns the step [m] from x to the place where the primitives would balance if they were read
/// there, to second order.
///
/// Primitives that are read at x balance at G(x); a tick searches x = G(x). Picard's iteration
/// moves to G and reads again. Under a load L on a surface of radius R, it multiplies the error by
/// L / (k R) in each reading. So it does not converge in a fillet with a radius below L / k.
/// Newton's method on the forces (eq. 14) and the surfaces together,
///
///     (I + D - M) step - sum_i n_i dL_i / k = (I + D) (G(x) - x) + M' (x - r),
///     M = sum_i (L_i dn_i/dx + [i at full strength] n_i (ds_i/dx)^T) / k,
///     c_i . step = -height_i   for every plane that holds, 0 < L_i < s_i,
///
/// converges there from a near start. Here c_i is Varying::across. The change of the loads has no
/// component perpendicular to all n, and the step is free perpendicular to all c. Directed forces
/// and yielding primitives act with their full strength, so their ds/dx counts. D is the derivative
/// at G of the pull of sliding lines and points, divided by k. D neglects that a friction's
/// strength depends on its load. M' is M without the planes of surfaces. r is the place where the
/// primitives were read. Before a tick's first reading, r is the place of the last tick's last
/// reading. If a primitive holds and does not turn, the condition on its forces is the same as in
/// the balance. If no varying primitive bears a load, or the step is not finite, the function
/// returns G(x) - x.
///
/// n and c differ most in a groove. With n in place of c, every step would be too short by the same
/// factor. Beyond the centre of curvature of a convex edge, the balance is a ridge. Then the step
/// leads down from the ridge: it uses the magnitudes of the eigenvalues, each at least 0.05.
///
/// @param balance     G(x), the balance of the primitives [m].
/// @param from        x, where the step begins [m].
/// @param read        r, where the primitives were read [m].
/// @param stiffness   k [N/m].
/// @param primitives  The primitives in balance.
/// @param forces      Force of each primitive on the proxy [N].
/// @param varying     Entries of the primitives that vary, in the same order.
/// RT: no allocation. Cost: O(primitives) if a varying primitive bears a load, else O(varying).
[[nodiscard]] Vec3 newtonStep(const Vec3& balance, const Vec3& from, const Vec3& read,
                              double stiffness, std::span<const Primitive> primitives,
                              std::span<const Vec3> forces,
                              std::span<const Varying> varying) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
