#include "palpate/bench/methods/nelder_mead.h"

#include "palpate/bench/methods/residual.h"
#include "palpate/bench/methods/simplex.h"

namespace palpate::methods {

Balance nelderMead(const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
                   const Vec3& start, const NelderMeadParams& params) noexcept {
  const double reach = sumOfStrengths(primitives) / stiffness;
  const auto energy = [&](const Vec3& offset) {
    return potential(offset, probe, stiffness, primitives);
  };
  Balance balance;
  balance.offset = withinReach(start - probe, reach);
  double size = params.size * reach;
  for (int i = 0; i <= params.restarts; ++i) {
    const SimplexResult found = minimiseBySimplex(
        energy, balance.offset,
        {size, params.tolerance * reach, params.max_evaluations - balance.iterations});
    balance.offset = found.best;
    balance.iterations += found.evaluations;
    balance.settled = found.settled;
    size *= 0.1;
    if (balance.iterations >= params.max_evaluations) break;
  }
  return balance;
}

}  // namespace palpate::methods
