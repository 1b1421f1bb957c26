/// Derives scalars and vectors from diffusion tensors, because modes cannot read tensors.
#pragma once

#include <array>

#include "palpate/engine/types.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

struct Diffusion {
  /// Unit vector, whose sign has no meaning. The first component that is not 0 is positive.
  Vec3 direction = Vec3::Zero();
  /// Fractional anisotropy, from 0 (equal in all directions) to 1 (diffusion only along a line).
  double anisotropy = 0.0;
  double diffusivity = 0.0;  ///< Mean diffusivity: a third of the trace.
};

/// Derives quantities from the symmetric part of D with the eigenvalues a >= b >= c:
///   direction    eigenvector of a; its first component that is not 0 is positive;
///   anisotropy   sqrt(1/2) sqrt((a-b)^2 + (b-c)^2 + (c-a)^2) / sqrt(a^2 + b^2 + c^2)
///                (Basser & Pierpaoli 1996). Negative eigenvalues are due to noise. Here they
///                count as 0, so that the anisotropy lies between 0 and 1;
///   diffusivity  (a + b + c) / 3, with negative eigenvalues unchanged.
/// All quantities are zero for a tensor that is zero or not finite. The direction is zero if a and
/// c are equal to within 1e-6 a, or if a <= 0.
[[nodiscard]] Diffusion diffusionOf(const Mat3& D);

/// Derives NAME_direction, NAME_anisotropy and NAME_diffusivity from tensors with 9 components, row
/// by row, or 6 in VTK's order.
[[nodiscard]] std::array<Array, 3> diffusionOf(const Array& tensors);

}  // namespace palpate::importer
