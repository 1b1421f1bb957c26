#include "tests/support/reference_solver.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include <Eigen/Geometry>

namespace palpate::test {
namespace {

using Real = long double;
using RealVec = Eigen::Matrix<Real, 3, 1>;

}  // namespace

Reference solveReference(const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
                         long max_sweeps) {
  const Real k = stiffness;
  const RealVec h = probe.cast<Real>();
  std::vector<RealVec> force(primitives.size(), RealVec::Zero());  // on the proxy
  std::vector<RealVec> q;
  RealVec total = RealVec::Zero();
  for (std::size_t i = 0; i < primitives.size(); ++i) {
    RealVec direction = primitives[i].direction.cast<Real>();
    if (direction.norm() > 0) direction.normalize();
    q.push_back(direction);
    if (primitives[i].kind == PrimitiveKind::kForce) {
      force[i] = Real(primitives[i].strength) * direction;
      total += force[i];
    }
  }

  Reference out;
  Real strengths = 0;
  for (const Primitive& p : primitives) strengths += p.strength;
  bool settled = false;
  for (out.sweeps = 1; out.sweeps <= max_sweeps && !settled; ++out.sweeps) {
    Real change = 0;
    for (std::size_t i = 0; i < primitives.size(); ++i) {
      const Primitive& p = primitives[i];
      const Real s = p.strength;
      const RealVec others = total - force[i];
      // Where the proxy would be without this primitive, as seen from it: d = x - x_i.
      const RealVec d = others / k - (p.position.cast<Real>() - h);
      RealVec f = force[i];
      switch (p.kind) {
        case PrimitiveKind::kForce:
          break;
        case PrimitiveKind::kPoint:
          f = -k * d;
          if (f.norm() > s) f *= s / f.norm();
          break;
        case PrimitiveKind::kLine:
          f = -k * (d - q[i] * q[i].dot(d));
          if (f.norm() > s) f *= s / f.norm();
          break;
        case PrimitiveKind::kPlane:
          f = std::clamp<Real>(-k * q[i].dot(d), 0, s) * q[i];
          break;
      }
      change = std::max(change, (f - force[i]).norm());
      total = others + f;
      force[i] = f;
    }
    settled = change <= 4 * std::numeric_limits<Real>::epsilon() * strengths;
    if (!settled && out.sweeps < max_sweeps) continue;

    // Gap at x = h + total / k: sum over primitives of potential minus what their force accounts
    // for.
    const RealVec x = total / k;
    Real gap = 0;
    const Real rounding = 64 * std::numeric_limits<Real>::epsilon();
    for (std::size_t i = 0; i < primitives.size(); ++i) {
      const Primitive& p = primitives[i];
      const Real s = p.strength;
      const RealVec d = x - (p.position.cast<Real>() - h);
      Real potential = 0;
      if (p.kind == PrimitiveKind::kForce) continue;
      if (p.kind == PrimitiveKind::kPoint) potential = s * d.norm();
      if (p.kind == PrimitiveKind::kLine) potential = s * (d - q[i] * q[i].dot(d)).norm();
      if (p.kind == PrimitiveKind::kPlane) potential = s * std::max<Real>(0, -q[i].dot(d));
      // The two cancel: what the difference rounds to counts as well.
      gap += std::max<Real>(0, potential + force[i].dot(d)) + rounding * s * d.norm();
    }
    out.offset = x.cast<double>();
    out.error_bound = static_cast<double>(std::sqrt(2 * gap / k));
  }
  return out;
}

}  // namespace palpate::test
