/// Private to scenes: the keys of a scene file as a table (devices/json/json_table.h).
#pragma once

#include "palpate/devices/json/json_table.h"
#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Table that reads a scene file and prints its schema. File names stay as in the scene file.
[[nodiscard]] const JsonObject<SceneSpec>& sceneTable();

/// Returns the whole schema: title, table and definitions.
[[nodiscard]] JsonSchema sceneTableSchema();

}  // namespace palpate
