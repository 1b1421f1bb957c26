/// Writes the results of `palpate feel` and `palpate view`: files, report and exit status.
#pragma once

#include <optional>

#include "palpate/scenes/apps/cli/picture.h"
#include "palpate/scenes/apps/cli/session.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/library/build_scene.h"

namespace palpate::cli {

/// Output files of a run. They are opened before the run, so that a path that cannot be written
/// ends the program at once. Each file appears complete or not at all.
struct Outputs {
  explicit Outputs(const FeelOptions& options) {
    if (!options.picture.empty()) picture.emplace(options.picture);
    if (!options.still.empty()) still.emplace(pngName(options.still));
    if (!options.summary.empty()) summary.emplace(options.summary);
  }
  std::optional<Picture> picture;
  std::optional<WholeFile> still;
  std::optional<WholeFile> summary;
};

/// Returns the processor, the compiler and the build type, for summaries and recordings.
[[nodiscard]] OrderedJson machineJson();

/// Ends a run: completes recordings, prints results and draws pictures. Returns the exit status.
/// `run.scene` and `built` are the last scene of the run. `search` is the cost of the search for
/// the simulated hand's path; null if no hand was simulated.
[[nodiscard]] int conclude(const Run& run, const BuiltScene& built, const OrderedJson& search,
                           Outputs& outputs);

}  // namespace palpate::cli
