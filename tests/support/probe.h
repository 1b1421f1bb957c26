/// Reads fields for tests and benchmarks.
#pragma once

#include <memory>
#include <utility>
#include <variant>

#include <Eigen/Geometry>

#include "palpate/engine/field/field.h"
#include "palpate/engine/field/flow.h"
#include "palpate/engine/scene/graph.h"
#include "palpate/samplers/grid/vdb_field.h"

namespace palpate::test {

/// A field with a cache.
struct Probe {
  FieldPtr field;
  FieldCache cache{};

  explicit Probe(FieldPtr f) : field(std::move(f)) {
    std::visit([&](const auto& p) { p->reset(cache); }, field);
  }
  explicit Probe(const std::shared_ptr<const Volume>& volume)
      : Probe(makeVdbField(volume, Placement{})) {}
  ScalarSample scalar(const Vec3& p) { return std::get<0>(field)->sample(p, cache); }
  Vec3 cellGradient(const Vec3& p) { return std::get<0>(field)->cellGradient(p, cache); }
  Mat3 gradientJacobian(const Vec3& p) { return std::get<0>(field)->gradientJacobian(p, cache); }
  VectorSample vector(const Vec3& p) { return std::get<1>(field)->sample(p, cache); }
};

/// Returns a placement with rotation, translation and scale.
inline Placement slanted() {
  Placement placement;
  placement.scale = 0.01;
  placement.rotation = Eigen::AngleAxisd(0.7, Vec3(1, 2, 3).normalized()).toRotationMatrix();
  placement.translate = Vec3(0.1, -0.2, 0.3);
  return placement;
}

/// Returns a property derived from a vector and its Jacobian. A scalar property is the first
/// component. Returns zero for kGradient, which needs a scalar field.
inline Vec3 onTheFly(Derivation what, const VectorSample& s) {
  switch (what) {
    case Derivation::kMagnitude:
      return {s.value.norm(), 0.0, 0.0};
    case Derivation::kDivergence:
      return {divergence(s.jacobian), 0.0, 0.0};
    case Derivation::kQ:
      return {qCriterion(s.jacobian), 0.0, 0.0};
    case Derivation::kLambda2:
      return {lambda2(s.jacobian), 0.0, 0.0};
    case Derivation::kCurl:
      return curl(s.jacobian);
    case Derivation::kUnit:
      return unit(s.value);
    case Derivation::kGradient:
      break;
  }
  return Vec3::Zero();
}

}  // namespace palpate::test
