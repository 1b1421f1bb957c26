#include "palpate/bench/methods/force_function.h"

#include "palpate/bench/methods/residual.h"

namespace palpate::methods {

Balance forceFunction(const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
                      const Vec3& /*start*/) noexcept {
  // At the probe the spring has zero length, so f_res is the primitives' force alone.
  return {residualForce(Vec3::Zero(), probe, stiffness, primitives) / stiffness, 1, true};
}

}  // namespace palpate::methods
