/// Modes that are turned up, down and off while they are felt: which they are, and what that makes
/// of a scene.
#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include "palpate/scenes/build_scene.h"
#include "palpate/scenes/live.h"

namespace palpate::cli {

/// Who the modes of a scene are, by their numbers: see LiveDial.
struct ModeIds {
  std::vector<std::uint32_t> of;  ///< Of each mode.
  std::uint32_t next = 0;         ///< That no mode has had.
};
/// Of a scene that is the first.
[[nodiscard]] ModeIds idsOf(const SceneSpec& spec);
/// Of a scene that was edited. A mode is the same where it has the same name, or none and is of the
/// same kind and volume; of several such by their order, where there are as many as before. Else it
/// is a new one.
[[nodiscard]] ModeIds idsOf(const SceneSpec& edited, const SceneSpec& before, const ModeIds& ids);

/// Factors by who the modes are; 1 where there is none.
using Dials = std::map<std::uint32_t, float>;
/// The same by the modes' numbers.
[[nodiscard]] std::vector<LiveDial> inOrder(const Dials& dials, const ModeIds& ids);

/// Multiplies what each mode holds with, its strength and its viscosity, by a factor: the scene is
/// then the one that has these written in its file. By 0 it is next to nothing, so that the hand
/// feels a scene of the same modes. `dials`: by the modes' numbers.
void dial(SceneSpec& spec, const std::vector<LiveDial>& dials);

}  // namespace palpate::cli
