/// Gains: factors by which the user changes modes during a run. A gain stays with its mode when the
/// scene is edited.
#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/live.h"

namespace palpate::cli {

/// Identities of a scene's modes (LiveDial::mode), in the scene's order of modes.
struct ModeIds {
  std::vector<std::uint32_t> of;
  std::uint32_t next = 0;
};
[[nodiscard]] ModeIds idsOf(const SceneSpec& spec);
/// Returns identities for an edited scene. A mode keeps the identity of the mode in `before` with
/// the same name or, without a name, with the same kind and volume. Several matches are paired in
/// order if both scenes have equally many. All other modes get new identities.
[[nodiscard]] ModeIds idsOf(const SceneSpec& edited, const SceneSpec& before, const ModeIds& ids);

/// Gains by the modes' identities. A mode without an entry has gain 1.
using Dials = std::map<std::uint32_t, float>;
[[nodiscard]] std::vector<LiveDial> inOrder(const Dials& dials, const ModeIds& ids);

/// Multiplies the strength and viscosity of each mode, except user-defined modes, by its gain.
/// `dials` is in the order of the modes. A gain of 0 gives a very small strength, so that the mode
/// remains in the scene.
void dial(SceneSpec& spec, const std::vector<LiveDial>& dials);

}  // namespace palpate::cli
