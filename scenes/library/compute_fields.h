/// Computes derived fields when a scene is built.
#pragma once

#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/scene_cache.h"

namespace palpate {

/// Computes the derived fields whose own derivatives a mode or another field needs, and adds them
/// to the volumes. Returns the graph without these fields; its remaining fields are derived in each
/// tick. Throws SceneError. Errors in the definitions of fields are reported when the graph is
/// compiled.
[[nodiscard]] GraphSpec computeFields(const SceneSpec& spec, BuiltScene& built, SceneCache& cache);

}  // namespace palpate
