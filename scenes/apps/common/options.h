/// Options of a command line as data, for completion.
#pragma once

#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {

/// Hidden option with which palpate-import prints its own optionsOf().
inline constexpr const char* kOptionsOption = "--options";

/// Returns an array with an entry per option: its `names` (empty for a positional argument), `what`
/// it is, what it `takes` (FLOAT, TEXT, ...; the name of a positional argument; null for a flag),
/// its possible `values` (empty: any), and whether it may be given `again`.
[[nodiscard]] OrderedJson optionsOf(const CLI::App& app);

}  // namespace palpate::cli
