/// Reduces a scene with parts to one graph that contains only given parts.
#pragma once

#include <cstddef>
#include <set>

#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Returns a scene with the given parts (indices into Scene::parts) and the modes outside parts.
/// `built` is the scene built from `spec`. If no other part is near, the forces are those of the
/// whole scene, except in ticks that end at the sub-step limit. Names in an instance end in its
/// number, such as "rock[7]". Volumes with instances that no given part contains are at their first
/// place. Throws SceneError if the scene already uses such a name. buildScene() of the result
/// throws if one graph cannot hold it: 64 volumes, 64 properties, 256 modes.
[[nodiscard]] SceneSpec nearby(const SceneSpec& spec, const BuiltScene& built,
                               const std::set<std::size_t>& parts);

}  // namespace palpate
