#pragma once

#include <string>
#include <variant>
#include <vector>

#include "palpate/engine/error.h"
#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Returns a JSON path as errors show it, after the name of the scene if the scene has a name.
[[nodiscard]] std::string pathIn(const SceneSpec& spec, const std::string& path);

/// Returns the error for an unknown volume. Its remedy suggests the most similar of `names`, if one
/// is similar.
[[nodiscard]] SceneError unknownVolume(const std::string& path, const std::string& name,
                                       const std::vector<std::string>& names);

[[nodiscard]] inline bool isGiven(const FieldPtr& field) {
  return std::visit([](const auto& pointer) { return pointer != nullptr; }, field);
}

[[nodiscard]] bool isInBricks(const VolumeSpec& volume);

[[nodiscard]] bool isSequence(const VolumeSpec& volume);

/// Returns the sampling of a volume, with the slope_reach of the scene.
[[nodiscard]] Sampling samplingOf(const SceneSpec& spec, const std::string& name);

}  // namespace palpate
