#include "palpate/bench/methods/constraint_approach.h"

#include <array>
#include <cstddef>

#include <Eigen/Geometry>

#include "palpate/bench/methods/residual.h"

namespace palpate::methods {
namespace {

/// Orthonormal basis of the directions that primitives constrain.
class ConstrainedFrame {
 public:
  /// Adds the part of a direction outside the basis, if the angle to the basis exceeds 1e-6 rad.
  void add(const Vec3& direction) noexcept {
    const Vec3 rest = unconstrained(direction);
    if (count_ < axes_.size() && rest.norm() > 1e-6) axes_[count_++] = rest.normalized();
  }
  [[nodiscard]] Vec3 unconstrained(const Vec3& v) const noexcept {
    Vec3 rest = v;
    for (std::size_t i = 0; i < count_; ++i) rest -= axes_[i].dot(rest) * axes_[i];
    return rest;
  }

 private:
  std::array<Vec3, 3> axes_;
  std::size_t count_ = 0;
};

/// Applies eq. (2) of Lundin et al. along the direction of eta: returns the part of eta that
/// exceeds s/k.
Vec3 yieldedAlong(const Vec3& eta, double strength_over_stiffness) noexcept {
  const double length = eta.norm();
  return length > strength_over_stiffness ? Vec3((1.0 - strength_over_stiffness / length) * eta)
                                          : Vec3(Vec3::Zero());
}

}  // namespace

Vec3 constraintProxy(const Vec3& probe, const Vec3& proxy, double stiffness,
                     std::span<const Constraint> constraints) noexcept {
  const Vec3 eta = probe - proxy;  // eq. (1)
  Vec3 moved = proxy;
  for (const Constraint& c : constraints) {
    // Applies eq. (2) to q and to -q, because a constraint holds in both senses of its direction.
    moved += yieldedAlong(eta.dot(c.direction) * c.direction, c.strength / stiffness);
  }
  return moved;
}

Balance constraintApproach(const Vec3& probe, double stiffness,
                           std::span<const Primitive> primitives, const Vec3& start) noexcept {
  Vec3 end = Vec3::Zero();
  ConstrainedFrame constrained;
  for (const Primitive& p : primitives) {
    switch (p.kind) {
      case PrimitiveKind::kForce:
        end += p.strength / stiffness * p.direction;
        break;
      case PrimitiveKind::kPoint:
        for (int i = 0; i < 3; ++i) constrained.add(Vec3::Unit(i));
        break;
      case PrimitiveKind::kLine: {
        const Vec3 across = p.direction.unitOrthogonal();
        constrained.add(across);
        constrained.add(p.direction.cross(across));
        break;
      }
      case PrimitiveKind::kPlane:
        constrained.add(p.direction);
        break;
    }
  }

  const Vec3 proxy = start - probe;
  Vec3 moved = proxy + constrained.unconstrained(end - proxy);
  for (const Primitive& p : primitives) {
    const Vec3 anchor = p.position - probe;
    const Vec3 to_anchor = anchor - proxy;
    const Vec3 eta = end - anchor;
    const double reach = p.strength / stiffness;
    switch (p.kind) {
      case PrimitiveKind::kForce:
        break;
      case PrimitiveKind::kPoint:
        moved += to_anchor + yieldedAlong(eta, reach);
        break;
      case PrimitiveKind::kLine:
        moved += -acrossLine(p.direction, to_anchor) +
                 yieldedAlong(-acrossLine(p.direction, eta), reach);
        break;
      case PrimitiveKind::kPlane: {
        const double along = eta.dot(p.direction);
        moved += to_anchor.dot(p.direction) * p.direction +
                 yieldedAlong(along * p.direction, along < 0.0 ? reach : 0.0);
        break;
      }
    }
  }
  return {moved, 1, true};
}

}  // namespace palpate::methods
