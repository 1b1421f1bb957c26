#include "palpate/engine/balance/primitive.h"

#include <algorithm>
#include <cmath>

namespace palpate {

const char* wordFor(PrimitiveKind kind) noexcept {
  switch (kind) {
    case PrimitiveKind::kForce:
      return "force";
    case PrimitiveKind::kPoint:
      return "point";
    case PrimitiveKind::kLine:
      return "line";
    case PrimitiveKind::kPlane:
      return "plane";
  }
  return "";
}

bool isValid(const Primitive& primitive) noexcept {
  if (primitive.kind > PrimitiveKind::kPlane) return false;
  if (!(primitive.strength >= 0.0) || !std::isfinite(primitive.strength)) return false;
  if (primitive.kind != PrimitiveKind::kForce && !primitive.position.allFinite()) return false;
  if (primitive.kind == PrimitiveKind::kPoint) return true;
  return std::abs(primitive.direction.squaredNorm() - 1.0) <= 2e-6;  // false for NaN too
}

double distanceTo(const Primitive& primitive, const Vec3& x) noexcept {
  const Vec3 d = x - primitive.position;
  const double along = primitive.direction.dot(d);
  switch (primitive.kind) {
    case PrimitiveKind::kForce:
      return 0.0;
    case PrimitiveKind::kPoint:
      break;
    case PrimitiveKind::kLine:
      return (d - along * primitive.direction).norm();
    case PrimitiveKind::kPlane:
      return std::max(0.0, -along);
  }
  return d.norm();
}

}  // namespace palpate
