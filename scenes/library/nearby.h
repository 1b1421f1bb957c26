/// Reduces a scene with parts to one graph with the parts near a hand.
#pragma once

#include <cstddef>
#include <set>

#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Returns the scene with the given parts (indices into Scene::parts) and the modes outside parts,
/// from `spec` and the scene `built` from it. If no other part is near, the forces are those of the
/// whole scene, except in ticks that end at the sub-step limit. Names in an instance end in its
/// number, such as "rock[7]". Volumes with instances that belong to no given part are at their
/// first place. Throws SceneError if the scene already uses the name of an instance. buildScene()
/// of the result throws if one graph cannot hold it: 64 volumes, 64 properties, 256 modes.
[[nodiscard]] SceneSpec nearby(const SceneSpec& spec, const BuiltScene& built,
                               const std::set<std::size_t>& parts);

}  // namespace palpate
