/// Private to guesses and imports: vectors that a file keeps as three scalars.
#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <vector>

namespace palpate {

/// The x, y and z of a vector among other arrays.
struct Components {
  std::string name;                  ///< Of the vector: "Momentum" of Momentum_x, _y, _z.
  std::array<std::size_t, 3> parts;  ///< Where in the list they are.
};

/// Finds them by name: names that are alike but for one letter, which is x, y and z, or u, v and w
/// that stand alone. So X Velocity, Velocity-y, MomZ, Uz, u and V_velocity are components; tensors'
/// (xx, xy, xz) and bare x, y, z, which are places, are not.
[[nodiscard]] std::vector<Components> findComponents(const std::vector<std::string>& names);

}  // namespace palpate
