/// Derived fields that are computed at load.
#pragma once

#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/scene_cache.h"

namespace palpate {

/// Computes the derived fields whose own derivatives are needed, and adds them to the volumes.
/// Returns the graph without these fields; the rest is derived in each tick. The graph reports
/// errors in fields. Throws SceneError.
[[nodiscard]] GraphSpec computeFields(const SceneSpec& spec, BuiltScene& built, SceneCache& cache);

}  // namespace palpate
