/// Private to guesses and imports: vectors that a file stores as three scalars.
#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <vector>

namespace palpate {

/// Three arrays that are the x, y and z of a vector.
struct Components {
  std::string name;                  ///< Name of the vector: "Momentum" for Momentum_x, _y, _z.
  std::array<std::size_t, 3> parts;  ///< Indices into the list of names.
};

/// Finds vectors by the names of their components. These names differ in one letter only: x, y and
/// z, or u, v and w as separate words. So X Velocity, Velocity-y, MomZ, Uz, u and V_velocity are
/// components. Components of tensors (xx, xy, xz) and bare x, y, z, which are coordinates, are not.
[[nodiscard]] std::vector<Components> findComponents(const std::vector<std::string>& names);

}  // namespace palpate
