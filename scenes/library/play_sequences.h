/// Sequences of a scene, and how they are played.
#pragma once

#include <memory>
#include <string>

#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/scene_cache.h"

namespace palpate {

/// Throws SceneError if a sequence has a setting that sequences cannot have.
void checkSequence(const SceneSpec& spec, const std::string& name);

/// Opens a placed sequence. Throws VolumeError.
[[nodiscard]] std::shared_ptr<const FrameSequence> openSequence(const SceneSpec& spec,
                                                                const std::string& name,
                                                                const Placement& placement,
                                                                SceneCache& cache);

/// Returns how the scene's sequences are played. Throws SceneError.
[[nodiscard]] PlayParams playOf(const SceneSpec& spec, const BuiltScene& built);

/// Notes sequences of one frame, and sequences whose budget is too small for the speed of play.
void noteSequences(const SceneSpec& spec, BuiltScene& built);

}  // namespace palpate
