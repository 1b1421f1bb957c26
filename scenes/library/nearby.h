/// Reduces a scene with parts to the parts near a hand, as a scene with one graph. Instances get
/// names.
#pragma once

#include <cstddef>
#include <set>

#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Returns the scene with the modes that are in no part and with the given parts. The result has
/// the same forces as the whole scene if no other part is near, except in ticks that end at the
/// sub-step limit. In parts that are instances, names of volumes, fields and modes end in the
/// number of the instance, such as "rock[7]". Volumes with instances that belong to no given part
/// are at their first place.
///
/// @param spec   Description from which `built` was built.
/// @param parts  Indices into Scene::parts.
///
/// Throws SceneError if the scene already uses such a name. buildScene() of the result throws if
/// one graph cannot hold it: 64 volumes, 64 properties, 256 modes.
[[nodiscard]] SceneSpec nearby(const SceneSpec& spec, const BuiltScene& built,
                               const std::set<std::size_t>& parts);

}  // namespace palpate
