/// Reduces a scene with parts to one graph that contains only the given parts.
#pragma once

#include <cstddef>
#include <set>

#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Returns a scene with the given parts (indices into Scene::parts) and the modes outside parts.
/// `built` is the scene built from `spec`. If the hand is near no other part, the forces equal
/// those of the whole scene, except in ticks that end at the sub-step limit. The name of a volume,
/// field or mode in an instance ends in the instance's number, such as "rock[7]". Throws SceneError
/// if the scene already uses such a name. A volume with instances that the result needs outside the
/// given parts is at its first place. buildScene() rejects a result beyond the limits of one graph:
/// 64 volumes, 64 properties, 256 modes.
[[nodiscard]] SceneSpec nearby(const SceneSpec& spec, const BuiltScene& built,
                               const std::set<std::size_t>& parts);

}  // namespace palpate
