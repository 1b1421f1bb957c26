#include "palpate/engine/field/warp.h"

#include <Eigen/LU>

namespace palpate {

Deformation deformationAt(const Warp& warp, const Vec3& x, double time) noexcept {
  constexpr double kFolds = 0.05;
  const Displacement u = warp.at(x, time);
  Deformation about;
  const Mat3 F = Mat3::Identity() + u.slope;
  if (F.determinant() >= kFolds) {
    about.slope = F;
    about.back = F.inverse();
  }
  about.origin = x + u.shift - about.slope * x;
  about.rate = u.rate;
  about.bend = u.bend;
  about.time = time;
  about.at = x;
  return about;
}

}  // namespace palpate
