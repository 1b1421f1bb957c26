/// Input and result of the methods from the literature, which benchmarks and tests compare with the
/// engine's solver. The shipped program does not link them.
#pragma once

#include <span>

#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/types.h"

namespace palpate::methods {

/// The solution of one balance by a method.
struct Balance {
  Vec3 offset = Vec3::Zero();  ///< proxy - probe [m]; the force on the hand is k times this.
  int iterations = 0;          ///< Evaluations of the potential or of f_res (Lundin et al.).
  bool settled = false;        ///< True if the method stopped before its iteration limit.
};

}  // namespace palpate::methods
