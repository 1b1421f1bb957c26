/// Lines along a vector field, read where they go.
#pragma once

#include <vector>

#include "palpate/engine/field.h"

namespace palpate::view {

/// What of a vector field is meant.
enum class Along : std::uint8_t {
  kValue,  ///< Itself.
  kCurl,   ///< Its curl: vortices turn about such lines.
};

/// That vector at a place, zero where there are no data.
[[nodiscard]] Vec3 vectorAt(const VectorField& field, Along along, const Vec3& p,
                            FieldCache& cache);

/// The line through a place, both ways, at most `length` each [m]; empty where there is none. A
/// vector's sign is that of the one before it: axes are followed as arrows are.
[[nodiscard]] std::vector<Vec3> lineThrough(const VectorField& field, Along along, const Vec3& p,
                                            double length);

}  // namespace palpate::view
