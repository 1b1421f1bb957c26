#include "palpate/bench/methods/smallest_residual.h"

#include <limits>

#include "palpate/bench/methods/residual.h"
#include "palpate/bench/methods/simplex.h"

namespace palpate::methods {

Balance smallestResidual(const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
                         const Vec3& start, const SmallestResidualParams& params) noexcept {
  const double reach = sumOfStrengths(primitives) / stiffness;
  const auto magnitude = [&](const Vec3& offset) {
    return residualForce(offset, probe, stiffness, primitives).norm();
  };
  Balance balance;
  double least = std::numeric_limits<double>::infinity();
  const auto search_from = [&](const Vec3& offset) {
    const SimplexResult found = minimiseBySimplex(magnitude, withinReach(offset, reach),
                                                  {params.size * reach, params.tolerance * reach,
                                                   params.max_evaluations - balance.iterations});
    balance.iterations += found.evaluations;
    if (found.value >= least) return;
    least = found.value;
    balance.offset = found.best;
    balance.settled = found.settled;
  };

  // Starts at different points, because the kinks near the last proxy, the probe and the anchors
  // differ.
  search_from(start - probe);
  if (params.searches > 1) search_from(Vec3::Zero());
  int left = params.searches - 2;
  for (const Primitive& p : primitives) {
    if (left <= 0 || balance.iterations >= params.max_evaluations) break;
    if (p.kind == PrimitiveKind::kForce) continue;
    search_from(p.position - probe);
    --left;
  }
  return balance;
}

}  // namespace palpate::methods
