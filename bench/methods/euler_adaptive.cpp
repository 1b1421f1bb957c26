#include "palpate/bench/methods/euler_adaptive.h"

#include <algorithm>

#include "palpate/bench/methods/residual.h"

namespace palpate::methods {

Balance eulerAdaptive(const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
                      const Vec3& start, const EulerAdaptiveParams& params) noexcept {
  const double enough = params.tolerance * sumOfStrengths(primitives);
  Balance balance;
  balance.offset = start - probe;
  Vec3 force = residualForce(balance.offset, probe, stiffness, primitives);
  balance.iterations = 1;
  double step = 1.0;  // as a share of 1/k
  while (balance.iterations < params.max_iterations) {
    balance.offset += (step / stiffness) * force;
    balance.settled = step * force.norm() <= enough;
    if (balance.settled) break;
    const double before = force.norm();
    force = residualForce(balance.offset, probe, stiffness, primitives);
    ++balance.iterations;
    step = force.norm() < before ? std::min(1.0, params.grow * step) : params.shrink * step;
  }
  return balance;
}

}  // namespace palpate::methods
