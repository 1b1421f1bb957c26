/// Private to scenes: the keys of a volume's place and motion in scene files.
#pragma once

#include "palpate/devices/json/json_table.h"
#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Reads a list of three numbers.
[[nodiscard]] JsonType<Vec3> vectorType();
/// Reads the place and the motion of a volume.
[[nodiscard]] JsonType<PlaceSpec> placeType();
/// Reads the place of an instance, which cannot move.
[[nodiscard]] JsonType<PlaceSpec> instanceType();

}  // namespace palpate
