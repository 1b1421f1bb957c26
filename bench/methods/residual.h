/// Computes the residual force f_res, eq. (14) of Lundin et al., and its potential. Positions are
/// relative to the probe (`offset`), so that rounding errors stay small even 1e4 m from the origin.
/// The functions are inline, because they take most of the methods' time.
#pragma once

#include <algorithm>
#include <span>

#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/types.h"

namespace palpate::methods {

/// Returns m of eq. (10): the vector from the proxy x to the nearest point of a line. The line
/// passes through x_i, and d = x - x_i.
[[nodiscard]] inline Vec3 acrossLine(const Vec3& direction, const Vec3& d) noexcept {
  return direction * direction.dot(d) - d;
}

/// Returns a primitive's force [N] on a proxy at d = x - x_i [m], eqs (8), (9), (11) and (13). On
/// the primitive's kink, the force is zero.
[[nodiscard]] inline Vec3 forceOf(const Primitive& primitive, const Vec3& d) noexcept {
  switch (primitive.kind) {
    case PrimitiveKind::kForce:
      return primitive.strength * primitive.direction;
    case PrimitiveKind::kPoint: {
      const double distance = d.norm();
      return distance == 0.0 ? Vec3(Vec3::Zero()) : Vec3(-(primitive.strength / distance) * d);
    }
    case PrimitiveKind::kLine: {
      const Vec3 m = acrossLine(primitive.direction, d);
      const double distance = m.norm();
      return distance == 0.0 ? m : Vec3((primitive.strength / distance) * m);
    }
    case PrimitiveKind::kPlane:
      return d.dot(primitive.direction) >= 0.0 ? Vec3(Vec3::Zero())
                                               : Vec3(primitive.strength * primitive.direction);
  }
  return Vec3::Zero();
}

[[nodiscard]] inline Vec3 residualForce(const Vec3& offset, const Vec3& probe, double stiffness,
                                        std::span<const Primitive> primitives) noexcept {
  Vec3 force = -stiffness * offset;
  for (const Primitive& p : primitives) force += forceOf(p, offset - (p.position - probe));
  return force;
}

/// Returns E of engine/balance/solver.h [J] at probe + offset, up to a constant. f_res is minus its
/// gradient, where the gradient exists.
[[nodiscard]] inline double potential(const Vec3& offset, const Vec3& probe, double stiffness,
                                      std::span<const Primitive> primitives) noexcept {
  double energy = 0.5 * stiffness * offset.squaredNorm();
  for (const Primitive& p : primitives) {
    const Vec3 d = offset - (p.position - probe);
    switch (p.kind) {
      case PrimitiveKind::kForce:
        energy -= p.strength * p.direction.dot(offset);
        break;
      case PrimitiveKind::kPoint:
        energy += p.strength * d.norm();
        break;
      case PrimitiveKind::kLine:
        energy += p.strength * acrossLine(p.direction, d).norm();
        break;
      case PrimitiveKind::kPlane:
        energy += p.strength * std::max(0.0, -p.direction.dot(d));
        break;
    }
  }
  return energy;
}

/// Returns S, the sum of strengths [N]. The balance is at most S/k away from the probe.
[[nodiscard]] inline double sumOfStrengths(std::span<const Primitive> primitives) noexcept {
  double sum = 0.0;
  for (const Primitive& p : primitives) sum += p.strength;
  return sum;
}

/// Returns the point nearest to `offset` within `reach` of the probe.
[[nodiscard]] inline Vec3 withinReach(const Vec3& offset, double reach) noexcept {
  const double distance = offset.norm();
  return distance > reach ? Vec3((reach / distance) * offset) : offset;
}

}  // namespace palpate::methods
