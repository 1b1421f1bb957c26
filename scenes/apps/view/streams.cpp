#include "palpate/scenes/apps/view/streams.h"

#include <algorithm>

namespace palpate::view {

Vec3 vectorAt(const VectorField& field, Along along, const Vec3& p, FieldCache& cache) {
  const VectorSample sample = field.sample(p, cache);
  const Mat3& j = sample.jacobian;
  const Vec3 v = along == Along::kValue
                     ? sample.value
                     : Vec3(j(2, 1) - j(1, 2), j(0, 2) - j(2, 0), j(1, 0) - j(0, 1));
  return sample.inside && v.allFinite() ? v : Vec3::Zero();
}

std::vector<Vec3> lineThrough(const VectorField& field, Along along, const Vec3& p, double length) {
  constexpr int kMostSteps = 400;
  constexpr double kNothing = 1e-12;
  FieldCache cache;
  field.reset(cache);
  const double step = std::max(0.5 * field.frame().voxel, length / kMostSteps);
  const int steps = static_cast<int>(length / step);
  // Returns the unit vector with the sign of `last`; zero at the end of the line.
  const auto turned = [&](const Vec3& at, const Vec3& last) -> Vec3 {
    const Vec3 v = vectorAt(field, along, at, cache);
    const double size = v.norm();
    if (size < kNothing) return Vec3::Zero();
    return v / (v.dot(last) < 0.0 ? -size : size);
  };
  const Vec3 first = turned(p, Vec3::Zero());
  if (first.isZero()) return {};
  std::vector<Vec3> line;
  for (const double sign : {-1.0, 1.0}) {
    Vec3 at = p;
    Vec3 last = sign * first;
    for (int i = 0; i < steps; ++i) {
      const Vec3 a = turned(at, last);
      const Vec3 b = turned(at + 0.5 * step * a, last);
      const Vec3 c = turned(at + 0.5 * step * b, last);
      const Vec3 d = turned(at + step * c, last);
      if (a.isZero() || b.isZero() || c.isZero() || d.isZero()) break;
      at += step / 6.0 * (a + 2.0 * b + 2.0 * c + d);
      last = a;
      line.push_back(at);
    }
    if (sign < 0.0) {
      std::reverse(line.begin(), line.end());
      line.push_back(p);
    }
  }
  return line;
}

}  // namespace palpate::view
