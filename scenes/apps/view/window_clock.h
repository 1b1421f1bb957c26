/// Private to scenes/apps/view: clocks of the window.
#pragma once

#include <chrono>

namespace palpate::view {

/// Returns the time since a moment [s].
[[nodiscard]] double secondsSince(std::chrono::steady_clock::time_point since);
/// Returns the CPU time of this process, in all threads [s].
[[nodiscard]] double cpu();

}  // namespace palpate::view
