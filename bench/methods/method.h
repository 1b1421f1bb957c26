/// Input and result of the methods from the literature. Benchmarks and tests compare these methods
/// with the engine's single solver. The shipped program does not link them.
#pragma once

#include <span>

#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/types.h"

namespace palpate::methods {

/// A method's answer to one balance.
struct Balance {
  Vec3 offset = Vec3::Zero();  ///< proxy - probe [m]; the hand feels k times this.
  int iterations = 0;          ///< Evaluations of eq. (14) (of the potential, for Nelder-Mead).
  bool settled = false;        ///< The method's own stopping rule ended it before its limit.
};

}  // namespace palpate::methods
