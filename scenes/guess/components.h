/// Private to scene guesses and imports: finds vectors whose components a file stores as three
/// scalars.
#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <vector>

namespace palpate {

/// Three arrays that are the components x, y and z of a vector.
struct Components {
  /// Name of the vector, for example "Momentum" for Momentum_x, Momentum_y and Momentum_z.
  std::string name;
  std::array<std::size_t, 3> parts;  ///< Indices of the components in the list of names.
};

/// Finds vectors by the names of their components. The three names differ in one letter only: x, y
/// and z, or u, v and w if that letter stands alone. Examples are X Velocity, Velocity-y, MomZ, Uz,
/// u and V_velocity. Components of a tensor (xx, xy, xz) do not count, and neither do the bare
/// names x, y, z, which are coordinates.
[[nodiscard]] std::vector<Components> findComponents(const std::vector<std::string>& names);

}  // namespace palpate
