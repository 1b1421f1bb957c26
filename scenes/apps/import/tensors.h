/// Derives scalars and vectors from diffusion tensors, for haptics.
#pragma once

#include <array>

#include "palpate/engine/types.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Properties of one tensor.
struct Diffusion {
  Vec3 direction = Vec3::Zero();  ///< Unit; the sign has no meaning: the first component is > 0.
  double anisotropy = 0.0;        ///< Fractional, 0 (a ball) to 1 (a line).
  double diffusivity = 0.0;       ///< Mean: a third of the trace.
};

/// Evaluates D's symmetric part, with the eigenvalues a >= b >= c:
///   direction    of a; if the first component is 0, the next one is > 0, and so on;
///   anisotropy   sqrt(1/2) sqrt((a-b)^2 + (b-c)^2 + (c-a)^2) / sqrt(a^2 + b^2 + c^2)
///                (Basser & Pierpaoli 1996); negative eigenvalues, which are noise, count as 0
///                there, as is common, so that it stays within 0 and 1;
///   diffusivity  (a + b + c) / 3, with negative eigenvalues unchanged.
/// All are zero for a tensor that is zero or not finite. The direction is zero if a = c or a <= 0.
[[nodiscard]] Diffusion diffusionOf(const Mat3& D);

/// Evaluates an array of tensors, 9 components row by row or 6 in VTK's order. Returns
/// NAME_direction, NAME_anisotropy and NAME_diffusivity, as floats.
[[nodiscard]] std::array<Array, 3> diffusionOf(const Array& tensors);

}  // namespace palpate::importer
