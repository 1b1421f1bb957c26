/// Runs `palpate feel`, `palpate view` and `palpate explain --until`.
#pragma once

#include "palpate/scenes/apps/cli/session.h"

namespace palpate::cli {

/// Runs the hands and prints the results. With FeelOptions::until, explains the first hand's last
/// tick instead. Returns the exit status. Throws Error.
[[nodiscard]] int feel(FeelOptions options);

/// Adds the option --rate, which also sets FeelOptions::rate_given.
void addRate(CLI::App& verb, FeelOptions& options);

}  // namespace palpate::cli
