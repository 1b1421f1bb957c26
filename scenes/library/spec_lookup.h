/// Finds items in the description of a scene. Several steps of buildScene() use these functions.
#pragma once

#include <string>
#include <variant>
#include <vector>

#include "palpate/engine/error.h"
#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Returns a JSON path as errors show it, preceded by the name of the scene file if there is one.
[[nodiscard]] std::string pathIn(const SceneSpec& spec, const std::string& path);

/// Returns the error for a volume's name that is not in `names`. Its remedy suggests the most
/// similar name.
[[nodiscard]] SceneError unknownVolume(const std::string& path, const std::string& name,
                                       const std::vector<std::string>& names);

/// Returns true if the field is not null.
[[nodiscard]] inline bool isGiven(const FieldPtr& field) {
  return std::visit([](const auto& pointer) { return pointer != nullptr; }, field);
}

/// Returns true if the volume is read from bricks.
[[nodiscard]] bool isInBricks(const VolumeSpec& volume);

/// Returns true if the volume is a sequence.
[[nodiscard]] bool isSequence(const VolumeSpec& volume);

/// Returns the sampling of a volume, with the slope_reach of the scene.
[[nodiscard]] Sampling samplingOf(const SceneSpec& spec, const std::string& name);

}  // namespace palpate
