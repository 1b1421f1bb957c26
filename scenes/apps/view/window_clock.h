/// Private to scenes/apps/view: times that measure the cost of drawing.
#pragma once

#include <chrono>

namespace palpate::view {

/// Returns the time since `since` [s].
[[nodiscard]] double secondsSince(std::chrono::steady_clock::time_point since);
/// Returns the CPU time that all threads of this process have used [s].
[[nodiscard]] double cpu();

}  // namespace palpate::view
