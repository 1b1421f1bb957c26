/// Prints the explanation of a tick.
#pragma once

#include "palpate/scenes/apps/common/explain_tick.h"

namespace palpate::cli {

/// Prints an explanation as text or JSON. Returns the exit status.
[[nodiscard]] int sayExplained(const Explained& told, bool json);

}  // namespace palpate::cli
