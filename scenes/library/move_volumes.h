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

/// Frames of the displacement fields, by the names of their volumes.
using Displacements = std::map<std::string, std::vector<std::shared_ptr<const Volume>>>;

/// Returns the names of the displacement fields. Throws SceneError for an unknown name.
[[nodiscard]] std::set<std::string> displacementNames(const SceneSpec& spec);

/// Throws SceneError if a mode, a guide, a field or the coupling reads a displacement field. Also
/// throws if a displacement field moves, has instances or is a sequence. `names` are those from
/// displacementNames().
void checkDisplacements(const SceneSpec& spec, const std::set<std::string>& names);

/// Returns the motions that volumes define themselves, not by `like`. Throws SceneError.
[[nodiscard]] std::map<std::string, MotionPtr> ownMotions(const SceneSpec& spec,
                                                          const Displacements& displacements,
                                                          Placer& placer, SceneCache& cache);

/// Copies a volume's motion to the volumes that are placed like it and to the fields computed from
/// it. Call joinMotions() after Placer has resolved all places: then "like" has no unknown names
/// and no circles.
void joinMotions(const SceneSpec& spec, BuiltScene& built);

}  // namespace palpate
