/// The properties of the volumes at one point. Fields provide them, and modes read them.
#pragma once

#include <array>

#include "palpate/engine/types.h"

namespace palpate {

/// Largest number of scalars, and also of vectors, that one graph may read.
inline constexpr int kMaxProperties = 64;

/// Properties from one reading: step 1 of figure 1 in Lundin et al.
struct Properties {
  /// A scalar property at the place of the reading.
  struct Scalar {
    /// Value in the data's unit; for a derived scalar, in the unit of its formula. If the volume
    /// was not sampled: the background of a scalar volume, else zero.
    double value = 0.0;
    bool inside = false;        ///< True if there are data here.
    Vec3 slope = Vec3::Zero();  ///< Slope of the interpolated value [its unit / m], in W; zero if
                                ///< unknown or not needed.
  };
  /// A vector property at the place of the reading.
  struct Vector {
    /// Value in W, in the data's unit. Gradients and curls are per unit of the data's space.
    Vec3 value = Vec3::Zero();
    bool inside = false;  ///< True if there are data here.
    Mat3 jacobian =
        Mat3::Zero();  ///< J(i, j) = d value_i / d x_j [its unit / m], in W. Zero for a curl, for a
                       ///< cell gradient, and for a gradient that no primitive follows.
  };
  std::array<Scalar, kMaxProperties> scalars;  ///< Graph::scalar_properties has their names.
  std::array<Vector, kMaxProperties> vectors;  ///< Graph::vector_properties has their names.
  /// True if coarser data, or data of another time, replaced missing data in the last reading.
  bool coarse = false;
};

}  // namespace palpate
