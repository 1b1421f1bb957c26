/// What can be felt of diffusion tensors.
#pragma once

#include <array>

#include "palpate/engine/types.h"
#include "palpate/scenes/import/reader.h"

namespace palpate::importer {

/// Of one tensor.
struct Diffusion {
  Vec3 direction = Vec3::Zero();  ///< Unit; its sign means nothing: the first component is > 0.
  double anisotropy = 0.0;        ///< Fractional, 0 (a ball) to 1 (a line).
  double diffusivity = 0.0;       ///< Mean: a third of the trace.
};

/// Of D's symmetric part, with the eigenvalues a >= b >= c:
///   direction    of a; of components that are 0 the next one is > 0;
///   anisotropy   sqrt(1/2) sqrt((a-b)^2 + (b-c)^2 + (c-a)^2) / sqrt(a^2 + b^2 + c^2)
///                (Basser & Pierpaoli 1996); negative eigenvalues, which are noise, count as 0
///                there, as is common, so that it stays within 0 and 1;
///   diffusivity  (a + b + c) / 3, with the negative ones as they are.
/// All zero for a tensor that is zero or not finite; no direction where a = c, or a <= 0.
[[nodiscard]] Diffusion diffusionOf(const Mat3& D);

/// The same for an array of tensors, 9 components row by row or 6 in VTK's order: NAME_direction,
/// NAME_anisotropy and NAME_diffusivity, as floats.
[[nodiscard]] std::array<Array, 3> diffusionOf(const Array& tensors);

}  // namespace palpate::importer
