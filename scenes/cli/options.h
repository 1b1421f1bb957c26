/// The options of a command line as data, for completion.
#pragma once

#include "palpate/scenes/cli/common.h"

namespace palpate::cli {

/// The hidden option with which palpate-import prints optionsOf() itself.
inline constexpr const char* kOptionsOption = "--options";

/// An array: of each its `names` (of what stands at its place none), `what` it is, what it `takes`
/// (FLOAT, TEXT, ...; the name of what stands at its place; of a flag null), the `values` that it
/// may have (empty: any), and whether it may be given `again`.
[[nodiscard]] OrderedJson optionsOf(const CLI::App& app);

}  // namespace palpate::cli
