/// Reports a volume in bricks.
#pragma once

#include "palpate/samplers/bricks/bricks.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {

/// Returns the report as docs/formats.md defines it.
[[nodiscard]] OrderedJson bricksJson(const BrickManifest& manifest);
/// Prints one line for each level and one for the total.
void sayBricks(const BrickManifest& manifest);

}  // namespace palpate::cli
