/// Solves the balance by a plain method in quadruple precision, with a proof by definition. The
/// tests compare with its result.
#pragma once

#include <span>

#include "palpate/engine/balance/primitive.h"

namespace palpate::test {

struct Reference {
  Vec3 offset = Vec3::Zero();  ///< proxy - probe [m]
  double error_bound = 0.0;    ///< [m], at least the distance to the exact balance of the numbers
                               ///< as given, directions normalised; some 1e-10 S/k.
  double potential = 0.0;      ///< E there [J]
};

/// Rounds every kink off by mu, |d| -> sqrt(|d|^2 + mu^2), and lowers the smooth potential by
/// Newton's method with step halving. Then mu is divided by ten, from S/k to 1e-20 S/k. Forces of a
/// rounded primitive stay within its strength, so they are a feasible point of the dual. For any x,
/// however found, weak duality gives
///
///     k/2 |x - x*|^2 <= E(x) - D(f),
///
/// both evaluated by their definitions in 113 bits. The code is independent of the engine's
/// solver. A call takes milliseconds.
Reference solveReference(const Vec3& probe, double stiffness,
                         std::span<const Primitive> primitives);

}  // namespace palpate::test
