/// The earlier method on which the paper improves: one-dimensional constraints, Lundin et al., eq.
/// (2).
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
/// added. Correct only for orthogonal directions (section 3.1). Applies eq. (2) to q and to -q:
/// with eq. (2) as printed, a push against q would never move the proxy.
[[nodiscard]] Vec3 constraintProxy(const Vec3& probe, const Vec3& proxy, double stiffness,
                                   std::span<const Constraint> constraints) noexcept;

/// Applies eqs (1) and (2) to haptic primitives in one pass: each primitive moves the proxy
/// separately, and the movements are added.
///
/// The paper has no map from primitives to constraints; this map is the most favourable that we
/// know. Every set has an answer. The answer is the balance if the constrained directions of
/// different primitives are orthogonal: planes with orthogonal normals, a line and the plane across
/// it, a point alone; directed forces may be added to each. For other sets the answer is not
/// useful, which is the paper's point.
/// - A plane constrains its normal in one sense: eq. (2) with s_i against the normal, with zero
///   along it.
/// - A line constrains the two directions across it, a point all three. The paper lets the frame
///   turn with the motion. With the frame's first axis along the constrained part of eta, only
///   that axis moves. The two or three strengths then bound the length of the force, as they
///   should, and not its components.
/// - Directed forces move the spring's end: eta leads to probe + sum s_i q_i / k.
/// - Directions that no primitive constrains follow the spring's end. Section 2 needs three
///   independent constraints; these directions are the missing ones, with zero strength. They are
///   orthogonal to all constrained directions.
/// - eta starts at the primitive's own anchor if it differs from the proxy. A constraint has no
///   position, so without this a plane away from the proxy would have no effect.
///
/// @param probe       Hand position [m].
/// @param stiffness   k [N/m], > 0.
/// @param start       Last proxy [m]; has no effect if the answer is the balance.
[[nodiscard]] Balance constraintApproach(const Vec3& probe, double stiffness,
                                         std::span<const Primitive> primitives,
                                         const Vec3& start) noexcept;

}  // namespace palpate::methods
