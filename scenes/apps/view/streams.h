/// Traces lines along a vector field.
#pragma once

#include <vector>

#include "palpate/engine/field/field.h"

namespace palpate::view {

/// The vector of a field that a line follows.
enum class Along : std::uint8_t {
  kValue,  ///< The field's value.
  kCurl,   ///< Its curl: vortices turn about these lines.
};

/// Returns that vector at a place; zero where data are missing.
[[nodiscard]] Vec3 vectorAt(const VectorField& field, Along along, const Vec3& p,
                            FieldCache& cache);

/// Returns the line through a place, in both directions, at most `length` in each [m]; empty if the
/// vector there is zero. The sign of a vector is chosen to agree with the vector before it: axes
/// are followed like arrows.
[[nodiscard]] std::vector<Vec3> lineThrough(const VectorField& field, Along along, const Vec3& p,
                                            double length);

}  // namespace palpate::view
