#pragma once

#include <memory>
#include <string>

#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/scene_cache.h"

namespace palpate {

/// Throws SceneError if a sequence has a setting that is not allowed for sequences, an invalid
/// rate, both a rate and times, or neither.
void checkSequence(const SceneSpec& spec, const std::string& name);

[[nodiscard]] std::shared_ptr<const FrameSequence> openSequence(const SceneSpec& spec,
                                                                const std::string& name,
                                                                const Placement& placement,
                                                                SceneCache& cache);

/// Returns the playback of the scene's sequences. Throws SceneError.
[[nodiscard]] PlayParams playOf(const SceneSpec& spec, const BuiltScene& built);

/// Adds notes about sequences with one frame, with frames without data, or with too little memory
/// for the playback speed.
void noteSequences(const SceneSpec& spec, BuiltScene& built);

}  // namespace palpate
