/// Reads what the user of a window requests. Another process writes the memory, so its content may
/// be anything; the results are always within their bounds.
#pragma once

#include <cstdint>
#include <vector>

#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/scenes/library/live.h"

namespace palpate::cli {

/// The requests that are new since the previous reading.
struct Asked {
  bool cut = false;  ///< The force must be cut.
  /// The force must be restored. Never set together with `cut`, which has priority.
  bool clear = false;
  bool closed = false;        ///< The user has closed the window.
  std::uint64_t dialled = 0;  ///< LiveWishes::dialled if the user has changed gains; else 0.
  /// If `dialled` is not 0, the gains of all modes, each from 0 to kMostDial.
  std::vector<LiveDial> dials;
};
[[nodiscard]] Asked asked(const LiveWishes& before, const LiveWishes& now);

/// Returns a hand that follows the mouse from `start` [m] on, through a low-pass filter and below
/// WatchLimits::max_speed. The filter is necessary because a mouse position jumps thirty times a
/// second. `mouse` must outlive the result.
[[nodiscard]] HandTarget behindMouse(const Published<LiveHand>& mouse, const Vec3& start);

}  // namespace palpate::cli
