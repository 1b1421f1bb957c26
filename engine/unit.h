/// The direction of a vector that may be zero or not finite.
#pragma once

#include <cmath>

#include "palpate/engine/types.h"

namespace palpate {

/// Writes v/|v| to `direction`. If the computed |v| is at most 1e-300 or not finite, returns false
/// and does not write. |v|^2 underflows to 0 below |v| = 1.5e-162, and overflows above 1.3e154. RT:
/// no allocation.
[[nodiscard]] inline bool unit(const Vec3& v, Vec3& direction) noexcept {
  const double length = v.norm();
  if (!(length > 1e-300) || !std::isfinite(length)) return false;
  direction = v / length;
  return true;
}

}  // namespace palpate
