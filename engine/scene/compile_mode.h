/// Private to engine, for .cpp files: compiles a mode's spec into the mode that a tick runs.
#pragma once

#include <string>

#include "palpate/engine/scene/graph.h"
#include "palpate/engine/scene/graph_reads.h"

namespace palpate {

/// A compiled mode, and the fields that must have data for it to act.
struct CompiledMode {
  Mode mode;         ///< Reads properties by their indices in GraphReads::graph.
  FieldSet support;  ///< Becomes ModeFields::support.
};

/// Compiles one mode. `path` is its path in the scene file, for messages. Adds the fields that the
/// mode reads to `reads` and to `reads.current`. Throws SceneError if `spec` is wrong.
[[nodiscard]] CompiledMode compileMode(const ModeSpec& spec, const std::string& path,
                                       GraphReads& reads);

/// Compiles a varying coupling stiffness. Throws SceneError if the stiffness can be 0 or exceed 1e9
/// N/m, if there is no factor, if a curve has no input, or if an input is not a known scalar.
[[nodiscard]] Transfer compileStiffness(const TransferSpec& spec, GraphReads& reads);

}  // namespace palpate
