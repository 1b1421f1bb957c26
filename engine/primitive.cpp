#include "engine/primitive.h"

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

}  // namespace palpate
