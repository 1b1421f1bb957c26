/// Fields given by a formula: for tests, benchmarks and first programs. No OpenVDB.
#pragma once

#include <functional>
#include <memory>
#include <utility>

#include "engine/field.h"

namespace palpate {

/// A scalar field from a formula for its value and gradient, in metres of W.
class AnalyticScalarField final : public ScalarField {
 public:
  /// Returns value and gradient at p [m]; `inside` is the formula's to set.
  using Formula = std::function<ScalarSample(const Vec3&)>;

  /// `frame.voxel` is the step [m] that the proxy may take before the formula is read again.
  AnalyticScalarField(const FieldFrame& frame, Formula formula)
      : ScalarField(frame), formula_(std::move(formula)) {}

  void reset(FieldCache& /*cache*/) const noexcept override {}
  [[nodiscard]] ScalarSample sample(const Vec3& p_W, FieldCache& cache) const noexcept override;

 private:
  Formula formula_;
};

/// A vector field from a formula for its value and Jacobian, in metres of W.
class AnalyticVectorField final : public VectorField {
 public:
  using Formula = std::function<VectorSample(const Vec3&)>;

  AnalyticVectorField(const FieldFrame& frame, Formula formula)
      : VectorField(frame), formula_(std::move(formula)) {}

  void reset(FieldCache& /*cache*/) const noexcept override {}
  [[nodiscard]] VectorSample sample(const Vec3& p_W, FieldCache& cache) const noexcept override;

 private:
  Formula formula_;
};

/// The distance to a sphere's surface [m], negative inside.
[[nodiscard]] std::shared_ptr<const ScalarField> makeSphere(const Vec3& centre, double radius,
                                                            double voxel = 1e-3);

/// The height over a plane through `point` [m].
[[nodiscard]] std::shared_ptr<const ScalarField> makeHalfSpace(const Vec3& point,
                                                               const Vec3& normal,
                                                               double voxel = 1e-3);

/// A rigid vortex about an axis through `centre` with a flow along it: v = omega x r + axial e.
/// curl v = 2 omega, div v = 0.
[[nodiscard]] std::shared_ptr<const VectorField> makeVortex(const Vec3& centre, const Vec3& omega,
                                                            double axial, double radius,
                                                            double voxel = 1e-3);

}  // namespace palpate
