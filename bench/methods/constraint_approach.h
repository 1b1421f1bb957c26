/// The older method that the paper improves on: one-dimensional constraints, Lundin et al., eq.
/// (2).
#pragma once

#include <span>

#include "engine/types.h"

namespace palpate::methods {

/// One constraint of section 2: holds the proxy along `direction` up to `strength`.
struct Constraint {
  Vec3 direction = Vec3::UnitX();  ///< q_i, unit.
  double strength = 0.0;           ///< s_i [N], >= 0.
};

/// Eqs (1) and (2): each constraint moves the proxy on its own, and the movements are added. Right
/// only where the directions are orthogonal (section 3.1).
[[nodiscard]] Vec3 constraintProxy(const Vec3& probe, const Vec3& proxy, double stiffness,
                                   std::span<const Constraint> constraints) noexcept;

}  // namespace palpate::methods
