/// The earlier method that the paper improves: Lundin et al., eq. (2), for scalar constraints.
#pragma once

#include <span>

#include "palpate/bench/methods/method.h"

namespace palpate::methods {

/// One constraint of section 2, which holds the proxy along `direction` up to `strength`.
struct Constraint {
  Vec3 direction = Vec3::UnitX();  ///< q_i, unit.
  double strength = 0.0;           ///< s_i [N], >= 0.
};

/// Applies eqs (1) and (2): each constraint moves the proxy separately, and the movements are
/// added. Correct only for orthogonal directions (section 3.1). Applies eq. (2) to q and to -q,
/// because eq. (2) alone does not let a push against q move the proxy.
[[nodiscard]] Vec3 constraintProxy(const Vec3& probe, const Vec3& proxy, double stiffness,
                                   std::span<const Constraint> constraints) noexcept;

/// Applies eqs (1) and (2) to haptic primitives, one by one, and adds the movements.
///
/// The paper does not state how to convert primitives to constraints. This conversion is the most
/// favourable one that we know. The answer is the balance if the constrained directions of
/// different primitives are orthogonal; directed forces may be added. For other sets the answer can
/// be far from the balance.
///
/// A plane constrains its normal in one sense: s_i against the normal, zero along it.
///
/// A line constrains the two directions perpendicular to it, a point all three. One axis of the
/// constraints is along the motion, so that the strength bounds the length of the force.
///
/// Directed forces move the spring's end: eta leads to probe + sum s_i q_i / k.
///
/// In directions that no primitive constrains, the proxy follows the spring's end, as with zero
/// strength.
///
/// eta starts at the primitive's anchor: a constraint has no position, so a plane away from the
/// proxy would otherwise have no effect.
///
/// @param probe       Hand position [m].
/// @param stiffness   k [N/m], > 0.
/// @param start       Last proxy [m]; has no effect if the answer is the balance.
[[nodiscard]] Balance constraintApproach(const Vec3& probe, double stiffness,
                                         std::span<const Primitive> primitives,
                                         const Vec3& start) noexcept;

}  // namespace palpate::methods
