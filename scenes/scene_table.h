/// Private to scenes: what a scene file may say, as a table (devices/json_table.h).
#pragma once

#include "palpate/devices/json_table.h"
#include "palpate/scenes/build_scene.h"

namespace palpate {

/// Reads a scene file and prints its schema. Files are named as the scene file names them.
[[nodiscard]] const JsonObject<SceneSpec>& sceneTable();

/// The whole schema: title, table and definitions.
[[nodiscard]] JsonSchema sceneTableSchema();

}  // namespace palpate
