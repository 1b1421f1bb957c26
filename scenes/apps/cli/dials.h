/// Gains of modes that the user changes during a run: how modes keep their identity when a scene is
/// edited, and how gains change a scene.
#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/live.h"

namespace palpate::cli {

/// Identities of a scene's modes, by their numbers: see LiveDial.
struct ModeIds {
  std::vector<std::uint32_t> of;  ///< Identity of each mode.
  std::uint32_t next = 0;         ///< First unused identity.
};
/// Returns identities for a first scene.
[[nodiscard]] ModeIds idsOf(const SceneSpec& spec);
/// Returns identities for an edited scene. A mode keeps its identity if it has the same name, or
/// has no name and has the same kind and volume. If several modes match, their order decides,
/// provided that there are as many as before. Otherwise the mode is new.
[[nodiscard]] ModeIds idsOf(const SceneSpec& edited, const SceneSpec& before, const ModeIds& ids);

/// Gains by the modes' identities; 1 if absent.
using Dials = std::map<std::uint32_t, float>;
/// Returns the gains in the order of the modes' numbers.
[[nodiscard]] std::vector<LiveDial> inOrder(const Dials& dials, const ModeIds& ids);

/// Multiplies each mode's strength and viscosity by a gain. The scene is then the same as if its
/// file had these values. A gain of 0 leaves a tiny strength, so that the scene keeps its modes.
/// `dials`: by the modes' numbers.
void dial(SceneSpec& spec, const std::vector<LiveDial>& dials);

}  // namespace palpate::cli
