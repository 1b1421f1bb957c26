/// The properties of the volumes at one point, between the fields and the modes.
#pragma once

#include <array>

#include "palpate/engine/types.h"

namespace palpate {

/// Most scalars, and most vectors, that the modes of one scene may read.
inline constexpr int kMaxProperties = 64;

/// Step 1 of the paper's figure 1: what was sampled at the proxy, indexed by the small integers
/// that the graph hands out. Modes see nothing else of the volumes.
struct Properties {
  /// A scalar property where properties were read.
  struct Scalar {
    double value = 0.0;         ///< In the data's unit; of a volume not sampled its background.
    bool inside = false;        ///< False where there is no data.
    Vec3 slope = Vec3::Zero();  ///< Slope of the interpolated value [its unit / m], in W; zero
                                ///< where no mode's strength depends on the value or it is unknown.
  };
  /// A vector property where properties were read.
  struct Vector {
    Vec3 value = Vec3::Zero();     ///< In W; derivatives per unit of the data's own space.
    bool inside = false;           ///< False where there is no data.
    Mat3 jacobian = Mat3::Zero();  ///< J(i, j) = d value_i / d x_j [its unit / m], in W; zero for a
                                   ///< curl, and for a gradient that no primitive is along.
  };
  std::array<Scalar, kMaxProperties> scalars;  ///< As named in Graph::scalar_properties.
  std::array<Vector, kMaxProperties> vectors;  ///< As named in Graph::vector_properties.
  bool coarse =
      false;  ///< Some of them are of data coarser than their volume's, or of another moment's.
};

}  // namespace palpate
