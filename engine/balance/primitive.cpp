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
