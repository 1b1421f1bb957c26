/// Reports the content of a volume in bricks, for `palpate info`.
#pragma once

#include "palpate/samplers/bricks/bricks.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {

/// Returns the report as JSON (docs/formats.md).
[[nodiscard]] OrderedJson bricksJson(const BrickManifest& manifest);
/// Prints the levels and the size of the bricks as text.
void sayBricks(const BrickManifest& manifest);

}  // namespace palpate::cli
