/// What a volume in bricks says of itself.
#pragma once

#include "palpate/samplers/bricks.h"
#include "palpate/scenes/cli/common.h"

namespace palpate::cli {

/// As docs/formats.md has it.
[[nodiscard]] OrderedJson bricksJson(const BrickManifest& manifest);
/// A line a level, and one of all.
void sayBricks(const BrickManifest& manifest);

}  // namespace palpate::cli
