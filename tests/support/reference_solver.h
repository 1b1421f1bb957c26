/// Solves the balance by a simple method in quadruple precision, with a provable error bound. Tests
/// compare the engine with it.
#pragma once

#include <span>

#include "palpate/engine/balance/primitive.h"

namespace palpate::test {

struct Reference {
  Vec3 offset = Vec3::Zero();  ///< proxy - probe [m]
  /// Upper bound on the distance to the exact balance, for normalised directions [m]; about 1e-10
  /// S/k.
  double error_bound = 0.0;
  double potential = 0.0;  ///< E at the result [J].
};

/// Rounds every kink by mu, |d| -> sqrt(|d|^2 + mu^2), and minimises the smooth potential by
/// Newton's method with step halving. Repeats this for values of mu that fall by factors of ten,
/// from 0.1 S/k to 1e-20 S/k. The forces of a rounded primitive stay within its strength, so they
/// are a feasible point of the dual. For any x, weak duality gives
///
///     k/2 |x - x*|^2 <= E(x) - D(f),
///
/// where both are evaluated by their definitions in 113 bits. Shares no code with the engine's
/// solver. A call takes milliseconds.
Reference solveReference(const Vec3& probe, double stiffness,
                         std::span<const Primitive> primitives);

}  // namespace palpate::test
