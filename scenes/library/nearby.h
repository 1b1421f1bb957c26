/// Scene subset: the parts that a hand comes near, as a scene of one graph that names each part.
#pragma once

#include <cstddef>
#include <set>

#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Returns the scene with the given parts only; modes outside of all parts stay. The forces are
/// those of the whole scene if no other part is near, except in ticks that end at the sub-step
/// limit. For an instance, the names of volumes, fields and modes end in its number, "rock[7]".
/// Other volumes with instances stand at one place only.
///
/// @param spec   Description from which `built` was built.
/// @param parts  Indices into Scene::parts.
///
/// Throws SceneError if a name of this form is already taken. buildScene() of the result throws if
/// one graph cannot hold it: 64 volumes, 64 properties, 256 modes.
[[nodiscard]] SceneSpec nearby(const SceneSpec& spec, const BuiltScene& built,
                               const std::set<std::size_t>& parts);

}  // namespace palpate
