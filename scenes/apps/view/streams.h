/// Computes lines along a vector field.
#pragma once

#include <vector>

#include "palpate/engine/field/field.h"

namespace palpate::view {

/// The vector that a line follows.
enum class Along : std::uint8_t {
  kValue,  ///< The vector of the field.
  kCurl,   ///< The curl of the field. Vortices turn about these lines.
};

/// Returns the vector at a place; zero where data are missing.
[[nodiscard]] Vec3 vectorAt(const VectorField& field, Along along, const Vec3& p,
                            FieldCache& cache);

/// Returns a line through a place, at most `length` [m] in each direction. Returns an empty line if
/// the vector is zero there. Each vector gets the sign that agrees with the previous vector, so
/// that vectors without a sign can be followed too.
[[nodiscard]] std::vector<Vec3> lineThrough(const VectorField& field, Along along, const Vec3& p,
                                            double length);

}  // namespace palpate::view
