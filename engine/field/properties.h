/// The properties of the volumes at one point, between the fields and the modes.
#pragma once

#include <array>

#include "palpate/engine/types.h"

namespace palpate {

/// Largest number of scalars, and of vectors, that the modes of one scene may read.
inline constexpr int kMaxProperties = 64;

/// Properties sampled at the proxy, step 1 of the paper's figure 1, by the small indices that the
/// graph assigns. Modes read no other data of the volumes.
struct Properties {
  /// A scalar property where properties were read.
  struct Scalar {
    double value = 0.0;         ///< Value in the data's unit; the background if the volume was not
                                ///< sampled.
    bool inside = false;        ///< False where there is no data.
    Vec3 slope = Vec3::Zero();  ///< Slope of the interpolated value [its unit / m], in W; zero if
                                ///< no mode's strength depends on the value or it is unknown.
  };
  /// A vector property where properties were read.
  struct Vector {
    Vec3 value = Vec3::Zero();     ///< Value in W; derivatives per unit of the data's own space.
    bool inside = false;           ///< False where there is no data.
    Mat3 jacobian = Mat3::Zero();  ///< J(i, j) = d value_i / d x_j [its unit / m], in W; zero for a
                                   ///< curl, and for a gradient without a primitive along it.
  };
  std::array<Scalar, kMaxProperties> scalars;  ///< Named in Graph::scalar_properties.
  std::array<Vector, kMaxProperties> vectors;  ///< Named in Graph::vector_properties.
  bool coarse =
      false;  ///< Some are from data coarser than their volume's, or from data of another moment.
};

}  // namespace palpate
