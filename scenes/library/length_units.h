/// Private to scenes: the units of length in scene files.
#pragma once

#include <array>

namespace palpate {

/// A unit of length of scene files.
struct SceneUnit {
  const char* name = "";  ///< Word of the file, such as "mm".
  double metres = 0.0;    ///< Metres per unit.
};
/// All units, the largest first.
inline constexpr std::array<SceneUnit, 4> kSceneUnits{
    {{"m", 1.0}, {"cm", 1e-2}, {"mm", 1e-3}, {"um", 1e-6}}};

}  // namespace palpate
