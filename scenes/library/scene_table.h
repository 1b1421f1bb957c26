/// Private to scenes: describes all keys of a scene file as a table (devices/json/json_table.h).
#pragma once

#include "palpate/devices/json/json_table.h"
#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Returns the table that reads scene files and defines their schema. Names of files in the result
/// are as written in the scene file.
[[nodiscard]] const JsonObject<SceneSpec>& sceneTable();

/// Returns the whole schema: title, table and definitions.
[[nodiscard]] JsonSchema sceneTableSchema();

}  // namespace palpate
