/// Ends a run of `palpate feel` or `palpate view`: files, report and exit status.
#pragma once

#include <optional>

#include "palpate/scenes/apps/cli/picture.h"
#include "palpate/scenes/apps/cli/session.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/library/build_scene.h"

namespace palpate::cli {

/// Files of a run. They are opened before the run, so that a wrong path ends the program at once.
/// Each file is complete or absent.
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

/// Returns processor, compiler and build type, for summaries and recordings.
[[nodiscard]] OrderedJson machineJson();

/// Ends a run: completes recordings, prints results and draws pictures. Returns the exit status.
/// `run.scene` and `built` are as at the end of the run. `search`: cost of the simulated hand's
/// search; null if there was none.
[[nodiscard]] int conclude(const Run& run, const BuiltScene& built, const OrderedJson& search,
                           Outputs& outputs);

}  // namespace palpate::cli
