/// Private to engine: from a mode as it was asked for to one that ticks. Include it in .cpp files
/// only.
#pragma once

#include <string>

#include "palpate/engine/graph.h"
#include "palpate/engine/graph_reads.h"

namespace palpate {

/// A compiled mode, and what must be there for it to act.
struct CompiledMode {
  Mode mode;
  FieldSet support;
};

/// `path`: of the mode in the scene file, for errors. What it reads is added to `reads`; which of
/// it is this mode's is in `reads.current`. Throws SceneError.
[[nodiscard]] CompiledMode compileMode(const ModeSpec& spec, const std::string& path,
                                       GraphReads& reads);

/// The stiffness of a scene whose properties set it, "/coupling/stiffness". Throws SceneError.
[[nodiscard]] Transfer compileStiffness(const TransferSpec& spec, GraphReads& reads);

}  // namespace palpate
