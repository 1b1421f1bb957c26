#include "palpate/samplers/grid/analytic_field.h"

namespace palpate {

std::shared_ptr<const ScalarField> makeSphere(const Vec3& centre, double radius, double voxel) {
  const Vec3 half = Vec3::Constant(2.0 * radius);
  const FieldFrame frame{voxel, 1.0, {centre - half, centre + half}, radius};
  return makeScalarField(frame, [=](const Vec3& p) {
    const Vec3 r = p - centre;
    const double distance = r.norm();
    const Vec3 normal = distance > 0.0 ? Vec3(r / distance) : Vec3::Zero();
    return ScalarSample{distance - radius, normal, true};
  });
}

}  // namespace palpate
