/// Private to scene guesses and imports: finds vectors that a file stores as three scalars.
#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <vector>

namespace palpate {

struct Components {
  /// Name of the vector, for example "Momentum" for Momentum_x, Momentum_y and Momentum_z.
  std::string name;
  std::array<std::size_t, 3> parts;  ///< Indices of the components in the list of names.
};

/// Finds vectors by the names of their components, which differ in one letter: x, y and z, or u, v
/// and w if the letter is separate (X Velocity, MomZ, Uz, u, V_velocity). Ignores components of
/// tensors (xx, xy, xz), and the coordinates x, y and z.
[[nodiscard]] std::vector<Components> findComponents(const std::vector<std::string>& names);

}  // namespace palpate
