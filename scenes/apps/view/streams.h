/// Computes lines along a vector field.
#pragma once

#include <vector>

#include "palpate/engine/field/field.h"

namespace palpate::view {

enum class Along : std::uint8_t {
  kValue,
  kCurl,  ///< The curl of the field. Vortices turn about these lines.
};

/// Returns the vector at p [m]; zero where data are missing.
[[nodiscard]] Vec3 vectorAt(const VectorField& field, Along along, const Vec3& p,
                            FieldCache& cache);

/// Returns a line through p, at most `length` [m] in each direction; empty if the vector is zero.
/// Each vector gets the sign nearest to the previous one, because axial vectors have no sign.
[[nodiscard]] std::vector<Vec3> lineThrough(const VectorField& field, Along along, const Vec3& p,
                                            double length);

}  // namespace palpate::view
