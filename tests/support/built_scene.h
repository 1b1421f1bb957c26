/// Builds scenes for tests from JSON, as palpate builds them from a scene file.
#pragma once

#include <filesystem>
#include <string>

#include <nlohmann/json.hpp>

#include "palpate/engine/error.h"
#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/scene_cache.h"
#include "palpate/scenes/library/scene_file.h"

namespace palpate::test {

inline BuiltScene built(const nlohmann::json& scene, const std::filesystem::path& folder,
                        SceneCache* cache = nullptr) {
  return buildScene(parseScene(scene.dump(), "scene.json", folder), nullptr, cache);
}

/// Builds a scene. Returns the message of the Error that this throws; "taken" if it throws none.
inline std::string refusal(const nlohmann::json& scene, const std::filesystem::path& folder) {
  try {
    (void)built(scene, folder);
  } catch (const Error& e) {
    return e.what();
  }
  return "taken";
}

}  // namespace palpate::test
