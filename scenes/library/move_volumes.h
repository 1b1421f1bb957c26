/// Motions of a scene's volumes: keyframes and warps.
#pragma once

#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/place_volumes.h"
#include "palpate/scenes/library/scene_cache.h"

namespace palpate {

/// Frames of the displacement volumes, by name.
using Displacements = std::map<std::string, std::vector<std::shared_ptr<const Volume>>>;

/// Returns the names of the displacement volumes. Throws SceneError for an unknown name.
[[nodiscard]] std::set<std::string> displacementNames(const SceneSpec& spec);

/// Throws SceneError if a mode or a field uses a displacement, or if a displacement moves.
void checkDisplacements(const SceneSpec& spec, const std::set<std::string>& names);

/// Returns the volumes' own motions. Throws SceneError.
[[nodiscard]] std::map<std::string, MotionPtr> ownMotions(const SceneSpec& spec,
                                                          const Displacements& displacements,
                                                          Placer& placer, SceneCache& cache);

/// Gives the motion of a moving volume to volumes placed like it and to fields computed from it.
/// All places are resolved, so "like" contains no unknown names and no circles.
void joinMotions(const SceneSpec& spec, BuiltScene& built);

}  // namespace palpate
