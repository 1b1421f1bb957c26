/// What a hand comes near in a scene of parts, as a scene of one graph, which tells of each by
/// name.
#pragma once

#include <cstddef>
#include <set>

#include "palpate/scenes/build_scene.h"

namespace palpate {

/// What is always there and these parts of a scene, without the others: the same forces where no
/// other is near, but where a tick ends at its sub-step limit. Of an instance, names of volumes,
/// fields and modes end in its number, "rock[7]"; what stands nowhere near stands once.
///
/// @param spec   What `built` was built from.
/// @param parts  Indices into Scene::parts.
///
/// Throws SceneError where something else has such a name. buildScene() of it does where it is more
/// than one graph holds: 64 volumes, 64 properties, 256 modes.
[[nodiscard]] SceneSpec nearby(const SceneSpec& spec, const BuiltScene& built,
                               const std::set<std::size_t>& parts);

}  // namespace palpate
