#include "palpate/bench/methods/euler_fixed.h"

#include "palpate/bench/methods/residual.h"

namespace palpate::methods {

Balance eulerFixed(const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
                   const Vec3& start, const EulerFixedParams& params) noexcept {
  const double enough = params.tolerance * sumOfStrengths(primitives);
  Balance balance;
  balance.offset = start - probe;
  while (balance.iterations < params.max_iterations) {
    const Vec3 force = residualForce(balance.offset, probe, stiffness, primitives);
    ++balance.iterations;
    balance.settled = force.norm() <= enough;
    if (balance.settled) break;
    balance.offset += (params.step / stiffness) * force;
  }
  return balance;
}

}  // namespace palpate::methods
