/// Scenes as their files would make them, for the tests of scenes.
#pragma once

#include <filesystem>
#include <string>

#include <nlohmann/json.hpp>

#include "palpate/engine/error.h"
#include "palpate/scenes/build_scene.h"
#include "palpate/scenes/scene_cache.h"
#include "palpate/scenes/scene_file.h"

namespace palpate::test {

inline BuiltScene built(const nlohmann::json& scene, const std::filesystem::path& folder,
                        SceneCache* cache = nullptr) {
  return buildScene(parseScene(scene.dump(), "scene.json", folder), nullptr, cache);
}

/// Why a scene is not built; "taken": it is.
inline std::string refusal(const nlohmann::json& scene, const std::filesystem::path& folder) {
  try {
    (void)built(scene, folder);
  } catch (const Error& e) {
    return e.what();
  }
  return "taken";
}

}  // namespace palpate::test
