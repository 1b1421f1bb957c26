/// Writes the results of `palpate feel` and `palpate view`.
#pragma once

#include <optional>

#include "palpate/scenes/apps/cli/picture.h"
#include "palpate/scenes/apps/cli/session.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/library/build_scene.h"

namespace palpate::cli {

/// Output files, opened before the run. Each file appears complete or not at all.
struct Outputs {
  explicit Outputs(const FeelOptions& options) {
    if (!options.picture.file.empty()) picture.emplace(options.picture);
    if (!options.still.empty()) still.emplace(pngName(options.still));
    if (!options.summary.empty()) summary.emplace(options.summary);
  }
  std::optional<Picture> picture;
  std::optional<WholeFile> still;
  std::optional<WholeFile> summary;
};

/// Returns the processor, its number of logical cores, the compiler and the build type.
[[nodiscard]] OrderedJson machineJson();

/// Completes recordings, prints results and draws pictures. Returns the exit status. `run.scene`
/// and `built` belong to the first scene of the run. After an edit, pictures show the latest scene.
/// `search` is the cost of finding the hand's path, or null.
[[nodiscard]] int conclude(const Run& run, const BuiltScene& built, const OrderedJson& search,
                           Outputs& outputs);

}  // namespace palpate::cli
