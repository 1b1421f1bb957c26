/// Gains: factors by which the user changes modes during a run. A gain stays with its mode when the
/// scene is edited.
#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/live.h"

namespace palpate::cli {

/// Identities of a scene's modes (LiveDial::mode), in the order of the modes.
struct ModeIds {
  std::vector<std::uint32_t> of;  ///< Identity of each mode.
  std::uint32_t next = 0;         ///< First identity that no mode has had.
};
/// Returns the identities for the first scene of a run.
[[nodiscard]] ModeIds idsOf(const SceneSpec& spec);
/// Returns identities for an edited scene. A mode keeps its identity if a mode of `before` has the
/// same name, or if both have no name and the same kind and volume. If several modes match, their
/// order decides, provided that both scenes have equally many of them. Otherwise the mode gets a
/// new identity.
[[nodiscard]] ModeIds idsOf(const SceneSpec& edited, const SceneSpec& before, const ModeIds& ids);

/// Gains by the modes' identities. A mode without an entry has gain 1.
using Dials = std::map<std::uint32_t, float>;
/// Returns the gains in the order of the modes.
[[nodiscard]] std::vector<LiveDial> inOrder(const Dials& dials, const ModeIds& ids);

/// Multiplies each mode's strength and viscosity by its gain, as if the scene file had these
/// values. If the gain is 0, the strength becomes very small instead, so that the scene keeps the
/// mode. `dials` is in the order of the modes.
void dial(SceneSpec& spec, const std::vector<LiveDial>& dials);

}  // namespace palpate::cli
