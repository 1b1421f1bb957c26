/// A method without a proxy: the force functions, which Lundin et al. list first in section 1.
#pragma once

#include <span>

#include "palpate/bench/methods/method.h"

namespace palpate::methods {

/// Returns the sum of the primitives' forces, eqs (8), (9), (11) and (13), at the probe, f = sum
/// f_i(probe), as the offset f/k.
///
/// The primitives replace the different force functions of the papers that section 1 cites. The
/// answer equals the balance only if no kink lies between probe and proxy. The force jumps at a
/// kink, which is the instability that section 1 describes.
///
/// @param probe       Hand position [m].
/// @param stiffness   k [N/m], > 0; sets only the unit of the answer.
/// @param start       Not used, because the method has no memory.
[[nodiscard]] Balance forceFunction(const Vec3& probe, double stiffness,
                                    std::span<const Primitive> primitives,
                                    const Vec3& start) noexcept;

}  // namespace palpate::methods
