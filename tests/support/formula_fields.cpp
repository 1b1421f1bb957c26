#include "tests/support/formula_fields.h"

#include <Eigen/Geometry>

#include "palpate/samplers/grid/analytic_field.h"

namespace palpate {
namespace {

Box cube(const Vec3& centre, double half) {
  return {centre - Vec3::Constant(half), centre + Vec3::Constant(half)};
}

}  // namespace

std::shared_ptr<const ScalarField> makeHalfSpace(const Vec3& point, const Vec3& normal,
                                                 double voxel) {
  const Vec3 n = normal.normalized();
  const FieldFrame frame{voxel, 1.0, cube(point, 10.0), 10.0};
  return makeScalarField(frame, [=](const Vec3& p) {
    return ScalarSample{n.dot(p - point), n, true};
  });
}

std::shared_ptr<const VectorField> makeVortex(const Vec3& centre, const Vec3& omega, double axial,
                                              double radius, double voxel) {
  const Vec3 axis = omega.normalized();
  Mat3 J;
  J << 0, -omega.z(), omega.y(), omega.z(), 0, -omega.x(), -omega.y(), omega.x(), 0;
  return makeVectorField(FieldFrame{voxel, 1.0, cube(centre, radius)}, [=](const Vec3& p) {
    const Vec3 r = p - centre;
    return VectorSample{omega.cross(r) + axial * axis, J, r.norm() <= radius};
  });
}

}  // namespace palpate
