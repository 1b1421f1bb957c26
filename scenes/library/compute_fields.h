#pragma once

#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/scene_cache.h"

namespace palpate {

/// Computes the derived fields whose derivatives a mode or another field needs, and adds them to
/// the volumes. Returns the graph without these fields; compileGraph checks this graph later.
/// Throws SceneError.
[[nodiscard]] GraphSpec computeFields(const SceneSpec& spec, BuiltScene& built, SceneCache& cache);

}  // namespace palpate
