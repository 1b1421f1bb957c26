/// Fields that are given by a formula, for tests, benchmarks and first programs. Needs no OpenVDB.
#pragma once

#include <memory>
#include <utility>

#include "palpate/engine/field/field.h"

namespace palpate {

/// A scalar field from a formula for its value and gradient, in metres of W.
/// @tparam Formula  ScalarSample(const Vec3& p) noexcept, p [m]. The formula also sets `inside`. It
///                  runs in the tick, so it must not allocate or lock.
template <class Formula>
class AnalyticScalarField final : public ScalarField {
 public:
  /// `frame.voxel` is the distance that the proxy may move until the next evaluation [m].
  AnalyticScalarField(const FieldFrame& frame, Formula formula)
      : ScalarField(frame), formula_(std::move(formula)) {}

  void reset(FieldCache& /*cache*/) const noexcept override {}
  [[nodiscard]] ScalarSample sample(const Vec3& p_W,
                                    FieldCache& /*cache*/) const noexcept override {
    return p_W.allFinite() ? formula_(p_W) : ScalarSample{};
  }

 private:
  Formula formula_;
};

/// A vector field from a formula for its value and Jacobian, in metres of W. The formula has the
/// type VectorSample(const Vec3& p) noexcept, and must meet the requirements of
/// AnalyticScalarField.
template <class Formula>
class AnalyticVectorField final : public VectorField {
 public:
  AnalyticVectorField(const FieldFrame& frame, Formula formula)
      : VectorField(frame), formula_(std::move(formula)) {}  ///< See AnalyticScalarField.

  void reset(FieldCache& /*cache*/) const noexcept override {}  ///< A formula has no cache.
  [[nodiscard]] VectorSample sample(const Vec3& p_W,
                                    FieldCache& /*cache*/) const noexcept override {
    return p_W.allFinite() ? formula_(p_W) : VectorSample{};
  }  ///< Returns the sample of the formula; no data if p_W is not finite.

 private:
  Formula formula_;
};

/// Makes a scalar field from a formula.
template <class Formula>
[[nodiscard]] std::shared_ptr<const ScalarField> makeScalarField(const FieldFrame& frame,
                                                                 Formula formula) {
  return std::make_shared<AnalyticScalarField<Formula>>(frame, std::move(formula));
}

/// Makes a vector field from a formula.
template <class Formula>
[[nodiscard]] std::shared_ptr<const VectorField> makeVectorField(const FieldFrame& frame,
                                                                 Formula formula) {
  return std::make_shared<AnalyticVectorField<Formula>>(frame, std::move(formula));
}

/// Makes a scalar field that is the distance [m] from the surface of a sphere, negative inside.
/// @param centre  Centre of the sphere in W [m].
/// @param radius  Radius of the sphere [m].
/// @param voxel   Value of FieldFrame::voxel [m].
[[nodiscard]] std::shared_ptr<const ScalarField> makeSphere(const Vec3& centre, double radius,
                                                            double voxel = 1e-3);

}  // namespace palpate
